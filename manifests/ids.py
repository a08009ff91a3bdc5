"""Ids, seeds and draws: hashes of everything that determines a picture, its geometry and its noise.

The factory, which assigns ids, and `verify`, which checks them, both use these functions. An id is
a hash of inputs, never of pixels: two renders of one shot differ by 2e-6. A change of a value here
invalidates every existing data set.

render      fingerprint of the render settings (factory.planning.fingerprint): a key of `settings`
            in dataset.json
materials   one hash per segment, in the order of segment ids
rotations   texels by which a light map is rolled, 0 … 127
key         spawn key of a combination of shape, materials and light. What a job leaves to chance
            comes from SeedSequence(job.seed, spawn_key=key), so that a shape, light or view that is
            added does not change the draws of the others.
"""

import hashlib
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from msgspec import structs

from manifests.schema import Camera, Draw, Job, Record
from manifests.viewpoints import COUNT, azimuths_deg

TEXELS = 128
CAMERA_DRAWS = 0xCA3E4A  # first part of the spawn keys of cameras
ID_DIGITS = 24  # 96 bits: two of a million shots meet by chance once in 1e17 data sets


def camera_words(camera: Camera) -> str:
    """Return the camera as text for hashes; 20 and 20.0 degrees give the same text."""
    height, width = camera.size
    fov = "orthographic" if camera.fov_deg is None else f"{float(camera.fov_deg)!r}"
    # older data sets had no choice; their ids stay
    pixel = "" if camera.pixel == "square" else f" {camera.pixel}"
    roll = f" roll {float(camera.roll_deg)!r}" if camera.roll_deg else ""
    return (
        f"{height} {width} {fov} {float(camera.elevation_deg)!r}"
        f" {float(camera.half_extent)!r}{pixel}{roll}"
    )


def camera_of(job: Job, shape_hash: str, viewpoint: int) -> Camera:
    """Return the camera that sees a shape from a viewpoint in a job.

    In a job with camera_ranges, it is drawn from the job's seed, the shape's hash and the
    viewpoint, whatever else the job names. Four numbers are drawn whichever ranges there are, so
    that a range that is added does not change the other draws.
    """
    ranges = job.camera_ranges
    if ranges is None:
        return job.camera
    key = (CAMERA_DRAWS, hash_word(shape_hash), viewpoint)
    rng = np.random.default_rng(np.random.SeedSequence(job.seed, spawn_key=key))
    elevation, roll, fov, perspective = rng.random(4).tolist()
    drawn: dict[str, Any] = {}
    if ranges.elevation_deg is not None:
        drawn["elevation_deg"] = _within(ranges.elevation_deg, elevation)
    if ranges.roll_deg is not None:
        drawn["roll_deg"] = _within(ranges.roll_deg, roll)
    if ranges.fov_deg is not None:
        drawn["fov_deg"] = None
        if perspective < ranges.perspective_share:
            drawn["fov_deg"] = _within(ranges.fov_deg, fov)
            # rounded, because the last digit of a cosine depends on the machine
            half_extent = job.camera.half_extent / math.cos(math.radians(drawn["fov_deg"]) / 2)
            drawn["half_extent"] = round(half_extent, 6)
    return structs.replace(job.camera, **drawn)


def _within(span: tuple[float, float], share: float) -> float:
    """Return the number that lies at a share of a range, to a thousandth of a degree."""
    return round(span[0] + share * (span[1] - span[0]), 3)


@lru_cache(maxsize=4096)
def geometry_id(shape_hash: str, camera: str, viewpoint: int, render: str) -> str:
    """Return the id of the geometry of a shape from a viewpoint.

    camera  as `camera_words` gives it
    """
    digest = _digest(
        b"brdfactory geometry 1", render, shape_hash, camera, azimuths_deg()[viewpoint]
    )
    return digest.hexdigest()[:ID_DIGITS]


