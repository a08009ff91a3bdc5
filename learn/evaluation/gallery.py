"""Pictures of one edit, side by side: what the method was shown, the truth, and each method's edit
with its error beneath.

All under the truth's exposure but the input, which is under its own. Error: root mean square over
channels of display values, black 0, white FULL or more.
"""

import numpy as np
from PIL import Image

from learn.data.devices import array
from manifests.files import write_image
from shaders import tone

FULL = 64.0
BACKGROUND = 32.0


def write(path, batch, truth, pictures, mask):
    """A PNG of two rows: input, truth, each method's edit; beneath, two empty cells, and each error
    map.

    pictures  {name: (H, W, 3) radiance}, in the order of the columns
    """
    exposure, window = tone.auto_exposure(truth, mask), around(mask)
    seen = array(batch.image[0].movedim(0, -1))
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
        below.append(cut(heat(np.sqrt(((shown - right) ** 2).mean(-1))), mask))
    sheet = np.concatenate(
        [np.concatenate([cell[window] for cell in row], 1) for row in (above, below)], 0
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, np.clip(np.rint(sheet), 0, 255).astype(np.uint8))


def cells(path, count):
    """[(above, below)] display pictures of the `count` columns of a sheet that `write` made."""
    sheet = np.asarray(Image.open(path, formats=["PNG"]).convert("RGB"))
    H, W = sheet.shape[0] // 2, sheet.shape[1] // count
    return [(sheet[:H, k * W : (k + 1) * W], sheet[H:, k * W : (k + 1) * W]) for k in range(count)]


def around(mask):
    """The square about the object, as two slices; the frame where it is larger."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    side = min(max(np.ptp(rows), np.ptp(columns)) + 7, *mask.shape)
    top, left = (
        np.clip((at[0] + at[-1] + 1 - side) // 2, 0, size - side)
        for at, size in ((rows, mask.shape[0]), (columns, mask.shape[1]))
    )
    return np.s_[top : top + side, left : left + side]


def cut(display, mask):
    """The picture before a grey ground."""
    return np.where(mask[..., None], display, BACKGROUND)


def heat(error):
    """Colours (H, W, 3) of errors (H, W): black, violet, orange, white."""
    x = np.clip(error / FULL, 0, 1)
    stops = np.array(
        [[0, 0, 0], [70, 15, 110], [180, 50, 90], [245, 125, 20], [252, 255, 200]], float
    )
    return np.stack(
        [np.interp(x, np.linspace(0, 1, len(stops)), stops[:, k]) for k in range(3)], -1
    )
