"""Light map files: recognised by their first bytes, bounded by their header, then read.

Radiance .hdr and OpenEXR .exr, (H, 2H) pixels of an equirectangular map; .npz of numpy, arrays (H,
2H, 3) whose columns are as in the other two: one map where a light is read, any number where maps
are added to a library.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from factory.lights import rgbe
from manifests.archives import ArrayHeader, open_zip, read_exactly
from manifests.errors import InputError
from manifests.exr import parts_of
from manifests.inputs import require_file
from manifests.quiet import silenced
from manifests.store_paths import file_hash
from shaders import envmap

SUFFIXES = (".hdr", ".exr", ".npz")
# Rows. A map of 8192 × 4096 takes 0.4 GB; while it is read the same (.hdr, .npz, .exr of floats),
# 0.6 GB (.exr of halves or with alpha), or 1 GB (.exr with other channels). No render of ours can
# tell it from a larger one
MAX_HEIGHT = 4096
MIN_HEIGHT = 4
MAGIC = {b"#?": "hdr", b"\x76\x2f\x31\x01": "exr", b"PK\x03\x04": "npz"}
MOST_MAPS = 1000  # in one .npz
LARGEST = 1 << 30  # bytes of an .hdr or .exr: more than the largest map takes without compression
LARGEST_TILE = 1 << 26  # bytes: an .exr in tiles needs room for one besides its pixels
A_LIGHT = "an .hdr, .exr or .npz file"
PICTURES = {
    b"\x89PNG": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"GIF8": "GIF",
    b"BM": "BMP",
    b"RIFF": "WebP",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
}


def is_light_path(text: str | Path) -> bool:
    """Return whether a text is a path rather than a name: it has a folder or a map's ending."""
    return "/" in str(text) or "\\" in str(text) or Path(text).suffix.lower() in SUFFIXES


def read(path: str | Path) -> tuple[np.ndarray, str]:
    """Return pixels (H, W, 3) float32 as stored, and the SHA-256 of the file.

    Raises  InputError; OSError if the file cannot be opened
    """
    path = Path(path)
    kind = _kind(path)
    if kind != "npz":
        require_file(path, A_LIGHT, maximum_bytes=LARGEST)

    def check_size(height, width, bytes_needed):
        if (
            height > MAX_HEIGHT
            or width > 2 * MAX_HEIGHT
            or bytes_needed > 16 * 2 * MAX_HEIGHT**2 + LARGEST_TILE
        ):
            limit = f"at most {2 * MAX_HEIGHT}×{MAX_HEIGHT} pixels of four channels"
            raise InputError(
                path,
                limit,
                f"{width}×{height}, {bytes_needed / 1e9:.1f} GB",
                "save a smaller copy of the map",
            )
        if width != 2 * height or height < MIN_HEIGHT:
            raise InputError(
                path,
                "an equirectangular map, twice as wide as high",
                f"{width}×{height}",
                "crop or resize it to 2:1",
            )

    pixels = {"hdr": rgbe.read, "exr": _read_exr, "npz": _read_npz}[kind](path, check_size)
    return pixels, file_hash(path)


def is_collection(path: str | Path) -> bool:
    """Return whether a file is an .npz, which may hold many maps."""
    return Path(path).is_file() and _kind(Path(path)) == "npz"


def maps_in(path: str | Path) -> Iterator[tuple[str, np.ndarray]]:
    """Yield (name, pixels (H, 2H, 3) float32) of each map in an .npz. Raises InputError."""
    with open_zip(
        path, "a whole .npz file of arrays (H, 2H, 3)", "export it again with numpy.savez"
    ) as archive:
        members = archive.infolist()
        if not 1 <= len(members) <= MOST_MAPS:
            raise InputError(
                path, f"1 to {MOST_MAPS} maps", str(len(members)), "save them as several files"
            )
        for member in members:
            with archive.open(member) as file:
                header = ArrayHeader(file)  # sizes are judged before memory is taken
                _check_map(path, member.filename, header.shape, header.dtype)
                pixels = _floats(file, header)
            yield Path(member.filename).stem, pixels


def _check_map(path, name, shape, dtype):
    right = (
        len(shape) == 3
        and shape[2] == 3
        and shape[1] == 2 * shape[0]
        and MIN_HEIGHT <= shape[0] <= MAX_HEIGHT
    )
    if not (right and dtype.kind == "f" and dtype.itemsize <= 8):
        expected = f"arrays (H, 2H, 3) of floats, H from {MIN_HEIGHT} to {MAX_HEIGHT}"
        raise InputError(
            path, expected, f"{name} with {shape} of {dtype}", "save R, G, B maps, 2:1"
        )


