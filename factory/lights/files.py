"""A light map's file: told apart by its first bytes, bounded by its header before memory is taken, then read.

Radiance .hdr and OpenEXR .exr, (H, 2H) pixels of an equirectangular map; .npz of numpy, arrays (H, 2H, 3) whose columns are as in the
other two: one map where a light is read, any number where maps are added to a library.
"""

import hashlib
import zipfile
import zlib
from pathlib import Path

import numpy as np

from factory.lights import rgbe
from manifests.problems import Problem
from manifests.quiet import silenced

SUFFIXES = (".hdr", ".exr", ".npz")
MAX_HEIGHT = 4096  # rows; a map of 8192 × 4096 takes 0.4 GB here, and no render of ours can tell it from a larger one
MIN_HEIGHT = 4
MAGIC = {b"#?": "hdr", b"\x76\x2f\x31\x01": "exr", b"PK\x03\x04": "npz"}
MOST_MAPS = 1000  # in one .npz
PICTURES = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG", b"GIF8": "GIF", b"BM": "BMP", b"RIFF": "WebP", b"II*\0": "TIFF", b"MM\0*": "TIFF"}


def is_light_path(text):
    """True if a text means a file rather than a name: it has a folder in it or a light map's ending."""
    return "/" in str(text) or "\\" in str(text) or Path(text).suffix.lower() in SUFFIXES


def read(path):
    """Pixels (H, W, 3) float32 as stored, and the SHA-256 of the file. Raises Problem; OSError if it cannot be opened."""
    path = Path(path)
    kind = _kind(path)

    def check_size(height, width, bytes_needed):
        if height > MAX_HEIGHT or width > 2 * MAX_HEIGHT or bytes_needed > 16 * 2 * MAX_HEIGHT**2:
            limit = f"at most {2 * MAX_HEIGHT}×{MAX_HEIGHT} pixels of four channels"
            raise Problem(path, limit, f"{width}×{height}, {bytes_needed / 1e9:.1f} GB", "save a smaller copy of the map")
        if width != 2 * height or height < MIN_HEIGHT:
            raise Problem(path, "an equirectangular map, twice as wide as high", f"{width}×{height}", "crop or resize it to 2:1")

    pixels = {"hdr": rgbe.read, "exr": _read_exr, "npz": _read_npz}[kind](path, check_size)
    return pixels, digest(path)


def is_collection(path):
    """True for an .npz, which may hold many maps."""
    return Path(path).is_file() and _kind(Path(path)) == "npz"


def maps_in(path):
    """(name, pixels (H, 2H, 3) float32) of each map in an .npz, one after another. Raises Problem."""
    broken = "a whole .npz file of arrays (H, 2H, 3)"
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if not 1 <= len(members) <= MOST_MAPS:
                raise Problem(path, f"1 to {MOST_MAPS} maps", str(len(members)), "save them as several files")
            for member in members:
                with archive.open(member) as file:  # the header alone: sizes are judged before memory is taken
                    shape, dtype = _npy_header(file)
                if (
                    len(shape) != 3
                    or shape[2] != 3
                    or shape[1] != 2 * shape[0]
                    or not MIN_HEIGHT <= shape[0] <= MAX_HEIGHT
                    or dtype.kind != "f"
                ):
                    found = f"{member.filename} with {shape} of {dtype}"
                    raise Problem(
                        path, f"arrays (H, 2H, 3) of floats, H from {MIN_HEIGHT} to {MAX_HEIGHT}", found, "save R, G, B maps, 2:1"
                    )
                with archive.open(member) as file:
                    pixels = np.lib.format.read_array(file, allow_pickle=False)
                yield Path(member.filename).stem, pixels.astype(np.float32)
    except Problem:
        raise
    except (zipfile.BadZipFile, ValueError, EOFError, OSError, NotImplementedError, zlib.error) as error:
        raise Problem(path, broken, str(error)[:100] or "one cut short", "export it again with numpy.savez") from None


def _npy_header(file):
    """shape and dtype of an .npy stream."""
    version = np.lib.format.read_magic(file)
    shape, _, dtype = (np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0)(file)
    return shape, dtype


def _read_npz(path, check_size):
    """The one map of an .npz."""
    maps = maps_in(path)
    (name, pixels), second = next(maps), next(maps, None)
    check_size(*pixels.shape[:2], pixels.nbytes)
    if second is not None:
        raise Problem(path, "one map", f"several ('{name}', '{second[0]}', …)", "put them into a library: python -m factory lights add")
    return pixels


def digest(path):
    """SHA-256 of a file, hex."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _kind(path):
    if path.is_dir():
        raise Problem(path, "an .hdr, .exr or .npz file", "a folder", "name a file in it, or `python -m factory lights list` the folder")
    if not path.is_file():
        raise Problem(path, "an .hdr, .exr or .npz file", "nothing there", "check the path")
    with open(path, "rb") as file:
        first = file.read(12)
    for magic, kind in MAGIC.items():
        if first.startswith(magic):
            return kind
    if not first:
        raise Problem(path, "an .hdr, .exr or .npz file", "an empty file", "download or export it again")
    for magic, name in PICTURES.items():
        if first.startswith(magic):
            remedy = "use a high-dynamic-range map: a clipped picture has lost its lamps and its sun"
            raise Problem(path, "Radiance .hdr or OpenEXR .exr", f"a {name} picture", remedy)
    raise Problem(path, "Radiance .hdr, OpenEXR .exr or .npz", f"a file that begins with {first[:4]!r}", "export the map as one of the two")


def _read_exr(path, check_size):
    """R, G, B, or one grey channel three times, of an OpenEXR file's first part."""
    import OpenEXR

    broken = Problem(path, "a whole OpenEXR picture", "a damaged or truncated file", "download or export it again")
    try:
        with silenced(1, 2), OpenEXR.File(str(path), header_only=True) as file:  # the library prints each error besides raising it
            header = file.header()
            low, high, count = *header["dataWindow"], len(header["channels"])
    except Exception as error:  # the library's own errors are RuntimeError, ValueError and others
        raise broken from error
    width, height = (int(high[k]) - int(low[k]) + 1 for k in (0, 1))
    check_size(height, width, 4 * count * height * width)
    try:
        with silenced(1, 2), OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except Exception as error:
        raise broken from error
    wanted = next((names for names in (("R", "G", "B"), ("Y", "Y", "Y"), ("V", "V", "V")) if set(names) <= set(channels)), None)
    if wanted is None:
        raise Problem(path, "channels R, G, B", ", ".join(sorted(channels)), "export the map as RGB")
    if any(channels[name].shape != (height, width) for name in wanted):
        raise Problem(path, "channels of the picture's full size", "sub-sampled ones", "export the map as plain RGB")
    return np.stack([channels[name] for name in wanted], axis=-1).astype(np.float32)
