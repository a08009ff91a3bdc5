"""Files of pictures and geometry: how they are written and read.

Readers refuse what another program may have written: missing channels, other shapes, values that
are no radiance and no normals. manifests.arrays says what the channels hold.
"""

from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from manifests import exr, facets
from manifests.arrays import (
    DEPTH_CHANNEL,
    FACET_TYPES,
    GEOMETRY_TYPES,
    LARGEST_HALF,
    MOST_SEGMENTS,
    NORMAL_CHANNELS,
    PICTURE_CHANNELS,
    PICTURE_TYPES,
    SEGMENT_CHANNEL,
    STEPS_PER_UNIT,
)
from manifests.errors import InputError
from manifests.facets import Facets
from manifests.inputs import require_file, require_hash
from manifests.wording import number_of

PIXEL_BYTES = 4 * len(
    GEOMETRY_TYPES | FACET_TYPES
)  # the most that a pixel of ours takes, uncompressed
# the most that an EXR's header and its table of lines take beside the pixels
HEADER_BYTES = 1 << 20
UNIT_LENGTH = 1e-2  # of |n|; what is written keeps it to 1e-4
AGAIN = "render or copy it again"


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
        raise InputError(
            path,
            "finite radiance ≥ 0",
            number_of(wrong, "value that is not", "values that are not"),
            AGAIN,
        )
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
        raise InputError(
            path,
            f"finite {what}",
            number_of(wrong, "value that is not", "values that are not"),
            AGAIN,
        )


def _require_unit(path: str | Path, what: str, normals: np.ndarray, mask: np.ndarray) -> None:
    """Raise InputError unless normals (height, width, 3) are finite, and unit inside the mask."""
    _require_finite(path, what, normals)
    inside = normals[mask].astype(np.float64)
    lengths = np.sqrt((inside * inside).sum(-1))
    if lengths.size and np.abs(lengths - 1).max() > UNIT_LENGTH:
        raise InputError(
            path, f"unit {what}", f"lengths {lengths.min():.4f}–{lengths.max():.4f}", AGAIN
        )


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
    require_hash(path, data, file_hash)
    return channels
