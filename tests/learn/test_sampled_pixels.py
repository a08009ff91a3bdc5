"""The pixels at which losses compare rendered pictures."""

import collections
from types import SimpleNamespace

import pytest
import torch

from learn.training.rerendering import sample_pixels

PIXELS = 16


@pytest.fixture
def batch():
    """Objects of many, no, five and all pixels."""
    inside = torch.rand(4, 8, 8, generator=torch.Generator().manual_seed(0)) > 0.6
    inside[1], inside[2], inside[3] = False, False, True
    inside[2, 3, 2:7] = True
    return SimpleNamespace(segments=inside.long(), mask=inside[:, None].float())


def test_sampled_pixels_are_different_and_all_inside(batch):
    rng = torch.Generator().manual_seed(1)
    inside = (batch.segments > 0).flatten(1)
    for _ in range(50):
        where, count = sample_pixels(batch, PIXELS, rng)
        assert count == sum(min(PIXELS, int(each.sum())) for each in inside)
        for places, each in zip(where, inside, strict=True):
            chosen = places[places >= 0]
            assert len(set(chosen.tolist())) == len(chosen) == min(PIXELS, int(each.sum()))
            assert each[chosen].all()


def test_each_pixel_of_an_object_is_equally_likely(batch):
    rng, draws = torch.Generator().manual_seed(1), 4000
    counts = collections.Counter()
    for _ in range(draws):
        counts.update(sample_pixels(batch, PIXELS, rng)[0][0].tolist())
    number = int((batch.segments[0] > 0).sum())
    assert PIXELS < number == len(counts)
    expected = draws * PIXELS / number
    assert all(abs(count - expected) < 0.12 * expected for count in counts.values())
