"""Photographs whose depth was measured by stereo: their normals, and how far these may be off.

A disparity d (pixels) at focal length f (pixels) and baseline b means a depth f b / (d + offset).
On a plane, d is linear in the pixel's place; with its slopes α to the right and β downwards and its
value γ = d + offset at the optical centre the plane's normal in the camera frame is parallel to
(−α f, β f, γ). Planes are fitted about each pixel under a Gaussian window.

H, W  pixels of a photograph; normals are in the frame of each pixel's ray, as networks predict them
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from scipy.ndimage import gaussian_filter

from learn.data import photographs
from manifests import archives
from manifests.errors import InputError
from manifests.reading import read
from manifests.store_paths import inside
from shaders import frames

LARGEST_ARRAY = 256 << 20  # bytes of a disparity map
LEAST_SHARE = 0.35  # of a window: pixels with less of it on the object have no normal
TRIALS = 8  # of the simulated error


class Scene(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A photograph with a map of disparities.

    picture, disparity  files below --pictures: a picture, and a PNG or an .npz of one array
    centre        optical centre (x, y), pixels
    offset        added to disparities before they become depth; offset_error: how far it may be off
    step          of rounded disparities, 0 for those that are not rounded
    window        standard deviation of the window of plane fits, pixels
    objects       {name: file of a mask below the folder of the description}
    shapes        {name: one of learn.primitives.PRIMITIVES} of objects that have such a shape
    """

    name: str
    about: str
    picture: str
    disparity: str
    focal: float
    centre: tuple[float, float]
    baseline_mm: float
    offset: float
    offset_error: float
    step: float
    window: float
    objects: dict[str, str]
    shapes: dict[str, Literal["box", "cylinder", "ball", "flat"]] = {}