def shots_digest(
    render: str,
    shape_hash: str,
    materials: tuple[str, ...],
    light_hash: str,
    camera: str,
    samples: int | str,
) -> Any:
    """Return the hash of what a group of shots has in common, which `shot_id` continues.

    camera   as `camera_words` gives it
    samples  a number, or `sampling` of a job or record
    """
    return _digest(
        b"brdfactory shot 1", render, shape_hash, *materials, light_hash, camera, samples
    )


def sampling(line: Job | Record) -> int | str:
    """Return what decides the samples of a job's or record's pictures: their number or an error."""
    if isinstance(line, Job):
        return line.samples if line.error is None else f"error {float(line.error)!r}"
    return line.samples if line.accuracy is None else f"error {float(line.accuracy.requested)!r}"


def shot_id(
    shared: Any, viewpoint: int, rotation: int, tier: str, light_resolution: str, seed: int
) -> str:
    """Return the id of one shot.

    shared  of `shots_digest`; it is not changed
    """
    digest = shared.copy()
    digest.update(
        f"{azimuths_deg()[viewpoint]} {rotation} {tier} {light_resolution} {seed}".encode()
    )
    return digest.hexdigest()[:ID_DIGITS]


def combination_key(
    shape_hash: str,
    materials: tuple[str, ...],
    light_hash: str,
    occurrence: int,
    choice: int | None = None,
) -> tuple[int, ...]:
    """Return the spawn key of a combination.

    occurrence  0 where the job names the light first, 1 where it names it again
    choice      number of the draw of materials, None where the job gives the whole shape one
                material
    """
    key = (
        hash_word(shape_hash),
        *(hash_word(m) for m in materials),
        hash_word(light_hash),
        occurrence,
    )
    return key if choice is None else (*key, choice)


def draws(job: Job, key: tuple[int, ...]) -> tuple[int, Sequence[int], Sequence[Sequence[int]]]:
    """Return what a job draws for one combination: a word for seeds, views and rotations.

    Returns  word, views, and for each view its rotations
    """
    sequence = np.random.SeedSequence(job.seed, spawn_key=key)
    rng, word = np.random.default_rng(sequence), sequence.generate_state(1)[0].item()
    views: Sequence[int]
    if isinstance(job.views, Draw):
        views = np.sort(rng.permutation(COUNT)[: job.views.random]).tolist()
    else:
        views = job.views
    if not isinstance(job.rotations, Draw):
        return word, views, (job.rotations,) * len(views)
    every = np.broadcast_to(np.arange(TEXELS), (len(views), TEXELS))
    return word, views, rng.permuted(every, axis=1)[:, : job.rotations.random].tolist()


def views_alone(job: Job, shape_hash: str) -> Sequence[int]:
    """Return the views of one shape in a job without pictures."""
    if not isinstance(job.views, Draw):
        return job.views
    rng = np.random.default_rng(
        np.random.SeedSequence(job.seed, spawn_key=(0x9E0, hash_word(shape_hash)))
    )
    return np.sort(rng.permutation(COUNT)[: job.views.random]).tolist()


def shot_place(viewpoint: int, rotation: int, tier: str, light_resolution: str, repeat: int) -> str:
    """Return a shot's place within its combination, as `shot_seed` takes it."""
    return f"{viewpoint} {rotation} {tier} {light_resolution} {repeat}"


def shot_seed(word: int, place: str) -> int:
    """Return 31 bits for Cycles: a hash of a combination's word and the shot's place within it."""
    return (
        int.from_bytes(hashlib.blake2b(f"{word} {place}".encode(), digest_size=4).digest(), "big")
        >> 1
    )


def hash_word(hash_: str) -> int:
    """Return 32 bits of a hash, for a spawn key."""
    return int(hash_[:8], 16)


def _digest(start: bytes, *parts: Any) -> Any:
    digest = hashlib.sha256(start)
    for part in parts:
        digest.update(b"\n" + str(part).encode())
    digest.update(b"\n")
    return digest
