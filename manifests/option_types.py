"""Numbers that options take: functions for argparse's `type`."""

import argparse
import math

# whose materials: the data set's own, or those that come with the program
MATERIALS = ("dataset", "built-in")
LARGEST_COUNT = 10**9  # a larger count is a slip of the keyboard


def positive(text: str) -> int:
    """Return a count, a whole number of 1 or more. Raises argparse.ArgumentTypeError."""
    value = _whole_number(text)
    if value is None or not 1 <= value <= LARGEST_COUNT:
        raise argparse.ArgumentTypeError(f"expected a whole number of 1 or more, found '{text}'")
    return value


def whole(text: str) -> int:
    """Return a whole number of 0 or more. Raises argparse.ArgumentTypeError."""
    value = _whole_number(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"expected a whole number of 0 or more, found '{text}'")
    return value


def above_zero(text: str) -> float:
    """Return a finite number above 0. Raises argparse.ArgumentTypeError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number above 0, found '{text}'")
    return value


def share(text: str) -> float:
    """Return a number from 0 to 1. Raises argparse.ArgumentTypeError."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"expected a number from 0 to 1, found '{text}'")
    return value


def _whole_number(text: str) -> int | None:
    """Return the number that up to 19 digits spell, None for other text."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else None
