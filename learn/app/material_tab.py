"""Tab 2 of the page: what the edit looks like, and the materials and the light that it is given.

Each change shows a quick view at once; the exact one follows when no later change came.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from learn.app import choices, gallery
from learn.app.background_decomposition import Stopped
from learn.app.choices import MOST_STOPS, OWN_LIGHT, Chosen, Edit, LightChoice, Painted
from learn.app.edit_controls import (
    FIRST,
    SECOND,
    controls_of,
    painting,
    region_choices,
    said,
    share_of,
)
from learn.app.event_handling import (
    QUIET,
    SessionOf,
    hexadecimal,
    one_line,
    progress_on,
    read_and_delete,
)
from learn.app.marked_photograph import THE_PAGE
from learn.app.material_from_file import materials_of
from learn.app.offline_gradio import gr
from learn.app.page_html import address_of, figures, kept_tiles, progress_bar
from learn.app.session import Session
from learn.app.viewer import Superseded
from learn.figures import montage
from manifests.errors import InputError
from manifests.wording import number_of

QUICK_TEXT = "Quick view; the exact one follows."
EXACT_TEXT = "Exact view."
SLIDERS = (  # of a material of one's own: id, label, first value
    ("roughness", "Roughness", 0.35),
    ("metallic", "Metallic", 0.0),
    ("specular", "Specular (0.5 is common)", 0.5),
    ("sheen", "Sheen, as of cloth", 0.0),
    ("coat", "Coat of clear lacquer", 0.0),
)
TILE_CLICKS = """
element.addEventListener('click', event => {
  const tile = event.target.closest('button');
  if (tile) trigger('click', {...tile.dataset});
});
"""


class MaterialTab:
    """Lays the tab out when it is made, inside gr.Tabs; `connect` then says what its parts do.

    pictures  the file of the materials' pictures, where the page's server has it
    views     the edit, a line about it, the decomposition's parts, the kept pictures, and how far
              improving is; EMPTY: their values before there is a decomposition
    filled    all components that a decomposition gives new values, which `fill` returns

    The methods after `fill` handle one event each, and return the new values of what is shown.
    """

    NOTHING_YET = "Choose a photograph first, in step 1, and click on its object."
    EMPTY = (None, NOTHING_YET, None, "", "")

    def __init__(self, session_of: SessionOf, pictures: Path):
        self.session_of, self.pictures = session_of, pictures
        with gr.Tab("2  Material", id="edit"), gr.Row(elem_id="step-2"):
            with gr.Column(scale=3, min_width=320):
                self.slider = gr.ImageSlider(
                    show_label=False,
                    interactive=False,
                    buttons=["fullscreen"],
                    elem_id="editor",
                    type="filepath",
                    slider_position=50,
                    max_height=560,
                )
                shown = gr.Markdown(self.NOTHING_YET, elem_id="shown")
                with gr.Row():
                    self.keep = gr.Button(
                        "Keep this picture to compare", elem_id="keep-it", size="sm"
                    )
                    self.improve = gr.Button(
                        "Improve shape and light", elem_id="improve", size="sm"
                    )
                    self.halt = gr.Button(
                        "Stop improving", elem_id="stop-improving", size="sm", visible=False
                    )
                self.improving = gr.HTML("", elem_id="improving")
                self.kept_row = gr.HTML("", js_on_load=TILE_CLICKS, elem_id="kept")
                with gr.Accordion("What was read from the photograph", open=False):
                    parts = gr.HTML(elem_id="decomposition")
            with gr.Column(scale=2, min_width=320):
                self._lay_out_gallery()
                self._lay_out_own_materials()
                self._lay_out_light()
        self.view = [self.slider, shown]
        self.views: list[Any] = [*self.view, parts, self.kept_row, self.improving]
        self.controls: list[Any] = [
            self.share,
            self.rotation,
            self.light,
            self.hide,
            self.brightness,
        ]
        self.filled: list[Any] = [*self.views, self.region, *self.controls]

    def _lay_out_gallery(self) -> None:
        self.region = gr.Radio(
            region_choices(1), value=1, label="Part of the object", elem_id="region", visible=False
        )
        self.slot = gr.Radio([FIRST, SECOND], value=FIRST, label="Choose", elem_id="slot")
        self.words = gr.Textbox(
            placeholder="Search: wood, leather, gold, red plastic …",
            label="Search materials",
            show_label=False,
            elem_id="words",
        )
        self.count = gr.Markdown(f"{len(gallery.search(''))} materials", elem_id="count")
        self.materials = gr.HTML(
            self._tiles(gallery.search("")), js_on_load=TILE_CLICKS, elem_id="materials"
        )
        self.share = gr.Slider(
            0,
            100,
            0,
            step=1,
            label="Mix: per cent of the second material",
            elem_id="share",
            buttons=[],
        )
        self.back = gr.Button("As in the photograph", elem_id="keep", size="sm")

    def _tiles(self, names: list[str], text: str = "") -> str:
        return gallery.page_tiles(names, address_of(self.pictures), text)

    def _lay_out_own_materials(self) -> None:
        with gr.Accordion("A material of your own", open=False, elem_id="own"):
            self.color = gr.ColorPicker("#a03020", label="Colour", elem_id="color")
            self.numbers = [
                gr.Slider(0, 1, value, step=0.01, label=label, buttons=[], elem_id=key)
                for key, label, value in SLIDERS
            ]
        with gr.Accordion("The material of another picture", open=False):
            gr.Markdown(
                "A picture of an object before a transparent background, or a material.json. One"
                " of several regions gives each region its own."
            )
            self.other = gr.UploadButton(
                "Choose a picture or material.json", elem_id="other", size="sm"
            )

    def _lay_out_light(self) -> None:
        with gr.Accordion("Light", open=True):
            self.light = gr.Dropdown(
                [OWN_LIGHT, *choices.light_names()],
                value=OWN_LIGHT,
                label="Light",
                elem_id="light",
            )
            self.light_file = gr.UploadButton(
                "Or a map of your own (.exr)", elem_id="light-file", size="sm"
            )
            self.rotation = gr.Slider(
                -180,
                180,
                0,
                step=1,
                label="Turned by degrees",
                elem_id="rotation",
                buttons=[],
            )
            self.brightness = gr.Slider(
                -MOST_STOPS,
                MOST_STOPS,
                0,
                step=0.1,
                label="Brightness of the new material",
                info="How bright it is can only be guessed. +1 doubles it, −1 halves it.",
                elem_id="brightness",
                buttons=[],
            )
            self.hide = gr.Checkbox(False, label="Hide the background", elem_id="hide")

    def connect(self) -> None:
        """Connect the events of this tab."""
        place = [self.region, self.slot]
        self._show_live(self.materials.click, self.from_gallery, place, [*self.view, self.share])
        self._show_live(self.share.input, self.blended, [self.region, self.share])
        self._show_live(self.back.click, self.kept, [self.region])
        self._show_live(self.light.input, self.lit, [self.light, self.rotation])
        self._show_live(self.rotation.input, self.lit, [self.light, self.rotation])
        self._show_live(self.hide.input, self.hidden, [self.hide])
        self._show_live(self.brightness.input, self.brightened, [self.brightness])
        self.keep.click(self.keep_picture, None, self.kept_row, trigger_mode="once", **QUIET)
        self.improve.click(
            self.improved,
            None,
            [self.halt, *self.views],
            concurrency_limit=2,
            trigger_mode="once",
            **QUIET,
        )
        self.halt.click(self.stop_improving, None, self.improving, queue=False, **QUIET)
        self._show_live(
            self.kept_row.click,
            self.kept_clicked,
            [self.region],
            [*self.view, self.kept_row, *self.controls],
        )
        controls: list[Any] = [self.color, *self.numbers]
        for control in controls:
            self._show_live(control.input, self.sliders, [*place, *controls])
        self.region.input(self.share_shown, self.region, self.share, **QUIET)
        self.words.change(
            self.searched,
            self.words,
            [self.materials, self.count],
            trigger_mode="always_last",
            **QUIET,
        )
        waiting = progress_on(self.slider)
        self.other.upload(self.take_material, [*place, self.other], self.view, **waiting).success(
            self.exact, None, self.view, **QUIET
        )
        self.light_file.upload(
            self.take_light, [self.light_file, self.rotation], [*self.view, self.light], **waiting
        ).success(self.exact, None, self.view, **QUIET)

    def _show_live(
        self,
        listen: Callable[..., Any],
        handler: Callable[..., Any],
        inputs: list[Any],
        outputs: list[Any] | None = None,
    ) -> None:
        """Show a quick view at each change, then the exact one."""
        # a page asks for one at a time; a queue would cost two more requests
        first = listen(
            one_line(handler),
            inputs,
            outputs or self.view,
            trigger_mode="always_last",
            queue=False,
            **QUIET,
        )
        first.success(
            self.exact, None, self.view, concurrency_limit=2, trigger_mode="multiple", **QUIET
        )

    def fill(self, session: Session) -> tuple[Any, ...]:
        """Return the values of `filled` for a photograph that was decomposed just now."""
        viewer, edit = session.decomposed()
        before = str(session.write_view(viewer.before(), "before"))
        tiles = [
            (session.write_view(montage.eight_bit(picture), f"part{k}"), caption)
            for k, (caption, picture) in enumerate(viewer.parts())
        ]
        session.before = before
        result = (before, before), "Now choose a material."
        if not edit.unchanged:  # of saved work
            path = str(session.write_view(viewer.view(edit, True)))
            result = (before, path), said(session, EXACT_TEXT)
        several = len(edit.regions) > 1
        return (
            *result,
            figures(tiles),
            self._kept_of(session),
            "",
            gr.Radio(region_choices(len(edit.regions)), value=1, visible=several),
            *controls_of(session, 1),
        )

    @one_line
    def improved(self, request: gr.Request) -> Iterator[tuple[Any, ...]]:
        """Refine the decomposition; yield the progress, and at last what is shown.

        The edit goes on meanwhile with the decomposition that there is.
        """
        session = self.session_of(request)
        session.decomposed()
        rest = (gr.skip(),) * (len(self.views) - 1)
        shown, hidden = gr.Button(visible=True), gr.Button(visible=False)
        if session.refined:
            yield hidden, *rest, "Shape and light are improved already."
            return
        try:
            yield shown, *rest, progress_bar(0.01, "waiting until another user is served")
            for report in session.decompose(refine=True, goes_on=True):
                yield shown, *rest, progress_bar(report.share, report.text)
        except Stopped:
            yield hidden, *rest, "Stopped. The edit is as it was."
            return
        except InputError:
            yield hidden, *rest, ""
            raise
        done = "Shape and light are fitted more closely to the photograph now."
        yield hidden, *self.fill(session)[: len(rest)], done

    def stop_improving(self, request: gr.Request) -> str:
        """Stop the refinement."""
        self.session_of(request).stop.set()
        return "Stopping …"

    def shown_again(self, session: Session) -> tuple[Any, ...]:
        """Return the values of `filled` for a page that was loaded again."""
        if session.viewer is None or session.edit is None:
            return (gr.skip(),) * len(self.filled)
        return self.fill(session)

    def _quick(self, session: Session, change: Callable[[Edit], Edit]) -> tuple[Any, ...]:
        """Change the edit, and return the quick view of it."""
        session.choose(change)
        viewer, edit = session.decomposed()
        path = str(session.write_view(viewer.view(edit)))
        note = EXACT_TEXT if viewer.is_exact(edit) else QUICK_TEXT
        return (session.left, path), said(session, note)

    def _kept_of(self, session: Session) -> str:
        beside = None if session.beside is None else session.kept.index(session.beside)
        return kept_tiles([(each.picture, each.edit.caption) for each in session.kept], beside)

    def exact(self, request: gr.Request) -> tuple[Any, ...]:
        """Show the exact view of the latest choice, unless there is a later one."""
        session = self.session_of(request)
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
        return (session.left, path), said(session, EXACT_TEXT)

    def from_gallery(
        self, number: int, place: str, event: gr.EventData, request: gr.Request
    ) -> tuple[Any, ...]:
        """Give a region the material whose picture was clicked on."""
        chosen = choices.named_material(str(event.name))
        session = self.session_of(request)
        result = self._quick(session, painting(int(number), place, chosen))
        return (*result, share_of(session, number))

    def sliders(
        self,
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
        """Give a region the material that colour and sliders describe."""
        values = map(float, (roughness, metallic, specular, sheen, coat))
        chosen = choices.principled_material(hexadecimal(shade), *values)
        return self._quick(self.session_of(request), painting(int(number), place, chosen))

    @one_line
    def take_material(
        self, number: int, place: str, sent: str, request: gr.Request
    ) -> tuple[Any, ...]:
        """Give a region the material of a picture, or of a material.json, that was sent.

        A material.json of several regions gives each region its own.
        """
        session = self.session_of(request)
        session.decomposed()
        chosen: dict[int, Chosen] = read_and_delete(
            sent, lambda path: materials_of(session, path, int(number))
        )

        def change(edit: Edit) -> Edit:
            for region, each in chosen.items():
                edit = painting(region, place, each)(edit)
            return edit

        return self._quick(session, change)

    def blended(self, number: int, per_cent: float, request: gr.Request) -> tuple[Any, ...]:
        """Change the second material's share of a blend."""

        def change(edit: Edit) -> Edit:
            painted = edit.regions[int(number) - 1]
            if painted.second is None:
                rule = (THE_PAGE, "a second material", "none")
                raise InputError(*rule, f"first set Choose to “{SECOND}”, and click on a material")
            return edit.with_region(int(number) - 1, replace(painted, share=per_cent / 100))

        return self._quick(self.session_of(request), change)

    def kept(self, number: int, request: gr.Request) -> tuple[Any, ...]:
        """Leave a region as it is."""
        return self._quick(
            self.session_of(request), lambda e: e.with_region(int(number) - 1, Painted())
        )

    def lit(self, name: str, degrees: float, request: gr.Request) -> tuple[Any, ...]:
        """Change the light or its direction."""

        def change(edit: Edit) -> Edit:
            known = name == OWN_LIGHT or name in choices.light_names()
            if not known and edit.light.name == name:  # a map of the user's own
                return replace(edit, light=replace(edit.light, rotation_deg=degrees))
            return replace(edit, light=choices.light_of(name, degrees))

        return self._quick(self.session_of(request), change)

    @one_line
    def take_light(self, sent: str, degrees: float, request: gr.Request) -> tuple[Any, ...]:
        """Use a map that was sent as the light."""
        session = self.session_of(request)
        session.decomposed()
        given: LightChoice = read_and_delete(sent, choices.light_of_file)
        given = replace(given, rotation_deg=degrees)
        all_names = [OWN_LIGHT, *choices.light_names(), given.name]
        result = self._quick(session, lambda e: replace(e, light=given))
        return (*result, gr.Dropdown(all_names, value=given.name))

    def hidden(self, value: bool, request: gr.Request) -> tuple[Any, ...]:
        """Hide or show the background."""
        return self._quick(
            self.session_of(request), lambda e: replace(e, hide_background=bool(value))
        )

    def brightened(self, stops: float, request: gr.Request) -> tuple[Any, ...]:
        """Make all that is rendered brighter or darker."""
        return self._quick(
            self.session_of(request), lambda e: replace(e, brightness_stops=float(stops))
        )

    @one_line
    def keep_picture(self, request: gr.Request) -> str:
        """Keep the edit to compare it with others."""
        session = self.session_of(request)
        session.keep()
        return self._kept_of(session)

    def kept_clicked(
        self, region: int, event: gr.EventData, request: gr.Request
    ) -> tuple[Any, ...]:
        """Show a kept edit again, show it on the left of the view, or keep it no longer."""
        session = self.session_of(request)
        kept = session.kept_edit(int(event.number))
        if event.act == "remove":
            session.forget(int(event.number))
        elif event.act == "beside":
            session.beside = None if session.beside is kept else kept
        result = self._quick(session, lambda edit: kept.edit if event.act == "show" else edit)
        return (*result, self._kept_of(session), *controls_of(session, int(region)))

    def share_shown(self, number: int, request: gr.Request) -> float:
        """Return the second material's share in the region that was chosen, in per cent."""
        return share_of(self.session_of(request), number)

    def searched(self, text: str) -> tuple[Any, ...]:
        """Show the materials that match words."""
        matching = gallery.search(text)
        line = number_of(len(matching), "material")
        if not matching:
            matching = gallery.close_to(text)
            line = f"No material is called “{text.strip()[:40]}”. "
            line += (
                "These are close:"
                if matching
                else "Try a colour, or wood, metal, fabric, plastic, stone; or mix one under “A"
                " material of your own”."
            )
        return self._tiles(matching, text), line
