"""Painted objects: what paint does to a picture, and the tables of edits by paint and method."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from learn.experiments.photographs import painted_photographs, painted_tables, painting
from learn.experiments.photographs.painted_photographs import BEFORE, IN_USE, METHODS, PREDICTED
from learn.experiments.photographs.painting import COLOUR, KINDS, LABEL, NONE, PRINT
from learn.experiments.photographs.photographed_fit import SCALES

SIZE = 48


def lobes(*of):
    """A label (108,) of lobes (κ, γ), wide ones first; the others reflect nothing."""
    label = np.full((3, 3, 2, 6), -12.0, np.float32)
    for k, values in enumerate(of):
        label[:, k] = np.log(values)[:, None]
    return label.reshape(-1)


MATTE, LACQUER, METAL = lobes((0.1, 0.02)), lobes((0.1, 0.02), (0.5, 400.0)), lobes((2.0, 900.0))


@pytest.fixture
def ball(rng):
    """Make a sample of a ball that fills two thirds of the picture, in a material."""
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j] * 1.5
    z = 1 - x * x - y * y
    inside = z > 0
    n = np.stack([x, y, np.sqrt(np.maximum(z, 0))], -1) * inside[..., None]
    radiance = rng.uniform(0.1, 1, (SIZE, SIZE, 3)) * inside[..., None]
    light = np.ones((64, 128, 3), np.float32)
    light[10:20, 30:50] = 30.0

    def sample(label):
        return SimpleNamespace(
            image=torch.from_numpy(radiance.astype(np.float32)),
            n=torch.from_numpy(n.astype(np.float32)),
            mask=torch.from_numpy(inside),
            label=torch.from_numpy(label)[None],
            light=torch.from_numpy(light),
            elevation=0.35,
        )

    return sample


def factors(kind, sample, name="a"):
    """What paint multiplies the radiance of the ball's pixels (P, 3) by."""
    painted, inside = painting.painted(kind, sample, name), sample.mask.numpy()
    assert np.array_equal(painted[~inside], sample.image.numpy()[~inside])
    return painted[inside] / sample.image.numpy()[inside]


def test_an_object_without_paint_is_as_it_was(ball):
    assert (factors(NONE, ball(MATTE)) == 1).all()


@pytest.mark.parametrize("label", [MATTE, METAL])
@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_one_colour_is_the_same_everywhere_and_strong(ball, name, label):
    of = factors(COLOUR, ball(label), name)
    assert of == pytest.approx(np.broadcast_to(of[0], of.shape), rel=1e-3)
    assert of.max() <= 1 + 1e-6 and of[0].max() / of[0].min() > 2
    assert of[0] != pytest.approx(factors(COLOUR, ball(label), f"not {name}")[0], rel=0.01)


def test_highlights_of_lacquer_keep_their_colour(ball):
    share = painting.matte_share(ball(LACQUER))[ball(LACQUER).mask.numpy()]
    assert share.min() < 0.7 < 0.9 < share.max() <= 1
    dye = factors(COLOUR, ball(MATTE))[0]
    assert factors(COLOUR, ball(LACQUER)) == pytest.approx(1 + share * (dye - 1), rel=1e-3)


@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_a_print_leaves_bare_pixels_and_darkens_others(ball, name):
    of = factors(PRINT, ball(MATTE), name)
    bare = (of > 0.999).all(-1).mean()
    assert 0.1 < bare < 0.99 and of.max() <= 1 + 1e-6
    assert of == pytest.approx(factors(PRINT, ball(MATTE), name))


@pytest.mark.parametrize("name", ["a", "b", "c"])
@pytest.mark.parametrize("label", [MATTE, METAL])
def test_a_label_is_without_colour_and_has_black_bars_on_an_object_of_one_colour(ball, name, label):
    of, plain = factors(LABEL, ball(label), name), factors(COLOUR, ball(label), name)
    coloured = np.isclose(of, plain, rtol=1e-3).all(-1)
    grey = np.isclose(of, of[:, :1], rtol=1e-3).all(-1) & ~coloured
    assert (coloured | grey).all() and 0.01 < grey.mean() < 0.3
    brightness = of[grey].mean(-1)
    assert {round(float(v), 2) for v in brightness} == {1.0, painting.BLACK}


def report_of(l2):
    """A report of three photographs, two edits each; L2 is l2[paint, method], a stop too bright."""
    at = SCALES.index(0.0)
    rows = []
    for photograph in "abc":
        for paint in KINDS:
            for method in METHODS:
                figures = [float(l2[paint, method]) + 100 * abs(k - at + 4) for k in range(33)]
                edit = {"l2": figures, "stops": 1.0, "green": 0.5, "red_blue": -0.5}
                edits = [edit | {"target": target} for target in ("brass", "felt")]
                about = {"shape": photograph, "light": "city", "group": "own"}
                row = about | {"photograph": photograph, "paint": paint, "method": method}
                rows.append(row | {"edits": edits})
    return {"rows": rows, "weights": "w", "seen": []}


def test_tables_have_the_figures_of_each_paint_and_method_and_their_ratios():
    l2 = {(paint, method): 200.0 for paint in KINDS for method in METHODS}
    l2[COLOUR, IN_USE], l2[COLOUR, BEFORE] = 100.0, 900.0
    report = report_of(l2)
    edits = painted_tables.edits_of(report)
    assert {key: len(of) for key, of in edits.items()} == dict.fromkeys(l2, 6)
    assert {edit["as_bright"] for edit in edits[COLOUR, IN_USE]} == {100.0}
    assert {edit["l2"] for edit in edits[COLOUR, IN_USE]} == {500.0}  # a stop is four of SCALES
    page = painted_tables.page(report)
    assert f"| {COLOUR} | {IN_USE} | 500 [500, 500] | 100 [100, 100] | 1.00 | 0.50 | 0.50 |" in page
    ratio = "0.38 [0.38, 0.38] | 0.11 [0.11, 0.11] | 6 of 6"
    assert f"| {COLOUR} | {IN_USE} ÷ {BEFORE} | {ratio} |" in page
    assert (
        f"| {PRINT} | {IN_USE} ÷ {PREDICTED} | 1.00 [1.00, 1.00] | 1.00 [1.00, 1.00] | 0 of 6"
        in page
    )


def test_a_photograph_that_one_method_cannot_edit_is_left_out_for_all():
    report = report_of({(paint, method): 200.0 for paint in KINDS for method in METHODS})
    refused = next(r for r in report["rows"] if (r["paint"], r["method"]) == (PRINT, BEFORE))
    refused["edits"], refused["refused"] = [], "the object is black"
    edits = painted_tables.edits_of(report)
    assert {len(edits[PRINT, method]) for method in METHODS} == {4}
    assert len(edits[COLOUR, BEFORE]) == 6
    assert "decompositions that were refused: 1." in painted_tables.page(report)


def test_methods_differ_in_refinement_as_their_names_say():
    of = {method: painted_photographs.settings_of(method) for method in METHODS}
    assert of[PREDICTED] is None
    assert (of[BEFORE].b_colour, of[BEFORE].unexplained_share_at_half_weight) == (0, None)
    assert of[painted_photographs.LIGHT_HELD].unexplained_share_at_half_weight is None
    assert of[painted_photographs.LIGHT_HELD].b_colour == of[IN_USE].b_colour > 0
