"""What Cycles' noise leaves open: standard errors of figures, and how they are written."""

import math
from collections.abc import Iterable

# A limit that lies within this many standard errors of a figure may be kept or missed by noise: of
# normal noise, one figure in twenty is farther off to one side.
STANDARD_ERRORS = 1.645


def of_mean(errors: Iterable[float | None]) -> float | None:
    """Return the standard error of a mean from those of its terms, or None if none is known.

    The terms are independent: every picture has seeds of its own.
    """
    known = [error for error in errors if error is not None]
    return math.hypot(*known) / len(known) if known else None


def noise_may_decide(figure: float | None, error: float | None, limit: float | None) -> bool | None:
    """Return whether a limit lies within STANDARD_ERRORS of a figure; None where not known."""
    if figure is None or error is None or limit is None:
        return None
    return bool(abs(figure - limit) <= STANDARD_ERRORS * error)


def as_text(figure: float | None, error: float | None, limit: float | None = None) -> str:
    """Return a figure as "0.37 ± 0.20 (limit 0.37)", rounded as its standard error asks.

    The error has two digits and the limit at least two. Without an error the figure has three, and
    without a limit there are no brackets.
    """
    if figure is None:
        return "–"
    if not error:
        text, decimals = f"{figure:.3g}", 0
    else:
        decimals = _decimals(error)
        text = f"{figure:.{decimals}f} ± {error:.{decimals}f}"
    if limit is None:
        return text
    return f"{text} (limit {limit:.{max(decimals, _decimals(limit))}f})"


def _decimals(value: float) -> int:
    """Return how many decimals show two digits of a value."""
    return max(0, 1 - math.floor(math.log10(value))) if value > 0 else 0


def advice(may_decide: bool | None) -> str:
    """Return the sentence, after a space, for a verdict that noise may have decided, else ""."""
    if not may_decide:
        return ""
    return (
        f" Noise may have decided this, because the limit lies within {STANDARD_ERRORS:g} standard"
        " errors of the figure: render more samples or more pictures."
    )
