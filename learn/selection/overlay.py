"""The photograph as the page shows it to be clicked on: its regions in colour, and the clicks."""

import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation

from learn.figures import montage
from learn.selection.marks import Selection

# display colours of the regions on the page; region 1 is the first
REGION_COLORS = np.array(
    [
        (0, 158, 115),
        (230, 159, 0),
        (86, 180, 233),
        (204, 121, 167),
        (240, 228, 66),
        (0, 114, 178),
        (213, 94, 0),
        (150, 150, 150),
    ],
    np.float64,
)
DISC, RIM = 5, 8  # radii in pixels of a click: in its region's colour, and with the white rim


def size_of(selection: Selection, scale: float) -> tuple[int, int]:
    """Return width and height of the photograph when it is scaled."""
    height, width = (max(1, round(scale * side)) for side in selection.size)
    return width, height


def draw(selection: Selection, scale: float) -> np.ndarray:
    """Return the photograph (h, w, 3) uint8, scaled, with its regions in colour."""
    width, height = size_of(selection, scale)
    labels = np.asarray(
        Image.fromarray(selection.labels()).resize((width, height), Image.Resampling.NEAREST)
    )
    shown = selection.reduced((width, height)).astype(np.float64)
    colors = np.concatenate([np.zeros((1, 3)), REGION_COLORS])[labels]
    inside = (labels > 0)[..., None]
    outside = 0.8 * shown if inside.any() else shown  # nothing is darker before the first click
    shown = np.where(inside, 0.55 * shown + 0.45 * colors, outside)
    edge = np.zeros(labels.shape, bool)
    edge[1:] |= labels[1:] != labels[:-1]
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge = binary_dilation(edge)
    # white within black, so that it is seen on a white object before a white wall
    shown[binary_dilation(edge, iterations=2)] = 0.0
    shown[edge] = 255.0
    rows, columns = np.ogrid[: labels.shape[0], : labels.shape[1]]
    for click in selection.clicks:
        distance = (rows - scale * click.row) ** 2 + (columns - scale * click.column) ** 2
        shown[distance <= RIM**2] = 255.0
        color = REGION_COLORS[click.region - 1] if click.region else np.zeros(3)
        shown[distance <= DISC**2] = color
    return montage.eight_bit(shown)
