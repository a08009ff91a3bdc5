"""Examples from pictures that Cycles rendered: a dataset's records, in an order that is a function
of (seed, side, number) alone.

The target O is another record of the same shape, view and light where there is one; else the layer
renders it. Truth about both is the picture itself, not what the layer would have made of it: what
the layer leaves out, a network then learns to live with.
"""

from functools import lru_cache

import numpy as np
import torch

from learn.data import augmentation
from learn.data.batch import joined
from learn.data.relit import BRIGHTEST, SIDES
from learn.data.settings import Data
from learn.layer import render
from manifests.errors import InputError
from shaders.envmap import roll

ORDER, DRAW = 10, 20  # of a SeedSequence's key, far from what relit pictures use


class RenderedSplit:
    """The pictures of one side of the split.

    records    learn.data.records.Records; geometry: learn.data.geometry.Geometry of the same folder
    chosen     the records of this side; skipped: {id: what is wrong} of the dataset's records that
    were left out
    """

    def __init__(self, records, geometry, chosen, skipped=None):
        self.records, self.geometry, self.chosen, self.skipped = (
            records,
            geometry,
            chosen,
            skipped or {},
        )
        self.view_of = {view.hash: i for i, view in enumerate(geometry.views)}
        self.scenes = {}
        for i, record in enumerate(chosen):
            self.scenes.setdefault(_scene(record), []).append(i)

    def __len__(self):
        return len(self.chosen)

    def partners(self, record):
        """Records of the same shape, view, light and tier in other materials."""
        return [
            self.chosen[i]
            for i in self.scenes[_scene(record)]
            if self.chosen[i].materials != record.materials
        ]

    def labels(self, record, regions):
        """(regions, 108): of segment after segment; a shape of fewer segments repeats its last."""
        names = [record.materials[min(s, len(record.materials) - 1)] for s in range(regions)]
        return np.stack([self.records.label(name) for name in names])


def fits(record, regions):
    """Whether so many labels say all about a record's materials, when segments beyond them begin
    again with the first.
    """
    return all(name == record.materials[s % regions] for s, name in enumerate(record.materials))


class RenderedDataset:
    """Batches of rendered examples; arguments as learn.data.relit.RelitDataset's.

    Raises  InputError for pictures that do not suit the size
    """

    def __init__(self, data_split, data: Data, batch, size, seed, part=(0, 1)):
        self.data_split, self.rendered_split, self.data, self.size, self.seed, self.batch = (
            data_split,
            data_split.rendered_split,
            data,
            size,
            seed,
            batch,
        )
        geometry = self.rendered_split.geometry
        if any(side % size for side in geometry.size):
            result = f"{geometry.size[0]} × {geometry.size[1]}"
            raise InputError(
                geometry.folder,
                f"pictures of a whole number of times {size} pixels",
                result,
                f'render them with "size": {size}',
            )
        if batch % part[1]:
            raise ValueError(
                f"batch: expected a multiple of {part[1]} pictures for so many processes, found"
                f" {batch}"
            )
        share = batch // part[1]
        self.places = range(part[0] * share, (part[0] + 1) * share)
        self.names = sorted(data_split.labels)

    def __getitem__(self, k):
        """The k-th Batch."""
        return joined(
            [self._example(k * self.batch + j) for j in self.places],
            self.rendered_split.geometry.elevation,
        )

    def _example(self, number):
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
            target, target_label = (
                self._picture(partner),
                self.rendered_split.labels(partner, self.data.regions),
            )
        label, target_label = (
            each.reshape(-1, 3, 36)[:, channels].reshape(-1, 108) for each in (label, target_label)
        )
        image, target, L = (
            np.ascontiguousarray(each[..., channels]) for each in (image, target, L)
        )
        mask = (segments > 0).numpy()
        along = (
            n,
            segments,
            torch.from_numpy(image * mask[..., None]),
            torch.from_numpy(target * mask[..., None]),
        )
        image, seen, along = augmentation.seen(
            rng, image, mask, along, training and self.data.photograph
        )
        n, segments, picture, target = along
        name = (
            f"{record.shape} view {record.viewpoint} {record.id}"
            f" {'+'.join(dict.fromkeys(record.materials))}"
        )
        return image, seen, n, segments, label, L, target_label, name, picture, target

    def _geometry(self, record):
        at, geometry = (
            self.rendered_split.view_of[record.geometry_hash],
            self.rendered_split.geometry,
        )
        n, segments = (
            torch.from_numpy(self._small(geometry.normals(at))),
            torch.from_numpy(self._small(geometry.segments(at))),
        )
        return n, (segments - 1).clamp(min=0) % self.data.regions + (segments > 0)

    def _picture(self, record):
        return np.clip(self._small(self.rendered_split.records.image(record)), 0, BRIGHTEST)

    def _small(self, array):
        """Every so many-th pixel, as geometry is made smaller: a mean of normals would be the
        normal of nothing.
        """
        step = len(array) // self.size
        return np.ascontiguousarray(array[step // 2 :: step, step // 2 :: step])

    def _relit(self, n, segments, label, L):
        arrays = n[None], torch.from_numpy(label).exp()[None], torch.from_numpy(L)[None]
        with torch.no_grad():
            picture = render(
                *arrays,
                segments=segments[None],
                tolerance=self.data.tolerance,
                elevation=self.rendered_split.geometry.elevation,
            )
        return picture[0].clamp(0, BRIGHTEST).numpy()


class MixedDataset:
    """Batches of two sources: a share of Cycles', spread evenly, the rest relit; a function of the
    batch's number alone.
    """

    def __init__(self, relit, cycles, share):
        self.relit, self.cycles, self.share = relit, cycles, share

    def __getitem__(self, k):
        """The k-th Batch."""
        before = int(k * self.share)
        return self.cycles[before] if int((k + 1) * self.share) > before else self.relit[k - before]


@lru_cache(4)
def _order(seed, side, epoch, count):
    """Records of one epoch, each once."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(ORDER + side, epoch))
    ).permutation(count)


def _scene(record):
    return (
        record.shape_hash,
        record.geometry_hash,
        record.light_hash,
        record.rotation_texels,
        record.tier,
        record.light_resolution,
    )
