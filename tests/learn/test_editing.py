"""Edits: the photograph's own size, its background untouched, regions apart, and with true parts
the photograph itself.
"""

import json
from dataclasses import replace
from itertools import chain
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch
from PIL import Image

from learn.__main__ import COMMANDS
from learn.data import framing
from learn.data.records import Records
from learn.editing import (
    compositor,
    decomposition,
    drawing,
    edit,
    photograph,
    region_masks,
    targets,
    transfer_grids,
)
from learn.editing.compositor import Compositor
from learn.figures import spheres
from learn.layer.display_method import method_for
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.paper import Paper
from learn.networks.prediction import Prediction
from learn.networks.separate import Separate
from manifests.cli import main
from manifests.materials import load_catalogue
from shaders import tone
from tests.support.known_ball import NETWORK, SIZE, Knowing, ball, label_of, lit, opened
from tests.support.synthetic import entry, matte, write_dataset


@pytest.mark.parametrize("balance", [(1, 1, 1), (1.4, 1.0, 0.7)])
def test_with_true_parts_an_edit_into_its_own_material_is_the_photograph(balance):
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    seen = radiance / np.array(balance, np.float32)  # as a camera out of balance would have it
    result = decomposition.decompose(
        opened(seen, inside.astype(np.int64), 2.0, balance), Knowing(label), NETWORK
    )
    again = Compositor(result).edit([label[0]])
    core = ball(SIZE, 30)[0][..., 2] > 0.4  # at the rim 64² normals, enlarged, are a pixel off
    level = tone.auto_exposure(seen, inside)
    # of 65,025; the picture itself has a variance of a thousand
    assert tone.display_l2(again, seen, level, core) < 15
    assert tone.display_l2(again * 1.25, seen, level, core) > 60  # what a slip of scale would give


def test_an_edit_keeps_size_and_background():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    tall = np.pad(radiance, ((7, 20), (0, 31), (0, 0)), constant_values=0.3)
    regions = np.pad(inside.astype(np.int64), ((7, 20), (0, 31)))
    edited = Compositor(
        decomposition.decompose(opened(tall, regions), Knowing(label), NETWORK)
    ).edit([label_of("gold-paint")[0]])
    assert edited.shape == tall.shape
    np.testing.assert_array_equal(edited[regions == 0], tall[regions == 0])
    assert abs(edited - tall)[regions > 0].mean() > 0.02


def test_an_object_that_touches_the_border_is_edited_up_to_it():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    cut, regions = radiance[30:, 40:], inside[30:, 40:].astype(np.int64)
    edited = Compositor(
        decomposition.decompose(opened(cut, regions), Knowing(label), NETWORK)
    ).edit([label_of("gold-paint")[0]])
    assert edited.shape == cut.shape and np.isfinite(edited).all()
    assert (abs(edited - cut).max(-1) > 0)[regions > 0].mean() > 0.9


def test_an_object_larger_than_the_rendered_grid_has_no_dark_rim(monkeypatch):
    label = label_of("blue-rubber")
    coverage = np.zeros((SIZE, SIZE), np.float32)
    coverage[20:70, 20:70] = 1
    grey = np.full((SIZE, SIZE, 3), 0.25, np.float32)
    result = photograph.Photograph(
        "square", grey, coverage, (coverage >= 0.5).astype(np.int64), np.ones(3, np.float32), 1.0
    )
    decomposed = decomposition.decompose(result, Knowing(label), NETWORK)
    monkeypatch.setattr(compositor, "COARSEST", 12)
    monkeypatch.setattr(compositor, "FINEST", 12)
    painter = Compositor(decomposed)
    white = targets.resolve_labels("lambert(#ffffff)", None)
    assert painter.grid < painter.side / 4
    seen = painter.radiance(white)[painter.coverage > 0]
    # white and matte in even light: as bright everywhere
    np.testing.assert_allclose(seen, np.median(seen), rtol=0.05)


