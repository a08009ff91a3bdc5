"""Refinement's energy term by term, by hand; its coordinates' bounds; and that the defaults are
those that docs/refinement.md tells.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from scipy.optimize import OptimizeResult, minimize

from learn.data.batch import ExampleBatch
from learn.layer import predictions, render
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings, coordinates, descent, refine
from learn.refinement.coordinates import LightCoordinates, NormalCoordinates
from learn.refinement.energy import (
    DARK,
    FAINT,
    LABEL_RADIUS,
    Energy,
    explained_weights,
    label_weights,
    raise_mirror_weights,
)
from learn.refinement.settings import NAMED, PHOTOGRAPHS, Level
from manifests.materials import load_catalogue
from shaders import envmap
from tests.support.flat_plane import SIZE, flat

LEVEL = Level(pixels=0, light=(16, 32), method="exact", rounds=1, iterations=4)
QUICK = replace(RefinementSettings(), levels=(LEVEL,), outer_iterations=1)
# standard deviation of z at which many changes of log light, and most of normals, are at their
# bounds
WILD = 3.0


def luminance(light):
    """Mean over the sphere, of a map (1, 3, H, W)."""
    return envmap.mean_radiance(light[0].movedim(0, -1).numpy()) @ envmap.LUMINANCE


def disk(n):
    return n[:, :2] / (1 + n[:, 2:])


@pytest.fixture
def dome():
    """A batch and its truth: a dome that leans 50° at its corners, in blue rubber under a light
    with a bright side.
    """
    x, y = torch.meshgrid(*[torch.linspace(-0.54, 0.54, SIZE)] * 2, indexing="xy")
    n = torch.stack([x, -y, (1 - x * x - y * y).sqrt()])[None]
    label = torch.from_numpy(
        load_catalogue()["blue-rubber"].label.reshape(1, 1, 108).astype(np.float32)
    )
    light = np.exp(1.2 * envmap.directions(64, 128)[0][..., :1]) * [1.1, 1.0, 0.8]
    light = torch.from_numpy(envmap.unit_mean(light)[0]).movedim(-1, 0)[None]
    inside = torch.ones(1, SIZE, SIZE, dtype=torch.bool)
    picture = render(
        n.movedim(1, -1).contiguous(),
        label[:, 0].exp(),
        light.movedim(1, -1).contiguous(),
        mask=inside,
        method="exact",
    )
    image = picture.movedim(-1, 1).contiguous()
    batch = ExampleBatch(
        image, inside[:, None].float(), n, inside.long(), label, light, label, ("dome",), 0.349
    )
    return batch, Prediction(n, None, label, None, light)


def test_the_energy_of_a_displaced_state_is_what_it_is_by_hand(monkeypatch):
    batch, start = flat()
    n, light = start.n.clone(), start.light.clone()
    n[0, :, 3, 5] = torch.tensor([0.6, 0.0, 0.8])
    light[:, :2, :32] = math.e**2 - 1
    moved = replace(start, n=n, light=light, z={"material": torch.tensor([[1.0, 2.0, 2.0]])})
    # 2 where n moved, else 1
    monkeypatch.setattr(
        predictions, "render", lambda n, *_, **__: (1 + n[..., :1] / 0.6).expand(n.shape)
    )
    pixels = SIZE * (SIZE - 1)
    expected = {
        "image": (math.log(17 / 9) / math.log(9)) ** 2 / pixels,
        "normals": (0.6**2 + 0.2**2) / pixels,
        "light": 2 / 6,  # 1 in two channels of three, half of the sphere
        # twice 1/3 and once −2/3 of it beyond the mean of the channels, half of the sphere
        "colour": math.log((FAINT + math.e**2 - 1) / (FAINT + math.e - 1)) ** 2 / 9,
        "material": 3.0,
    }
    expected["total"] = (
        expected["image"]
        + 2 * expected["normals"]
        + 3 * expected["light"]
        + 7 * expected["colour"]
        + 5 * expected["material"]
    )
    settings = replace(RefinementSettings(), a=2.0, b=3.0, b_colour=7.0, c=5.0)
    result = Energy(batch, start, settings).terms_of_all_pixels(moved)
    assert result == pytest.approx(expected, rel=1e-5)  # float32


def test_a_pixel_counts_less_the_less_its_regions_colour_and_white_explain_it():
    half = 0.1
    red, blue = torch.tensor([0.8, 0.2, 0.2]), torch.tensor([0.1, 0.1, 0.7])
    strange = F.normalize(torch.linalg.cross(red, torch.ones(3)), dim=0)
    off = red + half * (red.norm() + DARK) / (1 - half**2) ** 0.5 * strange
    share = half * (red.norm() + DARK) / (1 - half**2) ** 0.5 / (off.norm() + DARK)
    image = torch.stack([red, red, 0.3 * red, red + 0.4, off, blue, blue, blue, red])
    regions = torch.tensor([1, 1, 1, 1, 1, 2, 2, 2, 2])
    weights = explained_weights(image, regions, half).numpy()
    assert weights[:4] == pytest.approx(1) and weights[5:8] == pytest.approx(1)
    assert weights[4] == pytest.approx(float(1 / (1 + (share / half) ** 2)), rel=1e-4)
    assert weights[4] == pytest.approx(0.5, abs=0.01) and weights[8] < 0.05
    alike = explained_weights(image, torch.ones(9, dtype=torch.long), half).numpy()
    assert (alike[5:8] < 0.05).all() and alike[8] > 0.5  # of one region, about red
    grey = explained_weights(torch.full((5, 3), 0.4) + 0.01 * torch.eye(5, 3), torch.ones(5), half)
    assert (grey > 0.95).all()


def labelled(size=24):
    """A terracotta square with a white label that has black bars: image, segments, place."""
    image = torch.tensor([0.36, 0.16, 0.09]).repeat(size, size, 1)
    image[3:6, 3:6] += 0.04  # dust
    place = (slice(10, 20), slice(10, 20))
    image[place] = 0.7
    image[12:18, 12:18:2] = 0.01
    return image, torch.ones(size, size, dtype=torch.long), place


def test_a_label_counts_nothing_with_its_letters_and_its_edge_and_dust_counts_whole():
    image, segments, place = labelled()
    weights = label_weights(image, segments, None, 2)
    assert weights[place].max() < 0.02 and weights[9, 9:21].max() < 0.02
    away = torch.ones_like(segments, dtype=torch.bool)
    away[9:21, 9:21] = False
    assert weights[away].min() > 0.98


def test_a_white_patch_is_a_highlight_where_the_file_clips_it():
    image, segments, _ = labelled()
    image[10:20, 10:20] = 0.7
    clipped = torch.zeros(image.shape[:2])
    clipped[12:18, 12:18] = 1  # its edge is not white in the file
    assert label_weights(image, segments, clipped, 2).min() > 0.98
    assert label_weights(image, segments, None, 2).min() < 0.02


def test_a_label_of_one_region_is_not_judged_by_anothers_colour():
    image, segments, place = labelled()
    segments[place] = 2
    image[place] = torch.tensor([0.1, 0.3, 0.7])
    assert label_weights(image, segments, None, 2).min() > 0.98
    assert label_weights(image, segments.clamp(max=1), None, 2)[place].max() < 0.02


def test_an_object_of_many_colours_has_no_label():
    colours = torch.from_numpy(np.random.default_rng(0).uniform(0.1, 0.9, (6, 6, 3)))
    image = colours.repeat_interleave(5, 0).repeat_interleave(5, 1).float()
    segments = torch.ones(image.shape[:2], dtype=torch.long)
    assert (label_weights(image, segments, None, 2) == 1).all()


def test_a_highlight_beside_a_label_counts_whole():
    image, segments, _ = labelled()
    image[9, 10:20] = 1.0  # at the label's upper edge
    clipped = torch.zeros(image.shape[:2])
    clipped[9, 10:20] = 1
    weights = label_weights(image, segments, clipped, 2)
    assert weights[:12].min() > 0.98 and weights[13:20, 10:20].max() < 0.02


def test_many_colours_of_one_region_leave_anothers_label_a_label():
    image, segments, place = labelled()
    colours = torch.from_numpy(np.random.default_rng(0).uniform(0.1, 0.9, (2, 8, 3))).float()
    image[:6] = colours.repeat_interleave(3, 0).repeat_interleave(3, 1)
    segments[:6] = 2
    weights = label_weights(image, segments, None, 2)
    assert (weights[:6] == 1).all() and weights[place].max() < 0.02


BLUE = torch.tensor([0.1, 0.3, 0.9])


def energy_weights(image, segments, clipped=None):
    """Weights (P,) that refinement gives the object's pixels, those with segments (H, W) > 0."""
    batch, start = flat()
    matte = torch.zeros(1, int(segments.max()), 3, 3, 2, 6, dtype=torch.float64)
    matte[..., 0, :], matte[..., 1, :] = math.log(0.1), math.log(0.5)
    shown = replace(
        batch,
        image=image.movedim(-1, 0)[None],
        mask=(segments > 0)[None, None].float(),
        segments=segments[None],
        clipped=None if clipped is None else clipped.movedim(-1, 0)[None],
    )
    return Energy(shown, replace(start, label=matte.flatten(2)), PHOTOGRAPHS).weights


