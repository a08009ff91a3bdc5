"""Tab 2 of the page: what each control of it does.

Each change shows a quick view at once; the exact one follows when no later change came.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from learn.app import choices, gallery
from learn.app.background_decomposition import Stopped
from learn.app.choices import OWN_LIGHT, Chosen, Edit, LightChoice, Painted, Principled
from learn.app.edit_controls import SECOND, controls_of, painting, region_of, share_of
from learn.app.edit_view import exact_view, first_values, kept_row, quick_view, shape_line
from learn.app.event_handling import (
    QUIET,
    SessionOf,
    hexadecimal,
    in_place,
    one_line,
    progress_on,
    read_and_delete,
)
from learn.app.marked_photograph import THE_PAGE
from learn.app.material_from_file import materials_of
from learn.app.material_layout import SLIDERS, MaterialLayout
from learn.app.offline_gradio import gr
from learn.app.page_html import progress_bar
from learn.app.session import NEXT, Session
from manifests.errors import InputError


class MaterialTab:
    """Lays the tab out when it is made, inside gr.Tabs; `connect` then says what its parts do.

    layout         its parts
    views, filled  as MaterialLayout has them; EMPTY: the values of `views` before there is a
                   decomposition of a photograph

    The methods after `connect` handle one event each, and return the new values of what is shown.
    """

    EMPTY = (None, f"Mark the object in step 1 first, and press “{NEXT}”.", None, "", "")

    def __init__(self, session_of: SessionOf, pictures: Path):
        self.session_of, self.layout = session_of, MaterialLayout(pictures)
        self.views, self.filled = self.layout.views, self.layout.filled

    def connect(self) -> None:
        """Connect the events of this tab."""
        on = self.layout
        place = [on.region, on.slot]
        # of several clicks Gradio would take the first one's material, were they not sent each
        self._show_live(
            on.materials.click, self.from_gallery, place, [*on.view, on.share], "multiple"
        )
        self._show_live(on.share.input, self.blended, [on.region, on.share])
        self._show_live(on.back.click, self.kept, [on.region])
        self._show_live(on.light.input, self.lit, [on.light, on.rotation])
        self._show_live(on.rotation.input, self.lit, [on.light, on.rotation])
        self._show_live(on.hide.input, self.hidden, [on.hide])
        self._show_live(on.brightness.input, self.brightened, [on.brightness])
        self._show_live(on.detail.input, self.shaded, [on.detail])
        on.keep.click(self.keep_picture, None, on.kept_row, trigger_mode="once", **QUIET)
        on.improve.click(
            self.improved,
            None,
            [on.halt, *on.views],
            concurrency_limit=2,
            trigger_mode="once",
            **QUIET,
        )
        on.halt.click(self.stop_improving, None, on.improving, queue=False, **QUIET)
        self._show_live(
            on.kept_row.click,
            self.kept_clicked,
            [on.region],
            [*on.view, on.kept_row, *on.controls],
            "multiple",
        )
        own: list[Any] = [on.color, *on.numbers]
        for control in own:
            self._show_live(control.input, self.sliders, {*place, *own})
        on.region.input(self.share_shown, on.region, on.share, **QUIET)
        on.words.change(
            self.searched,
            on.words,
            [on.materials, on.count],
            trigger_mode="always_last",
            **QUIET,
        )
        waiting = progress_on(on.slider)
        on.other.upload(self.take_material, [*place, on.other], on.view, **waiting).success(
            self.exact, None, on.view, **QUIET
        )
        on.light_file.upload(
            self.take_light, [on.light_file, on.rotation], [*on.view, on.light], **waiting
        ).success(self.exact, None, on.view, **QUIET)

    def _show_live(
        self,
        listen: Callable[..., Any],
        handler: Callable[..., Any],
        inputs: list[Any] | set[Any],
        outputs: list[Any] | None = None,
        trigger_mode: Literal["always_last", "multiple"] = "always_last",
    ) -> None:
        """Show a quick view at each change, then the exact one."""
        outputs = outputs or self.layout.view
        first = listen(
            in_place(handler, len(outputs)),
            inputs,
            outputs,
            trigger_mode=trigger_mode,
            queue=False,  # which would cost two more requests
            **QUIET,
        )
        first.success(
            self.exact,
            None,
            self.layout.view,
            concurrency_limit=2,
            trigger_mode="multiple",
            **QUIET,
        )

    @one_line
    def improved(self, request: gr.Request) -> Iterator[tuple[Any, ...]]:
        """Refine the decomposition; yield the progress, and at last what is shown.

        The edit goes on meanwhile with the decomposition that there is.
        """
        session = self.session_of(request)
        session.decomposed()
        opened = session.photograph
        rest = (gr.skip(),) * (len(self.views) - 1)
        shown, hidden = gr.Button(visible=True), gr.Button(visible=False)
        if session.refined:
            yield hidden, *rest, _with_doubt(f"{_refined(session)} are improved already.", session)
            return
        try:
            yield shown, *rest, progress_bar(0.01, "waiting until another user is served")
            for report in session.decompose(refine=True, goes_on=True):
                yield shown, *rest, progress_bar(report.share, report.text)
            done = f"{_refined(session)} are fitted more closely to the photograph now."
            yield hidden, *first_values(session)[: len(rest)], _with_doubt(done, session)
        except (Stopped, InputError) as error:
            is_open = session.photograph is opened
            stopped = isinstance(error, Stopped)
            said = ""
            if stopped and is_open:
                said = _with_doubt("Stopped. The edit is as it was.", session)
            yield hidden, *rest, said
            if is_open and not stopped:
                raise

    def stop_improving(self, request: gr.Request) -> str:
        """Stop the refinement."""
        self.session_of(request).stop.set()
        return "Stopping …"

    def shown_again(self, session: Session) -> tuple[Any, ...]:
        """Return the values of `filled` for a page that was loaded again."""
        try:
            return first_values(session)
        except InputError:  # no decomposition, or none any more
            rest = (gr.skip(),) * (len(self.filled) - len(self.EMPTY))
            return (*(self.EMPTY if session.photograph else (gr.skip(),) * len(self.EMPTY)), *rest)

    def exact(self, request: gr.Request) -> tuple[Any, ...]:
        """Show the exact view of the latest choice, unless there is a later one."""
        return exact_view(self.session_of(request))

    def from_gallery(
        self, number: int, place: str, event: gr.EventData, request: gr.Request
    ) -> tuple[Any, ...]:
        """Give a region the material whose picture was clicked on."""
        chosen = choices.named_material(str(event.name))
        session = self.session_of(request)
        if not session.is_latest_click(float(event.at)):
            return (gr.skip(),) * 3
        result = quick_view(session, painting(int(number), place, chosen))
        return (*result, share_of(session, number))

    def sliders(self, values: dict[Any, Any], request: gr.Request) -> tuple[Any, ...]:
        """Give a region the material that colour and sliders describe; values: by component."""
        on = self.layout
        numbers = {
            key: float(values[slider])
            for (key, *_), slider in zip(SLIDERS, on.numbers, strict=True)
        }
        described = Principled(hexadecimal(values[on.color]), **numbers)
        chosen = choices.principled_material(described)
        change = painting(int(values[on.region]), values[on.slot], chosen)
        return quick_view(self.session_of(request), change)

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

        return quick_view(session, change)

    def blended(self, number: int, per_cent: float, request: gr.Request) -> tuple[Any, ...]:
        """Change the second material's share of a blend."""

        def change(edit: Edit) -> Edit:
            painted = region_of(edit, int(number))
            if painted.second is None:
                rule = (THE_PAGE, "a second material", "none")
                raise InputError(*rule, f"first set Choose to “{SECOND}”, and click on a material")
            return edit.with_region(int(number) - 1, replace(painted, share=per_cent / 100))

        return quick_view(self.session_of(request), change)

    def kept(self, number: int, request: gr.Request) -> tuple[Any, ...]:
        """Leave a region as it is."""

        def change(edit: Edit) -> Edit:
            region_of(edit, int(number))
            return edit.with_region(int(number) - 1, Painted())

        return quick_view(self.session_of(request), change)

    def lit(self, name: str, degrees: float, request: gr.Request) -> tuple[Any, ...]:
        """Change the light or its direction."""

        def change(edit: Edit) -> Edit:
            known = name == OWN_LIGHT or name in choices.light_names()
            if not known and edit.light.name == name:  # a map of the user's own
                return replace(edit, light=replace(edit.light, rotation_deg=degrees))
            return replace(edit, light=choices.light_of(name, degrees))

        return quick_view(self.session_of(request), change)

    @one_line
    def take_light(self, sent: str, degrees: float, request: gr.Request) -> tuple[Any, ...]:
        """Use a map that was sent as the light."""
        session = self.session_of(request)
        session.decomposed()
        given: LightChoice = read_and_delete(sent, choices.light_of_file)
        given = replace(given, rotation_deg=degrees)
        all_names = [OWN_LIGHT, *choices.light_names(), given.name]
        result = quick_view(session, lambda e: replace(e, light=given))
        return (*result, gr.Dropdown(all_names, value=given.name))

    def hidden(self, value: bool, request: gr.Request) -> tuple[Any, ...]:
        """Hide or show the background."""
        return quick_view(
            self.session_of(request), lambda e: replace(e, hide_background=bool(value))
        )

    def brightened(self, stops: float, request: gr.Request) -> tuple[Any, ...]:
        """Make all that is rendered brighter or darker."""
        return quick_view(
            self.session_of(request), lambda e: replace(e, brightness_stops=float(stops))
        )

    def shaded(self, per_cent: float, request: gr.Request) -> tuple[Any, ...]:
        """Keep more or less of the photograph's own shading."""
        detail = min(max(float(per_cent) / 100, 0.0), 1.0)
        return quick_view(self.session_of(request), lambda e: replace(e, detail=detail))

    @one_line
    def keep_picture(self, request: gr.Request) -> str:
        """Keep the edit to compare it with others."""
        session = self.session_of(request)
        session.keep()
        return kept_row(session)

    def kept_clicked(
        self, region: int, event: gr.EventData, request: gr.Request
    ) -> tuple[Any, ...]:
        """Show a kept edit again, show it on the left of the view, or keep it no longer."""
        session = self.session_of(request)
        kept = session.kept_edit(str(event.name))
        if event.act == "remove":
            session.forget(kept)
        elif event.act == "beside":
            session.put_beside(kept)
        result = quick_view(session, lambda edit: kept.edit if event.act == "show" else edit)
        return (*result, kept_row(session), *controls_of(session, int(region)))

    def share_shown(self, number: int, request: gr.Request) -> float:
        """Return the second material's share in the region that was chosen, in per cent."""
        return share_of(self.session_of(request), number)

    def searched(self, text: str) -> tuple[Any, ...]:
        """Show the materials that match words."""
        matching, line = gallery.found_by(text)
        return self.layout.tiles(matching, text), line


def _with_doubt(text: str, session: Session) -> str:
    """Return a text, and what is said if the shape that was named does not suit the mask."""
    return f"{text} {shape_line(session)}".rstrip()


def _refined(session: Session) -> str:
    """Return what a refinement adjusted, at the beginning of a sentence."""
    return "Shape and light" if session.shape_was is None else "Light and material"
