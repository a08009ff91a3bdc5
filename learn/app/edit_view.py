"""What tab 2 of the page shows of an edit: quickly at each change, then exactly."""

from collections.abc import Callable
from typing import Any

from learn.app.choices import Edit
from learn.app.edit_controls import controls_of, region_choices
from learn.app.offline_gradio import gr
from learn.app.page_html import figures, kept_tiles, without_markup
from learn.app.session import Kept, Session
from learn.app.viewer import Superseded
from learn.editing.decomposition import shape_warning
from learn.figures import montage

QUICK_TEXT = "Quick view; the exact one follows."
EXACT_TEXT = "Exact view."
WITHOUT_SHAPE = "choose “Guess it” in step 1"
UNCHANGED = (gr.skip(), gr.skip())


def first_values(session: Session) -> tuple[Any, ...]:
    """Return the values of MaterialLayout.filled for what was decomposed just now."""
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
        result = (before, path), said(EXACT_TEXT, edit, session.beside)
    count = len(edit.regions)
    return (
        *result,
        figures(tiles),
        kept_row(session),
        shape_line(session),
        gr.Radio(region_choices(count), value=1, visible=count > 1),
        *controls_of(session, 1),
    )


def quick_view(session: Session, change: Callable[[Edit], Edit]) -> tuple[Any, ...]:
    """Change the edit, and return the quick view of it; UNCHANGED if there is a later choice.

    Raises  InputError
    """
    number = session.choose(change)
    viewer, edit = session.decomposed()
    picture = viewer.view(edit)
    if session.number != number:
        return UNCHANGED
    path = str(session.write_view(picture))
    note = EXACT_TEXT if viewer.is_exact(edit) else QUICK_TEXT
    return (session.left, path), said(note, edit, session.beside)


def exact_view(session: Session) -> tuple[Any, ...]:
    """Return the exact view of the latest choice; UNCHANGED if there is a later one."""
    number, viewer, edit = session.number, session.viewer, session.edit
    if viewer is None or edit is None or viewer.is_exact(edit):
        return UNCHANGED
    try:
        picture = viewer.view(edit, True, lambda: session.number == number)
    except Superseded:
        return UNCHANGED
    if session.number != number:
        return UNCHANGED
    path = str(session.write_view(picture))
    return (session.left, path), said(EXACT_TEXT, edit, session.beside)


def kept_row(session: Session) -> str:
    """Return HTML with the pictures that are kept to be compared."""
    kept, left = list(session.kept), session.beside
    beside = next((number for number, each in enumerate(kept) if each is left), None)
    return kept_tiles([(each.picture, each.edit.caption) for each in kept], beside)


def shape_line(session: Session) -> str:
    """Return a line if the shape that the user named does not suit the mask, else ""."""
    viewer, _ = session.decomposed()
    overlap = viewer.decomposition.shape_overlap
    warning = shape_warning(session.shape_was, overlap, WITHOUT_SHAPE)
    return warning and f"{warning}."


def said(note: str, edit: Edit, beside: Kept | None) -> str:
    """Return the line below the view: a note, what the edit is, and what is on the left."""
    left = "the photograph" if beside is None else beside.edit.caption
    return f"{note} {without_markup(edit.caption)}. Left of the line: {without_markup(left)}."
