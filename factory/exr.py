"""Pictures and geometry as OpenEXR files: whole or not there at all.

picture   channels R, G, B; half; linear Rec.709 radiance, row 0 at the top
geometry  normal.X, normal.Y, normal.Z (float, camera frame) and depth.Z (float), rounded to 2^-15: a normal turns by .001° at most (in
          half by .03°, a tenth of chrome's lobe), and files shrink by 20 to 60 %; segment (uint32; 0: background: mask = segment > 0)
"""

import numpy as np

from manifests import exr
from manifests.problems import Problem

GEOMETRY_STEPS = np.float32(1 << 15)  # a unit
LARGEST_HALF = 65504.0  # a sun seen in a mirror may exceed it; it is far above any exposure's white


def _stacked(path, channels, names):
    missing = [name for name in names if name not in channels]
    if missing:
        raise Problem(path, f"channels {', '.join(names)}", f"only {', '.join(sorted(channels))}", "render or copy it again")
    return np.stack([channels[name] for name in names], axis=-1)


def write_picture(path, radiance):
    """radiance (height, width, 3); stored as half, values above 65504 held there."""
    half = np.clip(radiance, 0.0, LARGEST_HALF).astype(np.float16)
    exr.write(path, {name: half[..., k] for k, name in enumerate("RGB")})


def read_picture(path):
    """Radiance (height, width, 3) float32."""
    return _stacked(path, exr.read(path), ("R", "G", "B")).astype(np.float32)


def write_geometry(path, geometry):
    """geometry: anything with normals (height, width, 3), depth (height, width) and segments (height, width), as studio.Geometry has."""
    layers = {f"normal.{axis}": geometry.normals[..., k] for k, axis in enumerate("XYZ")} | {"depth.Z": geometry.depth}
    channels = {name: np.rint(values.astype(np.float32) * GEOMETRY_STEPS) / GEOMETRY_STEPS for name, values in layers.items()}
    exr.write(path, channels | {"segment": geometry.segments.astype(np.uint32)})


def read_geometry(path):
    """normals (height, width, 3) float32, mask (height, width) bool, depth (height, width) float32, segments (height, width) uint8."""
    channels = exr.read(path)
    normals = _stacked(path, channels, ("normal.X", "normal.Y", "normal.Z")).astype(np.float32)
    depth, segments = (_stacked(path, channels, (name,))[..., 0] for name in ("depth.Z", "segment"))
    return normals, segments > 0, depth.astype(np.float32), segments.astype(np.uint8)
