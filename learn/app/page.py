"""The page itself, made with Gradio: its components, and what each does with a user's session.

Nothing is sent anywhere: fonts are the system's, analytics are off, and the server listens on this
computer alone unless another address is given.
"""

import functools
import html
import inspect
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"  # read while gradio is imported
os.environ.setdefault("HF_HUB_OFFLINE", "1")

import gradio as gr
import numpy as np

from learn.app import choices, gallery
from learn.app.choices import OWN_LIGHT, Chosen, Edit, LightChoice, Painted
from learn.app.session import MOST_BYTES, MOST_SESSIONS, Network, Session, Sessions, Stopped
from learn.app.viewer import Superseded
from learn.data.photographs import MOST_REGIONS
from manifests import files
from manifests.errors import InputError

TITLE = "Edit a photograph"
FIRST, SECOND = "the material", "the material blended with it"
REGIONS_OFFERED = 4
DELETE_AFTER = (300, 1800)  # seconds: how often to look for files of pages long closed, their age
QUICK_TEXT = "Quick view; the exact one follows."
EXACT_TEXT = "Exact view."
CSS = """
.gradio-container {max-width: 1240px !important; width: 100%; margin: auto !important}
.gradio-container main {width: 100%; max-width: 100% !important}
#marking button {cursor: crosshair}
#materials .tiles {display: grid; grid-template-columns: repeat(auto-fill, minmax(84px, 1fr));
  gap: 4px; max-height: 300px; overflow-y: auto; contain: content}
#materials button {display: flex; flex-direction: column; align-items: center; padding: 2px;
  border: 2px solid transparent; border-radius: 4px; background: none; cursor: pointer}
#materials button:hover, #materials button:focus-visible {border-color: var(--color-accent)}
#materials .picture {width: 80px; height: 80px}
.tiles .caption {font-size: 10px; line-height: 1.15; text-align: center; overflow-wrap: anywhere}
#decomposition .tiles {display: flex; flex-wrap: wrap; gap: 8px}
#decomposition figure {margin: 0; width: 110px; text-align: center}
#decomposition img {width: 110px; height: 110px; object-fit: contain}
#progress progress {width: 100%; height: 14px}
footer {display: none !important}
"""
DONE = "Done."
# Tabs that were an output of Python would be asked for all that they hold at each later change.
OPEN_EDIT = """
said => {
  const tabs = [...document.querySelectorAll('[role=tab]')];
  if (said === 'DONE') tabs.find(tab => tab.innerText.includes('Material and light')).click();
}
""".replace("DONE", DONE)
TILE_CLICKS = """
element.addEventListener('click', event => {
  const tile = event.target.closest('button');
  if (tile) trigger('click', {name: tile.dataset.name});
});
"""


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
            theme=gr.themes.Default(
                font=["system-ui", "sans-serif"], font_mono=["ui-monospace", "monospace"]
            ),
            css=CSS,
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


def one_line(function: Callable[..., Any]) -> Callable[..., Any]:
    """Show an InputError as the line that the command line prints."""

    def shown(error: InputError) -> gr.Error:
        text = html.escape(str(error))
        return gr.Error(text, duration=20, title="This did not work", print_exception=False)

    if inspect.isgeneratorfunction(function):

        @functools.wraps(function)
        def generator(*arguments: Any, **named: Any) -> Iterator[Any]:
            try:
                yield from function(*arguments, **named)
            except InputError as error:
                raise shown(error) from None

        return generator

    @functools.wraps(function)
    def wrapped(*arguments: Any, **named: Any) -> Any:
        try:
            return function(*arguments, **named)
        except InputError as error:
            raise shown(error) from None

    return wrapped


def bar(share: float, text: str) -> str:
    """Return a progress bar with what is being done, as HTML."""
    return f'<progress max="1" value="{share:.3f}"></progress><div>{html.escape(text)}</div>'


def address_of(path: Path) -> str:
    """Return the address under which the page's server has a file, relative to the page."""
    return f"gradio_api/file={path}"


def figures(pictures: list[tuple[Path, str]]) -> str:
    """Return pictures, (file, caption), in a row, as HTML."""
    each = (
        f'<figure><img src="{html.escape(address_of(path))}" alt="">'
        f'<figcaption class="caption">{html.escape(caption)}</figcaption></figure>'
        for path, caption in pictures
    )
    return f'<div class="tiles">{"".join(each)}</div>'


