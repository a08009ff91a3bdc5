"""Examples from pictures that Cycles rendered, that is, from the records of a data set.

Their order depends only on (seed, side, number). The target O is another record of the same shape,
view and light if there is one; otherwise the layer renders it. Losses compare with the pictures
themselves, not with the layer's renderings of them, so that a network learns to cope with what the
layer leaves out.
"""

from collections.abc import Hashable
from functools import lru_cache

import numpy as np
import torch

from learn.data import augmentation
from learn.data.batch import ExampleBatch, collate
from learn.data.data_split import DataSplit
from learn.data.devices import to_numpy
from learn.data.geometry import Geometry, fold_segments, subsample
from learn.data.records import Records
from learn.data.relit import BRIGHTEST, SIDES, RelitDataset
from learn.data.settings import Data
from learn.layer import render
from manifests.errors import InputError
from manifests.schema import Record
from shaders.envmap import roll

ORDER, DRAW = 10, 20  # of a SeedSequence's key, far from what relit pictures use


class RenderedSplit:
    """The pictures of one side of the split.

    records    all records of a data set
    geometry   of the same data set
    chosen     the records on this side
    skipped    {id: what is wrong} for the records of the data set that were left out
    """

    def __init__(
        self,
        records: Records,
        geometry: Geometry,
        chosen: list[Record],
        skipped: dict[str, str] | None = None,
    ):
        self.records, self.geometry, self.chosen = records, geometry, chosen
        self.skipped = skipped or {}
        self.view_of = {view.hash: i for i, view in enumerate(geometry.views)}
        self.scenes: dict[Hashable, list[int]] = {}
        for i, record in enumerate(chosen):
            self.scenes.setdefault(_scene(record), []).append(i)

    def __len__(self) -> int:
        return len(self.chosen)

    def partners(self, record: Record) -> list[Record]:
        """Return records of the same shape, view, light and tier in other materials."""
        return [
            self.chosen[i]
            for i in self.scenes[_scene(record)]
            if self.chosen[i].materials != record.materials
        ]

    def labels(self, record: Record, regions: int) -> np.ndarray:
        """Return the labels (regions, 108) of a record's segments; missing ones repeat the last."""
        names = [record.materials[min(s, len(record.materials) - 1)] for s in range(regions)]
        return np.stack([self.records.label(name) for name in names])


def fits(record: Record, regions: int) -> bool:
    """Return whether `regions` labels describe all of a record's materials.

    Segments beyond them begin again with the first label.
    """
    return all(name == record.materials[s % regions] for s, name in enumerate(record.materials))


