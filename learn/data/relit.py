"""Examples relit on the fly: the layer renders stored geometry in any material under any light.

No image files are needed. Batch k of a run is a function of (seed, side, k) alone, in any order and
on any machine. Pictures come in groups of `sharing`, of different shapes and views, that share a
material and a light, and therefore a reflectance map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np
import torch

from learn.data import augmentation, deformations, lights, patterns, shadows
from learn.data.batch import ExampleBatch, collate
from learn.data.data_split import DataSplit, gloss
from learn.data.devices import to_numpy
from learn.data.geometry import fold_segments, subsample
from learn.data.label_augmentation import LabelAugmentation
from learn.data.settings import Data
from learn.layer import render
from manifests.errors import InputError, closest

SIDES = {"train": 0, "validation": 1, "test": 2}
# of a SeedSequence's key, after side, batch and group: draws of their own, so that pictures without
# them are the same in a run that has them
LABELS, PATTERNS, DEFORMATIONS, SHADOWS = 1, 2, 3, 4
BRIGHTEST = 6e4  # half floats end there, and so do pictures from files


class _Scene(NamedTuple):
    """What the B pictures of a group show: B views in one material under one light.

    views     (B,) indices into the geometry
    n         (B, H, W, 3) normals
    segments  (B, H, W) 1 … S, 0 in the background
    depths    {place in the group: (H, W)} of views that were deformed, where the run needs depth
    label     (S, 108)
    light     (64, 128, 3)
    """

    views: np.ndarray
    n: torch.Tensor
    segments: torch.Tensor
    depths: dict[int, np.ndarray]
    label: np.ndarray
    light: np.ndarray


class RelitDataset:
    """Batches of relit examples.

    batch    number of pictures in a batch
    size     height and width of pictures; geometry's are a whole number of times larger
    part     (i, n): of every batch only the i-th of n equal parts, for several processes
    printed  share of pictures with a pattern; None: the run's in training, otherwise none
    """

    def __init__(
        self,
        data_split: DataSplit,
        data: Data,
        batch: int,
        size: int,
        seed: int,
        part: tuple[int, int] = (0, 1),
        printed: float | None = None,
    ):
        self.is_training = data_split.side == "train"
        self.printed = data.patterns * self.is_training if printed is None else printed
        self.augmentation = None
        if self.is_training and data.label_mixtures + data.scaled_lobes + data.principled > 0:
            self.augmentation = LabelAugmentation(data_split.labels, data, seed)
        self.data_split, self.data, self.size, self.seed = data_split, data, size, seed
        if any(side % size for side in data_split.geometry.size):
            result = f"{data_split.geometry.size[0]} × {data_split.geometry.size[1]}"
            raise InputError(
                data_split.geometry.folder,
                f"geometry of a whole number of times {size} pixels",
                result,
                f"render a job whose camera has that size, or with --size {size}",
            )
        groups = -(-batch // data.sharing)
        if groups % part[1]:
            raise InputError(
                f"schedule.batch, {part[1]} processes",
                f"a multiple of {data.sharing * part[1]} pictures, data.sharing for each process",
                str(batch),
                "change schedule.batch, or the number of processes",
            )
        self.groups = range(groups)[part[0] :: part[1]]
        self.of_group = [
            len(range(g * data.sharing, min((g + 1) * data.sharing, batch))) for g in range(groups)
        ]
        self.probabilities = (
            self._probabilities() if self.is_training and data.category_weights else None
        )
        self.names = sorted(data_split.labels)
        if data.gloss_curriculum:
            self.names.sort(key=lambda name: gloss(data_split.labels[name]))

    def __getitem__(self, k: int) -> ExampleBatch:
        """Return the k-th batch."""
        return collate(
            [example for g in self.groups for example in self._group(k, g)],
            self.data_split.geometry.elevation,
        )

    def _group(self, k: int, g: int) -> list[tuple]:
        """Return the examples of group g of batch k, which share a material and a light."""
        rng = self._generator(k, g)
        views = self._draw_views(rng, self.of_group[g])
        names, labels = self._draw_materials(rng, k)
        names, labels = self._augment_labels(k, g, names, labels)
        light = self._draw_light(rng)
        label, target = labels[: self.data.regions], labels[self.data.regions :]
        n, segments = self._geometry(views)
        depths: dict[int, np.ndarray] = {}
        if self.is_training and self.data.deformations:
            n, segments, depths = self._deform(views, n, segments, (k, g))
        scene = _Scene(views, n, segments, depths, label, light)
        images = self._pictures(n, segments, label, light)
        images = self._add_prints(images, scene, (k, g))
        if self.is_training and self.data.shadows:
            images = self._add_shadows(images, scene, (k, g))
        result = []
        for i, v in enumerate(views):
            view = self.data_split.geometry.views[v]
            name = f"{view.shape} view {view.viewpoint} {'+'.join(names[: len(label)])}"
            mask = (segments[i] > 0).numpy()
            image, drawn_mask, (normals, covered) = augmentation.augment(
                self.data, self.is_training, rng, images[i], mask, (n[i], segments[i])
            )
            truth = (normals, covered, label, light, target, name)
            result.append((image, drawn_mask, *truth))
        return result

    def _draw_views(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return the indices (count,) of different views, as far as there are so many."""
        views = self.data_split.views
        drawable = (
            len(views) if self.probabilities is None else np.count_nonzero(self.probabilities)
        )
        return views[rng.choice(len(views), count, count > drawable, self.probabilities)]

    def _draw_materials(self, rng: np.random.Generator, k: int) -> tuple[list[str], np.ndarray]:
        """Return names and labels (2 S, 108): of the picture's S regions, then of the target's.

        In training the colour channels of each are exchanged at random.
        """
        chosen = [self.names[i] for i in rng.choice(self._admitted_count(k), 2 * self.data.regions)]
        channels = [rng.permutation(3) if self.is_training else np.arange(3) for _ in chosen]
        labels = [
            self.data_split.labels[name].reshape(3, 36)[c].reshape(108)
            for name, c in zip(chosen, channels, strict=True)
        ]
        return chosen, np.stack(labels)

    def _draw_light(self, rng: np.random.Generator) -> np.ndarray:
        """Return a light (64, 128, 3): in training varied, else a map at a random rotation."""
        maps = self.data_split.maps
        if self.is_training:
            light = lights.draw(rng, maps, self.data.real_lights)
            return lights.tilt(rng, light) if self.data.unknown_camera else light
        return np.roll(maps[rng.integers(len(maps))], int(rng.integers(lights.WIDTH)), 1)

    def _generator(self, *key: int) -> np.random.Generator:
        """Return the generator of a batch and a group, and of what is drawn for it."""
        key = (SIDES[self.data_split.side], *key)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def _probabilities(self) -> np.ndarray:
        """Return the probability (views,) that a draw takes each view, as category_weights say.

        Raises  InputError: a category without a training view, no view with a weight above 0
        """
        folder, weights = self.data_split.geometry.folder, self.data.category_weights
        categories = [self.data_split.geometry.views[v].category for v in self.data_split.views]
        for category in weights:
            if category not in categories:
                raise InputError(
                    f"data.category_weights of category '{category}'",
                    f"a category of the training shapes of {folder}",
                    "no shape of that category",
                    closest(category, set(categories)),
                )
        result = np.array([weights.get(category, 1.0) for category in categories])
        if not result.any():
            raise InputError(
                "data.category_weights",
                "a weight above 0 of a category of training shapes",
                f"0 for all categories of {folder}",
                "raise one of them",
            )
        return result / result.sum()

    def _augment_labels(
        self, k: int, g: int, names: list[str], labels: np.ndarray
    ) -> tuple[list[str], np.ndarray]:
        """Return names and labels (M, 108), some replaced as the run's shares say."""
        if self.augmentation is None:
            return names, labels
        rng, admitted = self._generator(k, g, LABELS), self.names[: self._admitted_count(k)]
        drawn = [
            self.augmentation.draw(rng, name, label, admitted)
            for name, label in zip(names, labels, strict=True)
        ]
        return [name for name, _ in drawn], np.stack([label for _, label in drawn])

    def _admitted_count(self, k: int) -> int:
        """Return the number of materials that batch k draws from (the gloss curriculum)."""
        if not self.data.gloss_curriculum or not self.is_training:
            return len(self.names)
        return max(
            1, math.ceil(len(self.names) * min(1.0, (1 + 2 * k / self.data.gloss_curriculum) / 3))
        )

    def _geometry(self, views: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Return normals (B, H, W, 3) and segments (B, H, W) at the size of pictures."""
        geometry = self.data_split.geometry
        n = np.stack([subsample(geometry.normals(v), self.size) for v in views])
        segments = np.stack([subsample(geometry.segments(v), self.size) for v in views])
        return torch.from_numpy(n), fold_segments(torch.from_numpy(segments), self.data.regions)

    def _deform(
        self,
        views: np.ndarray,
        n: torch.Tensor,
        segments: torch.Tensor,
        number: tuple[int, int],
    ) -> tuple[torch.Tensor, torch.Tensor, dict[int, np.ndarray]]:
        """Return normals and segments, a share of them deformed; number: (batch, group).

        The last part has the depth (H, W) of those that were deformed, by their place in the group,
        where the run needs depth.
        """
        rng, geometry = self._generator(*number, DEFORMATIONS), self.data_split.geometry
        n, segments, depths = n.clone(), segments.clone(), {}
        for i in np.nonzero(rng.random(len(n)) < self.data.deformations)[0]:
            depth = subsample(geometry.depth(views[i]), self.size) if self.data.shadows else None
            half_extent = geometry.cameras[views[i]].half_extent
            deformed = deformations.deform(
                rng, n[i].numpy(), segments[i].numpy(), depth, half_extent
            )
            n[i], segments[i] = torch.from_numpy(deformed.n), torch.from_numpy(deformed.segments)
            if deformed.depth is not None:
                depths[int(i)] = deformed.depth
        return n, segments, depths

    def _pictures(
        self, n: torch.Tensor, segments: torch.Tensor, label: np.ndarray, L: np.ndarray
    ) -> np.ndarray:
        """Return pictures (B, H, W, 3) in one label (S, 108) under one light (64, 128, 3).

        Both are expanded over the batch, so that the layer shares its reflectance map.
        """
        count = len(n)
        material = torch.from_numpy(label).exp()[None].expand(count, -1, -1)
        light = torch.from_numpy(L)[None].expand(count, -1, -1, -1)
        with torch.no_grad():
            shared = material[:, 0] if self.data.regions == 1 else material
            picture = render(
                n,
                shared,
                light,
                segments=None if self.data.regions == 1 else segments,
                method=self.data.layer_method,
                tolerance=self.data.tolerance,
                elevation=self.data_split.geometry.elevation,
            )
        return to_numpy(picture.clamp(0, BRIGHTEST))

    def _add_prints(self, images: np.ndarray, scene: _Scene, number: tuple[int, int]) -> np.ndarray:
        """Return the pictures, all with a pattern or none; number: (batch, group)."""
        rng = self._generator(*number, PATTERNS)
        if not self.printed or rng.random() >= self.printed:
            return images
        return patterns.add_prints(
            rng,
            images,
            scene.n,
            scene.segments,
            scene.label,
            lambda label: self._pictures(scene.n, scene.segments, label, scene.light),
        )

    def _add_shadows(
        self, images: np.ndarray, scene: _Scene, number: tuple[int, int]
    ) -> np.ndarray:
        """Return the pictures, a share of them with shadows; number: (batch, group)."""
        rng, geometry = self._generator(*number, SHADOWS), self.data_split.geometry
        result = images.copy()
        for i in np.nonzero(rng.random(len(images)) < self.data.shadows)[0]:
            view = scene.views[i]
            camera = geometry.cameras[view]
            if i in scene.depths:  # deformations treat every viewer as a distant one
                distant = msgspec.structs.replace(camera, fov_deg=None)
                position, to_viewer = shadows.positions(scene.depths[i], distant)
            else:
                position, to_viewer = (
                    subsample(each, self.size)
                    for each in shadows.positions(geometry.depth(view), camera)
                )
            factor = shadows.shadow_factor(
                scene.n[i].numpy(),
                position,
                to_viewer,
                scene.segments[i].numpy(),
                images[i],
                scene.label,
                scene.light,
                geometry.elevation,
            )
            result[i] = np.minimum(images[i] * factor, BRIGHTEST)
        return result
