"""The arrays of a dataset on disk: channel names, types, units, frames and rounding. The one home of all of them.

picture    OpenEXR, half: R, G, B. Linear Rec.709 radiance under the light scaled to unit mean luminance; row 0 at the top.
geometry   OpenEXR, float32: normal.X, normal.Y, normal.Z, unit vectors in the camera frame (x right, y up, z towards
           the viewer), 0 in the background; depth.Z, distance along the optical axis behind the plane through the
           object's centre, in radii of the sphere that the object fills, negative in front of it, 0 in the background.
           Both are rounded to 2^-15: a normal turns by .001° at most (in half precision by .03°, a tenth of chrome's
           lobe), and files shrink by 20 to 60 %. uint32: segment, 1 … S, 0 in the background; mask = segment > 0.
light map  npz: L, (64, 128, 3) float32, linear Rec.709 radiance of unit mean luminance, rows from the zenith down,
           columns around the vertical axis, as the camera sees it at rotation 0; scale, the factor taken off.

height, width are those of the picture. Whatever reads a file refuses what another program may have left there: missing
channels, other shapes, values that are no radiance. Each reader raises manifests.problems.Problem.
"""

import lzma
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifests import exr
from manifests.files import npz_bytes
from manifests.inputs import require_file
from manifests.problems import Problem

PICTURE_CHANNELS = ("R", "G", "B")
NORMAL_CHANNELS = ("normal.X", "normal.Y", "normal.Z")
DEPTH_CHANNEL = "depth.Z"
SEGMENT_CHANNEL = "segment"
STEPS_PER_UNIT = np.float32(1 << 15)  # of normals and depth
LARGEST_HALF = 65504.0  # a sun seen in a mirror may exceed it; it is far above any exposure's white
MOST_SEGMENTS = 255
LIGHT_SHAPE = (64, 128, 3)
LIGHT_BYTES = 4 << 20  # a stored map takes a tenth of it
AGAIN = "render or copy it again"


class Geometry(NamedTuple):
    """What a shape shows from one view.

    normals   (height, width, 3) float32, unit vectors in the camera frame, 0 in the background
    depth     (height, width) float32, 0 in the background
    segments  (height, width) uint8, 1 … S, 0 in the background
    """

    normals: np.ndarray
    depth: np.ndarray
    segments: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """(height, width) bool: what the object covers."""
        return self.segments > 0


def encode_picture(radiance: np.ndarray) -> bytes:
    """A picture's file. radiance (height, width, 3); values above 65504 are held there."""
    half = np.clip(radiance, 0.0, LARGEST_HALF).astype(np.float16)
    return exr.encode({name: half[..., k] for k, name in enumerate(PICTURE_CHANNELS)})


def read_picture(path: str | Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Radiance (height, width, 3) float32, finite and not negative.

    size    (height, width) that the picture must have, None: any
    Raises  Problem
    """
    channels = _channels(path, PICTURE_CHANNELS, size)
    radiance = np.stack([channels[name] for name in PICTURE_CHANNELS], axis=-1).astype(np.float32)
    if wrong := int((~(np.isfinite(radiance) & (radiance >= 0))).sum()):
        raise Problem(path, "finite radiance ≥ 0", f"{wrong} values that are not", AGAIN)
    return radiance


def encode_geometry(geometry: Any) -> bytes:
    """A geometry file. geometry: a Geometry, or anything with its three arrays."""
    layers = dict(zip(NORMAL_CHANNELS, np.moveaxis(geometry.normals, -1, 0), strict=True))
    layers[DEPTH_CHANNEL] = geometry.depth
    rounded = {name: np.rint(values.astype(np.float32) * STEPS_PER_UNIT) / STEPS_PER_UNIT for name, values in layers.items()}
    return exr.encode(rounded | {SEGMENT_CHANNEL: geometry.segments.astype(np.uint32)})


def read_geometry(path: str | Path, size: tuple[int, int] | None = None) -> Geometry:
    """The Geometry of a file.

    size    (height, width) that it must have, None: any
    Raises  Problem
    """
    channels = _channels(path, (*NORMAL_CHANNELS, DEPTH_CHANNEL, SEGMENT_CHANNEL), size)
    segments = channels[SEGMENT_CHANNEL]
    whole = segments.astype(np.int64) if np.isfinite(segments).all() else np.full_like(segments, -1, np.int64)
    if (whole != segments).any() or whole.min(initial=0) < 0 or whole.max(initial=0) > MOST_SEGMENTS:
        raise Problem(path, f"segments 0 to {MOST_SEGMENTS}", f"{segments.min()} to {segments.max()}", AGAIN)
    normals = np.stack([channels[name] for name in NORMAL_CHANNELS], axis=-1).astype(np.float32)
    return Geometry(normals, channels[DEPTH_CHANNEL].astype(np.float32), whole.astype(np.uint8))


def encode_light(L: np.ndarray, scale: float) -> bytes:
    """A stored light's file. L (64, 128, 3); scale: what L was divided by."""
    return npz_bytes({"L": np.asarray(L, np.float32), "scale": np.float64(scale)})


def read_light(path: str | Path) -> np.ndarray:
    """L (64, 128, 3) float32 of a stored light, finite and not negative. Raises Problem."""
    remedy = "render or copy the dataset again"
    require_file(path, "a stored light map", remedy, LIGHT_BYTES)
    try:
        with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
            member = archive.getinfo("L.npy")
            if member.file_size > LIGHT_BYTES:  # told by the directory, before memory is taken
                raise Problem(path, f"radiance of shape {LIGHT_SHAPE}", f"{member.file_size} bytes", remedy)
            with archive.open(member) as stored:
                L = np.lib.format.read_array(stored, allow_pickle=False)
    except Problem:
        raise
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError) as error:
        raise Problem(path, "a stored light map", str(error)[:120] or "none", remedy) from None
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError) as error:
        raise Problem(path, "a stored light map", str(error)[:120], remedy) from None
    if L.shape != LIGHT_SHAPE or L.dtype.kind != "f":
        raise Problem(path, f"radiance of shape {LIGHT_SHAPE}", f"{L.shape} of {L.dtype}", remedy)
    if wrong := int((~(np.isfinite(L) & (L >= 0))).sum()):
        raise Problem(path, "finite radiance ≥ 0", f"{wrong} values that are not", remedy)
    return L.astype(np.float32)


def _channels(path: str | Path, names: tuple[str, ...], size: tuple[int, int] | None) -> dict[str, np.ndarray]:
    """The named channels of a file, all of one size."""
    channels = exr.read(path)
    missing = [name for name in names if name not in channels]
    if missing:
        found = f"only {', '.join(sorted(channels))}"
        raise Problem(path, f"channels {', '.join(names)}", found, AGAIN)
    sizes = {channels[name].shape for name in names}
    if len(sizes) != 1 or any(len(shape) != 2 for shape in sizes) or (size is not None and sizes != {tuple(size)}):
        expected = "one size of all channels" if size is None else f"{size[0]} × {size[1]} pixels"
        found = ", ".join(sorted(" × ".join(map(str, shape)) for shape in sizes))
        raise Problem(path, expected, found, AGAIN)
    return channels
