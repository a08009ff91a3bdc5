"""Clipped highlights: found in files, kept through resizing, and one-sided in refinement."""

from dataclasses import replace

import numpy as np
import torch

from learn.data import framing, photographs
from learn.data.settings import Losses
from learn.networks.coding import Ranges
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings
from learn.refinement.energy import Energy, misfit
from learn.training.losses import terms
from tests.support.flat_plane import flat


def test_white_is_marked_by_channel_and_through_resizing() -> None:
    display = np.full((32, 32, 3), 128.0)
    display[8:16, 8:16, 0] = 255
    display[16:20, 8:16, 1] = photographs.NEAR_WHITE - 1
    radiance = photographs._linear(display / 255)
    clipped = photographs.find_saturated(radiance)
    assert clipped.sum() == 64
    assert clipped[8:16, 8:16, 0].all()
    mask = np.zeros((32, 32), bool)
    mask[4:24, 4:24] = True
    framed = framing.frame_object(radiance, mask, 8, clipped=clipped)
    assert framed.clipped is not None
    assert framed.clipped.shape == (8, 8, 3)
    share = framed.clipped[..., 0]
    assert 0 < share.max() <= 1
    assert ((share > 0) & (share < 1)).any()
    assert not framed.clipped[..., 1:].any()
    assert framing.frame_object(radiance, mask, 8).clipped is None


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


def test_training_compares_with_the_truth_and_not_with_what_a_camera_clipped() -> None:
    """A prediction that is too bright costs as much where the picture is clipped."""
    batch, _ = flat()
    prediction = Prediction(batch.n, None, batch.label + 1, None, batch.light)
    cost = [
        terms(
            prediction,
            replace(batch, clipped=clipped),
            Losses(image=1),
            torch.Generator().manual_seed(0),
            Ranges.of(torch.zeros(2, 108)),
        )["image"]
        for clipped in (None, torch.ones_like(batch.image))
    ]
    assert cost[0] == cost[1] > 0.01
