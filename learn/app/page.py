"""The page itself: its three tabs, and the server that serves it.

Nothing is sent anywhere: fonts are the system's, analytics are off, and the server listens on this
computer alone unless another address is given.
"""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from learn.app import gallery
from learn.app.background_decomposition import Network
from learn.app.download_tab import DownloadTab
from learn.app.event_handling import QUIET
from learn.app.material_tab import MaterialTab
from learn.app.object_tab import ObjectTab
from learn.app.offline_gradio import gr
from learn.app.session import MOST_BYTES, Session
from learn.app.sessions import MOST_SESSIONS, Sessions
from manifests import files
from manifests.errors import InputError

TITLE = "Edit a photograph"
DELETE_AFTER = (300, 1800)  # seconds: how often to look for files of pages long closed, their age
CSS = """
:root {--block-info-text-color: #595959; --body-text-color-subdued: #595959}
.dark {--block-info-text-color: #b4b4b4; --body-text-color-subdued: #b4b4b4}
.gradio-container {max-width: 1240px !important; width: 100%; margin: auto !important;
  overflow: clip !important}
.gradio-container main {width: 100%; max-width: 100% !important}
#marking button {cursor: crosshair}
#materials .tiles {display: grid; grid-template-columns: repeat(auto-fill, minmax(84px, 1fr));
  gap: 4px; max-height: 300px; overflow-y: auto; contain: content}
#materials button {display: flex; flex-direction: column; align-items: center; padding: 2px;
  border: 2px solid transparent; border-radius: 4px; background: none; cursor: pointer}
#materials button:hover, #materials button:focus-visible {border-color: var(--color-accent)}
#materials .picture {width: 80px; height: 80px}
#materials .caption, #materials .note {font-size: 11px; line-height: 1.15; text-align: center;
  overflow-wrap: anywhere}
#materials .note {font-weight: normal}
#stayed, .form:has(> #key) {display: none}
/* a message says what did not work; Gradio's own sign would cover the open photograph */
[data-testid=status-tracker]:has(.error) {display: none !important}
#kept .tiles {display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr));
  gap: 8px; max-height: none}
#kept figure {margin: 0}
#kept img {width: 100%; border-radius: 4px}
#kept button {cursor: pointer; font-size: 12px; padding: 4px 8px; margin: 2px 4px 2px 0;
  border: 1px solid var(--border-color-primary); border-radius: 4px}
#kept button:has(img) {padding: 0; border: none}
#kept button[aria-pressed=true] {border-color: var(--color-accent); font-weight: bold}
#kept .caption {font-size: 12px; overflow-wrap: anywhere}
#kept :focus-visible {outline: 2px solid var(--color-accent)}
#decomposition .tiles {display: flex; flex-wrap: wrap; gap: 8px}
#decomposition figure {margin: 0; width: 110px; text-align: center}
#decomposition img {width: 110px; height: 110px; object-fit: contain}
#progress progress, #improving progress {width: 100%; height: 14px}
footer {display: none !important}
@media (max-width: 640px) {
  /* the picture comes after the buttons that choose it, and before what is done with it */
  .main {padding: 8px !important}
  .tab-container button {padding-inline: 8px !important}
  #step-1, #step-2 {flex-direction: column; flex-wrap: nowrap}
  #step-1 > .column, #step-2 > .column {display: contents}
  #step-1 > .column > * {order: 4}
  #photo, #example, #work {order: 1 !important}
  #status {order: 2 !important}
  #marked {order: 3 !important}
  #picture {order: 3 !important}
  #marking, #marking img, #brush {height: auto !important; max-height: 46vh}
  #step-2 > .column > * {order: 3}
  #editor, #shown {order: 1 !important}
  #editor {position: sticky; top: 0; z-index: 5; background: var(--body-background-fill)}
  #editor img {max-height: 40vh; object-fit: contain}
}
"""
# Asks before a page with a photograph is left, since it cannot be brought back, and tells the
# server if the user stays (a timer runs only then); says aloud what changes; names pictures.
SCRIPT = """
() => {
  addEventListener('beforeunload', event => {
    if (!document.querySelector('#marking img')) return;
    event.preventDefault();
    setTimeout(() => document.querySelector('#stayed').click(), 500);
  });
  const live = '#status, #shown, #progress, #improving, #made, #count';
  const names = {
    '#marking img': 'The photograph. A click on it marks the object.',
    '#editor img': 'The photograph and its edit, divided by a line',
  };
  const label = () => {
    document.querySelectorAll(live).forEach(e => {
      if (!e.ariaLive) e.ariaLive = 'polite';
    });
    for (const [place, text] of Object.entries(names))
      document.querySelectorAll(place).forEach(e => {
        if (e.alt !== text) e.alt = text;
      });
  };
  label();
  new MutationObserver(label).observe(document.body, {childList: true, subtree: true});
}
"""

