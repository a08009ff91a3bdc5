"""The contact sheet of a validation, one row per example.

Columns: picture as the network sees it, predicted and true normals, predicted and true light, true
and predicted material on a sphere, I', O', true O.
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from learn.data.batch import ExampleBatch
from learn.data.devices import array
from learn.layer import render
from learn.networks.prediction import Prediction, required
from learn.training.validation import picture
from manifests.files import write_image
from shaders import tone

ROWS = 6


def write(path: Path, batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Write the contact sheet of a batch as a JPEG; return it as `contact_sheet` does."""
    sheet = contact_sheet(batch, prediction)
    write_image(path, sheet, "JPEG", quality=90)
    return sheet


def contact_sheet(batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Return the first ROWS examples of a batch as (rows H, columns W, 3) uint8.

    Parts that were not predicted are shown as the truth.
    """
    n = batch.n if prediction.n is None else prediction.n
    label = batch.label if prediction.label is None else prediction.label
    light = batch.light if prediction.light is None else prediction.light
    rendered = picture(n, label, light, batch)
    target = picture(n, batch.target_label, light, batch)
    true_target, true_image = (
        picture(batch.n, truth, batch.light, batch) if of_cycles is None else _last(of_cycles)
        for truth, of_cycles in ((batch.target_label, batch.target), (batch.label, batch.picture))
    )
    rows = []
    for i in range(min(ROWS, len(n))):
        mask = array(batch.segments[i] > 0)
        exposure = tone.auto_exposure(true_image[i], mask)
        target_exposure = tone.auto_exposure(true_target[i], mask)
        size = len(mask)
        row = [
            tone.display(array(batch.image[i].movedim(0, -1)), exposure),
            _normals(n[i], mask),
            _normals(batch.n[i], mask),
            _light(light[i], size),
            _light(batch.light[i], size),
            _sphere(batch.label[i, 0], size, batch.elevation),
            _sphere(label[i, 0], size, batch.elevation),
            tone.display(rendered[i], exposure),
            tone.display(target[i], target_exposure),
            tone.display(true_target[i], target_exposure),
        ]
        rows.append(np.concatenate([np.clip(c, 0, 255) for c in row], 1))
    return np.concatenate(rows).astype(np.uint8)


def parts(
    batch: ExampleBatch, prediction: Prediction, rendering: np.ndarray, exposure: float
) -> dict[str, np.ndarray]:
    """Return {name: display picture} of one decomposed picture.

    rendering  (H, W, 3) radiance, the picture rendered from its prediction
    """
    mask = array(batch.mask[0, 0]) > 0
    return {
        "picture": tone.display(array(batch.image[0].movedim(0, -1)), exposure),
        "normals": _normals(required(prediction.n)[0], mask),
        "light": _light(required(prediction.light)[0], len(mask)),
        "material": _sphere(required(prediction.label)[0, 0], len(mask), batch.elevation),
        "rendering": tone.display(rendering, exposure),
    }


def _last(values: torch.Tensor) -> np.ndarray:
    """Return pictures (B, 3, H, W) as (B, H, W, 3) numpy."""
    return array(values.movedim(1, -1))


def _normals(n: torch.Tensor, mask: np.ndarray) -> np.ndarray:
    return (array(n.movedim(0, -1)) * 0.5 + 0.5) * 255 * mask[..., None]


def _light(light: torch.Tensor, size: int) -> np.ndarray:
    small = tone.display(array(light.movedim(0, -1).float()), 0.5)
    cell = np.full((size, size, 3), 40.0)
    picture = np.asarray(Image.fromarray(small.astype(np.uint8)).resize((size, size // 2)), float)
    top = (size - len(picture)) // 2
    cell[top : top + len(picture)] = picture
    return cell


def _sphere(label: torch.Tensor, size: int, elevation: float) -> np.ndarray:
    """Return the material on a sphere under a plain light: bright above, one window."""
    at = (np.arange(size) + 0.5) / size * 2.2 - 1.1
    x, y = np.meshgrid(at, -at)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    n = torch.from_numpy((np.stack([x, y, z], -1) * (z > 0)[..., None]).astype(np.float32))[None]
    L = np.full((32, 64, 3), 0.4, np.float32)
    L[:16] = 0.9
    L[6:12, 8:16] = 12.0
    n, light = n.to(label.device), torch.from_numpy(L)[None].to(label.device)
    with torch.no_grad():
        radiance = render(n, label.detach().exp()[None], light, method="exact", elevation=elevation)
    return tone.display(array(radiance[0]), 0.8)
