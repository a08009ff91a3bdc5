"""Shots drawn at random, which validations render; the studio that shows them; and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from factory.lights import load as load_light
from factory.render.blender_threads import importing_blender
from factory.render.estimators.halves import Estimate, Halves, mean_over
from factory.render.estimators.renderer import Shown
from factory.render.validation.kept_references import KeptReference, path_of
from factory.shapes.catalogue import load as load_shape
from manifests.errors import InputError
from manifests.materials import load_catalogue
from manifests.schema import Camera, Tier
from shaders import tone

SHAPES = ("chair", "car", "sofa", "monitor", "vessel", "lamp", "blob", "sphere", "cube", "torus")
LIGHTS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
TIERS: tuple[Tier, ...] = ("direct", "shadow", "full")
ERRORS = (5.0, 20.0, 60.0)


@dataclass(frozen=True)
class Scene:
    """A shot by names; requested: the error."""

    shape: str
    material: str
    light: str
    rotation: int
    azimuth: float
    tier: Tier
    requested: float
    seed: int


def draw_scene(number: int, seed: int, materials: list[str], meshes: Sequence[Path] = ()) -> Scene:
    """Return shot `number` of a seed; other shots do not change it.

    meshes  files whose shapes are shown instead of the program's own
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    family = SHAPES[rng.integers(len(SHAPES))]
    shape = family if family in ("sphere", "cube", "torus") else f"{family}:{rng.integers(100)}"
    return Scene(
        shape=str(meshes[number * 7 % len(meshes)]) if meshes else shape,
        material=materials[rng.integers(len(materials))],
        light=LIGHTS[rng.integers(len(LIGHTS))],
        rotation=int(rng.integers(128)),
        azimuth=float(rng.integers(24) * np.pi / 12),
        tier=TIERS[rng.integers(len(TIERS))],
        requested=ERRORS[number % len(ERRORS)],
        seed=int(rng.integers(2**31)),
    )


def meshes_of(folder: Path | None) -> list[Path]:
    """Return the .obj files of a folder; none without a folder. Raises InputError: it has none."""
    meshes = sorted(folder.rglob("*.obj")) if folder else []
    if folder and not meshes:
        raise InputError("--meshes", "a folder with .obj files", "none", "name another folder")
    return meshes


class Stage:
    """A studio that shows scenes.

    references  folder in which their references are kept for the next measurement; None: in none
    """

    def __init__(self, size: int, threads: int, references: Path | None = None):
        with importing_blender(threads):
            from factory.render.studio import Studio
        self.studio = Studio("cpu", threads)
        self.studio.set_camera(Camera(size=(size, size)))
        self._size, self._references = size, references
        self._catalogue = load_catalogue()
        self.materials = sorted(self._catalogue)

    def show(self, scene: Scene) -> np.ndarray:
        """Set a scene up and return its mask (height, width)."""
        mesh = load_shape(scene.shape)
        self.studio.set_shape(mesh)
        self.studio.set_light(load_light(scene.light).L64, scene.rotation)
        self.studio.set_materials([self._catalogue[scene.material].mixture] * mesh.segments)
        self.studio.set_view(scene.azimuth)
        mask = self.studio.geometry().mask
        self.studio.picture(1, 0, scene.tier)  # Cycles sends mesh and materials with the first
        return mask

    def reference(self, scene: Scene, mask: np.ndarray, samples: int) -> Halves:
        """Return halves of at least so many samples, by a seed that no picture has."""
        shown = Shown(self.studio, (scene.seed + 1) % 2**31, scene.tier, mask)
        halves = (
            KeptReference(shown, path_of(self._references, scene, self._size))
            if self._references
            else Halves(shown)
        )
        if halves.samples < samples:
            halves.grow(samples - halves.samples)
        return halves


def compare(one: np.ndarray, other: np.ndarray, reference: Halves) -> Estimate:
    """Return the mean of (one − R1)(other − R2) in display values: an error, or a squared bias."""
    mask = reference.shown.mask
    exposure = tone.auto_exposure(reference.picture, mask)
    a, b, r1, r2 = (
        tone.display(each[mask], exposure) for each in (one, other, *reference.pictures)
    )
    return mean_over(((a - r1) * (b - r2)).mean(-1))


def name_of_file(scene: Scene) -> Scene:
    """Return a scene whose shape is the name of its file, where it is a file's."""
    return replace(scene, shape=Path(scene.shape).name)
