"""Photographs of rendered pictures, and the line of exposures that is fitted to their edits."""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learn.data.records import Records
from learn.editing import exposure, mirror_correction
from learn.experiments.photographs import (
    photographed_edits,
    photographed_fit,
    photographing,
    room_cases,
)
from learn.experiments.photographs.photographed_fit import TERMS, Edits
from manifests.errors import InputError
from shaders import envmap, tone
from shaders.frames import ELEVATION
from tests.support import ladder_rungs, room_scenes


def test_a_frame_is_exposed_for_its_middle() -> None:
    even = np.full((40, 40), 0.5)
    assert photographing.metered(even) == pytest.approx(photographing.METERED / 0.5, rel=1e-6)
    bright_middle, bright_rim = even.copy(), even.copy()
    bright_middle[15:25, 15:25] = 1.0
    bright_rim[:5, :20] = 1.0  # as many pixels
    assert photographing.metered(bright_middle) < 0.95 * photographing.metered(bright_rim)
    lamp = even.copy()
    lamp[20, 20] = 1e6  # white, no more
    assert photographing.metered(lamp) == pytest.approx(photographing.metered(even), rel=0.02)


def test_the_light_is_behind_the_object_where_the_camera_looks() -> None:
    light = np.full((64, 128, 3), 0.1, np.float32)
    behind = -np.array([0.0, np.sin(ELEVATION), np.cos(ELEVATION)])
    light[envmap.texel(behind, 64, 128)] = 9.0
    above = behind + np.array([0.0, 0.2, 0.0])
    light[envmap.texel(above / np.linalg.norm(above), 64, 128)] = 5.0
    frame = photographing.surroundings(light, 60, ELEVATION)[..., 0]
    assert frame[30, 30] == 9.0
    rows, columns = np.nonzero(frame == 5.0)
    assert rows.size and (rows < 25).all() and (abs(columns - 29.5) < 10).all()


def test_a_photograph_holds_the_object_in_its_middle_under_its_exposure() -> None:
    rng = np.random.default_rng(0)
    radiance = rng.uniform(0, 1, (32, 32, 3)).astype(np.float32)
    mask = np.zeros((32, 32), bool)
    mask[4:28, 6:26] = True
    light = rng.uniform(0.5, 1.5, (64, 128, 3)).astype(np.float32)
    photo = photographing.photographed(radiance, mask, light, ELEVATION, "a")
    assert photo.pixels.shape == (48, 48, 3) and photo.mask.sum() == mask.sum()
    shown = tone.display(radiance, photo.exposure)
    assert abs(photo.pixels[8:40, 8:40][mask] - shown[mask]).max() <= 0.5
    behind = photographing.surroundings(light, 48, ELEVATION)
    outside = ~photo.mask
    assert abs(photo.pixels - tone.display(behind, photo.exposure))[outside].max() <= 0.5
    again = photographing.photographed(radiance, mask, light, ELEVATION, "a")
    other = photographing.photographed(radiance, mask, light, ELEVATION, "b")
    assert again.exposure == photo.exposure != other.exposure


def test_a_camera_takes_back_the_colour_of_the_light_but_little_green() -> None:
    rng = np.random.default_rng(0)
    grey = np.repeat(rng.uniform(0.05, 0.3, (20, 20, 1)), 3, -1)
    warm = grey * 2 ** np.array([0.5, 0.0, -0.5])
    balance = photographing.white_balance(warm)
    colour = (warm * balance).reshape(-1, 3).mean(0)
    assert colour == pytest.approx(colour.mean() * np.ones(3), rel=1e-5)
    middle = tone.LUMINANCE @ warm[0, 0]
    assert tone.LUMINANCE @ (warm[0, 0] * balance) == pytest.approx(middle, rel=1e-5)
    # a lamp that is brighter than white has no colour left
    lamp = warm.copy()
    lamp[3, 3] = 5.0, 0.2, 0.2
    assert photographing.white_balance(lamp) == pytest.approx(balance, rel=0.02)
    # a lawn stays green, and a red wall reddish
    green = photographing.white_balance(grey * 2 ** np.array([0.0, 1.0, 0.0]))
    assert np.log2(green[1] / green[0]) == pytest.approx(-photographing.MOST_GREEN, rel=1e-4)
    red = photographing.white_balance(grey * 2 ** np.array([1.5, 0.0, -1.5]))
    assert np.log2(red[2] / red[0]) == pytest.approx(photographing.MOST_RED_BLUE, rel=1e-4)
    # nothing is known of a frame that is white, or lacks a colour
    for frame in (np.full((4, 4, 3), 2.0), grey * np.array([1.0, 1.0, 0.0])):
        assert (photographing.white_balance(frame) == 1).all()


