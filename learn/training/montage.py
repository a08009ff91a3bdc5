"""A sheet of pictures that shows how a run is doing, one example a row: people look before they
read.

Columns: picture as seen, predicted and true normals, predicted and true light, true and predicted
material on a sphere, I', O', true O.
"""

import numpy as np

from learn.data.devices import array
from learn.figures import montage
from learn.figures.spheres import preview_sphere
from learn.training.validation import picture
from manifests.files import write_image
from shaders import tone

ROWS = 6


def write(path, batch, prediction):
    """The first rows of a batch as a JPEG; returns them as `cells` does."""
    result = cells(batch, prediction)
    write_image(path, result, "JPEG", quality=90)
    return result


def cells(batch, prediction):
    """(rows H, columns W, 3) uint8 of the first rows of a batch. Parts that were not predicted are
    shown as true.
    """
    n = batch.n if prediction.n is None else prediction.n
    label = batch.label if prediction.label is None else prediction.label
    light = batch.light if prediction.light is None else prediction.light
    mine, target = picture(n, label, light, batch), picture(n, batch.target_label, light, batch)
    true_target, true_image = (
        (
            picture(batch.n, truth, batch.light, batch)
            if rendered is None
            else array(rendered.movedim(1, -1))
        )
        for truth, rendered in ((batch.target_label, batch.target), (batch.label, batch.picture))
    )
    rows = []
    for i in range(min(ROWS, len(n))):
        mask = array(batch.segments[i] > 0)
        exposure, other = (
            tone.auto_exposure(true_image[i], mask),
            tone.auto_exposure(true_target[i], mask),
        )
        seen = tone.display(array(batch.image[i].movedim(0, -1)), exposure)
        size = len(mask)
        row = [
            seen,
            _normals(n[i], mask),
            _normals(batch.n[i], mask),
            _light(light[i], size),
            _light(batch.light[i], size),
            preview_sphere(batch.label[i, 0], size, batch.elevation),
            preview_sphere(label[i, 0], size, batch.elevation),
            tone.display(mine[i], exposure),
            tone.display(target[i], other),
            tone.display(true_target[i], other),
        ]
        rows.append([np.clip(cell, 0, 255) for cell in row])
    return montage.grid(rows).astype(np.uint8)


def parts(batch, prediction, again, exposure):
    """{name: display picture} of one picture taken apart; again: (H, W, 3) radiance of the
    re-rendering.
    """
    mask = array(batch.mask[0, 0]) > 0
    return {
        "picture": tone.display(array(batch.image[0].movedim(0, -1)), exposure),
        "normals": _normals(prediction.n[0], mask),
        "light": _light(prediction.light[0], len(mask)),
        "material": preview_sphere(prediction.label[0, 0], len(mask), batch.elevation),
        "rendering": tone.display(again, exposure),
    }


def _normals(n, mask):
    return montage.normals_picture(array(n.movedim(0, -1)), mask)


def _light(light, size):
    return montage.fitted(montage.light_picture(array(light.movedim(0, -1).float())), size)