def test_a_soft_edge_mixes_edit_and_background_and_not_the_old_colour():
    label = label_of("blue-rubber")
    ground = np.full((SIZE, SIZE, 3), 0.25, np.float32)
    coverage = np.zeros((SIZE, SIZE), np.float32)
    coverage[20:70, 20:70], coverage[20:70, 70] = 1, 0.5
    # red through and through, edge included
    red = np.where(coverage[..., None] > 0, np.array([5.0, 0, 0], np.float32), ground)
    result = photograph.Photograph(
        "square", red, coverage, (coverage >= 0.5).astype(np.int64), np.ones(3, np.float32), 1.0
    )
    edited = Compositor(decomposition.decompose(result, Knowing(label), NETWORK)).edit([label[0]])
    edge, within = edited[45, 70], edited[45, 69]
    # the layer's picture changes a little from pixel to pixel
    np.testing.assert_allclose(edge, 0.5 * within + 0.5 * 0.25, atol=0.05)


@pytest.mark.parametrize("opacity_beside", [0.0, 1.0])
def test_nothing_is_mixed_in_from_where_the_photograph_is_transparent(opacity_beside):
    """A cut-out with a mask of its own: what is behind its edge has a colour that no one sees."""
    label = load_catalogue()["blue-rubber"].label.reshape(1, 108).astype(np.float32)
    coverage = np.zeros((SIZE, SIZE), np.float32)
    coverage[20:70, 20:70], coverage[20:70, 70] = 1, 0.5
    hidden = np.where(coverage[..., None] > 0, 0.3, np.array([0, 9.0, 0])).astype(np.float32)
    result = photograph.Photograph(
        "square",
        hidden,
        coverage,
        (coverage >= 0.5).astype(np.int64),
        np.ones(3, np.float32),
        1.0,
        alpha=np.maximum(coverage, opacity_beside),
    )
    painter = Compositor(decomposition.decompose(result, Knowing(label), NETWORK))
    edited = painter.edit([label[0]])
    edge, within = edited[45, 70], edited[45, 69]
    if opacity_beside:
        np.testing.assert_allclose(edge, 0.5 * within + [0, 4.5, 0], atol=0.05)
    else:
        np.testing.assert_allclose(edge, within, atol=0.05)
    np.testing.assert_array_equal(edited[:, 72:], hidden[:, 72:])


