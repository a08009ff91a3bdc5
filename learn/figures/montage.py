"""Contact sheets: labelled tiles that show an edit, a prediction or a training run.

Pictures are (H, W, 3) display values in [0, 255].
"""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from manifests import captions
from shaders import tone

BORDER, GROUND = 4, 32.0
LIGHT_EXPOSURE = 0.5

Tile = tuple[str, np.ndarray | None]  # caption and display picture; None leaves the place empty


def eight_bit(display: np.ndarray) -> np.ndarray:
    """Return display values rounded to uint8."""
    return np.clip(np.rint(display), 0, 255).astype(np.uint8)


def fit_into_square(display: np.ndarray, size: int) -> np.ndarray:
    """Return a display picture (H, W, 3) scaled into a square (size, size, 3)."""
    H, W = display.shape[:2]
    height, width = max(1, round(size * H / max(H, W))), max(1, round(size * W / max(H, W)))
    small = Image.fromarray(np.clip(display, 0, 255).astype(np.uint8)).resize(
        (width, height), Image.Resampling.LANCZOS
    )
    out = np.full((size, size, 3), GROUND)
    top, left = (size - height) // 2, (size - width) // 2
    out[top : top + height, left : left + width] = small
    return out


def contact_sheet(rows: Sequence[Sequence[Tile]], size: int) -> np.ndarray:
    """Return one picture (H, W, 3) uint8 of rows of captioned tiles, each size pixels square."""
    columns = max(len(row) for row in rows)
    step_y, step_x = size + captions.LINE + BORDER, size + BORDER
    canvas = Image.new(
        "RGB", (columns * step_x + BORDER, len(rows) * step_y + BORDER), (int(GROUND) // 2,) * 3
    )
    draw = ImageDraw.Draw(canvas)
    for i, row in enumerate(rows):
        for j, (caption, picture) in enumerate(row):
            if picture is None:
                continue
            x, y = BORDER + j * step_x, BORDER + i * step_y
            captions.write_caption(draw, (x, y), caption, size, fill=(230, 230, 230))
            canvas.paste(
                Image.fromarray(np.clip(fit_into_square(picture, size), 0, 255).astype(np.uint8)),
                (x, y + captions.LINE),
            )
    return np.asarray(canvas)


def grid(rows: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Return pictures of one size side by side, row beneath row, without captions or borders."""
    return np.concatenate([np.concatenate(list(row), 1) for row in rows], 0)


def normals_picture(n: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return normals (H, W, 3), camera frame, as colours; black outside the mask (H, W)."""
    return (n * 0.5 + 0.5) * 255 * mask[..., None]


def light_picture(L: np.ndarray) -> np.ndarray:
    """Return a light map (Hl, Wl, 3) as a display picture at a fixed exposure."""
    return tone.display(L, LIGHT_EXPOSURE)
