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

height, width are those of the picture. Readers refuse what another program may have written:
missing channels, other shapes, values that are no radiance. Each reader raises
manifests.errors.InputError.
"""

import hashlib
import io
import zipfile
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from manifests import archives, exr, facets
from manifests.errors import InputError
from manifests.facets import Facets
from manifests.files import npz_bytes
from manifests.inputs import require_file
from shaders.envmap import mean_radiance
from shaders.tone import LUMINANCE

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
LIGHT_BYTES = 4 << 20  # a stored map takes a tenth of it
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
        "mean luminance of the map before it was divided by it",
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
FACET_TYPES = {name: array.type for array in FACETS for name in facets.numbered(array.name)}
PACKED_TYPES = {array.name: array.type for array in PACKED}
PIXEL_BYTES = 4 * len(
    GEOMETRY_TYPES | FACET_TYPES
)  # the most that a pixel of ours takes, uncompressed
# the most that an EXR's header and its table of lines take beside the pixels
HEADER_BYTES = 1 << 20
UNIT_LENGTH = 1e-2  # of |n|; what is written keeps it to 1e-4
UNIT_MEAN = 1e-4  # of a light's mean luminance; float32 sums keep it to 1e-6
AGAIN = "render or copy it again"
LIGHT_AGAIN = "render or copy the data set again"
_NO_ARCHIVE = (*archives.DAMAGE, KeyError)  # KeyError: a member is missing


class SeenGeometry(Protocol):
    """What a geometry file is encoded from: the arrays of Geometry, and the mask beside them."""

    @property
    def normals(self) -> np.ndarray: ...

    @property
    def depth(self) -> np.ndarray: ...

    @property
    def segments(self) -> np.ndarray: ...

    @property
    def mask(self) -> np.ndarray: ...

    @property
    def facets(self) -> Facets | None: ...


class Geometry(NamedTuple):
    """What a shape shows from one view.

    normals   (height, width, 3) float32, unit vectors in the camera frame, 0 in the background
    depth     (height, width) float32, 0 in the background
    segments  (height, width) uint8, 1 … S, 0 in the background
    facets    None where the file holds none
    """

    normals: np.ndarray
    depth: np.ndarray
    segments: np.ndarray
    facets: Facets | None = None

    @property
    def mask(self) -> np.ndarray:
        """(height, width) bool: what the object covers."""
        return self.segments > 0


def encode_picture(radiance: np.ndarray) -> bytes:
    """Return the bytes of a picture's file.

    radiance  (height, width, 3); values above 65504 are clipped to it
    """
    half = np.clip(radiance, 0.0, LARGEST_HALF).astype(np.float16)
    return exr.encode({name: half[..., k] for k, name in enumerate(PICTURE_CHANNELS)})


def read_picture(
    path: str | Path,
    size: tuple[int, int] | None = None,
    file_hash: str | None = None,
    exact: bool = False,
) -> np.ndarray:
    """Return radiance (height, width, 3) float32, finite and not negative.

    size       (height, width) that the picture must have, None: any
    file_hash  sha256 that the file must have, None: any
    exact      refuse other channels and types than `encode_picture` writes
    Raises     InputError
    """
    channels = _channels(path, PICTURE_TYPES, size, file_hash, exact)
    radiance = np.stack([channels[name] for name in PICTURE_CHANNELS], axis=-1).astype(np.float32)
    if wrong := int((~(np.isfinite(radiance) & (radiance >= 0))).sum()):
        raise InputError(path, "finite radiance ≥ 0", f"{wrong} values that are not", AGAIN)
    return radiance


def encode_geometry(geometry: SeenGeometry) -> bytes:
    """Return the bytes of a geometry file."""
    layers = dict(zip(NORMAL_CHANNELS, np.moveaxis(geometry.normals, -1, 0), strict=True))
    layers |= {DEPTH_CHANNEL: geometry.depth, SEGMENT_CHANNEL: geometry.segments}
    if geometry.facets is not None:
        layers |= facets.layers(geometry.facets)
    types = GEOMETRY_TYPES | FACET_TYPES
    return exr.encode(
        {
            name: values.astype(np.uint32)
            if types[name] == np.uint32
            else np.rint(values.astype(np.float32) * STEPS_PER_UNIT) / STEPS_PER_UNIT
            for name, values in layers.items()
        }
    )


def read_geometry(
    path: str | Path,
    size: tuple[int, int] | None = None,
    file_hash: str | None = None,
    exact: bool = False,
) -> Geometry:
    """Return the Geometry of a file.

    All arrays must be finite, and normals of unit length wherever there is a segment.

    size       (height, width) that it must have, None: any
    file_hash  sha256 that the file must have, None: any
    exact      refuse other channels and types than `encode_geometry` writes
    Raises     InputError
    """
    channels = _channels(path, GEOMETRY_TYPES, size, file_hash, exact, FACET_TYPES)
    segments = channels[SEGMENT_CHANNEL]
    whole = (
        segments.astype(np.int64)
        if np.isfinite(segments).all()
        else np.full_like(segments, -1, np.int64)
    )
    if (
        (whole != segments).any()
        or whole.min(initial=0) < 0
        or whole.max(initial=0) > MOST_SEGMENTS
    ):
        raise InputError(
            path, f"segments 0 to {MOST_SEGMENTS}", f"{segments.min()} to {segments.max()}", AGAIN
        )
    normals = np.stack([channels[name] for name in NORMAL_CHANNELS], axis=-1).astype(np.float32)
    depth = channels[DEPTH_CHANNEL].astype(np.float32)
    _require_finite(path, "depth", depth)
    _require_unit(path, "normals", normals, whole > 0)
    seen = None
    if facets.COSINE in channels:
        for name in FACET_TYPES:
            _require_finite(path, name, channels[name])
        seen = facets.of_channels(channels)
        _require_unit(path, "facet normals", seen.normals, whole > 0)
        mixed = seen.other_segments > 0
        _require_unit(path, "normals of other surfaces", seen.other_normals, mixed)
        _require_unit(path, "facet normals of other surfaces", seen.other_facets, mixed)
    return Geometry(normals, depth, whole.astype(np.uint8), seen)


def _require_finite(path: str | Path, what: str, values: np.ndarray) -> None:
    """Raise InputError unless all values are finite."""
    if wrong := int((~np.isfinite(values)).sum()):
        raise InputError(path, f"finite {what}", f"{wrong} values that are not", AGAIN)


def _require_unit(path: str | Path, what: str, normals: np.ndarray, mask: np.ndarray) -> None:
    """Raise InputError unless normals (height, width, 3) are finite, and unit inside the mask."""
    _require_finite(path, what, normals)
    inside = normals[mask].astype(np.float64)
    lengths = np.sqrt((inside * inside).sum(-1))
    if lengths.size and np.abs(lengths - 1).max() > UNIT_LENGTH:
        raise InputError(
            path, f"unit {what}", f"lengths {lengths.min():.4f}–{lengths.max():.4f}", AGAIN
        )


def encode_light(L: np.ndarray, scale: float) -> bytes:
    """Return the bytes of a stored light's file.

    L      (64, 128, 3)
    scale  what L was divided by
    """
    return npz_bytes({"L": np.asarray(L, np.float32), "scale": np.float64(scale)})


def read_light(path: str | Path, file_hash: str | None = None) -> np.ndarray:
    """Return L (64, 128, 3) float32 of a stored light: finite, not negative, mean luminance 1.

    file_hash  sha256 that the file must have, None: any
    Raises     InputError
    """
    arrays, data = _light_arrays(path, ("L",))
    L = arrays["L"]
    if wrong := int((~(np.isfinite(L) & (L >= 0))).sum()):
        raise InputError(path, "finite radiance ≥ 0", f"{wrong} values that are not", LIGHT_AGAIN)
    if not abs((mean := float(mean_radiance(L) @ LUMINANCE)) - 1) <= UNIT_MEAN:
        raise InputError(
            path, "radiance of unit mean luminance", f"a mean of {mean:.6g}", LIGHT_AGAIN
        )
    _require_hash(path, data, file_hash)
    return L.astype(np.float32)


def read_scale(path: str | Path) -> float:
    """Return the number by which a stored light was divided.

    Raises  InputError: no such file, other members or types than `encode_light` writes
    """
    arrays, _ = _light_arrays(path, tuple(LIGHT_MEMBERS), exact=True)
    scale = float(arrays["scale"])
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(path, "a finite scale above 0", f"{scale:g}", LIGHT_AGAIN)
    return scale


def _light_arrays(
    path: str | Path, names: tuple[str, ...], exact: bool = False
) -> tuple[dict[str, np.ndarray], bytes]:
    """Return members of a stored light, and the file's bytes.

    exact  refuse other members, and other types than `encode_light` writes
    """
    data = require_file(path, "a stored light map", LIGHT_AGAIN, LIGHT_BYTES).read_bytes()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            there = sorted(archive.namelist())
            if exact and there != sorted(f"{name}.npy" for name in names):
                raise InputError(
                    path,
                    f"arrays {', '.join(names)} alone",
                    ", ".join(there)[:120] or "none",
                    LIGHT_AGAIN,
                )
            arrays = {name: _light_member(path, archive, name) for name in names}
    except InputError:
        raise
    except _NO_ARCHIVE as error:
        result = str(error).replace("\n", " ")[:120] or type(error).__name__
        raise InputError(path, "a stored light map", result, LIGHT_AGAIN) from None
    if exact and (
        other := [name for name in names if arrays[name].dtype != LIGHT_MEMBERS[name][1]]
    ):
        expected, result = LIGHT_MEMBERS[other[0]][1], arrays[other[0]].dtype
        raise InputError(path, f"{other[0]} of {expected}", str(result), LIGHT_AGAIN)
    return arrays, data


def _light_member(path: str | Path, archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Return one array of a stored light; its size is checked before memory is allocated."""
    expected = LIGHT_MEMBERS[name][0]
    what = f"radiance of shape {expected}" if name == "L" else f"one number {name}"
    with archive.open(f"{name}.npy") as stored:
        header = archives.ArrayHeader(stored)
        if header.shape != expected or header.dtype.kind != "f":
            raise InputError(path, what, f"{header.shape} of {header.dtype}", LIGHT_AGAIN)
        values = np.frombuffer(stored.read(header.bytes), header.dtype)
        return values.reshape(header.shape, order="F" if header.fortran else "C")


