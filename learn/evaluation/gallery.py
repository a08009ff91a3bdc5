"""Pictures of one edit side by side: the input, the truth, and each method's edit and error.

All are under the truth's exposure except the input, which is under its own. The error is the root
mean square over channels of display values, from black for 0 to white for FULL or more.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.figures.montage import eight_bit, grid
from manifests.files import write_image
from shaders import tone

FULL = 64.0
BACKGROUND = 32.0
STOPS = ((0, 0, 0), (70, 15, 110), (180, 50, 90), (245, 125, 20), (252, 255, 200))  # of `heat`


def write(
    path: Path,
    batch: ExampleBatch,
    truth: np.ndarray,
    pictures: Mapping[str, np.ndarray],
    mask: np.ndarray,
) -> None:
    """Write a PNG of two rows: input, truth and each method's edit; beneath each edit its error.

    pictures  {name: (H, W, 3) radiance}, in the order of the columns
    """
    exposure, window = tone.auto_exposure(truth, mask), around(mask)
    seen = to_numpy(batch.image[0].movedim(0, -1))
    right = tone.display(truth, exposure)
    empty = np.full((*mask.shape, 3), BACKGROUND)
    above, below = (
        [
            cut(tone.display(seen, tone.auto_exposure(seen, mask)), mask),
            cut(right, mask),
        ],
        [empty, empty],
    )
    for picture in pictures.values():
        shown = tone.display(picture, exposure)
        above.append(cut(shown, mask))
        below.append(cut(heat(np.sqrt(tone.squared_difference(shown, right))), mask))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, eight_bit(grid([[cell[window] for cell in row] for row in (above, below)])))


def cells(path: Path, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (above, below), display pictures, of the `count` columns of a PNG of `write`."""
    both = np.asarray(Image.open(path, formats=["PNG"]).convert("RGB"))
    H, W = both.shape[0] // 2, both.shape[1] // count
    return [(both[:H, k * W : (k + 1) * W], both[H:, k * W : (k + 1) * W]) for k in range(count)]


def around(mask: np.ndarray) -> tuple[slice, slice]:
    """Return the square about the object as two slices, no larger than the frame."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    side = min(max(int(np.ptp(rows)), int(np.ptp(columns))) + 7, *mask.shape)
    top, left = (
        np.clip((at[0] + at[-1] + 1 - side) // 2, 0, size - side)
        for at, size in ((rows, mask.shape[0]), (columns, mask.shape[1]))
    )
    return slice(top, top + side), slice(left, left + side)


def cut(display: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a display picture (H, W, 3) with grey outside the mask."""
    return np.where(mask[..., None], display, BACKGROUND)


def heat(error: np.ndarray) -> np.ndarray:
    """Return colours (H, W, 3) of errors (H, W): black, violet, orange, white."""
    x = np.clip(error / FULL, 0, 1)
    stops = np.array(STOPS, float)
    return np.stack(
        [np.interp(x, np.linspace(0, 1, len(stops)), stops[:, k]) for k in range(3)], -1
    )