def test_refinement_takes_no_label_from_beyond_the_object_nor_from_another_region():
    image, segments, _ = labelled()
    image[10:20, 10:20] = image[0, 0]
    image[:, :6] = BLUE
    beyond, other = segments.clone(), segments.clone()
    beyond[:, :6], other[:, :6] = 0, 2
    assert energy_weights(image, beyond).min() > 0.95
    assert energy_weights(image, other).min() > 0.95
    assert energy_weights(image, segments).min() < 0.05


def test_refinement_takes_no_highlight_of_which_one_channel_is_clipped_for_a_label():
    image, segments, place = labelled()
    image[place] = BLUE
    clipped = torch.zeros_like(image)
    clipped[(*place, 2)] = 1
    assert energy_weights(image, segments, clipped).min() > 0.95
    assert energy_weights(image, segments).min() < 0.05


def test_labels_of_a_dark_picture_are_those_of_a_bright_one():
    image, segments, _ = labelled()
    bright = energy_weights(image, segments)
    assert bright.min() < 0.1
    torch.testing.assert_close(energy_weights(1e-3 * image, segments), bright, rtol=1e-3, atol=1e-4)


def test_a_label_counts_less_in_the_misfit_of_refinement(monkeypatch):
    batch, start = flat()
    image = batch.image.clone()
    image[0] = torch.tensor([0.4, 0.2, 0.1])[:, None, None]
    image[0, :, 1, 1] = 0.9
    monkeypatch.setattr(predictions, "render", lambda n, *_, **__: torch.ones(n.shape))
    label = torch.zeros(1, 1, 3, 3, 2, 6, dtype=torch.float64)
    label[..., 0, :], label[..., 1, :] = math.log(0.1), math.log(0.5)
    start = replace(start, label=label.reshape(1, 1, 108))
    energy = Energy(replace(batch, image=image), start, PHOTOGRAPHS)
    on = torch.zeros(batch.mask.shape[-2:], dtype=torch.bool)
    on[1, 1] = True
    assert energy.weights[on.flatten()[energy.inside]].max() < 0.15
    assert energy.weights[~on.flatten()[energy.inside]].max() > 0.9


