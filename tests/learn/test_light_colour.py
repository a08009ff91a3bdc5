"""The green of a predicted light goes into the material that was read."""

import numpy as np
import pytest
import torch

from learn.editing import light_colour
from learn.editing.decomposition import Parts
from learn.layer import predictions
from shaders import envmap
from shaders.dsbrdf import SHAPE
from shaders.tone import LUMINANCE
from tests.support.known_ball import label_of


def parts(name: str, tint: tuple[float, float, float]) -> Parts:
    rng = np.random.default_rng(0)
    L = rng.uniform(0.2, 2.0, (64, 128, 3)) * np.array(tint)
    n = torch.zeros(1, 3, 8, 8)
    n[:, 2] = 1
    light = torch.from_numpy(L.astype(np.float32)).movedim(-1, 0)[None].contiguous()
    return Parts(n, torch.from_numpy(label_of(name))[None].float(), light)


def mean(light: torch.Tensor) -> np.ndarray:
    return envmap.mean_radiance(light[0].movedim(0, -1).numpy())


def rendered(of: Parts) -> np.ndarray:
    segments = torch.ones(1, 8, 8, dtype=torch.long)
    return predictions.picture(of.n, of.label, of.light, segments, 0.35)[0].numpy()


def test_green_is_stops_above_the_mean_of_red_and_blue() -> None:
    assert light_colour.green_of(np.array([1.0, 1.0, 1.0])) == 0
    assert light_colour.green_of(np.array([0.5, 2.0, 2.0])) == pytest.approx(1)
    # a black body's colour has none of it
    assert light_colour.green_of(np.array([4.0, 2.0, 1.0])) == pytest.approx(0)


@pytest.mark.parametrize("tint", [(1, 1.5, 0.8), (1.2, 0.7, 1.3)])
def test_the_light_keeps_its_luminance_and_its_red_over_blue(tint) -> None:
    before = parts("blue-rubber", tint)
    after = light_colour.remove_green(before)
    was, now = mean(before.light), mean(after.light)
    assert abs(light_colour.green_of(was)) > 0.2
    assert light_colour.green_of(now) == pytest.approx(0, abs=1e-5)
    assert now @ LUMINANCE == pytest.approx(was @ LUMINANCE, rel=1e-5)
    assert now[0] / now[2] == pytest.approx(was[0] / was[2], rel=1e-5)
    assert torch.equal(after.n, before.n)


@pytest.mark.parametrize(("name", "exact"), [("blue-rubber", 0.005), ("gold-paint", 0.05)])
def test_the_object_looks_as_before_in_its_own_material(name, exact) -> None:
    before = parts(name, (1, 1.5, 0.8))
    after = light_colour.remove_green(before)
    np.testing.assert_allclose(rendered(after), rendered(before), rtol=exact)
    # in another material it has lost the cast
    other = torch.from_numpy(label_of("white-paint"))[None].float()
    colours = [rendered(of._replace(label=other)).mean((0, 1)) for of in (before, after)]
    green = [light_colour.green_of(colour) for colour in colours]
    assert green[0] - green[1] == pytest.approx(light_colour.green_of(mean(before.light)), abs=0.01)


def test_lobes_that_reflect_nothing_stay_so_and_numbers_stay_finite() -> None:
    before = parts("brass", (1, 1.5, 0.8))
    label = before.label.reshape(1, 1, *SHAPE).clone()
    label[..., 2, 0, :] = -60.0
    label[..., 0, 0, :] = 4.4
    after = light_colour.remove_green(before._replace(label=label.reshape(1, 1, -1)))
    assert after.label.isfinite().all()
    nothing = after.label.reshape(1, 1, *SHAPE)[..., 2, 0, :]
    assert (abs(nothing + 60) < 1).all()


def test_of_a_coloured_lamp_one_stop_is_taken_back() -> None:
    before = parts("blue-rubber", (0.05, 1.0, 0.05))
    green = [
        light_colour.green_of(mean(of.light)) for of in (before, light_colour.remove_green(before))
    ]
    assert green[0] - green[1] == pytest.approx(light_colour.MOST, abs=1e-4)


def test_a_light_without_a_channel_is_left_alone() -> None:
    before = parts("brass", (1, 0, 1))
    assert light_colour.remove_green(before) is before
