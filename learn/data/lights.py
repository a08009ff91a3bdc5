"""Lights for relit pictures: maps rotated, mirrored, mixed and tinted; computed skies and rooms.

The variations make many lights of few maps.

L  (64, 128, 3) float32 radiance of unit mean luminance, light frame
"""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from manifests import archives
from manifests.arrays import LIGHT_SHAPE
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.wording import number_of
from shaders import envmap
from shaders.frames import camera_from_light

HEIGHT, WIDTH, _ = LIGHT_SHAPE
LARGEST_FILE = 256 << 20
LARGEST_MAP = 1 << 20  # bytes: four times what a map of doubles takes
SUFFIXES = (".npz", ".hdr", ".exr")  # of maps in a library
MOST_MAPS = 4096  # together 400 MB in memory
UNKNOWN_ELEVATION_DEG = (-10.0, 60.0)  # as the job geometry-general draws its cameras
UNKNOWN_ROLL_DEG = (-15.0, 15.0)
BRIGHTEST = 1e30  # far beyond any unit; sums of float32 stay finite


def read_maps(path: str | Path) -> dict[str, np.ndarray]:
    """Return {name: L} of an .npz of (64, 128, 3) arrays, or of a folder of them.

    An .npz file holds maps in the light frame. A folder is a library of the factory's: each .npz
    file in it is one map with a file's columns, which become those of the light frame here; its
    name is the file's. Maps of a library in other formats are refused.

    Raises  InputError
    """
    path = Path(path)
    if path.is_dir():
        return _library(path)
    rule, remedy = "an .npz of (64, 128, 3) light maps", "write it by numpy.savez(path, name=map)"
    require_file(path, rule, remedy, LARGEST_FILE)
    with archives.open_zip(path, rule, remedy) as archive:
        members = archive.infolist()
        if len(members) > MOST_MAPS:
            raise InputError(
                path, f"at most {MOST_MAPS} maps", str(len(members)), "give fewer maps"
            )
        return {
            member.filename.removesuffix(".npy"): _map(archive, member, path) for member in members
        }


def _library(folder: Path) -> dict[str, np.ndarray]:
    """Return {name: L} of a factory's library. Raises InputError."""
    files = sorted(
        file
        for file in folder.iterdir()
        # macOS writes "._NAME" beside each file on other systems' disks
        if file.suffix.lower() in SUFFIXES and not file.name.startswith("._")
    )
    if not 1 <= len(files) <= MOST_MAPS:
        remedy = "make some: python -m factory lights make" if not files else "give fewer maps"
        raise InputError(folder, f"1 to {MOST_MAPS} light maps", str(len(files)), remedy)
    result = {}
    for file in files:
        if file.suffix.lower() != ".npz":
            remedy = "average it to 64×128 and save it by numpy.savez"
            raise InputError(file, "an .npz light map", f"an {file.suffix} file", remedy)
        maps = read_maps(file)
        if len(maps) != 1:
            remedy = "put them into the library one by one: python -m factory lights add"
            raise InputError(file, "one map", str(len(maps)), remedy)
        (L,) = maps.values()
        result[file.stem] = np.ascontiguousarray(envmap.from_file_columns(L))
    return result


def _map(archive: zipfile.ZipFile, member: zipfile.ZipInfo, path: Path) -> np.ndarray:
    """Return L of one member of an archive, at unit mean.

    Raises InputError, and one of `archives.DAMAGE` for a damaged member.
    """
    where, remedy = f"{path}: {member.filename.removesuffix('.npy')}", "average it to 64×128 first"
    rule = "finite radiance of shape (64, 128, 3)"
    if member.file_size > LARGEST_MAP:  # by the directory, before memory is taken
        raise InputError(where, rule, number_of(member.file_size, "byte"), remedy)
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(where, "an array as numpy compresses it", "another compression", remedy)
    with archive.open(member) as stored:
        header = archives.ArrayHeader(stored)
        if header.shape != LIGHT_SHAPE or header.dtype.kind not in "fui":
            raise InputError(where, rule, f"{header.shape} of {header.dtype}", remedy)
        values = np.frombuffer(archives.read_exactly(stored, header.bytes), header.dtype)
    L = values.reshape(header.shape, order="F" if header.fortran else "C").astype(np.float64)
    if not np.isfinite(L).all() or L.max() > BRIGHTEST:
        result = f"values up to {L.max():g}" if np.isfinite(L).all() else "NaN or infinity"
        raise InputError(
            where, f"finite radiance up to {BRIGHTEST:g}", result, "clip it, and write it again"
        )
    if not (L > 0).any():
        raise InputError(where, "light", "a black map", "leave it out")
    return envmap.unit_mean(np.maximum(L, 0).astype(np.float32))[0].astype(np.float32)