def test_what_a_material_mirrors_counts_whole_whatever_its_colour():
    matte, mirror = np.zeros((3, 3, 2, 6)), np.zeros((3, 3, 2, 6))
    matte[:, :, 1], mirror[:, :, 1] = math.log(0.5), math.log(3000)
    labels = np.stack([matte.reshape(108), mirror.reshape(108)]).astype(np.float32)
    weights = raise_mirror_weights(
        torch.tensor([0.2, 0.2, 1.0]), torch.tensor([1, 2, 1]), labels
    ).numpy()
    assert 0.2 <= weights[0] < 0.3 and weights[1] > 0.95 and weights[2] == 1


def test_clipped_pixels_are_no_print_and_say_nothing_of_the_objects_colour():
    orange = torch.tensor([1.0, 0.45, 0.08])
    image = torch.stack([0.5 * orange, 0.6 * orange, *[(2 * orange).clamp(max=1)] * 5])
    regions, clipped = torch.ones(7, dtype=torch.long), torch.tensor([0.0, 0.0] + 5 * [1.0])
    assert explained_weights(image, regions, 0.1, clipped).numpy() == pytest.approx(1, abs=1e-3)
    assert (explained_weights(image, regions, 0.1)[:2] < 0.5).all()  # as if not known to be clipped
    partly = explained_weights(image[1:3], regions[:2], 0.1, torch.tensor([0.0, 0.5]))
    whole = explained_weights(image[1:3], regions[:2], 0.1, torch.tensor([0.0, 1e-9]))
    assert float(partly[1]) == pytest.approx(0.5 + float(whole[1]) / 2, rel=1e-4)


