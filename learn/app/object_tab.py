"""Tab 1 of the page: a photograph, what in it is the object, and its decomposition."""

from collections.abc import Iterator
from typing import Any

from learn.app.background_decomposition import Stopped
from learn.app.download_tab import DownloadTab
from learn.app.edit_view import first_values
from learn.app.event_handling import QUIET, SessionOf, one_line, progress_on, read_and_delete
from learn.app.marking_view import BRUSH, canvas_of, covered_text, mark_line, mark_place, strokes_of
from learn.app.material_tab import MaterialTab
from learn.app.offline_gradio import gr
from learn.app.page_html import progress_bar
from learn.app.session import NEXT, Session
from learn.primitives import PRIMITIVES
from learn.selection.superpixels import BACKGROUND
from manifests.errors import InputError

PARTS_OFFERED = 4
DONE = "Done."
PHOTO_BUTTON, WORK_BUTTON = "Choose a photograph", "Or open saved work (.zip)"
FIT_HELP = (
    "Moves the object's edge to where the colours change, by a few pixels at most. If the edge of"
    " an edit is frayed, switch this off and press “Next” again."
)
GUESSED = "guessed"  # in place of one of PRIMITIVES
SHAPES = (
    ("Guess it", GUESSED),
    ("Box", "box"),
    ("Cylinder or cone", "cylinder"),
    ("Ball", "ball"),
    ("Flat", "flat"),
)
SHAPE_LABEL = "Shape of the object"
SHAPE_HELP = (
    "If the whole object is one of these, say so: its shape then follows from its outline, and"
    " prints on it do not become relief."
)
# Tabs that were an output of Python would be asked for all that they hold at each later change.
OPEN_EDIT = """
said => {
  const tabs = [...document.querySelectorAll('[role=tab]')];
  if (said !== 'DONE') return;
  const edit = tabs.find(tab => tab.innerText.includes('Material'));
  edit.click();
  edit.focus({preventScroll: true});  // the button that had it is out of sight
  scrollTo(0, 0);
}
""".replace("DONE", DONE)


