"""Clipped highlights: found in files, kept through resizing, and one-sided in energy and loss."""

from dataclasses import replace

import numpy as np
import torch

from learn.data import photographs
from learn.data.batch import Clipping, joined
from learn.refinement import RefinementSettings
from learn.refinement.energy import Energy
from learn.training.losses import limited, misfit
from tests.support.flat_plane import flat


def test_white_is_marked_by_channel_and_through_resizing() -> None:
    display = np.full((32, 32, 3), 128.0)
    display[8:16, 8:16, 0] = 255
    display[16:20, 8:16, 1] = photographs.NEAR_WHITE - 1
    radiance = photographs._linear(display / 255)
    clipped = photographs.saturated(radiance)
    assert clipped.sum() == 64
    assert clipped[8:16, 8:16, 0].all()
    mask = np.zeros((32, 32), bool)
    mask[4:24, 4:24] = True
    framed = photographs.framed(radiance, mask, 8, clipped=clipped)
    assert framed.clipped is not None
    assert framed.clipped.shape == (8, 8, 3)
    share = framed.clipped[..., 0]
    assert 0 < share.max() <= 1
    assert ((share > 0) & (share < 1)).any()
    assert not framed.clipped[..., 1:].any()
    assert photographs.framed(radiance, mask, 8).clipped is None


def test_a_brighter_prediction_has_no_gradient_and_a_darker_one_is_pulled_up() -> None:
    mine = torch.tensor([2.0, 0.5, 2.0, 0.5], requires_grad=True)
    cost = misfit(mine, torch.ones(4), torch.tensor([1.0, 1.0, 0.0, 0.5]))
    (gradient,) = torch.autograd.grad(cost.sum(), mine)
    assert gradient.tolist() == [0.0, -1.0, 2.0, -1.0]


def test_energy_does_not_explain_highlights_beyond_white() -> None:
    batch, start = flat()
    brighter = replace(batch, image=batch.image * 0.1)
    energy = {}
    for name, share in (("value", None), ("bound", torch.ones_like(batch.image))):
        of_picture = Energy(replace(brighter, clipped=share), start, RefinementSettings())
        light = (start.light * 50).requires_grad_()
        image = of_picture.image(
            replace(start, light=light), of_picture.inside, (16, 32), "exact", 1e-2
        )
        (slope,) = torch.autograd.grad(image, light)
        energy[name] = float(image.detach()), float(slope.abs().max())
    assert energy["value"][0] > 0
    assert energy["value"][1] > 0
    assert energy["bound"] == (0.0, 0.0)


def test_truth_beyond_white_is_limited_where_it_is_clipped() -> None:
    truth, white = torch.full((1, 3, 2, 2), 5.0), torch.tensor([[1.0, 2.0, 9.0]])
    clipped = torch.zeros_like(truth)
    clipped[..., 0, 0] = 1
    result = limited(truth, white, clipped)
    assert result[0, :, 0, 0].tolist() == [1.0, 2.0, 5.0]
    assert (result[..., 1, :] == 5).all()


def test_captures_are_joined() -> None:
    picture = np.zeros((4, 4, 3), np.float32)
    label, light = np.zeros((1, 108), np.float32), np.zeros((64, 128, 3), np.float32)
    plain = (picture, picture[..., 0] > 0, picture, picture[..., 0], label, light, label, "x")
    white = np.array([1.0, 2.0, 3.0])
    batch = joined([(*plain, Clipping(picture > -1, white))] * 2, 0.3)
    assert joined([plain], 0.3).clipped is None
    assert batch.clipped is not None
    assert batch.white is not None
    assert batch.clipped.shape == (2, 3, 4, 4)
    assert batch.clipped.min() == 1
    assert batch.white[1].tolist() == [1.0, 2.0, 3.0]