def _floats(file, header):
    """Return the values of an array (H, W, 3) as float32.

    They are read band by band, so that no copy in the file's own type is held.
    """
    height, width, channels = header.shape
    pixels = np.empty(header.shape, np.float32)
    # what float32 cannot hold is infinite, and refused later, by count
    with np.errstate(over="ignore"):
        if header.fortran:  # rows run fastest, then columns
            for channel in range(channels):
                for columns in envmap.bands(width):
                    data = read_exactly(
                        file, (columns.stop - columns.start) * height * header.dtype.itemsize
                    )
                    pixels[:, columns, channel] = (
                        np.frombuffer(data, header.dtype).reshape(-1, height).T
                    )
        else:
            for rows in envmap.bands(height):
                data = read_exactly(
                    file, (rows.stop - rows.start) * width * channels * header.dtype.itemsize
                )
                pixels[rows] = np.frombuffer(data, header.dtype).reshape(-1, width, channels)
    return pixels


def _read_npz(path, check_size):
    """Return the one map of an .npz."""
    maps = maps_in(path)
    _, pixels = next(maps)
    check_size(*pixels.shape[:2], pixels.nbytes)
    with open_zip(path, "an .npz file", "export it again with numpy.savez") as archive:
        names = [Path(member.filename).stem for member in archive.infolist()]
    if len(names) > 1:
        raise InputError(
            path,
            "one map",
            f"several ('{names[0]}', '{names[1]}', …)",
            "put them into a library: python -m factory lights add",
        )
    return pixels


def _kind(path):
    require_file(
        path, A_LIGHT, "check the path; `python -m factory lights list` shows names and folders"
    )
    with open(path, "rb") as file:
        first = file.read(12)
    for magic, kind in MAGIC.items():
        if first.startswith(magic):
            return kind
    if not first:
        raise InputError(path, A_LIGHT, "an empty file", "download or export it again")
    for magic, name in PICTURES.items():
        if first.startswith(magic):
            remedy = (
                "use a high-dynamic-range map: a clipped picture has lost its lamps and its sun"
            )
            raise InputError(path, "Radiance .hdr or OpenEXR .exr", f"a {name} picture", remedy)
    raise InputError(
        path,
        "Radiance .hdr, OpenEXR .exr or .npz",
        f"a file that begins with {first[:4]!r}",
        "export the map as one of the two",
    )


def _read_exr(path, check_size):
    """Return R, G, B, or one grey channel three times, of an OpenEXR file's first part."""
    import OpenEXR

    broken = InputError(
        path,
        "a whole OpenEXR picture",
        "a damaged or truncated file",
        "download or export it again",
    )
    try:
        # the library prints each error besides raising it
        with silenced(1, 2), OpenEXR.File(str(path), header_only=True) as file:
            parts = parts_of(file)
    except Exception as error:  # the library's own errors are RuntimeError, ValueError and others
        raise broken from error
    if not parts or not all(part.flat for part in parts):
        raise InputError(path, "a flat picture", "a deep one", "flatten it and save it again")
    first = parts[0]
    requested = next(
        (names for names in (("R", "G", "B"), ("Y",), ("V",)) if set(names) <= set(first.channels)),
        None,
    )
    if requested is None:
        raise InputError(
            path,
            "channels R, G, B",
            ", ".join(sorted(first.channels))[:100] or "none",
            "export the map as RGB",
        )
    if first.sampled:
        raise InputError(
            path,
            "channels of the picture's full size",
            "sub-sampled ones",
            "export the map as plain RGB",
        )
    # the library reads all parts
    check_size(first.height, first.width, sum(part.bytes for part in parts))
    arrays = None
    if sorted(first.channels) in (list("BGR"), list("ABGR")):
        with contextlib.suppress(Exception):  # they are of different types
            arrays = _exr_arrays(path, separately=False)
    try:
        arrays = arrays or _exr_arrays(path, separately=True)
    except Exception as error:
        raise broken from error
    return _rgb(arrays, requested, (first.height, first.width), broken)


def _exr_arrays(path, separately):
    """Return {name: array} of the first part.

    Each channel (H, W) stands by itself, or "RGB" and "RGBA" stand together, (H, W, 3 or 4).
    """
    import OpenEXR

    with silenced(1, 2), OpenEXR.File(str(path), separate_channels=separately) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def _rgb(arrays, requested, size, broken):
    """Return pixels (H, W, 3) float32 from the library's arrays, without a copy of float32 ones.

    arrays  {name: (H, W) or (H, W, 3 or 4)}: channels by themselves, or R, G, B and perhaps A
            together
    """
    joined = (
        next((array for name, array in arrays.items() if name in ("RGB", "RGBA")), None)
        if requested != ("Y",)
        else None
    )
    planes = (
        [arrays.get(name) for name in requested]
        if joined is None
        else [joined[..., k] for k in range(3)]
    )
    if any(
        plane is None or plane.shape != size or plane.dtype.kind not in "fu" for plane in planes
    ):
        raise broken
    if joined is not None and joined.dtype == np.float32:
        return joined[..., :3]
    pixels = np.empty((*size, 3), np.float32)
    for rows in envmap.bands(size[0]):
        for k in range(3):
            pixels[rows, :, k] = planes[k % len(planes)][rows]
    return pixels
