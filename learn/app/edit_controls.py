"""What the controls of tab 2 show of an edit, and what a choice with them changes in it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from learn.app import choices
from learn.app.choices import OWN_LIGHT, Chosen, Edit, Painted
from learn.app.marked_photograph import THE_PAGE
from learn.app.offline_gradio import gr
from learn.app.session import Session
from manifests.errors import InputError

FIRST, SECOND = "the material", "a second one to mix with it"


def region_choices(count: int) -> list[tuple[str, int]]:
    """Return the choices (label, number) of `count` regions, which the page calls parts."""
    return [(f"Part {number}", number) for number in range(1, count + 1)]


def region_of(edit: Edit, number: int) -> Painted:
    """Return what region `number` is painted with.

    Raises  InputError where it is gone, since the object has fewer parts now
    """
    if not 1 <= number <= len(edit.regions):
        rule = f"a part from 1 to {len(edit.regions)}"
        raise InputError(THE_PAGE, rule, f"{number}", "the object has fewer parts now: choose one")
    return edit.regions[number - 1]


def painting(number: int, place: str, chosen: Chosen) -> Callable[[Edit], Edit]:
    """Return the change that gives region `number` a material; place: FIRST or SECOND."""

    def change(edit: Edit) -> Edit:
        painted = region_of(edit, number)
        if place == FIRST:
            return edit.with_region(number - 1, replace(painted, first=chosen))
        # a second material is seen at once
        amount = painted.share if painted.second is not None and painted.share else 0.5
        return edit.with_region(number - 1, replace(painted, second=chosen, share=amount))

    return change


def share_of(session: Session, number: int) -> float:
    """Return the second material's share in region `number`, in per cent."""
    edit = session.edit
    if edit is None or number > len(edit.regions):
        return 0
    painted = edit.regions[int(number) - 1]
    return 0 if painted.second is None else 100 * painted.share


def controls_of(session: Session, number: int) -> tuple[Any, ...]:
    """Return the values of MaterialTab.controls that show the edit; number: of the region."""
    _, edit = session.decomposed()
    names = [OWN_LIGHT, *choices.light_names()]
    if edit.light.name not in names:  # a map of the user's own
        names.append(edit.light.name)
    return (
        share_of(session, number),
        edit.light.rotation_deg,
        gr.Dropdown(names, value=edit.light.name),
        edit.hide_background,
        edit.brightness_stops,
        100 * edit.detail,
    )
