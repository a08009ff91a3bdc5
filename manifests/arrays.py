"""The arrays of a data set on disk: channel names, types, units, frames and rounding.

This is their only home. The constants FILES and PACKED state each array in a line; docs/dataset.md
repeats the table for people, and a test compares the two.

picture    OpenEXR, half: R, G, B. Linear Rec.709 radiance under the light scaled to unit mean
           luminance; row 0 at the top.
geometry   OpenEXR, float32: normal.X, normal.Y, normal.Z, unit vectors in the camera frame (x
           right, y up, z towards the viewer), 0 in the background; depth.Z, distance along the
           optical axis behind the plane through the object's centre, in radii of the sphere that
           the object fills, negative in front of the plane, 0 in the background. Both are rounded
           to 2^-15: a normal turns by .001° at most (in half precision by .03°, a tenth of chrome's
           lobe), and files shrink by 20 to 60 %. uint32: segment, 1 … S, 0 in the background; mask
           = segment > 0. Where pixels are points and the viewer is distant also the channels of
           manifests.facets.
light map  npz: L, (64, 128, 3) float32, linear Rec.709 radiance of unit mean luminance, rows from
           the zenith down, columns around the vertical axis, as the camera sees it at rotation 0;
           scale, the mean luminance by which the map was divided.

height, width are those of the picture. manifests.picture_files, manifests.light_files and
manifests.packed_geometry write and read these arrays.
"""

from typing import NamedTuple

import numpy as np

from manifests import facets

PICTURE_CHANNELS = ("R", "G", "B")
NORMAL_CHANNELS = ("normal.X", "normal.Y", "normal.Z")
DEPTH_CHANNEL = "depth.Z"
SEGMENT_CHANNEL = "segment"
STEPS_PER_UNIT = np.float32(1 << 15)  # of normals and depth
LARGEST_HALF = 65504.0  # a sun seen in a mirror may exceed it; it is far above any exposure's white
MOST_SEGMENTS = 255
PACKED_UNIT = 32767  # of packed normals
PACKED_RADIUS = 16384  # of packed depth, at most 2 radii
LIGHT_SHAPE = (64, 128, 3)
LIGHT_MEMBERS: dict[str, tuple[tuple[int, ...], np.dtype]] = {
    "L": (LIGHT_SHAPE, np.dtype(np.float32)),
    "scale": ((), np.dtype(np.float64)),
}
# names in the cache of geometry that training keeps
PACKED_NORMALS, PACKED_SEGMENTS, PACKED_DEPTH = "normals.npy", "segments.npy", "depth.npy"


class Array(NamedTuple):
    """How one array is written: an OpenEXR channel, a member of an .npz, or an .npy file."""

    name: str
    type: np.dtype
    shape: str
    unit: str
    frame: str
    rounding: str


_FRAME = "height × width"  # of the picture
_STEP = f"steps of 2^-{int(np.log2(STEPS_PER_UNIT))}"
PICTURE = tuple(
    Array(
        name,
        np.dtype(np.float16),
        _FRAME,
        f"radiance, linear Rec.709 {colour}, relative to the light's mean luminance",
        "picture, row 0 at the top",
        f"half precision, at most {LARGEST_HALF:g}",
    )
    for name, colour in zip(PICTURE_CHANNELS, ("red", "green", "blue"), strict=True)
)
GEOMETRY = (
    *(
        Array(
            name,
            np.dtype(np.float32),
            _FRAME,
            "part of a unit vector; 0 in the background",
            f"camera, {axis}",
            _STEP,
        )
        for name, axis in zip(
            NORMAL_CHANNELS, ("x right", "y up", "z towards the viewer"), strict=True
        )
    ),
    Array(
        DEPTH_CHANNEL,
        np.dtype(np.float32),
        _FRAME,
        "radii of the sphere that the object fills; 0 in the background",
        "camera, along the optical axis, behind the plane through the object's centre",
        _STEP,
    ),
    Array(
        SEGMENT_CHANNEL,
        np.dtype(np.uint32),
        _FRAME,
        f"segment id, 1 to {MOST_SEGMENTS}; 0 in the background",
        "picture",
        "none",
    ),
)
FACETS = (  # of points seen by a distant viewer
    *(
        Array(name, np.dtype(np.float32), _FRAME, f"part of the {what}", f"camera, {axis}", _STEP)
        for what, names in facets.VECTORS.items()
        for name, axis in zip(names, ("x right", "y up", "z towards the viewer"), strict=True)
    ),
    *(
        Array(name, np.dtype(np.float32), _FRAME, what, "picture", _STEP)
        for name, what in facets.NUMBERS.items()
        if name != facets.OTHER_SEGMENT
    ),
    Array(
        facets.OTHER_SEGMENT,
        np.dtype(np.uint32),
        _FRAME,
        facets.NUMBERS[facets.OTHER_SEGMENT],
        "picture",
        "none",
    ),
)
LIGHT = (
    Array(
        "L",
        LIGHT_MEMBERS["L"][1],
        " × ".join(map(str, LIGHT_SHAPE)),
        "radiance, linear Rec.709, of mean luminance 1 over the sphere",
        "light, rows from the zenith down, as the camera sees it at rotation 0",
        "none",
    ),
    Array(
        "scale",
        LIGHT_MEMBERS["scale"][1],
        "one number",
        "mean luminance of the original map, by which it was divided",
        "none",
        "none",
    ),
)
PACKED = (
    Array(
        PACKED_NORMALS,
        np.dtype(np.int16),
        f"views × {_FRAME} × 2",
        f"x and y of the normals in units of 1/{PACKED_UNIT}; z = √(1 − x² − y²)",
        "camera",
        f"steps of 1/{PACKED_UNIT}",
    ),
    Array(
        PACKED_SEGMENTS,
        np.dtype(np.uint8),
        f"views × {_FRAME}",
        "segment id, 0 in the background",
        "picture",
        "none",
    ),
    Array(
        PACKED_DEPTH,
        np.dtype(np.int16),
        f"views × {_FRAME}",
        f"depth in units of 1/{PACKED_RADIUS} radius, for runs with shadows",
        "camera, along the optical axis",
        f"steps of 1/{PACKED_RADIUS}",
    ),
)
FILES = {
    "images/ab/ID.exr": PICTURE,
    "geometry/ab/ID.exr": (*GEOMETRY, *FACETS),
    "lights/NAME-HASH.npz": LIGHT,
}
PICTURE_TYPES = {array.name: array.type for array in PICTURE}
GEOMETRY_TYPES = {array.name: array.type for array in GEOMETRY}
FACET_TYPES = {name: array.type for array in FACETS for name in facets.number_channels(array.name)}
PACKED_TYPES = {array.name: array.type for array in PACKED}


def table() -> str:
    """Return the arrays of a data set's files as the Markdown table that docs/dataset.md holds."""
    lines = [
        "| file | array | type | shape | unit | frame | rounding |",
        "|---|---|---|---|---|---|---|",
    ]
    for file, arrays in FILES.items():
        lines += [
            f"| `{file}` | `{a.name}` | {a.type} | {a.shape} | {a.unit} | {a.frame} |"
            f" {a.rounding} |"
            for a in arrays
        ]
    return "\n".join(lines) + "\n"
