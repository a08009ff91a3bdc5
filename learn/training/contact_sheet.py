"""The contact sheet of a validation, one row per example.

Columns: picture as the network sees it, predicted and true normals, predicted and true light, true
and predicted material on a sphere, I', O', true O.
"""

from pathlib import Path

import numpy as np
import torch

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.figures import montage
from learn.figures.spheres import preview_sphere
from learn.networks.prediction import Prediction, require_part
from learn.training.validation import render_batch
from manifests.files import write_image
from shaders import tone

ROWS = 6


def write(path: Path, batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Write the contact sheet of a batch as a JPEG; return it as `draw` does."""
    picture = draw(batch, prediction)
    write_image(path, picture, "JPEG", quality=90)
    return picture


def draw(batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Return the first ROWS examples of a batch as (rows H, columns W, 3) uint8.

    Parts that were not predicted are shown as the truth.
    """
    n = batch.n if prediction.n is None else prediction.n
    label = batch.label if prediction.label is None else prediction.label
    light = batch.light if prediction.light is None else prediction.light
    rendered = render_batch(n, label, light, batch)
    target = render_batch(n, batch.target_label, light, batch)
    true_target, true_image = (
        render_batch(batch.n, truth, batch.light, batch)
        if of_cycles is None
        else _channels_last(of_cycles)
        for truth, of_cycles in ((batch.target_label, batch.target), (batch.label, batch.picture))
    )
    rows = []
    for i in range(min(ROWS, len(n))):
        mask = to_numpy(batch.segments[i] > 0)
        exposure = tone.auto_exposure(true_image[i], mask)
        target_exposure = tone.auto_exposure(true_target[i], mask)
        size = len(mask)
        row = [
            tone.display(to_numpy(batch.image[i].movedim(0, -1)), exposure),
            _normals(n[i], mask),
            _normals(batch.n[i], mask),
            _light(light[i], size),
            _light(batch.light[i], size),
            preview_sphere(batch.label[i, 0], size, batch.elevation),
            preview_sphere(label[i, 0], size, batch.elevation),
            tone.display(rendered[i], exposure),
            tone.display(target[i], target_exposure),
            tone.display(true_target[i], target_exposure),
        ]
        rows.append([np.clip(cell, 0, 255) for cell in row])
    return montage.grid(rows).astype(np.uint8)


def draw_decomposition(
    batch: ExampleBatch, prediction: Prediction, rendering: np.ndarray, exposure: float
) -> dict[str, np.ndarray]:
    """Return {name: display picture} of one decomposed picture.

    batch      of one picture; prediction: of it, with all parts
    rendering  (H, W, 3) radiance, the picture rendered from its prediction
    exposure   by which the picture and its rendering are displayed
    """
    mask = to_numpy(batch.mask[0, 0]) > 0
    return {
        "picture": tone.display(to_numpy(batch.image[0].movedim(0, -1)), exposure),
        "normals": _normals(require_part(prediction.n)[0], mask),
        "light": _light(require_part(prediction.light)[0], len(mask)),
        "material": preview_sphere(
            require_part(prediction.label)[0, 0], len(mask), batch.elevation
        ),
        "rendering": tone.display(rendering, exposure),
    }


def _channels_last(values: torch.Tensor) -> np.ndarray:
    """Return pictures (B, 3, H, W) as (B, H, W, 3) numpy."""
    return to_numpy(values.movedim(1, -1))


def _normals(n: torch.Tensor, mask: np.ndarray) -> np.ndarray:
    return montage.normals_picture(to_numpy(n.movedim(0, -1)), mask)


def _light(light: torch.Tensor, size: int) -> np.ndarray:
    return montage.fit_into_square(
        montage.light_picture(to_numpy(light.movedim(0, -1).float())), size
    )
