"""Shows each batch several times, each time as another scene, so that less is relit per step.

Relighting a batch costs about as much processor time as a step of the network. A batch can be
shown again mirrored left to right, and with its colour channels exchanged cyclically: such scenes
are as likely as the scene itself, and their pictures are the changed picture exactly. With V
versions, step k shows batch k // V − v · DELAY in version v = k % V, so that versions of one
picture are not in consecutive steps.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import torch

from learn.data.batch import ExampleBatch
from learn.data.settings import Data

DELAY = 16


class Version:
    """How a batch is shown: whether mirrored, and by how many places its channels are moved."""

    def __init__(self, is_mirrored: bool, channels: int):
        self.is_mirrored, self.channels = is_mirrored, channels

    def apply(self, batch: ExampleBatch) -> ExampleBatch:
        """Return the batch in this version."""
        batch = mirror(batch) if self.is_mirrored else batch
        return exchange_channels(batch, self.channels) if self.channels else batch


def versions_of(data: Data) -> list[Version]:
    """Return the versions in which a run shows each batch, the batch itself first."""
    sides = (False, True) if data.mirrored else (False,)
    return [Version(side, channels) for channels in range(1 + data.recolored) for side in sides]


def shown_at(step: int, count: int) -> tuple[int, int]:
    """Return (number of the batch, number of its version) that a step shows, of `count` versions.

    Of the first batches, which have none so long before them, all versions are shown at once.
    """
    number, version = divmod(step, count)
    earlier = number - DELAY * version
    return (earlier if earlier >= 0 else number), version


def needed_batches(steps: Iterable[int], count: int) -> list[int]:
    """Return the numbers of the batches that these steps need, each once, in order of first use.

    count  number of versions in which each batch is shown
    """
    return list(dict.fromkeys(shown_at(step, count)[0] for step in steps))


def repeat_batches(
    steps: range,
    versions: Sequence[Version],
    load: Callable[[Sequence[int]], Iterator[ExampleBatch]],
) -> Iterator[ExampleBatch]:
    """Yield the batch of each step, in the version that `shown_at` says.

    versions  in which each batch is shown
    load      yields the batches of a sequence of numbers, in its order
    """
    count = len(versions)
    needed = needed_batches(steps, count)
    kept: dict[int, ExampleBatch] = {}
    for number, batch in zip(needed, load(needed), strict=True):
        kept[number] = batch
        while steps and (shown := shown_at(steps[0], count))[0] in kept:
            oldest, steps = steps[0] // count - DELAY * (count - 1), steps[1:]
            yield versions[shown[1]].apply(kept[shown[0]])
            for old in [each for each in kept if each < oldest]:
                del kept[old]


def mirror(batch: ExampleBatch) -> ExampleBatch:
    """Return a batch as a mirror shows it: left and right of pictures and light swapped."""
    n = batch.n.flip(-1)
    others = {
        name: picture.flip(-1)
        for name in ("picture", "target", "clipped")
        if (picture := getattr(batch, name)) is not None
    }
    # column j of a map lies at φ = 2π (j + ½) / width from +x; a mirror turns φ into π − φ
    light = batch.light.flip(-1).roll(batch.light.shape[-1] // 2, -1)
    return replace(
        batch,
        image=batch.image.flip(-1),
        mask=batch.mask.flip(-1),
        n=torch.cat([-n[:, :1], n[:, 1:]], 1),
        segments=batch.segments.flip(-1),
        light=light,
        **others,
    )


def exchange_channels(batch: ExampleBatch, places: int) -> ExampleBatch:
    """Return a batch whose colour channels are moved cyclically, in pictures, labels and light."""
    pictures = {
        name: picture.roll(places, 1)
        for name in ("image", "light", "picture", "target", "clipped")
        if (picture := getattr(batch, name)) is not None
    }
    labels = {
        name: label.unflatten(-1, (3, -1)).roll(places, -2).flatten(-2)
        for name in ("label", "target_label")
        for label in [getattr(batch, name)]
    }
    return replace(batch, **pictures, **labels)
