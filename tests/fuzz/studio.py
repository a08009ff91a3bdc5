"""The tests' studio without Blender, with another ball for each shape and view: of one ball there
would be one geometry file.
"""

import zlib
from types import SimpleNamespace

import numpy as np

from shaders import frames
from tests.support.fake_studio import Studio as FakeStudio


class Studio(FakeStudio):
    """Balls of radius 0.5 to 0.95, cut into as many sectors as the shape has segments."""

    def set_camera(self, camera):
        super().set_camera(camera)
        self._camera = camera

    def set_view(self, azimuth):
        super().set_view(azimuth)
        radius = 0.5 + 0.45 * (zlib.crc32(f"{self._mesh.hash} {azimuth}".encode()) % 1000) / 1000
        self._radius = radius
        x, y = (
            axis * self._camera.half_extent / radius
            for axis in frames.pixel_grid(*self._camera.size)
        )
        self._mask = x * x + y * y < 1
        z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
        self._normals = np.where(self._mask[..., None], np.stack([x, y, z], -1), 0).astype(
            np.float32
        )
        count = self._mesh.segments
        self._sectors = 1 + ((np.arctan2(y, x) + np.pi) / (2 * np.pi) * count).astype(int).clip(
            0, count - 1
        )

    def geometry(self):
        segments = np.where(self._mask, self._sectors, 0).astype(np.uint8)
        depth = np.where(self._mask, -self._radius * self._normals[..., 2], 0).astype(np.float32)
        return SimpleNamespace(
            normals=self._normals,
            mask=self._mask,
            depth=depth,
            segments=segments,
            facets=None,
        )