def test_a_region_that_is_kept_stays_and_the_other_changes():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    regions = inside.astype(np.int64)
    regions[:, SIZE // 2 :] *= 2
    edited = Compositor(
        decomposition.decompose(opened(radiance, regions), Knowing(label), NETWORK)
    ).edit([None, label_of("gold-paint")[0]])
    np.testing.assert_array_equal(edited[regions == 1], radiance[regions == 1])
    assert abs(edited - radiance)[regions == 2].mean() > 0.02


def test_brightness_changes_the_new_material_and_nothing_else():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    regions = inside.astype(np.int64)
    regions[:, SIZE // 2 :] *= 2
    painter = Compositor(
        decomposition.decompose(opened(radiance, regions), Knowing(label), NETWORK), detail=0.5
    )
    labels = [None, label_of("gold-paint")[0]]
    plain, brighter = (painter.edit(labels, stops=stops) for stops in (0.0, 1.5))
    new = regions == 2
    np.testing.assert_allclose(brighter[new], 2**1.5 * plain[new], rtol=1e-5)
    np.testing.assert_array_equal(brighter[~new], plain[~new])


def test_shading_is_kept_when_asked():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    stripes = np.where((np.arange(SIZE) % 2 == 0)[:, None, None], 1.15, 1 / 1.15).astype(np.float32)
    result = decomposition.decompose(
        opened(radiance * stripes, inside.astype(np.int64), 2.0), Knowing(label), NETWORK
    )
    middle = (slice(40, 56), slice(40, 56))
    for detail, low, high in ((0.0, 0.0, 0.02), (1.0, 0.2, 0.35)):
        edited = Compositor(result, detail=detail).edit([label_of("delrin")[0]])[middle]
        # 2 log 1.15 = 0.28 in the photograph
        contrast = abs(np.diff(np.log(edited[..., 1]), axis=0)).mean()
        assert low <= contrast <= high


@pytest.mark.parametrize("every", [1, 2])
def test_kept_shading_leaves_a_label_out_and_has_what_is_beside_it(monkeypatch, every):
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    stripes = np.where((np.arange(SIZE) % 2 == 0)[:, None, None], 1.15, 1 / 1.15).astype(np.float32)
    printed = radiance * stripes
    red = printed[48, 60].mean() * np.array([1, 0.1, 0.1], np.float32)
    printed[44:52, 40:48] = red * np.where(np.arange(8) % 2 == 0, 0.3, 1.2)[:, None, None]
    painter = Compositor(
        decomposition.decompose(
            opened(printed, inside.astype(np.int64), 2.0), Knowing(label), NETWORK
        )
    )
    top, left, side = painter.decomposition.framed.box
    monkeypatch.setattr(compositor, "FINEST", -(-side // every))  # of a large picture's pixels
    log = painter.residual()
    on, beside = (log[44 - top : 52 - top, k - left : k + 8 - left] for k in (40, 54))
    # behind the label is the mean of its surroundings, nearly without stripes and bars
    on, beside = (np.abs(np.diff(each, axis=0)) for each in (on, beside))
    assert on.max() < 0.15 and on.mean() < 0.05 < 0.2 < beside.mean()


@pytest.mark.parametrize("kind", ["clipped", "of another region"])
def test_shading_of_a_highlight_or_of_another_region_is_kept(kind):
    """Its colour is as unlike the object's as that of a label."""
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    stripes = np.where((np.arange(SIZE) % 2 == 0)[:, None, None], 1.15, 1 / 1.15).astype(np.float32)
    place = (slice(40, 56), slice(40, 56))
    red = radiance[48, 60].mean() * np.array([1, 0.5, 0.5], np.float32)
    marked = radiance.copy()
    marked[place] = red
    marked = marked * stripes
    regions = inside.astype(np.int64)
    if kind == "of another region":
        regions[place] = 2
    else:
        marked[(*place, 0)] = 1.0
    seen = replace(opened(marked, regions, 2.0), linear=False)
    painter = Compositor(decomposition.decompose(seen, Knowing(label), NETWORK))
    top, left, _ = painter.decomposition.framed.box
    log = painter.residual()[44 - top : 52 - top, 44 - left : 52 - left, 1:]
    assert np.abs(np.diff(log, axis=0)).mean() > 0.1


def test_an_edit_into_its_own_material_is_the_photograph_if_all_shading_is_kept():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    shadow = np.where((np.arange(SIZE) < 48)[:, None, None], 1, 0.6).astype(np.float32)
    seen = opened(radiance * shadow, inside.astype(np.int64), 2.0)
    result = decomposition.decompose(seen, Knowing(label), NETWORK)
    edited = Compositor(result, detail=1.0).edit([result.label[0]])
    within = result.photograph.coverage > 0.98
    ratio = edited[within] / seen.radiance[within]
    # but for the brightness and colour of the whole, and a little that counts as coloured
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio.mean(0), ratio.shape), rtol=5e-3)


@pytest.mark.parametrize("kind", ["a shadow", "a print", "a print on a named shape"])
def test_a_print_is_left_out_of_the_kept_shading_and_a_shadow_is_in_it(kind):
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    coloured = 3 if kind == "a print" else 1
    factors = np.random.default_rng(0).uniform(0.4, 1.6, (SIZE // 8, SIZE // 8, coloured))
    factors = factors.repeat(8, 0).repeat(8, 1).astype(np.float32)
    result = decomposition.decompose(
        opened(radiance * factors, inside.astype(np.int64), 2.0), Knowing(label), NETWORK
    )
    if kind == "a print on a named shape":
        result = replace(result, shape=SimpleNamespace(overlap=1.0))
    painter = Compositor(result, detail=0.5)
    box, within = result.framed.box, painter.coverage > 0.98
    seen = framing.cut_square(result.photograph.radiance, box)
    whole = np.log(seen[within] / painter.own_radiance()[within])
    whole -= whole.mean(0)
    kept = np.log(painter.kept_shading()[within])
    share = (kept * whole).sum() / (whole**2).sum()
    low, high = (0.48, 0.51) if kind == "a shadow" else (0.0, 0.2)
    assert low <= share <= high


@pytest.mark.parametrize(("times", "grid"), [(1, 256), (8, 567), (16, 1024)])
def test_objects_are_rendered_at_their_own_size_between_two_limits(times, grid):
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    radiance, regions = (
        x.repeat(times, 0).repeat(times, 1) for x in (radiance, inside.astype(np.uint8))
    )
    painter = Compositor(
        decomposition.decompose(opened(radiance, regions), Knowing(label), NETWORK)
    )
    assert painter.grid == grid  # 567: 1.18 times the object's 480 pixels
    assert painter.n.shape == (grid, grid, 3)


def test_grey_balance_makes_the_background_grey_and_keeps_its_luminance(tmp_path):
    values = np.full((40, 40, 3), (200, 160, 120), np.uint8)
    mask = np.zeros((40, 40), np.uint8)
    mask[10:30, 10:30] = 255
    values[mask > 0] = (0, 0, 255)
    Image.fromarray(values).save(tmp_path / "p.png")
    Image.fromarray(mask).save(tmp_path / "m.png")
    result = photograph.open_photograph(tmp_path / "p.png", [tmp_path / "m.png"], balance="grey")
    mean = result.balanced[:5].mean((0, 1))
    np.testing.assert_allclose(mean, mean[0], rtol=1e-3)
    np.testing.assert_allclose(
        mean @ [0.2126, 0.7152, 0.0722],
        result.radiance[:5].mean((0, 1)) @ [0.2126, 0.7152, 0.0722],
        rtol=1e-3,
    )


def test_grey_balance_does_not_look_at_what_is_transparent():
    values = np.full((40, 40, 4), (200, 160, 120, 255), np.uint8)
    inside = np.zeros((40, 40), bool)
    inside[10:30, 10:30] = True
    values[inside, :3] = (60, 90, 180)
    visible = photograph.from_arrays(values[..., :3], inside, balance="grey")
    values[:10] = (0, 0, 255, 0)
    half = photograph.from_arrays(values, inside, balance="grey")
    np.testing.assert_allclose(half.balance, visible.balance, rtol=1e-5)
    # with regions as without them, a cut-out has no background
    values[~inside] = (0, 0, 0, 0)
    alone = photograph.from_arrays(values, balance="grey")
    parts = photograph.from_arrays(values, None, inside.astype(np.uint8), balance="grey")
    np.testing.assert_allclose(parts.balance, alone.balance)


def test_a_white_balance_that_is_given_keeps_luminance(tmp_path):
    Image.new("RGB", (40, 30), (90, 90, 90)).save(tmp_path / "p.png")
    Image.new("L", (40, 30), 255).save(tmp_path / "m.png")
    for wanted_factors in ((2.0, 2.0, 2.0), (1.4, 1.0, 0.7)):
        result = photograph.open_photograph(
            tmp_path / "p.png", [tmp_path / "m.png"], balance=wanted_factors
        )
        # float32
        np.testing.assert_allclose(result.balance @ [0.2126, 0.7152, 0.0722], 1, rtol=1e-5)
        np.testing.assert_allclose(
            result.balance / result.balance[1],
            np.array(wanted_factors) / wanted_factors[1],
            rtol=1e-5,
        )


def test_a_black_and_white_mask_is_softened_and_a_grey_one_is_not(tmp_path):
    Image.new("RGB", (40, 30), (90, 90, 90)).save(tmp_path / "p.png")
    mask = np.zeros((30, 40), np.uint8)
    mask[:, 20:] = 255
    Image.fromarray(mask).save(tmp_path / "m.png")
    sharp = photograph.open_photograph(tmp_path / "p.png", [tmp_path / "m.png"])
    assert 0.1 < sharp.coverage[15, 19] < 0.5 < sharp.coverage[15, 20] < 0.9
    assert (sharp.regions > 0).sum() == 30 * 20  # what is edited stays what was asked for
    mask[:, 20] = 100
    Image.fromarray(mask).save(tmp_path / "m.png")
    grey = photograph.open_photograph(tmp_path / "p.png", [tmp_path / "m.png"])
    np.testing.assert_allclose(grey.coverage[15, 18:22], [0, 0, 100 / 255, 1], atol=1e-6)


@pytest.mark.parametrize("with_regions", [False, True])
def test_transparency_is_not_softened(tmp_path, with_regions):
    """A cut-out of black and white transparency: its edit has the same, and so has what is kept."""
    alpha = np.zeros((30, 40), np.uint8)
    alpha[5:25, 10:30] = 255
    picture = np.full((30, 40, 3), 90, np.uint8)
    Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / "p.png")
    Image.fromarray(alpha // 255).save(tmp_path / "r.png")
    from_file = photograph.open_photograph(
        tmp_path / "p.png", regions=tmp_path / "r.png" if with_regions else None
    )
    from_array = photograph.from_arrays(
        np.dstack([picture, alpha]), regions=alpha // 255 if with_regions else None
    )
    for result in (from_file, from_array):
        np.testing.assert_array_equal(result.coverage, alpha / 255)
        np.testing.assert_array_equal(result.opacity, alpha / 255)


@pytest.mark.parametrize("first_ends", [20, 30])
def test_several_masks_are_several_regions_and_where_they_overlap_the_later_one_holds(
    tmp_path, first_ends
):
    Image.new("RGB", (40, 30), (90, 90, 90)).save(tmp_path / "p.png")
    for name, box in (("a", (0, 0, first_ends, 30)), ("b", (20, 0, 40, 30))):
        mask = Image.new("L", (40, 30))
        mask.paste(255, box)
        mask.save(tmp_path / f"{name}.png")
    result = photograph.open_photograph(
        tmp_path / "p.png", [tmp_path / "a.png", tmp_path / "b.png"]
    )
    assert (result.regions[:, :20] == 1).all() and (result.regions[:, 20:] == 2).all()


@pytest.mark.parametrize("below", [False, True])
def test_between_soft_masks_that_meet_is_no_background(tmp_path, below):
    """A seat and legs as painting programs cut them; or a whole chair, and the legs over it."""
    Image.new("RGB", (40, 30), (90, 90, 90)).save(tmp_path / "p.png")
    first, second = np.zeros((2, 30, 40), np.uint8)
    first[5:25, 5:20] = second[5:25, 21:35] = 255
    first[5:25, 20] = second[5:25, 20] = 128
    first[25, 5:20] = second[25, 21:35] = 128  # the soft edge of both
    if below:
        first[5:25, 5:35], first[25, 5:35] = 255, 128
    for name, mask in (("a", first), ("b", second)):
        Image.fromarray(mask).save(tmp_path / f"{name}.png")
    result = photograph.open_photograph(
        tmp_path / "p.png", [tmp_path / "a.png", tmp_path / "b.png"]
    )
    np.testing.assert_allclose(result.coverage[5:25, 5:35], 1, atol=0.01)
    np.testing.assert_allclose(result.coverage[25, 22:35], 128 / 255, atol=0.01)
    assert result.mask[5:25, 5:35].all()


def test_a_record_is_seen_by_its_own_camera_at_its_own_exposure(tmp_path, rng):
    write_dataset(
        tmp_path, [matte("a", 0.2)], rng, size=32, seeds=1, rotations=(0,), method="quadrature"
    )
    result = photograph.open_photograph(tmp_path)
    assert result.exposure == 1 and result.record is not None
    assert photograph.open_photograph(tmp_path, exposure=3.0).exposure == 3
    camera = msgspec.structs.replace(result.record.camera, elevation_deg=50.0)
    label = label_of("blue-rubber")
    for record, degrees in (
        (None, 20.0),
        (msgspec.structs.replace(result.record, camera=camera), 50.0),
    ):
        taken = decomposition.decompose(replace(result, record=record), Knowing(label), NETWORK)
        assert np.degrees(taken.batch.elevation) == pytest.approx(degrees)


def test_a_record_that_has_a_target_material_already_is_edited_only_if_there_is_no_other(
    tmp_path, rng
):
    materials = [matte("a", 0.2), matte("b", 0.6)]
    write_dataset(
        tmp_path, materials, rng, size=32, seeds=1, rotations=(0,), method="quadrature", side="test"
    )
    first = photograph.open_photograph(tmp_path).record.materials[0]
    (other,) = {"a", "b"} - {first}
    assert photograph.open_photograph(tmp_path, targets=[first, "c"]).record.materials == (other,)
    assert photograph.open_photograph(tmp_path, targets=[other]).record.materials == (first,)
    assert photograph.open_photograph(tmp_path, targets=["a", "b"]).record.materials == (first,)


def write_two_materials(folder, rng, rotations):
    """A data set of the materials a and b."""
    both = [matte("a", 0.2), matte("b", 0.6)]
    write_dataset(folder, both, rng, size=32, seeds=1, rotations=rotations, method="quadrature")


def test_the_truth_of_an_edit_is_of_the_same_turn_of_the_light(tmp_path, rng):
    write_two_materials(tmp_path, rng, (0, 5))
    records = Records(tmp_path)
    by = {(r.materials, r.rotation_texels): r for r in records.records}
    for turn in (0, 5):
        result = photograph.open_photograph(tmp_path, record=by[("a",), turn].id)
        np.testing.assert_array_equal(edit.find_truth(result, "b"), records.image(by[("b",), turn]))
        assert edit.find_truth(result, "c") is None


def test_the_truth_of_regions_has_them_in_their_order_and_what_is_kept_as_it_was(tmp_path, rng):
    write_two_materials(tmp_path, rng, (0,))
    result = photograph.open_photograph(tmp_path)
    of = {
        key: msgspec.structs.replace(result.record, id=" ".join(key), materials=key)
        for key in (("a", "b"), ("b", "a"), ("b", "b"))
    }

    known = SimpleNamespace(records=list(of.values()), image=lambda record: record.materials)
    two = replace(result, records=known, record=of["b", "a"])
    assert edit.find_truth(two, "a+b") == ("a", "b")
    assert edit.find_truth(two, "b+a") == ("b", "a")
    assert edit.find_truth(two, "keep+b") == edit.find_truth(two, "b") == ("b", "b")
    assert edit.find_truth(two, "measured(b)+keep") == ("b", "a")
    assert edit.find_truth(two, "a+a") is None
    assert (
        edit.find_truth(
            replace(two, record=msgspec.structs.replace(of["b", "a"], rotation_texels=7)), "a+b"
        )
        is None
    )


def test_a_datasets_own_materials_are_known(tmp_path, rng):
    write_two_materials(tmp_path, rng, (0,))
    label = Records(tmp_path).label("b")
    np.testing.assert_array_equal(edit.labels_by_region("b", 1, None, {"b": label})[0], label)
    with pytest.raises(ValueError, match="none of that name"):
        edit.labels_by_region("a-name-of-none", 1, None, {"b": label})


def test_a_region_too_small_for_the_network_is_kept_or_changed_all_the_same():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    radiance, regions = (
        np.repeat(np.repeat(x, 4, 0), 4, 1) for x in (radiance, inside.astype(np.uint8))
    )
    regions[200:204, 201:205] = 2  # half a pixel of the network's, beside a pixel's middle
    result = decomposition.decompose(opened(radiance, regions), Knowing(label), 32)
    assert result.batch.segments.max() == 1 and result.parts.label.shape[1] == 2
    edited = Compositor(result).edit([label_of("gold-paint")[0], None])
    np.testing.assert_array_equal(edited[regions == 2], radiance[regions == 2])
    assert abs(edited - radiance)[regions == 1].mean() > 0.02
    swapped = opened(radiance, np.where(regions > 0, 3 - regions, 0).astype(np.uint8))
    assert [
        caption
        for caption, _ in drawing.reflectance_maps(
            decomposition.decompose(swapped, Knowing(label), 32)
        )
    ] == ["reflectance map 1, observed", "reflectance map 1, predicted"]


def test_a_region_that_no_pixel_shows_has_a_label_in_every_network():
    image, mask = torch.rand(1, 3, 64, 64), torch.ones(1, 1, 64, 64)
    segments = torch.ones(1, 64, 64, dtype=torch.int64)
    for kind in (Compact, Paper, Separate):
        network = kind(Ranges(torch.zeros(108), torch.ones(108))).eval()
        with torch.no_grad():
            result = network(image, mask, segments, ("normals", "material"), regions=3)
        assert result.label.shape == (1, 3, 108) and result.label.isfinite().all()


def test_what_lies_in_no_region_stays_as_it_is_but_for_a_rim(tmp_path):
    Image.new("RGB", (60, 40), (90, 90, 90)).save(tmp_path / "p.png")
    Image.new("L", (60, 40), 255).save(tmp_path / "m.png")
    regions = Image.new("L", (60, 40))
    regions.paste(1, (0, 0, 30, 40))
    regions.save(tmp_path / "r.png")
    result = photograph.open_photograph(
        tmp_path / "p.png", [tmp_path / "m.png"], tmp_path / "r.png"
    )
    assert (result.coverage[:, :30] > 0.99).all() and (result.coverage[:, 36:] == 0).all()
    painter = Compositor(decomposition.decompose(result, Knowing(label_of("blue-rubber")), NETWORK))
    edited = painter.edit([label_of("gold-paint")[0]])
    np.testing.assert_array_equal(edited[:, 36:], result.radiance[:, 36:])
    assert abs(edited - result.radiance)[:, :30].mean() > 0.02


def test_the_picture_rendered_again_has_none_of_the_photographs_own_detail():
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    stripes = np.where((np.arange(SIZE) % 2 == 0)[:, None, None], 1.15, 1 / 1.15).astype(np.float32)
    painter = Compositor(
        decomposition.decompose(
            opened(radiance * stripes, inside.astype(np.uint8), 2.0), Knowing(label), NETWORK
        ),
        detail=1.0,
    )
    middle = (slice(40, 56), slice(40, 56))
    assert abs(np.diff(np.log(painter.render_again()[middle][..., 1]), axis=0)).mean() < 0.02


def test_the_objects_own_material_is_rendered_once(monkeypatch):
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    drawn, rendered = [], Compositor._render
    decomposed = decomposition.decompose(
        opened(radiance, inside.astype(np.uint8)), Knowing(label), NETWORK
    )
    monkeypatch.setattr(Compositor, "_render", lambda *a: drawn.append(1) or rendered(*a))
    painter = Compositor(decomposed, detail=0.25)
    painter.edit([label_of("gold-paint")[0]])
    painter.render_again()
    assert len(drawn) == 2


def test_a_material_from_another_picture_is_not_scaled_by_this_ones_exposure(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        edit.decomposition,
        "decompose",
        lambda opened, *_: (
            asked.append(opened) or decomposition.Decomposition(opened, None, None, start(), None)
        ),
    )

    def start():
        nothing = torch.zeros(1, 3, 1, 1)
        return Prediction(nothing, None, torch.zeros(1, 1, 108), None, nothing)

    Image.new("RGB", (40, 30), (90, 60, 90)).save(tmp_path / "p.png")
    Image.new("L", (40, 30), 255).save(tmp_path / "p.mask.png")
    for balance, factors in (((2.0, 1.0, 1.0), 1), ("none", 1)):
        edit.read_label_from_picture(
            tmp_path / "p.png", None, 64, edit.EditOptions(tmp_path, None, 0.01, 0.0, 3.0, balance)
        )
        assert asked[-1].exposure is None
        np.testing.assert_array_equal(asked[-1].balance, factors)


def test_a_folder_of_masks_gives_each_picture_its_mask_and_never_itself(tmp_path):
    for name in ("a.png", "a.mask.png", "b.png", "c.jpg", "c.png"):
        (tmp_path / name).write_bytes(b"")
    assert region_masks.find_mask_beside(tmp_path / "a.png", tmp_path) == tmp_path / "a.mask.png"
    assert region_masks.find_mask_beside(tmp_path / "b.png", tmp_path) is None
    assert region_masks.find_mask_beside(tmp_path / "c.jpg", tmp_path) == tmp_path / "c.png"


def test_a_material_file_comes_back_as_it_was_written(tmp_path):
    label = label_of("brass")
    (tmp_path / "m.json").write_text(json.dumps({"label": [float(x) for x in label[0]]}))
    np.testing.assert_allclose(targets.resolve_labels(str(tmp_path / "m.json"), None), label)
    (tmp_path / "two.json").write_text(json.dumps({"labels": [[float(x) for x in label[0]]] * 2}))
    assert targets.resolve_labels(str(tmp_path / "two.json"), None).shape == (2, 108)


def test_materials_are_given_to_regions_in_their_order():
    result = edit.labels_by_region("brass+keep", 2, None)
    np.testing.assert_array_equal(result[0], label_of("brass")[0])
    assert result[1] is None
    assert len(edit.labels_by_region("brass", 3, None)) == 3
    with pytest.raises(
        ValueError, match=r"one material, or 2: one for each region, found 3 \(keep"
    ):
        edit.labels_by_region("brass+keep+keep", 2, None)
    with pytest.raises(ValueError, match=r"expected one material, found 2 \(give regions"):
        edit.labels_by_region("brass+keep", 1, None)


def test_a_file_of_several_materials_stands_alone(tmp_path):
    label = [float(x) for x in label_of("brass")[0]]
    file = tmp_path / "two.json"
    file.write_text(json.dumps({"labels": [label, label]}))
    assert len(edit.labels_by_region(str(file), 2, None)) == 2
    for text, count in ((f"{file}+keep", 2), (f"keep+keep+{file}", 3)):
        with pytest.raises(ValueError, match=r"files of one material beside \+, found 2"):
            edit.labels_by_region(text, count, None)


def test_mirrors_are_shown_by_the_integral_and_fabrics_by_the_sum():
    result = {
        name: method_for(torch.from_numpy(label_of(name)))
        for name in ("chrome", "red-fabric", "blue-rubber")
    }
    assert result == {"chrome": "quadrature", "red-fabric": "auto", "blue-rubber": "auto"}


def test_the_observed_reflectance_map_of_a_ball_is_its_picture():
    n, inside = ball(128, 62)
    colour = np.where(inside[..., None], n * 0.5 + 0.5, 0)
    seen = spheres.observed_reflectance(colour, n, inside, 64, 1.0)
    expected = tone.display(spheres.sphere_normals(64) * 0.5 + 0.5, 1.0)
    core = spheres.sphere_normals(64)[..., 2] > 0.3
    assert abs(seen - expected)[core].mean() < 4  # of 255: half a cell


def test_pictures_in_groups_are_all_there_and_none_alone():
    for count in range(2, 20):
        groups = transfer_grids.group_pictures(list(range(count)), 6)
        assert sorted(chain(*groups)) == list(range(count)) and all(
            2 <= len(group) <= 6 for group in groups
        )
        pairs = transfer_grids.group_pictures(list(range(count)), 2)
        assert list(chain(*pairs)) == list(range(count))
        assert [len(pair) for pair in pairs] == [2] * (count // 2 - count % 2) + [3] * (count % 2)


def test_edit_and_transfer_write_what_they_say(tmp_path, capsys):
    radiance, inside = lit(label_of("blue-rubber"), 1.0)
    gold, _ = lit(label_of("gold-paint"), 1.0)
    for name, seen in (("a", radiance), ("b", gold)):
        picture = tone.display(seen, 1.0)
        Image.fromarray(np.dstack([picture, 255.0 * inside]).astype(np.uint8)).save(
            tmp_path / f"{name}.png"
        )
    a, b, out = tmp_path / "a.png", tmp_path / "b.png", tmp_path / "edit"
    assert (
        main(
            "learn",
            "t",
            COMMANDS,
            ["edit", str(a), "--material", "red-fabric", str(b), "--no-refine", "--out", str(out)],
        )
        == 0
    )
    report = json.loads((out / "edit.json").read_text())
    assert report["refined"] is None and report["materials"] == ["red-fabric", str(b)]
    with Image.open(out / "edited-red-fabric.png") as picture:
        assert (picture.size, picture.mode) == ((SIZE, SIZE), "RGBA")
    assert {
        "sheet.png",
        "normals.exr",
        "light.exr",
        "ball.png",
        "reflectance.png",
        "material.json",
    } <= {p.name for p in out.iterdir()}
    assert (
        main(
            "learn",
            "t",
            COMMANDS,
            ["transfer", str(a), str(b), "--no-refine", "--out", str(tmp_path / "swap")],
        )
        == 0
    )
    assert {p.name for p in (tmp_path / "swap").iterdir()} == {
        "grid.png",
        "transfer.json",
        "a-in-b.png",
        "b-in-a.png",
    }
    shown = [
        np.asarray(Image.open(p).convert("RGB"))
        for p in (tmp_path / "swap" / "a-in-b.png", out / "edited-b.png", out / "rendering.png")
    ]
    np.testing.assert_array_equal(shown[0], shown[1])  # b's material on a, by either command
    assert abs(shown[0][inside].astype(int) - shown[2][inside]).mean() > 5  # and not a's own
    capsys.readouterr()


def test_one_material_is_written_as_edited_and_compared_where_its_truth_is_known(
    tmp_path, rng, capsys
):
    catalogue = load_catalogue()
    materials = [
        entry(name, catalogue[name].m.reshape(3, 3, 2, 6), catalogue[name].mixture)
        for name in ("red-fabric", "delrin")
    ]
    write_dataset(tmp_path / "data", materials, rng, size=32, seeds=1, rotations=(0,))
    record = next(r for r in Records(tmp_path / "data").records if r.materials == ("red-fabric",))
    words = [
        "edit",
        str(tmp_path / "data"),
        "--record",
        record.id,
        "--material",
        "delrin",
        "--no-refine",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main("learn", "t", COMMANDS, words) == 0
    assert (tmp_path / "out" / "edited.png").exists()
    report = json.loads((tmp_path / "out" / "edit.json").read_text())
    assert set(report["display_l2"]) == {"delrin"} and report["display_l2"]["delrin"]["mask"] > 0
    capsys.readouterr()
