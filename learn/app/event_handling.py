"""What the handlers of the page's events share: whose session, errors as one line, sent files."""

import functools
import html
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from learn.app.marked_photograph import THE_PAGE
from learn.app.offline_gradio import gr
from learn.app.page_html import without_markup
from learn.app.session import Session
from manifests.errors import InputError

SessionOf = Callable[[gr.Request], Session]  # the session of the page that sent a request

# how a listener behaves that shows no progress of Gradio's
QUIET: dict[str, Any] = {"show_progress": "hidden", "api_visibility": "private"}


def progress_on(component: gr.components.Component) -> dict[str, Any]:
    """Return how a listener behaves that shows Gradio's progress on one component."""
    return {"api_visibility": "private", "show_progress_on": [component]}


def for_people(error: InputError) -> str:
    """Return an error as HTML: what to do, then what is wrong, without what to do once more."""
    remedy = f"{error.remedy[:1].upper()}{error.remedy[1:]}.".replace("?.", "?")
    if error.where == THE_PAGE:  # nothing that was sent is at fault
        return html.escape(remedy)
    wrong = str(error).removesuffix(f" ({error.remedy})")
    return f"<b>{html.escape(remedy)}</b><br>{html.escape(wrong)}."


def one_line(function: Callable[..., Any]) -> Callable[..., Any]:
    """Show an InputError as `for_people` words it, in place of a trace."""

    def shown(error: InputError) -> gr.Error:
        text = for_people(error)
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


def in_place(function: Callable[..., Any], count: int) -> Callable[..., Any]:
    """Show an InputError in the second of `count` outputs, the line below the view, in bold.

    For listeners without a queue, of whose errors Gradio shows nothing.
    """

    @functools.wraps(function)
    def wrapped(*arguments: Any, **named: Any) -> Any:
        try:
            return function(*arguments, **named)
        except InputError as error:
            remedy = without_markup(f"{error.remedy[:1].upper()}{error.remedy[1:]}.")
            return (gr.skip(), f"**{remedy}**", *(gr.skip() for _ in range(count - 2)))

    return wrapped


def read_and_delete(sent: str, read: Callable[[Path], Any]) -> Any:
    """Return what `read` makes of a file that was sent, and delete the file.

    Raises  InputError with the file's name alone, which is what the user knows of it
    """
    path = Path(sent)
    try:
        return read(path)
    except InputError as error:
        where = error.where.replace(str(path), path.name)
        raise InputError(where, error.expected, error.found, error.remedy) from None
    finally:
        path.unlink(missing_ok=True)


def hexadecimal(color: str) -> str:
    """Return #rrggbb of what a colour picker gives: that, or rgb(a, b, c)."""
    if color.startswith("rgb"):
        inner = color[color.index("(") + 1 :].rstrip(")").split(",")[:3]
        return "#" + "".join(f"{min(255, max(0, round(float(each)))):02x}" for each in inner)
    return color
