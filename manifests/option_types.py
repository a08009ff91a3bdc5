"""Numbers that options take: functions for argparse's `type`, which turns their ValueError into a
line of usage.
"""

# whose materials: the data set's own, or those that come with the program
MATERIALS = ("dataset", "built-in")


def positive(text: str) -> int:
    """A whole number from 1. Raises ValueError."""
    value = int(text)
    if value < 1:
        raise ValueError(text)
    return value


def whole(text: str) -> int:
    """A whole number from 0. Raises ValueError."""
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def above_zero(text: str) -> float:
    """A finite number above 0. Raises ValueError."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError(text)
    return value