def test_a_balanced_photograph_says_how_it_took_its_colours() -> None:
    frame = np.random.default_rng(0).uniform(0.02, 0.2, (24, 24, 3)) * np.array([1.5, 1.0, 0.6])
    plain, balanced = (photographing.exposed(frame, frame[..., 0] > 0, "a", b) for b in (0, 1))
    assert (plain.balance == 1).all() and plain.exposure == balanced.exposure
    for photo in (plain, balanced):
        assert abs(photo.pixels - tone.display(photo.of(frame), 1.0)).max() <= 0.51
    assert np.ptp(plain.pixels.mean((0, 1))) > 3 * np.ptp(balanced.pixels.mean((0, 1)))


def edits(count: int, slopes: np.ndarray, noise: float = 0.0) -> Edits:
    """Return edits whose brightness follows a line; L2 is the square of how far they are off."""
    rng = np.random.default_rng(1)
    cues = np.concatenate([np.ones((count, 1)), rng.normal(size=(count, 4))], 1)
    right = cues @ slopes + noise * rng.normal(size=count)
    used, darkened = rng.normal(size=(2, count))
    stops = right - used - darkened
    scales = np.array(photographed_fit.SCALES)
    rows = [
        {"shape": str(k % 5), "light": str(k % 7), "target": "a", "group": "b", "family": "metal"}
        for k in range(count)
    ]
    l2 = abs(stops[:, None] + scales)
    true = cues[:, :4] @ slopes[:4]  # a narrow share makes edits too bright, nothing else does
    return Edits(rows, cues, used, darkened, true, stops, l2, np.ones(count))


RESULTS = Path(__file__).parents[2] / "docs" / "results"
SLOPES = np.array([-2.0, 0.1, 0.7, -0.5, 0.8])


def test_a_line_is_found_again_by_edits_of_other_shapes_under_other_lights() -> None:
    exact = edits(200, SLOPES)
    assert photographed_fit.fitted(exact, TERMS) == pytest.approx(SLOPES)
    predicted = photographed_fit.by_others(exact, TERMS)
    assert predicted == pytest.approx(exact.cues @ SLOPES)
    assert abs(exact.brightness(predicted)).max() < 1e-9
    # what is left out of a line is not used
    shorter = photographed_fit.fitted(exact, ("constant", "again"))
    assert (shorter[[1, 3, 4]] == 0).all()


def test_the_share_of_narrow_lobes_is_not_taken_for_what_sources_do_to_the_exposure() -> None:
    """Targets that are mirror-like where sources are bright: the exposure has its own line."""
    tied = edits(400, SLOPES)
    tied.cues[:, 4] += 2 * tied.cues[:, 2]
    right = tied.cues @ SLOPES
    tied = replace(tied, stops=right - tied.used - tied.darkened)
    tied = replace(tied, true=tied.cues[:, :4] @ SLOPES[:4])
    without_the_cue = photographed_fit.fitted(tied, ("constant", "object", "narrow"))
    assert without_the_cue[4] == pytest.approx(SLOPES[4])


def test_no_edit_sees_itself_in_its_line() -> None:
    noisy = edits(60, SLOPES, 0.3)
    shape, light = (np.array(noisy.names(key)) for key in ("shape", "light"))
    own = (shape == "0") | (light == "0")
    changed = replace(noisy, stops=np.where(own, noisy.stops + 5, noisy.stops))
    at = np.flatnonzero((shape == "0") & (light == "0"))
    before, after = (photographed_fit.by_others(each, TERMS)[at] for each in (noisy, changed))
    assert at.size and after == pytest.approx(before)
    with_own = photographed_fit.fitted(changed, TERMS) - photographed_fit.fitted(noisy, TERMS)
    assert abs(with_own).max() > 0.1