class ObjectTab:
    """Lays the tab out when it is made, inside gr.Tabs; `connect` then says what its parts do.

    All other methods handle one event each. They return the new values of the components that
    `connect` names for them: `marks`, the picture with its regions and what depends on them, or
    those of the tabs that a photograph fills or empties.

    on_canvas  `marks`, and the picture to draw on
    shown      `on_canvas`, and how the object is decomposed
    """

    def __init__(self, session_of: SessionOf):
        self.session_of = session_of
        with gr.Tab("1  Photo", id="object"), gr.Row(elem_id="step-1"):
            with gr.Column(scale=1, min_width=280):
                self._lay_out_controls()
            with gr.Column(scale=3, min_width=320):
                self._lay_out_picture()
        self.marks = [self.marking, self.status, self.decompose]
        self.on_canvas: list[Any] = [*self.marks, self.brush]
        self.shown: list[Any] = [*self.on_canvas, self.fit, self.shape]

    def _lay_out_controls(self) -> None:
        self.photo = gr.UploadButton(PHOTO_BUTTON, variant="primary", elem_id="photo", size="md")
        self.example = gr.Button("Or try the example, a cup", elem_id="example", size="md")
        self.work = gr.UploadButton(WORK_BUTTON, elem_id="work", size="sm")
        self.marked = gr.Radio(
            [("The object", 1), ("Not the object", BACKGROUND)]
            + [(f"Part {number}", number) for number in range(2, PARTS_OFFERED + 1)],
            value=1,
            label="What I click on or paint is …",
            info="Parts of an object can have different materials, such as a seat and its legs.",
            elem_id="marked",
        )
        with gr.Row(elem_id="undoing"):
            self.undo = gr.Button("Undo", elem_id="undo", size="sm", min_width=80)
            self.clear = gr.Button("Start again", elem_id="clear", size="sm", min_width=80)
        self.fit = gr.Checkbox(
            True,
            label="Fit the edge to the photograph",
            info=FIT_HELP,
            elem_id="fit",
        )
        self.shape = gr.Radio(
            SHAPES, value=GUESSED, label=SHAPE_LABEL, info=SHAPE_HELP, elem_id="shape"
        )
        with gr.Accordion("I have a mask already", open=False, elem_id="own-mask"):
            gr.Markdown(
                "A mask is a picture of the same size that is white where the object is. One with"
                " a grey or a colour for each part divides the object."
            )
            with gr.Row():
                self.mask = gr.UploadButton("Mask file", elem_id="mask", size="sm", min_width=90)
                self.regions_file = gr.UploadButton(
                    "File of parts", elem_id="regions-file", size="sm", min_width=90
                )

    def _lay_out_picture(self) -> None:
        # the button is beside the line that names it, where no screen is too low to show it
        with gr.Row(elem_id="guidance"):
            self.status = gr.Markdown(
                "Choose a photograph of an object (JPEG, HEIC, PNG, WebP, AVIF, TIFF, BMP, GIF or"
                " EXR), drop or paste it here, or try the example. Then click on the object, or"
                " choose *Draw* and draw a line around it.",
                elem_id="status",
            )
            self.decompose = gr.Button(
                NEXT,
                variant="primary",
                elem_id="decompose",
                interactive=False,
                size="md",
                scale=0,
                min_width=240,
            )
        self.progress = gr.HTML("", elem_id="progress")
        self.stop = gr.Button("Stop", variant="stop", elem_id="stop", visible=False, size="sm")
        with gr.Tabs(elem_id="picture"):
            with gr.Tab("Click", id="click"):
                self.marking = gr.Image(
                    interactive=False,
                    show_label=False,
                    height=520,
                    buttons=[],
                    elem_id="marking",
                    type="filepath",
                )
                # what the page's script says of the cross that arrow keys move
                gr.HTML('<p id="cross-line" aria-live="polite"></p>')
                self.place = gr.Textbox(elem_id="place", show_label=False)
                self.point = gr.Button("Mark what is under the cross", elem_id="point")
                self.outline = gr.Button("Use the line of the cross", elem_id="outline")
            with gr.Tab("Draw", id="draw") as self.drawing:
                gr.Markdown(
                    "Draw a line all around the object, or paint over a part of it; then press the"
                    " button that says what you drew. Near the outline a click or a stroke more"
                    " helps, also one of “Not the object”."
                )
                with gr.Row():
                    self.use_line = gr.Button(
                        "It is a line around the object", elem_id="use-line", size="sm"
                    )
                    self.use_brush = gr.Button(
                        "It is paint on the part that I chose", elem_id="use-brush", size="sm"
                    )
                self.brush = gr.ImageEditor(
                    show_label=False,
                    sources=(),
                    transforms=(),
                    layers=False,
                    type="numpy",
                    height=520,
                    brush=gr.Brush(default_size=BRUSH, colors=["#ff00ff"], color_mode="fixed"),
                    elem_id="brush",
                )

    def connect(self, materials: MaterialTab, download: DownloadTab) -> None:
        """Connect the events of this tab; `materials` and `download` show what they result in."""
        on_load = [*self.shown, self.progress, *materials.views, *download.outputs]
        waiting = progress_on(self.marking)
        self.photo.upload(self.take_photo, self.photo, on_load, **waiting)
        self.example.click(self.take_example, None, on_load, **waiting)
        self.mask.upload(self.take_mask, self.mask, self.marks, **waiting)
        self.regions_file.upload(self.take_regions, self.regions_file, self.marks, **waiting)
        self.marking.select(self.click, self.marked, self.marks, trigger_mode="multiple", **QUIET)
        for button, mark in ((self.point, self.mark_place), (self.outline, self.mark_line)):
            button.click(
                mark,
                [self.marked, self.place],
                self.marks,
                js="number => [number, globalThis.brdfactoryPlace]",
                trigger_mode="multiple",
                **QUIET,
            )
        for control, take in ((self.fit, self.take_fit), (self.shape, self.take_shape)):
            # of changes that follow each other at once, the last one counts
            control.input(take, control, None, queue=False, trigger_mode="always_last", **QUIET)
        drawn = [self.marked, self.brush]
        self.use_brush.click(self.stroke, drawn, self.on_canvas, **QUIET)
        self.use_line.click(self.line, drawn, self.on_canvas, **QUIET)
        self.drawing.select(self.canvas, None, self.brush, **QUIET)
        self.undo.click(self.take_back, None, self.on_canvas, trigger_mode="multiple", **QUIET)
        self.clear.click(self.take_back_all, None, self.on_canvas, **QUIET)

        decomposed_to = [self.progress, self.decompose, self.stop, *materials.filled]
        self.materials = materials
        self.decompose.click(
            self.run, None, decomposed_to, concurrency_limit=2, trigger_mode="once", **QUIET
        ).success(None, self.progress, js=OPEN_EDIT)
        self.work.upload(self.take_work, self.work, on_load, **waiting).success(
            self.run, None, decomposed_to, concurrency_limit=2, **QUIET
        ).success(None, self.progress, js=OPEN_EDIT)
        self.stop.click(self.halt, None, [self.progress, self.stop], queue=False, **QUIET)

    def _marks_of(self, session: Session, text: str) -> tuple[Any, ...]:
        opened = session.opened()
        path = session.write_view(opened.overlay())
        return str(path), text, gr.Button(interactive=opened.is_marked)

    def _loaded(self, session: Session, text: str) -> tuple[Any, ...]:
        others = (*MaterialTab.EMPTY, *DownloadTab.EMPTY)
        return (*self._shown(session, text), "", *others)

    def _shown(self, session: Session, text: str) -> tuple[Any, ...]:
        return (*self._marks_of(session, text), canvas_of(session), *self._choices_of(session))

    def _choices_of(self, session: Session) -> tuple[Any, ...]:
        return session.fit_mask, session.shape or GUESSED

    def shown_again(self, session: Session) -> tuple[Any, ...]:
        """Return the values of `shown` for a page that was loaded again."""
        if session.photograph is None:
            return (*(gr.skip() for _ in self.on_canvas), *self._choices_of(session))
        text = covered_text(session)
        if session.viewer is not None:
            text = f"Your edit is in step 2. {text}"
        return self._shown(session, text)

    @one_line
    def take_photo(self, sent: str, request: gr.Request) -> tuple[Any, ...]:
        """Open a photograph that was sent."""
        session = self.session_of(request)
        return self._loaded(session, read_and_delete(sent, session.load))

    @one_line
    def take_example(self, request: gr.Request) -> tuple[Any, ...]:
        """Open the program's example."""
        session = self.session_of(request)
        return self._loaded(session, session.load_example())

    @one_line
    def take_work(self, sent: str, request: gr.Request) -> tuple[Any, ...]:
        """Open saved work that was sent; `run` then decomposes its photograph."""
        session = self.session_of(request)
        return self._loaded(session, read_and_delete(sent, session.load_work))

    @one_line
    def take_mask(self, sent: str, request: gr.Request) -> tuple[Any, ...]:
        """Use a mask file that was sent."""
        session = self.session_of(request)
        return self._marks_of(session, read_and_delete(sent, session.give_mask))

    @one_line
    def take_regions(self, sent: str, request: gr.Request) -> tuple[Any, ...]:
        """Use a regions file that was sent."""
        session = self.session_of(request)
        return self._marks_of(session, read_and_delete(sent, session.give_regions))

    @one_line
    def click(self, number: int, event: gr.SelectData, request: gr.Request) -> tuple[Any, ...]:
        """Use a click on the picture, which says that its place belongs to region `number`."""
        session = self.session_of(request)
        column, row = event.index
        session.opened().click(float(column), float(row), int(number))
        return self._marks_of(session, covered_text(session))

    @one_line
    def mark_place(self, number: int, place: str, request: gr.Request) -> tuple[Any, ...]:
        """Mark the place of the cross as region `number`, or as background."""
        session = self.session_of(request)
        said = mark_place(session, int(number), place)
        return self._marks_of(session, f"{said} {covered_text(session)}")

    @one_line
    def mark_line(self, number: int, line: str, request: gr.Request) -> tuple[Any, ...]:
        """Use a line that the cross drew: around region `number`, or as paint on it."""
        session = self.session_of(request)
        said = mark_line(session, int(number), line)
        return self._marks_of(session, f"{said} {covered_text(session)}")

    @one_line
    def stroke(self, number: int, drawn: dict | None, request: gr.Request) -> tuple[Any, ...]:
        """Use the strokes of the brush, which say that they cover region `number`."""
        session = self.session_of(request)
        session.opened().paint(strokes_of(drawn), int(number))
        return (*self._marks_of(session, covered_text(session)), canvas_of(session))

    @one_line
    def line(self, number: int, drawn: dict | None, request: gr.Request) -> tuple[Any, ...]:
        """Use the strokes of the brush as a line around the object, of region `number`."""
        session = self.session_of(request)
        session.opened().enclose(strokes_of(drawn), int(number))
        return (*self._marks_of(session, covered_text(session)), canvas_of(session))

    def take_fit(self, is_on: bool, request: gr.Request) -> None:
        """Fit the mask's edge to the photograph from the next decomposition on, or leave it."""
        self.session_of(request).fit_mask = bool(is_on)

    def take_shape(self, name: str, request: gr.Request) -> None:
        """Use a shape for the object from the next decomposition on; GUESSED: the network's."""
        self.session_of(request).shape = name if name in PRIMITIVES else None

    def canvas(self, request: gr.Request) -> Any:
        """Show what is marked by now where it is drawn."""
        session = self.session_of(request)
        return gr.skip() if session.photograph is None else canvas_of(session)

    @one_line
    def take_back(self, request: gr.Request) -> tuple[Any, ...]:
        """Take back the last click, strokes or line."""
        session = self.session_of(request)
        undone = session.opened().selection.undo()
        text = covered_text(session)
        text = text if undone else f"Nothing is left to undo. {text}"
        return (*self._marks_of(session, text), canvas_of(session))

    @one_line
    def take_back_all(self, request: gr.Request) -> tuple[Any, ...]:
        """Take back all clicks, strokes and lines."""
        session = self.session_of(request)
        session.opened().selection.clear()
        return (*self._marks_of(session, covered_text(session)), canvas_of(session))

    @one_line
    def run(self, request: gr.Request) -> Iterator[tuple[Any, ...]]:
        """Decompose the photograph; yield the progress, and at last what tab 2 shows.

        Only saved work that was refined is refined at once: a first result takes some seconds, and
        tab 2 has a button that refines.
        """
        session = self.session_of(request)
        opened = session.photograph
        busy = gr.Button(interactive=False), gr.Button(visible=True)
        idle = gr.Button(interactive=True), gr.Button(visible=False)
        rest = (gr.skip(),) * len(self.materials.filled)
        try:
            session.opened().to_edit(fit_mask=False)  # what is wrong with the mask is said at once
            yield progress_bar(0.01, "waiting until another user is served"), *busy, *rest
            for report in session.decompose(session.saved_was_refined):
                yield progress_bar(report.share, report.text), *busy, *rest
            yield (DONE, *idle, *first_values(session))
        except (Stopped, InputError) as error:
            if session.photograph is not opened:
                # another one took its place, and its marks say whether the button can be pressed
                yield "", gr.skip(), idle[1], *rest
                return
            stopped = isinstance(error, Stopped)
            said = "Stopped. The photograph and its mask are still here." if stopped else ""
            yield said, *idle, *rest
            if not stopped:
                raise

    def halt(self, request: gr.Request) -> tuple[Any, ...]:
        """Stop the decomposition."""
        self.session_of(request).stop.set()
        return "Stopping …", gr.Button(visible=False)
