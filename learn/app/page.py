"""The page itself: its three tabs, and the server that serves it.

Nothing is sent anywhere: fonts are the system's, analytics are off, and the server listens on this
computer alone unless another address is given.
"""

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from learn.app import gallery, work_file
from learn.app.background_decomposition import Network
from learn.app.download_tab import DownloadTab
from learn.app.event_handling import QUIET
from learn.app.material_tab import MaterialTab
from learn.app.object_tab import ObjectTab
from learn.app.offline_gradio import gr
from learn.app.page_script import KEEP_KEY, RECALL_KEY, SCRIPT
from learn.app.page_style import CSS, theme
from learn.app.session import Session
from learn.app.sessions import MOST_SESSIONS, Sessions
from manifests import files
from manifests.errors import InputError
from manifests.stop_signals import raise_stopped

TITLE = "Edit a photograph"
DELETE_AFTER = (300, 1800)  # seconds: how often to look for files of pages long closed, their age


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
    wait   whether to return only when the server is ended, by Ctrl-C or a signal that ends programs
    Raises InputError: the port is taken
    """
    if not wait:
        return _launch(weights, device, host, port, open_browser)
    with _ended_by_signals() as ended:  # at any moment a signal would leave the folder behind
        address, end = _launch(weights, device, host, port, open_browser)
        try:
            print(f"Open {address} in a browser. Ctrl+C ends the server.", flush=True)
            while not ended.wait(0.5):
                pass
        finally:
            end()
    return address, end


def _launch(
    weights: Path, device: str, host: str, port: int | None, open_browser: bool
) -> tuple[str, Callable[[], None]]:
    """Start the server; the arguments and the result are those of `serve`."""
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
            max_file_size=work_file.MOST_BYTES,
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
    return address, end


@contextmanager
def _ended_by_signals() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, `kill`, services that stop and terminals that close set.

    Their signals interrupt nothing: an exception could be raised anywhere, also while users'
    photographs are deleted. Terminals that close often send two.
    """
    ended = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ended.set()

    replaced = (signal.SIG_DFL, signal.default_int_handler, raise_stopped)
    earlier = {
        number: signal.getsignal(number)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) in replaced
    }
    for number in earlier:
        signal.signal(number, end)
    try:
        yield ended
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


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
            " stays on the computer that serves this page, and is deleted when you close it.",
            elem_id="title",
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
            begun,
            key,
            [key, *objects.shown, *materials.filled],
            js=RECALL_KEY,
            **QUIET,
        ).success(None, key, js=KEEP_KEY, **QUIET)
        gr.Button("I stay", elem_id="stayed").click(stayed, None, None, queue=False, **QUIET)
        blocks.unload(closed)
    blocks.queue(default_concurrency_limit=4, max_size=64, api_open=False)
    return blocks
