"""What a network sees of a scene on a rung of the ladder, and the truth about it.

H, W   the network's picture; on 8-bit rungs a square about the object, as of a user's photograph

Normals are compared in the frame of each pixel's ray, whose z points to the camera: networks assume
a distant viewer, so that perspective is taken out of the truth. Of an orthographic camera this is
the camera frame.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from learn.data import framing, photographs
from learn.data.batch import ExampleBatch, collate
from learn.data.records import Records, Sample
from learn.evaluation.ladder_design import Rung, Scene
from manifests.files import write_image
from shaders import tone
from shaders.frames import ELEVATION, turned_to_viewer


@dataclass(frozen=True)
class Shown:
    """A scene on a rung.

    batch   of one picture, as networks see it; n is the true normals in the ray frame, label the
            source's, light the true light, and elevation what networks assume
    target  (H, W, 3) radiance of the truth of the edit, 0 outside the mask
    mask    (H, W) bool
    label   (1, 108) float32 natural logarithms of the target material
    exposure  the factor from what the file holds to what the network sees; 1.0 without a file
    """

    batch: ExampleBatch
    target: np.ndarray
    mask: np.ndarray
    label: np.ndarray
    exposure: float


def load_scene(records: Records, scene: Scene, rung: Rung, size: int) -> Shown:
    """Return a scene on a rung, at the network's size. Raises InputError for damaged files."""
    sample, truth = records.load(scene.source[rung.name]), records.image(scene.truth[rung.name])
    mask, image = sample.mask.numpy(), sample.image.numpy()
    normals, exposure = ray_frame_normals(sample), 1.0
    if rung.eight_bit:
        framed = framing.frame_object(*through_png(image, mask), size)
        image, exposure = framed.radiance, framed.exposure
        truth, normals = (_crop(values, mask, framed, size) for values in (truth, normals))
        mask = framed.mask & (np.linalg.norm(normals, axis=-1) > 0)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        normals = np.where(mask[..., None], normals / np.maximum(length, 1e-6), 0)
    label = sample.label[:1].numpy()
    example = (
        (image * mask[..., None]).astype(np.float32),
        mask,
        normals.astype(np.float32),
        mask.astype(np.int64),
        label,
        sample.light,
        label,
        f"{scene.shape} {scene.light} {rung.name}",
    )
    target = records.label(scene.truth[rung.name].materials[0])[None]
    batch = collate([example], float(ELEVATION))
    return Shown(batch, truth * mask[..., None], mask, target, exposure)


def through_png(radiance: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance and mask as they are read from a PNG of the picture.

    The PNG has 8 bits, sRGB under automatic exposure (the 99th percentile of the object's luminance
    is 1, and what is brighter is clipped), and the mask as its alpha.

    radiance (H, W, 3), mask (H, W) bool
    """
    display = tone.display(radiance * mask[..., None], tone.auto_exposure(radiance, mask))
    pixels = np.concatenate([np.rint(display), 255.0 * mask[..., None]], -1).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        write_image(path, pixels, "PNG")
        return photographs.read(path)


def ray_frame_normals(sample: Sample) -> np.ndarray:
    """Return normals (H, W, 3) of a sample in the frame of each pixel's ray, 0 outside the object.

    The frame of a pixel is the camera's, turned by the shortest way so that z points to the viewer.
    """
    n = sample.n.numpy()
    if sample.view is None:
        return n
    return turned_to_viewer(n, sample.view.numpy())


def _crop(values: np.ndarray, mask: np.ndarray, framed: framing.Framed, size: int) -> np.ndarray:
    """Values (H, W, 3) in the square of a framed picture, as `framing.frame_object` crops it."""
    covered = framing.resize_square(framing.cut_square(mask.astype(np.float32), framed.box), size)
    inside = framing.cut_square((values * mask[..., None]).astype(np.float32), framed.box)
    return framing.resize_square(inside, size) / np.maximum(covered, 1e-3)[..., None]