def test_the_side_of_a_grey_object_in_another_light_counts_as_little_as_the_documentation_says(
    root,
):
    lamplight, daylight = torch.tensor([0.5, 0.42, 0.33]), torch.tensor([0.3, 0.36, 0.45])
    image = torch.cat([lamplight.expand(60, 3), daylight.expand(40, 3)])
    labels = label_weights(image.reshape(10, 10, 3), torch.ones(10, 10), None, LABEL_RADIUS)
    weights = torch.minimum(explained_weights(image, torch.ones(100), 0.1), labels.flatten())
    report = (root / "docs" / "refinement.md").read_text(encoding="utf-8")
    assert (
        f"grey object in lamplight and daylight, it has a weight of {float(weights[-1]):.2f}."
        in report
    )
    assert float(weights[0]) == pytest.approx(1)


def test_grey_and_black_regions_count_whole():
    image = torch.cat([torch.full((4, 3), 0.4), torch.zeros(4, 3)])
    regions = torch.tensor([1] * 4 + [2] * 4)
    assert explained_weights(image, regions, 0.1).numpy() == pytest.approx(1)


@pytest.mark.parametrize(("gamma", "least", "most"), [(0.5, 0.0, 0.15), (3000.0, 0.95, 1.0)])
def test_a_print_counts_less_in_the_misfit_the_more_matte_the_material_is(
    monkeypatch, gamma, least, most
):
    batch, start = flat()
    image = batch.image.clone()
    image[0, 2, 5] = 0.1  # a yellow row of eight
    label = torch.zeros(1, 1, 3, 3, 2, 6, dtype=torch.float64)
    label[..., 0, :], label[..., 1, :] = math.log(0.1), math.log(gamma)
    start = replace(start, label=label.reshape(1, 1, 108))
    monkeypatch.setattr(predictions, "render", lambda n, *_, **__: torch.ones(n.shape))
    # its row is a label too, whatever the half
    no_label = "learn.refinement.energy.label_weights"
    monkeypatch.setattr(no_label, lambda picture, *_: torch.ones(picture.shape[:2]))

    def misfit(half):
        settings = replace(RefinementSettings(), unexplained_share_at_half_weight=half)
        energy = Energy(replace(batch, image=image), start, settings)
        terms = energy.terms(start, energy.inside)
        some = energy.terms(start, energy.inside[8 * 4 :])  # the yellow row and two others
        assert float(some["image"]) == pytest.approx(float(terms["image"]) * 7 / 3, rel=1e-5)
        return float(terms["image"])

    assert least < misfit(0.1) / misfit(None) < most
    assert misfit(1e6) == pytest.approx(misfit(None), rel=1e-5)


@pytest.mark.parametrize("row", [0, 31, 63])
def test_a_row_of_light_counts_by_its_share_of_the_sphere(row):
    batch, start = flat()
    light = start.light.clone()
    light[:, :, row] = math.e**2 - 1
    report = Energy(batch, start, RefinementSettings())
    result = report.terms(replace(start, light=light), report.pixels(1), (2, 4), "exact")["light"]
    share = (math.cos(math.pi * row / 64) - math.cos(math.pi * (row + 1) / 64)) / 2
    assert float(result) == pytest.approx(share, rel=1e-4)  # float32


def test_a_step_that_raises_the_energy_is_taken_back_and_the_one_before_it_stays(dome, monkeypatch):
    batch, truth = dome
    calls = []

    def good_then_bad(value_and_slope, x, **options):
        calls.append(len(x))
        return (
            minimize(value_and_slope, x, **options)
            if len(calls) == 1
            else OptimizeResult(x=x + 0.1)
        )

    monkeypatch.setattr(descent, "minimize", good_then_bad)
    start = truth._replace(label=truth.label + 0.3)
    result = refine(batch, start, replace(QUICK, order=("material", "light"), b=0.02, c=0.0))
    good, bad = result.history
    assert [good["accepted"], bad["accepted"]] == [True, False]
    assert good["total"] == result.after["total"] < result.before["total"]
    # so the start alone would not have turned it back
    assert good["total"] < bad["total"] < result.before["total"]
    assert result.after["light"] == result.before["light"]