def pack_normals(normals: np.ndarray) -> np.ndarray:
    """Return x and y of normals (…, 3) as (…, 2) int16 in units of 1/32767, as caches store them.

    The normals must face the viewer.
    """
    return np.rint(normals[..., :2] * PACKED_UNIT).astype(np.int16)


def unpack_normals(packed: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return unit normals (…, 3) float32 of packed ones (…, 2); 0 outside the mask (…) bool."""
    xy = packed.astype(np.float32) / PACKED_UNIT
    z = np.sqrt(np.clip(1.0 - (xy * xy).sum(-1, keepdims=True), 0.0, 1.0))
    return np.concatenate([xy, z], -1) * mask[..., None]


def pack_depth(depth: np.ndarray) -> np.ndarray:
    """Return depth (…) in radii as int16 in units of 1/16384, as caches store it; at most 2."""
    return np.rint(np.clip(depth * PACKED_RADIUS, -PACKED_UNIT, PACKED_UNIT)).astype(np.int16)


def unpack_depth(packed: np.ndarray) -> np.ndarray:
    """Return depth (…) float32 in radii of packed depth."""
    return packed.astype(np.float32) / PACKED_RADIUS


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


def _channels(
    path: str | Path,
    types: dict[str, np.dtype],
    size: tuple[int, int] | None,
    file_hash: str | None,
    exact: bool,
    optional: dict[str, np.dtype] | None = None,
) -> dict[str, np.ndarray]:
    """Return the channels of a file, all of one size.

    types     {name: type as it is written}
    optional  types of further channels, of which a file holds all or none
    """
    data = None
    if file_hash is not None:
        pixels = exr.MAX_PIXELS if size is None else size[0] * size[1]
        require_file(path, "an OpenEXR file", AGAIN, HEADER_BYTES + 2 * PIXEL_BYTES * pixels)
        data = Path(path).read_bytes()
    channels = exr.read(path, data)
    if optional:
        channels = facets.without_earlier(channels)
    missing = [name for name in types if name not in channels]
    if missing:
        result = f"only {', '.join(sorted(channels))}"
        raise InputError(path, f"channels {', '.join(types)}", result, AGAIN)
    if optional and any(name in channels for name in optional):
        if missing := [name for name in optional if name not in channels]:
            result = f"no {', '.join(missing)}"
            rule = "all channels of points (docs/dataset.md), or none of them"
            raise InputError(path, rule, result, AGAIN)
        types = types | optional
    sizes = {channels[name].shape for name in types}
    if (
        len(sizes) != 1
        or any(len(shape) != 2 for shape in sizes)
        or (size is not None and sizes != {tuple(size)})
    ):
        expected = "one size of all channels" if size is None else f"{size[0]} × {size[1]} pixels"
        result = ", ".join(sorted(" × ".join(map(str, shape)) for shape in sizes))
        raise InputError(path, expected, result, AGAIN)
    if exact and {name: values.dtype for name, values in channels.items()} != types:
        expected = ", ".join(f"{name} {type_}" for name, type_ in types.items())
        result = ", ".join(f"{name} {values.dtype}" for name, values in sorted(channels.items()))
        raise InputError(path, f"channels {expected}", result, AGAIN)
    _require_hash(path, data, file_hash)
    return channels


def _require_hash(path: str | Path, data: bytes | None, expected: str | None) -> None:
    """Raise InputError if a file's sha256 is not the one that a manifest holds."""
    if expected is None or data is None:
        return
    if (result := hashlib.sha256(data).hexdigest()) != expected:
        raise InputError(
            path, f"hash {expected[:12]}", f"{result[:12]}: the file was altered", AGAIN
        )