# The key of the page's session, by which a page that is loaded again goes on. The browser keeps it
# for this tab, and shows it to no other page; in the address it would be passed on with a link.
# A browser that may keep nothing throws an error at it; the page then works, but for being loaded
# again.
RECALL_KEY = """() => {
  try { return [sessionStorage.getItem('brdfactory-session') || ''] } catch { return [''] }
}"""
KEEP_KEY = """key => {
  try { sessionStorage.setItem('brdfactory-session', key) } catch {}
}"""


def serve(
    weights: Path,
    device: str = "cpu",
    host: str = "127.0.0.1",
    port: int | None = None,
    open_browser: bool = False,
    wait: bool = True,
) -> tuple[str, Callable[[], None]]:
    """Serve the page; return its address and a function that ends it.

    host   address to listen on; 127.0.0.1: this computer alone
    port   None: a free one from 7860 on
    wait   whether to return only when the server is ended from the keyboard
    Raises InputError: the port is taken
    """
    folder = Path(tempfile.mkdtemp(prefix="brdfactory-app-"))
    os.environ["GRADIO_TEMP_DIR"] = str(folder / "sent")
    sessions = Sessions(folder, Network(weights, device))
    blocks = page(sessions)

    def end() -> None:
        blocks.close(verbose=False)
        sessions.close_all()
        shutil.rmtree(folder, ignore_errors=True)

    try:
        _, address, _ = blocks.launch(
            server_name=host,
            server_port=port,
            inbrowser=open_browser,
            prevent_thread_lock=True,
            quiet=True,
            share=False,
            show_error=True,
            max_file_size=MOST_BYTES,
            state_session_capacity=MOST_SESSIONS,
            enable_monitoring=False,
            ssr_mode=False,
            mcp_server=False,
            footer_links=[],
            theme=theme(),
            css=CSS,
            js=SCRIPT,
        )
    except OSError as error:
        end()
        raise InputError("--port", "a free port", str(error), "leave --port out") from None
    if wait:
        print(f"Open {address} in a browser. Ctrl+C ends the server.", flush=True)
        try:
            blocks.block_thread()
        finally:
            end()
    return address, end


def theme() -> gr.themes.Base:
    """Return the page's colours and fonts; white on a button has a contrast of 5 to 1 or more."""
    fonts, of_code = ["system-ui", "sans-serif"], ["ui-monospace", "monospace"]
    return gr.themes.Default(primary_hue="blue", font=fonts, font_mono=of_code).set(
        button_primary_background_fill="*primary_600",
        button_primary_background_fill_hover="*primary_700",
        button_primary_background_fill_dark="*primary_700",
        button_cancel_background_fill="*neutral_600",
        button_cancel_background_fill_hover="*neutral_700",
    )


def page(sessions: Sessions) -> gr.Blocks:
    """Return the page. Its users' files are in the folder of `sessions`."""
    pictures = sessions.folder / "materials.jpg"
    files.write_bytes(pictures, gallery.PICTURES.read_bytes())
    gr.set_static_paths([sessions.folder])

    def session_of(request: gr.Request) -> Session:
        return sessions.of(str(request.session_hash))

    def begun(key: str, request: gr.Request) -> tuple:
        session = sessions.begin(str(request.session_hash), str(key))
        return session.key, *objects.shown_again(session), *materials.shown_again(session)

    def stayed(request: gr.Request) -> None:
        session_of(request)

    def closed(request: gr.Request) -> None:
        # Gradio says so as soon as the browser asks whether to leave the page; the user may stay
        sessions.close_later(str(request.session_hash))

    with gr.Blocks(
        title=TITLE, analytics_enabled=False, delete_cache=DELETE_AFTER, fill_width=True
    ) as blocks:
        gr.Markdown(
            f"# {TITLE}\nSee an object in leather, wood, metal, paint or cloth. The photograph"
            " stays on the computer that serves this page, and is deleted when you close it."
        )
        with gr.Tabs(selected="object"):
            objects = ObjectTab(session_of)
            materials = MaterialTab(session_of, pictures)
            download = DownloadTab(session_of)
        objects.connect(materials, download)
        materials.connect()
        download.connect()
        key = gr.Textbox(elem_id="key", show_label=False)
        blocks.load(
            begun, key, [key, *objects.on_canvas, *materials.filled], js=RECALL_KEY, **QUIET
        ).success(None, key, js=KEEP_KEY, **QUIET)
        gr.Button("I stay", elem_id="stayed").click(stayed, None, None, queue=False, **QUIET)
        blocks.unload(closed)
    blocks.queue(default_concurrency_limit=4, max_size=64, api_open=False)
    return blocks
