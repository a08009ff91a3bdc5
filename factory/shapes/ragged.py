"""Lists of different lengths, one after another in one array.

lengths  (L,) of the lists
"""

import numpy as np


def ranges(starts: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the whole numbers start, …, start + length - 1 of each range, range after range."""
    return np.arange(lengths.sum()) + np.repeat(starts - (np.cumsum(lengths) - lengths), lengths)


def successors(lengths: np.ndarray) -> np.ndarray:
    """Return the index of the element that follows each one in its list, the last one's first."""
    after = np.arange(1, lengths.sum() + 1)
    ends = np.cumsum(lengths)
    after[ends - 1] = ends - lengths
    return after
