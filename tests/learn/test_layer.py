"""The layer's door: what it takes, what it refuses, and that pixels, segments and images find their
own materials.
"""

import re

import pytest
import torch

from learn import methods
from learn.layer import RenderLayer, render


def test_segments_give_each_pixel_its_own_material(draw):
    scene = draw(30, images=2)
    other = draw(31, images=2)["material"]
    segments = torch.tensor([[1, 2, 0], [2, 1, 1], [0, 2, 2]]).expand(2, 3, 3)
    mixed = render(
        scene["n"], torch.stack([scene["material"], other], 1), scene["light"], segments=segments
    )
    first = render(scene["n"], scene["material"], scene["light"])
    second = render(scene["n"], other, scene["light"])
    expected = torch.where(
        (segments == 1)[..., None], first, torch.where((segments == 2)[..., None], second, 0.0)
    )
    torch.testing.assert_close(mixed, expected, rtol=1e-13, atol=0)


def test_the_module_is_the_function(draw):
    scene = draw(32)
    torch.testing.assert_close(
        RenderLayer(method="exact")(**scene), render(**scene, method="exact"), rtol=0, atol=0
    )


def test_elevation_turns_the_light_into_the_camera_frame(draw):
    """The light's zenith seen by a camera above: with elevation π/2 the zenith texels are behind
    the viewer.
    """
    scene = draw(33, light=(16, 32))
    n = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).reshape(1, 1, 1, 3)
    zenith = torch.zeros_like(scene["light"])
    zenith[:, 0] = 1.0
    straight = render(n, scene["material"], zenith, elevation=torch.pi / 2)
    level = render(n, scene["material"], zenith, elevation=0.0)
    assert (straight > 3 * level).all()


@pytest.mark.parametrize("name", methods.NAMES)
def test_every_method_carries_its_card(name):
    module = methods.load(name)
    assert module.CARD.name == name and callable(module.radiance)


REFUSALS = {
    "n: expected shape (B, H, W, 3), found (3, 3, 3)": {"n": lambda s: s["n"][0]},
    "n: expected unit vectors inside the mask (length 1 ± 0.01), found 2 (9 of 9 values)": {
        "n": lambda s: 2 * s["n"]
    },
    "n: expected unit vectors inside the mask (length 1 ± 0.01), found nan": {
        "n": lambda s: s["n"] * torch.nan
    },
    "n: expected a torch tensor, found ndarray": {"n": lambda s: s["n"].numpy()},
    "n: expected a floating dtype, found torch.int64": {"n": lambda s: s["n"].long()},
    "view: expected unit vectors inside the mask": {"view": lambda s: 0.5 * s["view"]},
    "view: expected the shape of n, (1, 3, 3, 3)": {"view": lambda s: s["view"][:, :2]},
    "light: expected finite radiance ≥ 0, found -1 (1 of 96 values)": {
        "light": lambda s: negative(s["light"])
    },
    "light: expected finite radiance ≥ 0, found inf": {"light": lambda s: s["light"] / 0},
    "light: expected shape (1, Hl, Wl, 3), found (4, 8, 3)": {"light": lambda s: s["light"][0]},
    "light: expected the dtype of n, torch.float64, found torch.float32": {
        "light": lambda s: s["light"].float()
    },
    "light: expected the device of n, cpu, found meta": {"light": lambda s: s["light"].to("meta")},
    "material: expected finite κ ≥ 0 (control values, not logarithms), found -": {
        "material": lambda s: s["material"].log()
    },
    "material: expected finite γ > 0 (control values, not logarithms), found 0": {
        "material": lambda s: 0 * s["material"]
    },
    "material: expected shape (1, 108), or (1, S, 108) with segments, found (1, 107)": {
        "material": lambda s: s["material"][:, 1:]
    },
    "segments: expected ids (B, H, W) for the 2 materials of each image, found None": {
        "material": lambda s: s["material"].expand(1, 2, 108)
    },
    "segments: expected ids 0 (background) … 1 (the materials given), found 2 … 2": {
        "segments": lambda s: torch.full((1, 3, 3), 2)
    },
    "segments: expected an integer dtype, found torch.float32": {
        "segments": lambda s: torch.ones(1, 3, 3)
    },
    "segments: expected shape (1, 3, 3)": {
        "segments": lambda s: torch.ones(3, 3, dtype=torch.long)
    },
    "mask: expected dtype torch.bool, found torch.int64": {
        "mask": lambda s: torch.ones(1, 3, 3, dtype=torch.long)
    },
    "mask: expected shape (1, 3, 3)": {"mask": lambda s: torch.ones(3, 3, dtype=torch.bool)},
    "tolerance: expected a positive number, found 0": {"tolerance": lambda s: 0},
    "elevation: expected radians in [-π/2, π/2], found 20": {"elevation": lambda s: 20},
    "method: expected one of auto, exact": {"method": lambda s: "exakt"},
}


def negative(light):
    light = light.clone()
    light[0, 0, 0, 0] = -1
    return light


@pytest.mark.parametrize("message", REFUSALS)
def test_bad_input_is_refused_in_one_line(draw, message):
    scene = draw(34)
    wrong = {key: make(scene) for key, make in REFUSALS[message].items()}
    with pytest.raises(ValueError, match=re.escape(message)):
        render(**(scene | wrong))