class Scenes(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A description of several scenes, as a file holds it."""

    scenes: list[Scene]


@dataclass(frozen=True)
class StereoObject:
    """An object of a scene.

    picture  (H, W, 3) radiance; mask (H, W) bool
    normals  (H, W, 3) unit length where `valid` (H, W) bool, in the frame of each pixel's ray
    own      {cause: mean angle in degrees by which it turns the normals}
    shape    one of learn.primitives.PRIMITIVES, None if it has no such shape
    """

    name: str
    picture: np.ndarray
    mask: np.ndarray
    normals: np.ndarray
    valid: np.ndarray
    own: dict[str, float]
    shape: str | None = None


def objects_of(description: Path, pictures: Path) -> list[StereoObject]:
    """Return all objects of a description. Raises InputError."""
    result = []
    for scene in read(description, Scenes).scenes:
        picture, _ = photographs.read_pixels(inside(pictures, scene.picture))
        disparity = _disparity(inside(pictures, scene.disparity))
        if disparity.shape != picture.shape[:2]:
            rule = f"disparities of the picture's size {picture.shape[1]} × {picture.shape[0]}"
            shape = " × ".join(str(n) for n in disparity.shape[::-1])
            raise InputError(scene.disparity, rule, shape, "take the map of this picture")
        for name, file in scene.objects.items():
            path = inside(description.parent, file)
            mask = photographs.read_mask(path, picture.shape[:2]) >= 0.5
            photographs.require_object(path, mask.astype(np.float32))
            of = _object(f"{scene.name}: {name}", scene, picture, disparity, mask)
            result.append(replace(of, shape=scene.shapes.get(name)))
    return result


def _disparity(path: Path) -> np.ndarray:
    """Return a map (H, W) float64, NaN where it has no value."""
    if path.suffix.lower() != ".npz":
        values, _ = photographs.read_pixels(path)
        shown = 255 * photographs.tone.srgb(values[..., 0].astype(np.float64))
        return np.where(np.rint(shown) > 0, np.rint(shown), np.nan)
    rule, remedy = "an .npz of one map of disparities", "write it by numpy.savez"
    with archives.open_zip(path, rule, remedy) as archive:
        (name, *rest) = archive.namelist()
        if rest:
            raise InputError(path, rule, f"{1 + len(rest)} arrays", remedy)
        values = archives.read_array(archive, name, LARGEST_ARRAY)
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise InputError(path, rule, f"{values.shape} of {values.dtype}", remedy)
    return np.where(np.isfinite(values), values, np.nan).astype(np.float64)


def _object(
    name: str, scene: Scene, picture: np.ndarray, disparity: np.ndarray, mask: np.ndarray
) -> StereoObject:
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    top, left = int(rows[0]), int(columns[0])
    part = np.s_[top : rows[-1] + 1, left : columns[-1] + 1]
    centre = (scene.centre[0] - left, scene.centre[1] - top)
    scene = msgspec.structs.replace(scene, centre=centre)
    known = (mask & np.isfinite(disparity))[part]
    plane, defined = fit_planes(disparity[part], known, scene.window)
    own = own_error(disparity[part], known, plane, defined, scene)
    normals, valid = np.zeros_like(picture, np.float64), np.zeros_like(mask)
    normals[part], valid[part] = normals_of(plane, scene), defined
    return StereoObject(name, picture, mask, normals, valid, own)


def fit_planes(
    disparity: np.ndarray, known: np.ndarray, window: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return planes (H, W, 3) fitted about each pixel, and where there are any (H, W).

    A plane is (value at the pixel, slope to the right, slope downwards), of disparities (H, W) at
    the pixels that are `known`.
    """
    weight = known.astype(np.float64)
    value = np.where(known, disparity, 0.0)
    y, x = np.indices(disparity.shape, dtype=np.float64)

    def mean(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values * weight, window, truncate=3.0, mode="constant")

    share = mean(np.ones_like(weight))
    valid = known & (share > LEAST_SHARE)
    total = np.where(valid, share, 1.0)
    centre_x, centre_y, level = (mean(each) / total for each in (x, y, value))
    xx, yy = mean(x * x) / total - centre_x**2, mean(y * y) / total - centre_y**2
    xy = mean(x * y) / total - centre_x * centre_y
    xd, yd = (
        mean(each * value) / total - centre * level
        for each, centre in ((x, centre_x), (y, centre_y))
    )
    determinant = np.where(valid, xx * yy - xy**2, 1.0)
    right, down = (yy * xd - xy * yd) / determinant, (xx * yd - xy * xd) / determinant
    here = level + right * (x - centre_x) + down * (y - centre_y)
    return np.stack([here, right, down], -1), valid


def normals_of(plane: np.ndarray, scene: Scene, offset: float | None = None) -> np.ndarray:
    """Return normals (H, W, 3) of planes (H, W, 3), in the frame of each pixel's ray.

    offset  in place of the scene's
    """
    height, width = plane.shape[:2]
    y, x = np.indices((height, width), dtype=np.float64)
    x, y = x - scene.centre[0], y - scene.centre[1]
    here, right, down = np.moveaxis(plane, -1, 0)
    at_centre = here - right * x - down * y + (scene.offset if offset is None else offset)
    n = np.stack([-right * scene.focal, down * scene.focal, at_centre], -1)
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    v = np.stack([-x, y, np.full_like(x, scene.focal)], -1)
    return frames.turned_to_viewer(n, v / np.linalg.norm(v, axis=-1, keepdims=True))


def own_error(
    disparity: np.ndarray, known: np.ndarray, plane: np.ndarray, valid: np.ndarray, scene: Scene
) -> dict[str, float]:
    """Return {cause: mean angle in degrees} by which measured normals may be off.

    noise   the fitted surface is measured again: rounded to the scene's step after a random shift,
            or with independent noise as large as the fit's residuals; and fitted again
    window  normals of a window half as wide are compared: what smoothing may hide, and noise again
    offset  the offset is moved by its error
    """
    rng = np.random.default_rng(0)
    right = normals_of(plane, scene)
    # values between whole steps, so that the simulated rounding is that of a smooth surface
    smooth = np.where(valid, plane[..., 0], disparity)
    deviation = float(np.std((disparity - plane[..., 0])[valid]))
    angles = []
    for _ in range(TRIALS):
        if scene.step:
            shift = rng.uniform(0, scene.step)
            again = scene.step * np.rint((smooth + shift) / scene.step) - shift
        else:
            again = smooth + rng.normal(0, deviation, smooth.shape)
        measured, _ = fit_planes(again, valid, scene.window)
        base, fits = fit_planes(smooth, valid, scene.window)
        angles.append(angle(normals_of(measured, scene), normals_of(base, scene))[fits].mean())
    narrow, fits = fit_planes(disparity, known, scene.window / 2)
    both = valid & fits
    result = {
        "noise": float(np.mean(angles)),
        "window": float(angle(normals_of(narrow, scene), right)[both].mean()),
    }
    if scene.offset_error:
        moved = normals_of(plane, scene, scene.offset + scene.offset_error)
        result["offset"] = float(angle(moved, right)[valid].mean())
    return result


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return angles (…) in degrees between unit vectors (…, 3)."""
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))