def test_errors_at_other_exposures_are_interpolated() -> None:
    some = edits(50, SLOPES)
    kept = some.used + some.darkened
    inside = abs(some.stops) < 3
    assert some.error(kept)[inside] == pytest.approx(abs(some.stops)[inside])
    # linear between scales, and |x| is linear but about 0
    brighter = some.error(kept - 0.6)
    assert brighter[inside] == pytest.approx(abs(some.stops + 0.6)[inside], abs=0.13)


@pytest.mark.parametrize(
    "name",
    [
        "photographed-edits-development",
        "photographed-edits-other-metals",
        "room-photographs-others",
    ],
)
def test_what_is_in_use_is_how_the_published_edits_were_made(name) -> None:
    report = json.loads((RESULTS / name / "report.json").read_text())
    made = photographed_fit.edits_of(report)
    assert len(made.rows) > 100
    assert photographed_fit.in_use(made) == pytest.approx(made.used + made.darkened, abs=1e-5)


def test_a_report_without_cues_is_a_sentence() -> None:
    row = {"photograph": "a", "cues": {"object": 0.0, "again": None, "background": 0.0}}
    report = {"rows": [row | {"edits": [{"narrow": 0.0}]}], "weights": "w", "seen": []}
    assert "No photograph" in photographed_fit.page(report)


def test_what_is_in_use_for_a_cut_out_has_no_part_of_the_background() -> None:
    some = edits(20, SLOPES)
    expected = [
        np.log2(exposure.exposure_from_cues(exposure.Cues(*row[1:4])))
        + mirror_correction.STOPS * row[4]
        for row in some.cues
    ]
    assert photographed_fit.in_use(some) == pytest.approx(expected)
    cut_out = photographed_fit.in_use(some, cut_out=True)
    assert abs(cut_out - expected).max() > 0.1


def test_photographs_are_edited_into_the_other_materials_of_their_scene(tmp_path) -> None:
    ladder_rungs.written(tmp_path, 32)
    records = Records(tmp_path)
    cases = photographed_edits.cases_of(records, 99, 0)
    assert len({case.source.id for case in cases}) == len(cases) > 3
    for case in cases:
        assert case.targets
        for target in case.targets:
            same = ("shape", "viewpoint", "light", "rotation_texels", "tier")
            assert all(getattr(target, key) == getattr(case.source, key) for key in same)
            assert target.materials != case.source.materials
            assert target.tier == "full" and target.camera.pixel == "square"
    shapes = [case.source.shape for case in cases[: len({c.source.shape for c in cases})]]
    assert len(set(shapes)) == len(shapes)  # they take turns
    assert photographed_edits.cases_of(records, 2, 0) == cases[:2]


def test_a_data_set_without_two_materials_of_a_scene_is_refused(tmp_path) -> None:
    ladder_rungs.written(tmp_path, 32)
    records = Records(tmp_path)
    first = records.records[0].materials
    records.records[:] = [r for r in records.records if r.materials == first]
    with pytest.raises(InputError, match="two materials"):
        photographed_edits.cases_of(records, 9, 0)


def test_a_scene_in_a_room_has_a_material_to_edit_and_another_one_to_edit_into(tmp_path):
    room_scenes.written(tmp_path)
    place = tmp_path / "0000"
    scene = json.loads((place / "scene.json").read_text())
    assert len(room_cases.cases_of(tmp_path)) == len(scene["materials"]) == 2
    (place / "scene.json").write_text(json.dumps(scene | {"materials": ["white-marble"]}))
    with pytest.raises(InputError, match=r"scene\.json"):
        room_cases.cases_of(tmp_path)


@pytest.mark.parametrize(
    ("text", "is_share"), [("0", 1), ("0.5", 1), ("2", 0), ("nan", 0), ("a", 0)]
)
def test_the_shading_that_edits_keep_is_a_number_from_0_to_1(capsys, text, is_share):
    parser = argparse.ArgumentParser()
    photographed_edits.add_detail(parser)
    if is_share:
        assert parser.parse_args(["--detail", text]).detail == float(text)
        return
    with pytest.raises(SystemExit):
        parser.parse_args(["--detail", text])
    assert f"expected a number from 0 to 1, found '{text}'" in capsys.readouterr().err