def draw(rng: np.random.Generator, maps: Sequence[np.ndarray], real: float) -> np.ndarray:
    """Return one light.

    maps  [L]; real: the share of single maps, the rest mixtures and computed ones in equal parts
    """
    kind = rng.random()
    if maps and kind < real:
        L = _rotate(rng, maps)
    elif maps and kind < (1 + real) / 2:
        share = rng.uniform(0.1, 0.9)
        L = share * _rotate(rng, maps) * _tint(rng, 0.3) + (1 - share) * _rotate(rng, maps) * _tint(
            rng, 0.3
        )
    else:
        L = draw_computed(rng)
    return envmap.unit_mean((L * _tint(rng, 0.15)).astype(np.float32))[0].astype(np.float32)


def tilt(rng: np.random.Generator, L: np.ndarray) -> np.ndarray:
    """Return a light as a camera of unknown elevation and roll sees it, of unit mean luminance.

    The result is in the frame that lies below the camera by the preset elevation, whatever the
    camera's own elevation and roll: nothing in a photograph says where the horizon is.
    """
    elevation = np.radians(rng.uniform(*UNKNOWN_ELEVATION_DEG))
    roll = np.radians(rng.uniform(*UNKNOWN_ROLL_DEG))
    rotation = camera_from_light().T @ camera_from_light(elevation, roll)
    return envmap.unit_mean(envmap.rotated(L, rotation))[0].astype(np.float32)


def draw_computed(rng: np.random.Generator) -> np.ndarray:
    """Return a sky with a sun, a room with lamps, or a mixture of both, over a ground."""
    w, _ = envmap.directions(HEIGHT, WIDTH)
    up = w[..., 1]
    gradient = np.clip(0.5 + 0.5 * up / rng.uniform(0.1, 1.0), 0, 1)[..., None]
    L = rng.uniform(0.02, 0.6) * _tint(rng, 0.4) + gradient * (
        rng.uniform(0.1, 1.5) * _tint(rng, 0.4)
    )
    for _ in range(rng.integers(0, 5)):
        centre = rng.normal(size=3)
        centre[1] = abs(centre[1]) * rng.choice([1.0, 1.0, 1.0, -0.5])
        centre /= np.linalg.norm(centre)
        width = np.exp(rng.uniform(np.log(0.04), np.log(0.7)))  # radians
        lamp = np.clip(
            (width - np.arccos(np.clip(w @ centre, -1, 1))) / (0.3 * width + 0.02) + 0.5, 0, 1
        )
        # of the sphere's light, against the ambient's of about one half
        share = np.exp(rng.uniform(np.log(0.03), np.log(1.0)))
        L = L + (share / max(lamp.mean(), 1e-4) * lamp)[..., None] * _tint(rng, 0.4)
    return L


def _rotate(rng: np.random.Generator, maps: Sequence[np.ndarray]) -> np.ndarray:
    """Return one of the maps, rotated, perhaps mirrored, its colours exchanged."""
    L = envmap.roll(maps[rng.integers(len(maps))], int(rng.integers(WIDTH)))
    L = L[:, ::-1] if rng.random() < 0.5 else L
    return L[..., rng.permutation(3)]


def _tint(rng: np.random.Generator, strength: float) -> np.ndarray:
    return np.exp(rng.normal(0, strength, 3))
