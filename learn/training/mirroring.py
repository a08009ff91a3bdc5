"""Use each batch a second time, mirrored left to right: half the relighting per step.

A mirrored scene is as likely as the scene itself, and its picture is the mirrored picture exactly.
Relighting a batch costs about as much processor time as a step of the network. Step k shows batch
k/2 if k is even; if k is odd, the batch of DELAY batches before, mirrored, so that a picture and
its mirror image are not in consecutive steps.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import torch

from learn.data.batch import ExampleBatch

DELAY = 16


def shown_at(step: int) -> tuple[int, bool]:
    """Return (the number of the batch that a step shows, whether it is mirrored).

    The first batches, which have none DELAY before them, are mirrored at once.
    """
    number, odd = divmod(step, 2)
    return (number - DELAY if odd and number >= DELAY else number), bool(odd)


def numbers(steps: Iterable[int]) -> list[int]:
    """Return the numbers of the batches that these steps need, each once, in order of first use."""
    return list(dict.fromkeys(shown_at(step)[0] for step in steps))


def batches(
    steps: range, made: Callable[[Sequence[int]], Iterator[ExampleBatch]]
) -> Iterator[ExampleBatch]:
    """Yield the batch of each step.

    made  yields the batches of a sequence of numbers, in its order
    """
    needed = numbers(steps)
    kept: dict[int, ExampleBatch] = {}
    for number, batch in zip(needed, made(needed), strict=True):
        kept[number] = batch
        while steps and (shown := shown_at(steps[0]))[0] in kept:
            steps = steps[1:]
            batch_number, is_mirrored = shown
            batch = kept[batch_number]
            yield mirrored(batch) if is_mirrored else batch
        for old in [each for each in kept if each < number - DELAY]:
            del kept[old]


def mirrored(batch: ExampleBatch) -> ExampleBatch:
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