class RenderedDataset:
    """Batches of rendered examples; the arguments are those of learn.data.relit.RelitDataset.

    Raises  InputError if the pictures cannot be used at this size; ValueError if there are none
    """

    def __init__(
        self,
        data_split: DataSplit,
        data: Data,
        batch: int,
        size: int,
        seed: int,
        part: tuple[int, int] = (0, 1),
    ):
        if data_split.rendered_split is None:
            raise ValueError(f"{data_split.side}: expected rendered pictures, found none")
        self.data_split, self.rendered_split = data_split, data_split.rendered_split
        self.data, self.size, self.seed, self.batch = data, size, seed, batch
        geometry = self.rendered_split.geometry
        if geometry.has_several_cameras:
            raise InputError(
                geometry.folder,
                "pictures by one orthographic camera without roll",
                "several cameras, perspective or roll",
                "render them with a job without fov_deg, roll_deg and camera_ranges",
            )
        if any(side % size for side in geometry.size):
            result = f"{geometry.size[0]} × {geometry.size[1]}"
            raise InputError(
                geometry.folder,
                f"pictures of a whole number of times {size} pixels",
                result,
                f'render them with "size": {size}',
            )
        if batch % part[1]:
            raise InputError(
                f"schedule.batch, {part[1]} processes",
                f"a multiple of {part[1]} pictures",
                str(batch),
                "change schedule.batch, or the number of processes",
            )
        share = batch // part[1]
        self.places = range(part[0] * share, (part[0] + 1) * share)
        self.names = sorted(data_split.labels)

    def __getitem__(self, k: int) -> ExampleBatch:
        """Return the k-th batch."""
        return collate(
            [self._example(k * self.batch + j) for j in self.places],
            self.rendered_split.geometry.elevation,
        )

    def _example(self, number: int) -> tuple:
        """Return the example of this number, over all epochs."""
        epoch, place = divmod(number, len(self.rendered_split))
        side = SIDES[self.data_split.side]
        record = self.rendered_split.chosen[
            _order(self.seed, side, epoch, len(self.rendered_split))[place]
        ]
        rng = np.random.default_rng(
            np.random.SeedSequence(self.seed, spawn_key=(DRAW + side, epoch, place))
        )
        training = self.data_split.side == "train"
        channels = rng.permutation(3) if training else np.arange(3)
        partners = self.rendered_split.partners(record)
        partner = partners[rng.integers(len(partners))] if partners else None
        n, segments = self._geometry(record)
        L = roll(self.rendered_split.records.light(record.light), record.rotation_texels)
        image, label = self._picture(record), self.rendered_split.labels(record, self.data.regions)
        if partner is None:
            names = [self.names[i] for i in rng.choice(len(self.names), self.data.regions)]
            target_label = np.stack([self.data_split.labels[name] for name in names])
            target = self._relit(n, segments, target_label, L)
        else:
            target = self._picture(partner)
            target_label = self.rendered_split.labels(partner, self.data.regions)
        label, target_label = (
            each.reshape(-1, 3, 36)[:, channels].reshape(-1, 108) for each in (label, target_label)
        )
        image, target, L = (
            np.ascontiguousarray(each[..., channels]) for each in (image, target, L)
        )
        mask = (segments > 0).numpy()
        true_pictures = (torch.from_numpy(each * mask[..., None]) for each in (image, target))
        image, seen, (n, segments, picture, target_picture) = augmentation.augment(
            self.data, training, rng, image, mask, (n, segments, *true_pictures)
        )
        name = (
            f"{record.shape} view {record.viewpoint} {record.id}"
            f" {'+'.join(dict.fromkeys(record.materials))}"
        )
        truth = (n, segments, label, L, target_label, name, picture, target_picture)
        return image, seen, *truth

    def _geometry(self, record: Record) -> tuple[torch.Tensor, torch.Tensor]:
        """Return normals (H, W, 3) and segments (H, W) at the size of pictures."""
        geometry = self.rendered_split.geometry
        at = self.rendered_split.view_of[record.geometry_hash]
        n, segments = (
            torch.from_numpy(subsample(values, self.size))
            for values in (geometry.normals(at), geometry.segments(at))
        )
        return n, fold_segments(segments, self.data.regions)

    def _picture(self, record: Record) -> np.ndarray:
        """Return radiance (H, W, 3) of a record at the size of pictures."""
        image = subsample(self.rendered_split.records.image(record), self.size)
        return np.clip(image, 0, BRIGHTEST)

    def _relit(
        self, n: torch.Tensor, segments: torch.Tensor, label: np.ndarray, L: np.ndarray
    ) -> np.ndarray:
        """Return the layer's picture (H, W, 3) in labels (S, 108) under a light (64, 128, 3)."""
        arrays = n[None], torch.from_numpy(label).exp()[None], torch.from_numpy(L)[None]
        with torch.no_grad():
            picture = render(
                *arrays,
                segments=segments[None],
                method=self.data.layer_method,
                tolerance=self.data.tolerance,
                elevation=self.rendered_split.geometry.elevation,
            )
        return to_numpy(picture[0].clamp(0, BRIGHTEST))


class MixedDataset:
    """Batches of two sources: a share rendered by Cycles, spread evenly, and the rest relit.

    The source of a batch depends only on its number.
    """

    def __init__(self, relit: RelitDataset, cycles: RenderedDataset, share: float):
        self.relit, self.cycles, self.share = relit, cycles, share

    def __getitem__(self, k: int) -> ExampleBatch:
        """Return the k-th batch."""
        before = int(k * self.share)
        return self.cycles[before] if int((k + 1) * self.share) > before else self.relit[k - before]


@lru_cache(4)
def _order(seed: int, side: int, epoch: int, count: int) -> np.ndarray:
    """Return a permutation of the records for one epoch."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(ORDER + side, epoch))
    ).permutation(count)


def _scene(record: Record) -> Hashable:
    """Return what pictures have in common that show one object in different materials, as a key."""
    return (
        record.shape_hash,
        record.geometry_hash,
        record.light_hash,
        record.rotation_texels,
        record.tier,
        record.light_resolution,
    )
