"""Light for relit pictures: maps turned, mirrored, mixed and tinted, and computed skies and rooms, for there are few maps.

L  (64, 128, 3) float32 radiance of unit mean luminance, light frame; all draws from a numpy Generator
"""

import zipfile
from pathlib import Path

import numpy as np

from manifests.problems import Problem
from shaders import envmap

HEIGHT, WIDTH = 64, 128
LARGEST_FILE = 256 << 20


def read_maps(path):
    """{name: L} of an .npz of (64, 128, 3) arrays. Raises Problem."""
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise Problem(path, f"at most {LARGEST_FILE >> 20} MiB", f"{path.stat().st_size >> 20} MiB", "give fewer maps")
        with np.load(path, allow_pickle=False) as arrays:
            maps = {name: np.asarray(arrays[name], np.float32) for name in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise Problem(path, "an .npz of (64, 128, 3) light maps", str(error), "write it by numpy.savez(path, name=map)") from None
    for name, L in maps.items():
        if L.shape != (HEIGHT, WIDTH, 3) or not np.isfinite(L).all():
            raise Problem(f"{path}: {name}", "finite radiance of shape (64, 128, 3)", f"{L.shape}", "average it to 64×128 first")
        maps[name] = envmap.unit_mean(np.maximum(L, 0))[0].astype(np.float32)
    return maps


def draw(rng, maps, real):
    """One light. maps: a list of L; real: the share of plain maps, the rest mixtures and computed ones in equal parts."""
    kind = rng.random()
    if maps and kind < real:
        L = _turned(rng, maps)
    elif maps and kind < (1 + real) / 2:
        share = rng.uniform(0.1, 0.9)
        L = share * _turned(rng, maps) * _tint(rng, 0.3) + (1 - share) * _turned(rng, maps) * _tint(rng, 0.3)
    else:
        L = computed(rng)
    return envmap.unit_mean((L * _tint(rng, 0.15)).astype(np.float32))[0].astype(np.float32)


def computed(rng):
    """A sky with a sun, or a room with lamps, or a mixture; over a ground."""
    w, _ = envmap.directions(HEIGHT, WIDTH)
    up = w[..., 1]
    gradient = np.clip(0.5 + 0.5 * up / rng.uniform(0.1, 1.0), 0, 1)[..., None]
    L = rng.uniform(0.02, 0.6) * _tint(rng, 0.4) + gradient * (rng.uniform(0.1, 1.5) * _tint(rng, 0.4))
    for _ in range(rng.integers(0, 5)):
        centre = rng.normal(size=3)
        centre[1] = abs(centre[1]) * rng.choice([1.0, 1.0, 1.0, -0.5])
        centre /= np.linalg.norm(centre)
        width = np.exp(rng.uniform(np.log(0.04), np.log(0.7)))  # radians
        lamp = np.clip((width - np.arccos(np.clip(w @ centre, -1, 1))) / (0.3 * width + 0.02) + 0.5, 0, 1)
        share = np.exp(rng.uniform(np.log(0.03), np.log(1.0)))  # of the sphere's light, against the ambient's of about one half
        L = L + (share / max(lamp.mean(), 1e-4) * lamp)[..., None] * _tint(rng, 0.4)
    return L


def _turned(rng, maps):
    L = envmap.roll(maps[rng.integers(len(maps))], int(rng.integers(WIDTH)))
    L = L[:, ::-1] if rng.random() < 0.5 else L
    return L[..., rng.permutation(3)]


def _tint(rng, strength):
    return np.exp(rng.normal(0, strength, 3))