def page(sessions: Sessions) -> gr.Blocks:
    """Return the page. Its users' files are in the folder of `sessions`."""
    picture = sessions.folder / "materials.jpg"
    files.write_bytes(picture, gallery.PICTURES.read_bytes())
    gr.set_static_paths([sessions.folder])

    def mine(request: gr.Request) -> Session:
        return sessions.of(str(request.session_hash))

    def tiles_of(names: list[str]) -> str:
        return gallery.page_tiles(names, address_of(picture))

    def region_choices(count: int) -> list[tuple[str, int]]:
        return [(f"Region {number}", number) for number in range(1, count + 1)]

    with gr.Blocks(
        title=TITLE, analytics_enabled=False, delete_cache=DELETE_AFTER, fill_width=True
    ) as blocks:
        gr.Markdown(
            f"# {TITLE}\nGive an object of your photograph another material. The photograph stays"
            " on the computer that serves this page, and is deleted when you close it."
        )
        with gr.Tabs(selected="object"):
            with gr.Tab("1  Photograph and object", id="object"), gr.Row():
                with gr.Column(scale=1, min_width=280):
                    photo = gr.UploadButton(
                        "Choose a photograph", variant="primary", elem_id="photo", size="md"
                    )
                    example = gr.Button("Or take the example, a cup", elem_id="example", size="md")
                    gr.Markdown("**What is the object?** Click on it in the picture, or:")
                    with gr.Row():
                        mask = gr.UploadButton("Mask file", elem_id="mask", size="sm", min_width=90)
                        regions_file = gr.UploadButton(
                            "Regions file", elem_id="regions-file", size="sm", min_width=90
                        )
                    marked = gr.Radio(
                        [("The object", 1)]
                        + [(f"Region {k}", k) for k in range(2, REGIONS_OFFERED + 1)]
                        + [("Background", 0)],
                        value=1,
                        label="A click says: this is …",
                        info="Regions can have different materials.",
                        elem_id="marked",
                    )
                    with gr.Row():
                        undo = gr.Button("Undo", elem_id="undo", size="sm", min_width=80)
                        clear = gr.Button("Clear", elem_id="clear", size="sm", min_width=80)
                    refine = gr.Checkbox(
                        True,
                        label="Refine",
                        info="Closer to the photograph; takes about half a minute longer.",
                        elem_id="refine",
                    )
                    with gr.Row():
                        decompose = gr.Button(
                            "Decompose", variant="primary", elem_id="decompose", interactive=False
                        )
                        stop = gr.Button("Stop", variant="stop", elem_id="stop", interactive=False)
                    progress = gr.HTML("", elem_id="progress")
                with gr.Column(scale=3, min_width=320):
                    status = gr.Markdown(
                        "Choose a photograph of one object, or the example.", elem_id="status"
                    )
                    with gr.Tabs():
                        with gr.Tab("Click", id="click"):
                            marking = gr.Image(
                                interactive=False,
                                show_label=False,
                                height=520,
                                buttons=[],
                                elem_id="marking",
                                type="filepath",
                            )
                        with gr.Tab("Brush", id="brush"):
                            gr.Markdown(
                                "Paint over the object, then press the button. Strokes count for"
                                " what is chosen on the left."
                            )
                            use_brush = gr.Button("Use the strokes", elem_id="use-brush", size="sm")
                            brush = gr.ImageEditor(
                                show_label=False,
                                sources=(),
                                transforms=(),
                                layers=False,
                                type="numpy",
                                height=520,
                                brush=gr.Brush(
                                    default_size=40, colors=["#ff00ff"], color_mode="fixed"
                                ),
                                elem_id="brush",
                            )
            with gr.Tab("2  Material and light", id="edit"), gr.Row():
                with gr.Column(scale=3, min_width=320):
                    slider = gr.ImageSlider(
                        show_label=False,
                        interactive=False,
                        buttons=["fullscreen"],
                        elem_id="editor",
                        type="filepath",
                        slider_position=50,
                        max_height=560,
                    )
                    shown = gr.Markdown("Decompose a photograph first (tab 1).", elem_id="shown")
                    gr.Markdown("**What was read from the photograph**")
                    parts = gr.HTML(elem_id="decomposition")
                with gr.Column(scale=2, min_width=320):
                    region = gr.Radio(
                        region_choices(1), value=1, label="Region", elem_id="region", visible=False
                    )
                    slot = gr.Radio([FIRST, SECOND], value=FIRST, label="Choose", elem_id="slot")
                    words = gr.Textbox(
                        placeholder="Search: wood, leather, gold, red plastic …",
                        show_label=False,
                        elem_id="words",
                    )
                    count = gr.Markdown(f"{len(gallery.search(''))} materials", elem_id="count")
                    materials = gr.HTML(
                        tiles_of(gallery.search("")), js_on_load=TILE_CLICKS, elem_id="materials"
                    )
                    share = gr.Slider(
                        0,
                        100,
                        0,
                        step=1,
                        label="Blend: per cent of the second material",
                        elem_id="share",
                        buttons=[],
                    )
                    back = gr.Button("Leave this region as it is", elem_id="keep", size="sm")
                    with gr.Accordion("A material of your own", open=False, elem_id="own"):
                        color = gr.ColorPicker("#a03020", label="Colour", elem_id="color")
                        numbers = [
                            gr.Slider(0, 1, value, step=0.01, label=label, buttons=[], elem_id=key)
                            for key, label, value in (
                                ("roughness", "Roughness", 0.35),
                                ("metallic", "Metallic", 0.0),
                                ("specular", "Specular (0.5 is common)", 0.5),
                                ("sheen", "Sheen, as of cloth", 0.0),
                                ("coat", "Coat of clear lacquer", 0.0),
                            )
                        ]
                    with gr.Accordion("The material of another picture", open=False):
                        gr.Markdown(
                            "A picture of an object before a transparent background, or a"
                            " material.json."
                        )
                        other = gr.UploadButton(
                            "Choose a picture or material.json", elem_id="other", size="sm"
                        )
                    with gr.Accordion("Light", open=True):
                        light = gr.Dropdown(
                            [OWN_LIGHT, *choices.light_names()],
                            value=OWN_LIGHT,
                            label="Light",
                            elem_id="light",
                        )
                        light_file = gr.UploadButton(
                            "Or a map of your own (.exr)", elem_id="light-file", size="sm"
                        )
                        rotation = gr.Slider(
                            -180,
                            180,
                            0,
                            step=1,
                            label="Turned by degrees",
                            elem_id="rotation",
                            buttons=[],
                        )
                        hide = gr.Checkbox(False, label="Hide the background", elem_id="hide")
            with gr.Tab("3  Download", id="download"):
                gr.Markdown(
                    "The edit at the photograph's size, rendered without shortcuts. This takes some"
                    " seconds."
                )
                make = gr.Button("Make the files", variant="primary", elem_id="make")
                made = gr.Markdown(elem_id="made")
                downloads = gr.File(
                    label="Files", file_count="multiple", interactive=False, elem_id="downloads"
                )
                command = gr.Textbox(
                    label="The command that repeats it, in a folder with these files and the"
                    " photograph",
                    interactive=False,
                    buttons=["copy"],
                    elem_id="command",
                )

        # --- tab 1 ---------------------------------------------------------------------------
        marks = [marking, status, decompose]

        def marks_of(session: Session, text: str) -> tuple[Any, ...]:
            selection = session.opened()
            path = session.write_view(session.overlay())
            return str(path), text, gr.Button(interactive=bool(selection.labels().any()))

        def loaded(session: Session, text: str) -> tuple[Any, ...]:
            canvas = {
                "background": session.opened().display,
                "layers": [],
                "composite": session.opened().display,
            }
            nothing = (None, "Decompose the photograph first (tab 1).", None, None, "", "")
            return (*marks_of(session, text), canvas, "", *nothing)

        on_load = [*marks, brush, progress, slider, shown, parts, downloads, command, made]

        @one_line
        def take_photo(sent: str, request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            return loaded(session, _with_file(sent, session.load))

        @one_line
        def take_example(request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            return loaded(session, session.load_example())

        @one_line
        def take_mask(sent: str, request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            return marks_of(session, _with_file(sent, session.give_mask))

        @one_line
        def take_regions(sent: str, request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            return marks_of(session, _with_file(sent, session.give_regions))

        def summary(session: Session) -> str:
            labels = session.opened().labels()
            covered = f"{(labels > 0).mean():.0%} of the picture"
            if not labels.any():
                return "Click on the object."
            count = int(labels.max())
            several = f", {count} regions" if count > 1 else ""
            return (
                f"The object covers {covered}{several}. Click where it is missing, or choose"
                " Background and click where it is too much. Then press Decompose."
            )

        @one_line
        def click(number: int, event: gr.SelectData, request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            column, row = event.index
            session.click(float(column), float(row), int(number))
            return marks_of(session, summary(session))

        @one_line
        def stroke(number: int, drawn: dict | None, request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            selection = session.opened()
            layers = [] if drawn is None else drawn.get("layers") or []
            covered = np.zeros(selection.size, bool)
            for layer in layers:
                if layer.shape[:2] != covered.shape:
                    selection.paint(np.zeros(layer.shape[:2], bool), int(number))
                covered |= layer[..., 3] > 127
            if not covered.any():
                rule = ("the brush", "strokes over the object", "none", "paint on the picture")
                raise InputError(*rule)
            selection.paint(covered, int(number))
            return marks_of(session, summary(session))

        @one_line
        def take_back(request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            session.opened().undo()
            return marks_of(session, summary(session))

        @one_line
        def take_back_all(request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            session.opened().clear()
            return marks_of(session, summary(session))

        quiet: dict[str, Any] = {"show_progress": "hidden", "api_visibility": "private"}
        waiting: dict[str, Any] = {"api_visibility": "private", "show_progress_on": [marking]}
        photo.upload(take_photo, photo, on_load, **waiting)
        example.click(take_example, None, on_load, **waiting)
        mask.upload(take_mask, mask, marks, **waiting)
        regions_file.upload(take_regions, regions_file, marks, **waiting)
        marking.select(click, marked, marks, trigger_mode="multiple", **quiet)
        use_brush.click(stroke, [marked, brush], marks, **waiting)
        undo.click(take_back, None, marks, trigger_mode="multiple", **quiet)
        clear.click(take_back_all, None, marks, **quiet)

        running = [progress, decompose, stop]
        decomposed_to = [*running, slider, shown, parts, region, share, rotation, light, hide]

        @one_line
        def run(refined: bool, request: gr.Request) -> Iterator[tuple[Any, ...]]:
            session = mine(request)
            go, halt = gr.Button(interactive=True), gr.Button(interactive=False)
            rest = (gr.skip(),) * (len(decomposed_to) - 3)
            try:
                session.marked()  # what is wrong with the mask is said at once
                yield bar(0.01, "waiting for a free place"), halt, go, *rest
                for report in session.decompose(refined):
                    yield bar(report.share, report.text), halt, go, *rest
            except Stopped:
                yield "Stopped. The photograph and its mask are still here.", go, halt, *rest
                return
            except InputError:
                yield "", go, halt, *rest
                raise
            viewer, edit = session.decomposed()
            before = str(session.write_view(viewer.before(), "before"))
            tiles = [
                (session.write_view(_eight_bit(picture), f"part{k}"), caption)
                for k, (caption, picture) in enumerate(viewer.parts())
            ]
            several = len(edit.regions) > 1
            session.before = before
            yield (
                DONE,
                go,
                halt,
                (before, before),
                "Choose a material on the right.",
                figures(tiles),
                gr.Radio(region_choices(len(edit.regions)), value=1, visible=several),
                0,
                0,
                OWN_LIGHT,
                False,
            )

        def halt(request: gr.Request) -> tuple[Any, ...]:
            mine(request).stop.set()
            return "Stopping …", gr.Button(interactive=False)

        decompose.click(
            run, refine, decomposed_to, concurrency_limit=2, trigger_mode="once", **quiet
        ).success(None, progress, js=OPEN_EDIT)
        stop.click(halt, None, [progress, stop], queue=False, **quiet)

        # --- tab 2 ---------------------------------------------------------------------------
        view = [slider, shown]

        def caption(edit: Edit) -> str:
            several = len(edit.regions) > 1
            each = [
                (f"region {k}: " if several else "") + painted.caption
                for k, painted in enumerate(edit.regions, 1)
            ]
            turned = f", turned by {edit.light.rotation_deg:g}°" if edit.light.columns else ""
            lit = "" if edit.light.unchanged else f"; light: {edit.light.name}{turned}"
            return "; ".join(each) + lit

        def quick(session: Session, change: Callable[[Edit], Edit]) -> tuple[Any, ...]:
            session.choose(change)
            viewer, edit = session.decomposed()
            path = str(session.write_view(viewer.view(edit)))
            note = EXACT_TEXT if viewer.is_exact(edit) else QUICK_TEXT
            return (session.before, path), f"{note} {caption(edit)}"

        def exact(request: gr.Request) -> tuple[Any, ...]:
            """Show the exact view of the latest choice, unless there is a later one."""
            session = mine(request)
            number = session.number
            if session.viewer is None or session.edit is None:
                return gr.skip(), gr.skip()
            viewer, edit = session.viewer, session.edit
            if viewer.is_exact(edit):
                return gr.skip(), gr.skip()
            try:
                picture = viewer.view(edit, True, lambda: session.number == number)
            except Superseded:
                return gr.skip(), gr.skip()
            if session.number != number:
                return gr.skip(), gr.skip()
            path = str(session.write_view(picture))
            return (session.before, path), f"{EXACT_TEXT} {caption(edit)}"

        def live(
            listen: Callable[..., Any],
            function: Callable[..., Any],
            inputs: Any,
            outputs: Any = view,
        ) -> None:
            """Show a quick view at each change, then the exact one."""
            # a page asks for one at a time; a queue would cost two more requests
            first = listen(
                one_line(function),
                inputs,
                outputs,
                trigger_mode="always_last",
                queue=False,
                **quiet,
            )
            first.success(exact, None, view, concurrency_limit=2, trigger_mode="multiple", **quiet)

        def painted_with(number: int, place: str, chosen: Chosen) -> Callable[[Edit], Edit]:
            def change(edit: Edit) -> Edit:
                painted = edit.regions[number - 1]
                if place == FIRST:
                    return edit.with_region(number - 1, replace(painted, first=chosen))
                # a second material is seen at once
                amount = painted.share if painted.second is not None and painted.share else 0.5
                return edit.with_region(number - 1, replace(painted, second=chosen, share=amount))

            return change

        def share_of(session: Session, number: int) -> float:
            if session.edit is None:
                return 0
            painted = session.edit.regions[int(number) - 1]
            return 0 if painted.second is None else 100 * painted.share

        def from_gallery(
            number: int, place: str, event: gr.EventData, request: gr.Request
        ) -> tuple[Any, ...]:
            chosen = choices.catalogue_material(str(event.name))
            session = mine(request)
            result = quick(session, painted_with(int(number), place, chosen))
            return (*result, share_of(session, number))

        def from_sliders(number: int, place: str, *values: Any) -> tuple[Any, ...]:
            *given, request = values
            chosen = choices.principled_material(_hex(given[0]), *map(float, given[1:]))
            return quick(mine(request), painted_with(int(number), place, chosen))

        def blended(number: int, per_cent: float, request: gr.Request) -> tuple[Any, ...]:
            def change(edit: Edit) -> Edit:
                painted = edit.regions[int(number) - 1]
                if painted.second is None:
                    rule = ("the blend", "a second material", "none")
                    raise InputError(*rule, f"set Choose to “{SECOND}” and click on one")
                return edit.with_region(int(number) - 1, replace(painted, share=per_cent / 100))

            return quick(mine(request), change)

        def kept(number: int, request: gr.Request) -> tuple[Any, ...]:
            return quick(mine(request), lambda e: e.with_region(int(number) - 1, Painted()))

        def lit(name: str, degrees: float, request: gr.Request) -> tuple[Any, ...]:
            def change(edit: Edit) -> Edit:
                known = name == OWN_LIGHT or name in choices.light_names()
                if not known and edit.light.name == name:  # a map of the user's own
                    return replace(edit, light=replace(edit.light, rotation_deg=degrees))
                return replace(edit, light=choices.light_of(name, degrees))

            return quick(mine(request), change)

        def hidden(value: bool, request: gr.Request) -> tuple[Any, ...]:
            return quick(mine(request), lambda e: replace(e, hide_background=bool(value)))

        live(materials.click, from_gallery, [region, slot], [*view, share])
        live(share.input, blended, [region, share])
        live(back.click, kept, [region])
        live(light.input, lit, [light, rotation])
        live(rotation.input, lit, [light, rotation])
        live(hide.input, hidden, [hide])

        def sliders(
            number: int,
            place: str,
            shade: str,
            roughness: float,
            metallic: float,
            specular: float,
            sheen: float,
            coat: float,
            request: gr.Request,
        ) -> tuple[Any, ...]:
            given = (shade, roughness, metallic, specular, sheen, coat)
            return from_sliders(number, place, *given, request)

        controls: list[Any] = [color, *numbers]
        for control in controls:
            live(control.input, sliders, [region, slot, color, *numbers])

        def share_shown(number: int, request: gr.Request) -> float:
            return share_of(mine(request), number)

        region.input(share_shown, region, share, **quiet)

        def searched(text: str) -> tuple[Any, ...]:
            matching = gallery.search(text)
            said = "1 material" if len(matching) == 1 else f"{len(matching)} materials"
            if not matching:
                said = "No material has such a name. Try wood, metal, fabric, plastic, stone …"
            return tiles_of(matching), said

        words.change(searched, words, [materials, count], trigger_mode="always_last", **quiet)

        @one_line
        def take_material(
            number: int, place: str, sent: str, request: gr.Request
        ) -> tuple[Any, ...]:
            session = mine(request)
            session.decomposed()
            chosen = _with_file(sent, lambda path: session.material_of(path, path.name))
            return quick(session, painted_with(int(number), place, chosen))

        other.upload(
            take_material,
            [region, slot, other],
            view,
            api_visibility="private",
            show_progress_on=[slider],
        ).success(exact, None, view, **quiet)

        @one_line
        def take_light(sent: str, degrees: float, request: gr.Request) -> tuple[Any, ...]:
            session = mine(request)
            session.decomposed()
            given: LightChoice = _with_file(sent, choices.light_of_file)
            given = replace(given, rotation_deg=degrees)
            all_names = [OWN_LIGHT, *choices.light_names(), given.name]
            result = quick(session, lambda e: replace(e, light=given))
            return (*result, gr.Dropdown(all_names, value=given.name))

        light_file.upload(
            take_light,
            [light_file, rotation],
            [*view, light],
            api_visibility="private",
            show_progress_on=[slider],
        ).success(exact, None, view, **quiet)

        # --- tab 3 ---------------------------------------------------------------------------
        @one_line
        def write_all(request: gr.Request) -> Iterator[tuple[Any, ...]]:
            session = mine(request)
            session.decomposed()
            yield gr.skip(), gr.skip(), "Rendering at the photograph's size …"
            paths, text = session.downloads()
            yield [str(path) for path in paths], text, f"{len(paths)} files are ready."

        make.click(write_all, None, [downloads, command, made], **quiet)

        def closed(request: gr.Request) -> None:
            sessions.close(str(request.session_hash))

        blocks.unload(closed)
    blocks.queue(default_concurrency_limit=4, max_size=64, api_open=False)
    return blocks


def _with_file(sent: str, read: Callable[[Path], Any]) -> Any:
    """Return what `read` makes of a file that was sent, and delete the file."""
    path = Path(sent)
    try:
        return read(path)
    except InputError as error:  # the user knows the file's name only
        where = error.where.replace(str(path), path.name)
        raise InputError(where, error.expected, error.found, error.remedy) from None
    finally:
        path.unlink(missing_ok=True)


def _eight_bit(picture: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _hex(color: str) -> str:
    """Return #rrggbb of what a colour picker gives: that, or rgb(a, b, c)."""
    if color.startswith("rgb"):
        inner = color[color.index("(") + 1 :].rstrip(")").split(",")[:3]
        return "#" + "".join(f"{min(255, max(0, round(float(each)))):02x}" for each in inner)
    return color


__all__ = ["MOST_REGIONS", "page", "serve"]