@pytest.mark.parametrize("seed", range(3))
def test_light_has_unit_mean_luminance_wherever_its_coordinates_lie(dome, seed):
    light = LightCoordinates(dome[1].light, 8)
    z = WILD * torch.randn(
        light.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    assert luminance(light(z)) == pytest.approx(1, abs=1e-5)
    z[1:] = 0  # brightness as a whole
    assert luminance(light(z)) == pytest.approx(1, abs=1e-5)


def test_refined_light_has_unit_mean_luminance(dome):
    batch, truth = dome
    result = refine(
        batch,
        truth._replace(label=truth.label - 0.3, light=truth.light.flip(-1)),
        replace(QUICK, order=("light",), b=0.0),
    )
    assert result.history[0]["accepted"]
    assert luminance(result.prediction.light) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_normals_stay_within_reach_wherever_their_coordinates_lie(dome, seed):
    batch, truth = dome
    normals = NormalCoordinates(truth.n, batch.segments > 0, 0.1)
    z = WILD * torch.randn(
        normals.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    moved = (disk(normals(z)) - disk(truth.n)).abs()
    assert 0.099 < moved.max() < 0.1 + 1e-6  # float32; along either axis of the disk


def test_refined_normals_stay_within_reach(dome):
    batch, truth = dome
    start = F.normalize(truth.n + torch.tensor([0.3, 0.0, 0.0])[:, None, None], dim=1)
    result = refine(
        batch, truth._replace(n=start), replace(QUICK, order=("normals",), trust_region=0.01, a=0.0)
    )
    assert result.history[0]["accepted"]
    assert (disk(result.prediction.n) - disk(start)).abs().max() < 0.01 + 1e-6  # float32


def test_directions_of_the_materials_know_the_training_ones_alone(monkeypatch, rng):
    known = {
        f"m{i}": SimpleNamespace(label=rng.standard_normal((3, 3, 2, 6)), split="train")
        for i in range(4)
    }
    outlying = {
        split: SimpleNamespace(label=50 * rng.standard_normal((3, 3, 2, 6)), split=split)
        for split in ("train", "test")
    }

    def directions(materials):
        monkeypatch.setattr(coordinates, "load_catalogue", lambda: materials)
        return coordinates._built_in_directions.__wrapped__()  # past the cache

    assert np.array_equal(directions(known | {"x": outlying["test"]}), directions(known))
    assert np.linalg.norm(directions(known | {"x": outlying["train"]})) > 5 * np.linalg.norm(
        directions(known)
    )


def test_defaults_are_those_that_the_documentation_tells(root):
    report, s, paper = (
        " ".join((root / "docs" / "refinement.md").read_text(encoding="utf-8").split()),
        RefinementSettings(),
        NAMED["paper"],
    )
    assert f"a = {s.a:g}, b = {s.b:g}, c = {s.c:g} and the passes were chosen" in report
    photographs = f"`b_colour` = {PHOTOGRAPHS.b_colour:g} and `unexplained_share_at_half_weight` ="
    assert f"{photographs} {PHOTOGRAPHS.unexplained_share_at_half_weight:g}" in report
    assert (s.b_colour, s.unexplained_share_at_half_weight) == (0, None)
    assert f"The paper's a = {paper.a:g}, b = {paper.b:g} hold the light still" in report
    assert f"paper: a = {paper.a:g}, b = {paper.b:g}, c = {paper.c:g}" in report
    assert f"spherical harmonics up to degree {s.degree}," in report
    assert f"each held within {s.trust_region:g} of where its pass began" in report
    assert f"| 1 | {', then '.join(s.order)}, one at a time |" in report
    assert f"under the whole map, rendered to {100 * s.tolerance:g} %" in report
    assert s.outer_iterations == 2 and "in one pass and evaluations in two" in report


def test_the_way_down_begins_under_few_lights_and_ends_under_all(root):
    report = " ".join((root / "docs" / "refinement.md").read_text(encoding="utf-8").split())
    first, last = RefinementSettings().levels
    assert (first.pixels, last.pixels) == (
        0,
        0,
    ) and "steps of L-BFGS, at all pixels of the object" in report
    for line in (
        "one at a time | reduced to 32 × 64 |",
        "| 2 | all three together | reduced to 32 × 64 |",
        "| 3 | all three together | whole, 64 × 128 |",
    ):
        assert line in report
    assert (first.light, last.light) == ((32, 64), (64, 128))
    assert first.rounds == 1 and first.iterations and first.joint_iterations
    assert last.rounds == 0 and last.joint_iterations
    assert all(
        level.method == "auto" and f"keeps an error of {100 * level.tolerance:g} %" in report
        for level in (first, last)
    )
