"""A studio without Blender, for what surrounds rendering: a shaded sphere in no time, and
misbehaviour on demand.

What it does wrong stands in the environment variable FAKE_STUDIO, comma-separated, each for one
shape: `nan:NAME` pixels, `crash:NAME`, `once:NAME` crashes only while the file named by
FAKE_STUDIO_MARK is not there, `slow` takes 20 ms a picture and
`slower` 0.4 s, `lost` has what was appended to files
of lines thrown away, as NFS does after it has lost their locks.
"""

import errno
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from factory.render.estimators.renderer import Portion
from shaders import frames


class Studio:
    """The methods of factory.render.studio.Studio that the pipeline calls."""

    settings = {"fake": True}  # noqa: RUF012 (read only)
    versions = {"fake": "1"}  # noqa: RUF012

    def __init__(self, device, threads):
        self._wrong = set(os.environ.get("FAKE_STUDIO", "").split(","))
        self._seen = {}
        if "lost" in self._wrong:
            _lose_lines()

    def set_camera(self, camera):
        x, y = frames.pixel_grid(*camera.size)
        z2 = 1 - (x**2 + y**2) * camera.half_extent**2
        self._mask = z2 > 0
        normals = np.stack(
            [x * camera.half_extent, y * camera.half_extent, np.sqrt(np.maximum(z2, 0))], axis=-1
        )
        self._normals = np.where(self._mask[..., None], normals, 0).astype(np.float32)

    def set_shape(self, mesh):
        self._mesh = mesh

    def set_view(self, azimuth):
        self._seen["view"] = azimuth

    def set_light(self, L, rotation_texels=0, light_resolution="64x128"):
        self._seen["light"] = float(L.mean()) + rotation_texels

    def set_materials(self, mixtures):
        self._colour = mixtures[0].weights[0, 0]

    def geometry(self):
        segments = self._mask.astype(np.uint8)
        return SimpleNamespace(
            normals=self._normals,
            mask=self._mask,
            depth=-self._normals[..., 2],
            segments=segments,
            facets=None,
        )

    def picture(self, samples, seed, tier="direct"):
        name = self._mesh.name
        if "slow" in self._wrong or "slower" in self._wrong:
            import time

            time.sleep(0.4 if "slower" in self._wrong else 0.02)
        if f"crash:{name}" in self._wrong:
            os.kill(os.getpid(), 11)
        if (
            f"once:{name}" in self._wrong
            and not (mark := Path(os.environ["FAKE_STUDIO_MARK"])).exists()
        ):
            mark.touch()
            os.kill(os.getpid(), 11)
        rng = np.random.default_rng(seed)
        radiance = (self._normals[..., 2:] * self._colour * (1 + 0.1 * rng.random())).astype(
            np.float32
        )
        if f"nan:{name}" in self._wrong:
            radiance[0, 0] = np.nan
        return radiance, self._mask.astype(np.float32)

    def portion(self, first, count, seed, tier="direct"):
        _, alpha = self.picture(count, seed, tier)
        radiance = self._normals[..., 2:] * np.float32(self._colour) * np.ones(3, np.float32)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(first,)))
        noise = rng.normal(size=radiance.shape).astype(np.float32) / np.float32(np.sqrt(count))
        noisy = np.maximum(radiance * (1 + 0.3 * noise), 0)
        return Portion(noisy, alpha, self._normals, np.zeros_like(noisy))

    def denoise(self, portion, effort):
        return portion.guides[..., 2:] * np.float32(self._colour) * np.ones(3, np.float32)

    def may_shade_itself(self):
        return True

    def direct_light_work(self, points):
        return None

    def direct_light(self, points, known=None, where=None):
        return None

    def visible_share(self, points, rays, seed, half, where=None, turn=0):
        return None


def _lose_lines():
    """Let a sync of a file of lines empty it and fail."""
    sync = os.fsync

    def lost(descriptor):
        if os.readlink(f"/proc/self/fd/{descriptor}").endswith(".jsonl"):
            os.ftruncate(descriptor, 0)
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        sync(descriptor)

    os.fsync = lost
