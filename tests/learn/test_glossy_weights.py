"""Weights beside each other on glossy pictures: names, sizes and what ratios are of."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
import torch

from learn.commands import options
from learn.data.batch import collate
from learn.evaluation.ladder_pictures import Shown
from learn.experiments.training import glossy_weights


def picture(size):
    """A picture whose pixels are numbered."""
    number = np.arange(size * size, dtype=np.float32).reshape(size, size)
    colours = np.repeat(number[..., None], 3, 2)
    mask = number % 7 > 0
    label, light = np.zeros((1, 108), np.float32), np.ones((64, 128, 3), np.float32)
    example = (colours, mask, colours, mask.astype(np.int64), label, light, label, "a b c")
    return Shown(collate([example], 0.3), colours, mask, label, 1.0)


def test_a_picture_becomes_every_second_pixel_in_all_of_its_parts():
    large, small = picture(8), glossy_weights.of_size(picture(8), 4)
    kept = large.target[1::2, 1::2, 0]
    assert small.mask.shape == (4, 4) and (small.target[..., 0] == kept).all()
    assert (small.mask == (kept % 7 > 0)).all()
    batch = small.batch
    assert (batch.image[0, 0].numpy() == kept).all() and (batch.n[0, 0].numpy() == kept).all()
    assert (batch.mask[0, 0].bool().numpy() == small.mask).all()
    assert (batch.segments[0].numpy() == small.mask).all()
    assert torch.equal(batch.light, large.batch.light)


@pytest.mark.parametrize("size", [8, 16, 3])
def test_a_picture_of_the_size_or_of_no_multiple_stays_as_it_is(size):
    given = picture(8)
    assert glossy_weights.of_size(given, size) is given
    assert glossy_weights.of_size(replace(given, mask=given.mask[:, 1:]), 4).mask.shape == (8, 7)


def test_weights_have_a_name_and_may_be_the_programs_own():
    name, path = glossy_weights.named_weights("given=general-compact")
    assert name == "given" and path == options.weights_file("general-compact") and path.exists()
    assert glossy_weights.named_weights("a=b/c=d.safetensors")[1].name == "c=d.safetensors"
    for text in ("weights.safetensors", "=x", "x="):
        with pytest.raises(argparse.ArgumentTypeError, match="NAME=FILE"):
            glossy_weights.named_weights(text)


def test_ratios_are_to_the_first_weights_picture_by_picture():
    rows = [
        {"rung": "direct", "weights": name, "shape": f"s{k}", "source": f"m{k}", "light": f"l{k}"}
        | {key: factor * (k + 1) for key in glossy_weights.FIGURES}
        for k in range(5)
        for name, factor in (("sum", 2.0), ("integral", 1.0))
    ]
    page = glossy_weights.tables(
        {"rows": rows, "weights": ["sum", "integral"], "sizes": {"sum": 64}, "seen": ["Seen."]}
    )
    assert "5 pictures of 5 shapes, 5 materials" in page and "**Seen.**" in page
    (ratios,) = (line for line in page.splitlines() if line.startswith("| integral | 0"))
    assert ratios.count("0.500 [0.500, 0.500]") == len(glossy_weights.FIGURES)
    assert "| sum | 6.00 [" in page and "| integral | 3.00 [" in page
