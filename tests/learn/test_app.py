"""The parts of `brdfactory app` without its page: masks by clicks, search, sessions, blends."""

import json
import shlex
import sys
import time
import types
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from learn.app import choices, download_files, edit_file, gallery, opening, viewer, work_file
from learn.app.background_decomposition import Network, Stopped
from learn.app.choices import Chosen, Edit, Painted, Principled
from learn.app.composition import composed, displayed
from learn.app.download_files import Downloads
from learn.app.marking_view import mark_line, mark_place
from learn.app.page_html import without_markup
from learn.app.session import Session
from learn.app.sessions import Sessions
from learn.app.viewer import Superseded, Viewer
from learn.commands import app as command
from learn.commands import options
from learn.data import photographs, picture_decoding
from learn.editing import DETAIL, decomposition, mirror_correction, photograph, reflectance_store
from learn.editing.compositor import Compositor
from learn.networks import built_in_weights
from learn.primitives import PRIMITIVES
from learn.selection import overlay
from learn.selection.display import display_of
from learn.selection.marks import MOST_STROKES, Selection, enclosed
from learn.selection.superpixels import Superpixels
from manifests.described_materials import DESCRIBED
from manifests.errors import InputError
from manifests.material_words import ALIKE
from manifests.materials import load_catalogue
from shaders import envmap, tone
from tests.support.known_ball import Knowing, ball, label_of

SIDE, RADIUS = 96, 36
REPEATED = ["photo.png", "--repeat", "edit.json", "--out", "x"]


def scene() -> np.ndarray:
    """A grey disk with a red half before a green ground, with a little noise."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:80, :120]
    picture = np.empty((80, 120, 3))
    picture[:] = (40, 120, 60)
    inside = (rows - 40) ** 2 + (columns - 60) ** 2 < 28**2
    picture[inside] = (150, 150, 160)
    picture[inside & (columns > 60)] = (170, 40, 40)
    return np.clip(picture + rng.normal(0, 4, picture.shape), 0, 255).astype(np.uint8)


def disk(half: bool = False) -> np.ndarray:
    rows, columns = np.mgrid[:80, :120]
    inside = (rows - 40) ** 2 + (columns - 60) ** 2 < 28**2
    return inside & (columns > 60) if half else inside


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_clicks_select_an_object_and_divide_it_into_regions() -> None:
    selection = Selection(scene())
    assert not selection.labels().any()
    selection.click(45, 40, 1)
    selection.click(75, 40, 2)
    labels = selection.labels()
    assert overlap(labels > 0, disk()) > 0.9
    assert overlap(labels == 2, disk(half=True)) > 0.9
    # a click on the red half as background leaves the grey one
    selection.click(80, 45, 0)
    selection.marks.pop(1)
    assert overlap(selection.labels() > 0, disk() & ~disk(half=True)) > 0.9
    selection.clear()
    assert not selection.labels().any()


def test_clicks_into_a_given_mask_divide_it_and_never_leave_it() -> None:
    selection = Selection(scene(), given=disk().astype(np.uint8))
    selection.click(75, 40, 2)
    labels = selection.labels()
    assert not (labels > 0)[~disk()].any()
    assert overlap(labels == 2, disk(half=True)) > 0.9
    assert overlap(labels == 1, disk() & ~disk(half=True)) > 0.9


def test_strokes_count_more_than_clicks_and_regions_have_no_gap() -> None:
    selection = Selection(scene())
    selection.click(45, 40, 1)
    covered = np.zeros((80, 120), bool)
    covered[:10, :10] = True
    selection.paint(covered, 4)
    labels = selection.labels()
    assert (labels[:10, :10] == 2).all() and labels.max() == 2


def test_a_stroke_is_carried_on_to_the_edges_of_what_it_covers() -> None:
    selection = Selection(scene())
    covered = np.zeros((80, 120), bool)
    covered[30:50, 45:75] = True  # over the grey half and the red one
    selection.paint(covered, 1)
    assert overlap(selection.labels() > 0, disk()) > 0.95
    # strokes that take away are carried on as well, and win over earlier ones where both are
    covered = np.zeros((80, 120), bool)
    covered[30:50, 66:80] = True
    selection.paint(covered, 0)
    labels = selection.labels()
    assert not labels[covered].any()
    assert overlap(labels > 0, disk() & ~disk(half=True)) > 0.85


def look_alike() -> tuple[np.ndarray, np.ndarray]:
    """A disk before a wall of its colour: only a line of shade on its rim tells them apart."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:240, :320]
    distance = np.hypot(rows - 120, columns - 160)
    picture = np.full((240, 320, 3), 180.0) - 40 * np.exp(-((distance - 70) ** 2) / 6)[..., None]
    return np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(
        np.uint8
    ), distance < 70


def test_a_faint_rim_keeps_a_stroke_from_leaking_into_a_wall_of_the_same_colour() -> None:
    picture, inside = look_alike()
    selection = Selection(picture)
    stroke = np.zeros(inside.shape, bool)
    stroke[110:130, 110:210] = True
    selection.paint(stroke, 1)
    assert overlap(selection.labels() > 0, inside) > 0.85
    selection.superpixels = Superpixels.of(picture, lines=False)
    selection._made = None
    assert overlap(selection.labels() > 0, inside) < 0.7  # without edges along borders


@pytest.mark.parametrize("gap", [0, 8])
def test_a_line_around_the_object_finds_it(gap: int) -> None:
    picture, inside = look_alike()
    rows, columns = np.mgrid[:240, :320]
    line = np.abs(np.hypot(rows - 120, columns - 160) - 90) < 3
    line[:, 158 : 158 + gap] &= rows[:, 158 : 158 + gap] > 120  # not closed at the top
    selection = Selection(picture)
    selection.enclose(line, 0)  # whatever the radio button says
    labels = selection.labels()
    assert overlap(labels > 0, inside) > 0.9
    assert not labels[np.hypot(rows - 120, columns - 160) > 95].any()
    assert selection.undo() and not selection.labels().any()


def test_a_line_that_ends_at_the_frame_encloses_what_the_frame_cuts_off() -> None:
    line = np.zeros((100, 150), bool)
    line[40:43, :60] = line[40:, 57:60] = True  # from the left side to the lower one
    inside = enclosed(line)
    assert inside[45:, :55].all() and not inside[:39].any() and not inside[:, 62:].any()


def test_a_line_that_encloses_nothing_is_refused() -> None:
    selection = Selection(scene())
    line = np.zeros((80, 120), bool)
    line[40, 20:100] = True
    with pytest.raises(InputError, match="the line: expected a closed line around the object"):
        selection.enclose(line, 1)
    assert not selection.marks


def test_a_line_cuts_a_mask_of_a_file_off() -> None:
    selection = Selection(scene(), given=disk().astype(np.uint8))
    line = np.zeros((80, 120), bool)
    line[5:75, 30:33] = line[5:75, 57:60] = line[5:8, 30:60] = line[72:75, 30:60] = True
    selection.enclose(line, 1)
    labels = selection.labels()
    assert labels[40, 45] and not labels[:, 61:].any() and not labels[~disk()].any()


def test_strokes_end_at_a_number_and_go_on_after_one_is_undone() -> None:
    selection = Selection(scene())
    covered = np.zeros((80, 120), bool)
    covered[:10, :10] = True
    for _ in range(MOST_STROKES):
        selection.paint(covered, 1)
    with pytest.raises(InputError, match=f"the brush: expected at most {MOST_STROKES}"):
        selection.paint(covered, 1)
    assert len(selection.strokes) == MOST_STROKES
    selection.undo()
    selection.paint(covered, 1)


def test_undo_takes_back_what_came_last_whether_click_or_strokes() -> None:
    selection = Selection(scene())
    covered = np.zeros((80, 120), bool)
    covered[:10, :10] = True
    selection.click(45, 40, 1)
    selection.paint(covered, 1)
    selection.click(75, 40, 2)
    with_both = selection.labels()
    assert selection.undo() and selection.labels().max() == 1
    assert selection.undo() and not selection.labels()[:10, :10].any()
    assert with_both[0, 0] == 1 and with_both.max() == 2  # an earlier result is not written into
    assert selection.undo() and not selection.labels().any()
    assert not selection.undo()


def test_labels_are_made_once_for_the_same_marks() -> None:
    """A click on a large photograph otherwise makes them three times, each in seconds."""
    selection = Selection(scene())
    selection.click(45, 40, 1)
    labels = selection.labels()
    assert selection.labels() is labels
    selection.given = disk().astype(np.uint8)
    assert selection.labels() is not labels
    with pytest.raises(ValueError, match="read-only"):
        labels[0, 0] = 1


def test_strokes_on_the_picture_that_is_shown_cover_the_photograph(
    sessions: Sessions, tmp_path: Path
) -> None:
    """The brush paints on a picture of another size than the photograph's."""
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    height, width = session.opened().reduced().shape[:2]
    assert (width, height) == (800, 533)
    upper = np.zeros((height, width), bool)
    upper[: height // 2, : width // 2] = True
    session.opened().paint([upper, ~upper & False], 1)
    covered = session.opened().selection.strokes[0].covered
    assert covered.shape == (80, 120)
    assert covered[:40, :60].all() and not covered[41:].any() and not covered[:, 61:].any()
    assert session.opened().selection.labels()[:40, :60].all()
    with pytest.raises(InputError, match="strokes of the picture's size 800 × 533"):
        session.opened().paint([np.ones((80, 120), bool)], 1)


@pytest.mark.parametrize("place", [(-1, 0, 1), (120, 0, 1), (0, 80, 1), (0, 0, 9)])
def test_a_click_outside_is_refused(place: tuple[int, int, int]) -> None:
    with pytest.raises(InputError, match="a click: expected"):
        Selection(scene()).click(*place)


def test_every_material_has_a_picture_and_is_found_by_its_name() -> None:
    names = [*DESCRIBED, *load_catalogue()]
    assert list(gallery.tiles()) == names == gallery.search("")
    for name, picture in gallery.tiles().items():
        assert picture.shape == (gallery.TILE, gallery.TILE, 3) and picture.std() > 5
        assert name in gallery.search(name)


@pytest.mark.parametrize("word", ALIKE)
def test_an_everyday_word_finds_what_looks_like_it_first(word: str) -> None:
    known = [name for name in ALIKE[word] if name in load_catalogue()]
    result = gallery.search(word)
    assert set(known) <= set(result)
    assert word not in DESCRIBED or result[0] == word
    assert gallery.search("no such material") == []


def test_words_that_no_material_has_together_find_what_comes_near() -> None:
    catalogue = load_catalogue()
    assert gallery.search("blue velvet") == gallery.search("green leather") == []
    near = gallery.close_to("blue velvet")
    assert near and all("blue" in name for name in near)
    assert {catalogue[name].family for name in near} == {"fabric"}
    # only one of the words is known
    assert gallery.close_to("shiny unobtainium")[0] in gallery.search("shiny")
    assert gallery.close_to("unobtainium") == []
    assert gallery.found_by("hematite")[1] == "1 material"
    assert gallery.found_by("blue velvet") == (
        near,
        "No material is called “blue velvet”. These are close:",
    )
    assert "Try a colour" in gallery.found_by("unobtainium")[1]
    tiles = gallery.page_tiles(gallery.search("leather"), "materials.jpg", "leather")
    assert tiles.count("looks like leather") == 3


def decomposed(count: int = 2) -> decomposition.Decomposition:
    """A ball of two regions before a ground, decomposed by a network that knows it."""
    _, inside = ball(SIDE, RADIUS)
    regions = inside.astype(np.uint8)
    if count == 2:
        regions[:, SIDE // 2 :] *= 2
    picture = np.where(inside[..., None], 0.3, 0.1) * np.ones(3)
    opened = photograph.Photograph(
        "ball",
        picture.astype(np.float32),
        inside.astype(np.float32),
        regions,
        np.ones(3, np.float32),
        1.0,
    )
    return decomposition.decompose(opened, Knowing(label_of("blue-rubber")), 64)


def chosen(name: str) -> Chosen:
    return choices.named_material(name)


def test_the_view_is_the_layers_picture_and_a_blend_is_linear() -> None:
    result = decomposed()
    viewer = Viewer(result)
    edit = Edit((Painted(chosen("red-plastic")), Painted()))
    exact = viewer.view(edit, exact=True).astype(float)
    linear, display = viewer.full(edit)
    mask = result.photograph.mask
    assert np.sqrt(((exact - display)[mask] ** 2).mean()) < 2.0
    labels = [label_of("red-plastic")[0], None]
    expected = Compositor(result, 1e-2, DETAIL).edit(labels)
    assert np.allclose(linear, expected, rtol=1e-4, atol=1e-5)

    def full(painted: Painted) -> np.ndarray:
        return viewer.full(Edit((painted, Painted())))[0]

    a, b = chosen("red-plastic"), chosen("green-fabric")
    mixed = full(Painted(a, b, 0.3))
    assert np.allclose(mixed, 0.7 * full(Painted(a)) + 0.3 * full(Painted(b)), atol=1e-4)
    assert np.allclose(full(Painted(a, b, 1.0)), full(Painted(b)), atol=1e-6)


def test_a_metal_is_as_bright_in_the_view_as_in_full_named_or_read_from_a_picture() -> None:
    result = decomposed(1)
    viewer = Viewer(result)
    mask = result.photograph.mask
    metal = chosen("chrome-steel")
    bright = []
    for each in (metal, Chosen("other.png", label_of("ss440")[0], False, read=True)):
        edit = Edit((Painted(each),))
        linear, display = viewer.full(edit)
        exact = viewer.view(edit, exact=True).astype(float)
        assert np.sqrt(((exact - display)[mask] ** 2).mean()) < 3.0
        plain = Compositor(result, 1e-2, DETAIL).edit([each.label], [each.label])
        bright.append(linear[mask].mean() / plain[mask].mean())
    assert bright == pytest.approx([mirror_correction.factor(metal.label), 1], rel=1e-3)


def test_a_turned_light_changes_the_object_and_not_the_background() -> None:
    result = decomposed()
    viewer = Viewer(result)
    edit = Edit((Painted(), Painted()), choices.light_of(next(iter(choices.light_names())), 90))
    linear, _ = viewer.full(edit)
    outside = result.photograph.coverage == 0
    assert np.array_equal(linear[outside], result.photograph.radiance[outside])
    assert abs(linear - result.photograph.radiance)[result.photograph.mask].mean() > 1e-3
    shown = viewer.view(edit, exact=True)
    _, display = viewer.full(edit)
    assert np.sqrt(((shown.astype(float) - display) ** 2).mean()) < 2.0
    _, cut = viewer.full(Edit(edit.regions, edit.light, hide_background=True))
    assert cut.shape[-1] == 4 and not cut[..., 3][outside].any()


@pytest.mark.parametrize("transparent", ["nowhere", "around", "left"])
@pytest.mark.parametrize("turned", [0.0, 40.0])
@pytest.mark.parametrize("hidden", [False, True])
def test_the_quick_composition_is_that_of_the_full_one(
    transparent: str, turned: float, hidden: bool
) -> None:
    result = decomposed()
    opened = result.photograph
    coverage = gaussian_filter(opened.coverage, 1.0)
    opened = replace(opened, coverage=coverage, cut_out=transparent == "around")
    if transparent == "left":
        beside = np.arange(SIDE) < SIDE // 2
        opened = replace(opened, alpha=np.where(beside, coverage, 1).astype(np.float32))
    viewer = Viewer(replace(result, photograph=opened))
    light = choices.LightChoice(rotation_deg=turned)
    edit = Edit((Painted(chosen("brass")), Painted()), light, hide_background=hidden)
    radiance = np.zeros((viewer.small.side, viewer.small.side, 3), np.float32)
    radiance[:] = np.linspace(0, 1.2, viewer.small.side, dtype=np.float32)[:, None, None]
    linear = composed(viewer.small, radiance / viewer.exposure, edit)
    expected = displayed(linear, viewer.exposure, opened, hidden)
    np.testing.assert_array_equal(viewer._composed(radiance, edit), expected)


def test_a_hidden_background_is_not_mixed_into_the_objects_edge() -> None:
    result = decomposed()
    coverage = gaussian_filter(result.photograph.coverage, 1.0)
    viewer = Viewer(replace(result, photograph=replace(result.photograph, coverage=coverage)))
    cut = replace(viewer.decomposition.photograph, cut_out=True)
    both = (Painted(chosen("white-fabric")), Painted(chosen("white-fabric")))
    alone = viewer.full(Edit(both, hide_background=True))
    expected = Viewer(replace(result, photograph=cut)).full(Edit(both))
    for picture, right in zip(alone, expected, strict=True):
        np.testing.assert_array_equal(picture, right)


def test_a_positive_rotation_turns_the_light_as_rotations_of_jobs_do() -> None:
    own = np.zeros((64, 128, 3), np.float32)
    own[20, 10] = 5.0
    turned = choices.light_of(choices.OWN_LIGHT, 90.0).of(own)
    np.testing.assert_array_equal(turned, envmap.roll(own, 32))
    assert not np.array_equal(turned, envmap.roll(own, -32))


def test_brightness_changes_what_is_rendered_and_nothing_else() -> None:
    """In the view and at full size: a stop doubles radiance, and the background stays."""
    result = decomposed()
    viewer = Viewer(result)
    plain = Edit((Painted(chosen("green-fabric")), Painted()))
    darker = replace(plain, brightness_stops=-1.0)
    shown = [viewer.view(edit, exact=True).astype(float) for edit in (plain, darker)]
    linear = [viewer.full(edit)[0] for edit in (plain, darker)]
    inside = binary_erosion(result.photograph.regions == 1, iterations=4)
    others = ~binary_dilation(result.photograph.regions == 1, iterations=4)
    np.testing.assert_allclose(linear[1][inside], 0.5 * linear[0][inside], rtol=1e-4)
    assert (shown[1][inside] < shown[0][inside] - 5).all()
    for one, two in (shown, linear):
        np.testing.assert_array_equal(one[others], two[others])
    untouched = Edit((Painted(), Painted()), brightness_stops=2.0)
    np.testing.assert_array_equal(viewer.view(untouched), viewer.before())
    command = edit_file.command_line(darker, "a.png", [], True, True, built_in_weights.EDITING)
    assert "--brightness -1 --material green-fabric+keep" in command


def test_the_photographs_own_shading_is_kept_as_far_as_the_user_says() -> None:
    """In the view, at full size and in the command; not under another light."""
    result = decomposed()
    viewer = Viewer(result)
    none = Edit((Painted(chosen("green-fabric")), Painted()), detail=0.0)
    edits = [replace(none, detail=d) for d in (0.0, 0.5, 1.0)]
    linear = [viewer.full(edit)[0] for edit in edits]
    inside = binary_erosion(result.photograph.regions == 1, iterations=4)
    half, whole = (each[inside] / linear[0][inside] for each in linear[1:])
    np.testing.assert_allclose(whole, half**2, rtol=1e-3)
    assert abs(np.log(whole)).max() > 0.05
    for edit, full in zip(edits, linear, strict=True):
        shown = viewer.view(edit, exact=True).astype(float)
        difference = shown - 255 * np.clip(tone.srgb(full * viewer.exposure), 0, 1)
        assert np.sqrt((difference[inside] ** 2).mean()) < 2.0
    lit = [replace(edit, light=choices.light_of(choices.OWN_LIGHT, 90.0)) for edit in edits[::2]]
    np.testing.assert_array_equal(*(viewer.full(edit)[0] for edit in lit))
    for edit, words in zip(edits, ("--detail 0 ", "", "--detail 1 "), strict=True):
        command = edit_file.command_line(edit, "a.png", [], True, True, built_in_weights.EDITING)
        assert words in command and ("--detail" in command) == bool(words)
    assert "own shading 0%" in none.caption and "shading" not in edits[1].caption


def test_an_exact_view_gives_way_to_a_later_choice() -> None:
    viewer = Viewer(decomposed())
    edit = Edit((Painted(chosen("brass")), Painted()))
    with pytest.raises(Superseded):
        viewer.view(edit, exact=True, is_current=lambda: False)
    assert not viewer.is_exact(edit)


def test_a_coarse_map_is_read_at_the_nodes_of_a_finer_one() -> None:
    def plane(side: int) -> np.ndarray:
        at = (np.arange(side + 5) - 2) * 2 / side - 1
        x, y = np.meshgrid(at, at)
        return np.stack([x + 3, y + 3, x * y + 3], -1).astype(np.float32)

    inner = np.s_[3:-3, 3:-3]
    assert np.allclose(
        reflectance_store.upsample(plane(16), 69)[inner], plane(64)[inner], atol=1e-4
    )


def test_edit_json_may_name_a_material_as_it_was_measured(tmp_path: Path) -> None:
    text = '{"regions": [{"first": {"text": "measured(brass)"}}]}'
    (tmp_path / "edit.json").write_text(text)
    (painted,) = edit_file.read(tmp_path / "edit.json").regions
    label = load_catalogue()["brass"].label.reshape(-1).astype(np.float32)
    np.testing.assert_array_equal(painted.first.label, label)


@pytest.mark.parametrize("map_of_own", [False, True])
def test_edit_json_brings_an_edit_back(tmp_path: Path, map_of_own: bool) -> None:
    read = Chosen("other.png", label_of("brass")[0], named=False, read=True)
    light = choices.light_of(next(iter(choices.light_names())), 45.0)
    if map_of_own:
        light = choices.LightChoice("mine.exr", 45.0, light.map)
    own = choices.principled_material(Principled("#a03020", 0.35, 0.0))
    edit = Edit((Painted(chosen("chrome"), read, 0.25), Painted(own)), light, True, -1.5, 0.8)
    edit_file.write(tmp_path / "edit.json", edit)
    again = edit_file.read(tmp_path / "edit.json")
    assert again.regions == edit.regions and again.hide_background
    assert again.brightness_stops == -1.5 and "brightness −1.5" in again.caption
    assert again.detail == 0.8 and "own shading 80%" in again.caption
    assert again.regions[0].second.read and not again.regions[0].first.read
    assert again.light.rotation_deg == 45.0
    assert again.light.map is not None and light.map is not None
    assert np.allclose(again.light.map, light.map, rtol=1e-5)


def test_a_damaged_edit_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    for text in ("{", '{"regions": []}', '{"regions": [{"first": {"text": "no-such"}}]}'):
        path.write_text(text)
        with pytest.raises(InputError):
            edit_file.read(path)
    path.write_text(json.dumps({"regions": [{}], "light": "x", "map": "../light.exr"}))
    with pytest.raises(InputError, match="same folder"):
        edit_file.read(path)


def test_a_map_without_a_name_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    path.write_text(json.dumps({"regions": [{}], "light": "x", "map": ""}))
    with pytest.raises(InputError, match="same folder, found an empty name"):
        edit_file.read(path)


def test_the_command_is_the_simplest_that_repeats_the_edit() -> None:
    plain = Edit((Painted(chosen("brass")), Painted()))
    default = built_in_weights.EDITING
    text = edit_file.command_line(plain, "my cup.png", ["regions.png"], False, True, default)
    assert text == (
        "brdfactory edit 'my cup.png' --regions regions.png --no-refine --material brass+keep"
        " --out edited"
    )
    blend = Edit((Painted(chosen("brass"), chosen("chrome")),))
    text = edit_file.command_line(blend, "a.png", ["mask.png"], True, False, default)
    assert text == (
        "brdfactory app a.png --mask mask.png --no-fit-mask --repeat edit.json --out edited"
    )
    for edit, files in ((plain, ["regions.png"]), (blend, ["mask.png"])):
        text = edit_file.command_line(edit, "a.png", files, True, True, default, "box")
        assert f"{files[0]} --shape box --" in text


@pytest.mark.parametrize("blended", [False, True])
@pytest.mark.parametrize("text", ["general-two-encoders", "own run/weights.safetensors"])
def test_the_command_takes_the_weights_that_decomposed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, blended: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    weights = options.weights_file(text)
    second = chosen("chrome") if blended else None
    edit = Edit((Painted(chosen("brass"), second),))
    line = edit_file.command_line(edit, "a.png", ["mask.png"], True, True, weights)
    *_, option, named = shlex.split(line)
    assert option == "--weights" and (named == text or Path(named).is_absolute())
    monkeypatch.chdir("/")
    assert options.weights_file(named) == tmp_path / weights


@pytest.fixture
def sessions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sessions:
    network = Network(Path("known.safetensors"))
    known = (Knowing(label_of("blue-rubber")), {"size": 64})
    monkeypatch.setattr(network, "loaded", lambda: known)
    return Sessions(tmp_path, network)


def photo_in(folder: Path) -> Path:
    path = folder / "sent.png"
    Image.fromarray(scene()).save(path)
    return path


def test_sessions_do_not_mix_and_delete_their_files(sessions: Sessions, tmp_path: Path) -> None:
    path = photo_in(tmp_path)
    sessions.begin("two")
    one, two = sessions.of("one"), sessions.of("two")
    one.load(path)
    one.opened().click(45 * one.opened().scale, 40 * one.opened().scale, 1)
    assert sessions.of("one") is one and two.photograph is None and one.folder != two.folder
    with pytest.raises(InputError, match="a photograph"):
        two.opened().overlay()
    view = one.write_view(one.opened().overlay())
    for _ in range(6):
        one.write_view(one.opened().overlay())
    assert not view.exists() and len(list(one.folder.glob("view-*"))) == 4
    sessions.close("one")
    assert not one.folder.exists() and two.folder.exists() and one.stop.is_set()
    for number in range(40):
        sessions.of(f"page {number}")
    assert len(sessions) == 16 and not two.folder.exists()
    sessions.close_all()
    assert [each for each in tmp_path.iterdir() if each.is_dir()] == []


def decompose(session: Session, refine: bool) -> list[float]:
    return [report.share for report in session.decompose(refine)]


def test_a_session_decomposes_chooses_and_writes_all_files(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    sessions.begin("one")
    session = sessions.of("one")
    with pytest.raises(InputError, match="choose a photograph first, in step 1"):
        session.decomposed()
    session.load(photo_in(tmp_path))
    with pytest.raises(InputError, match="mark the object in step 1 first"):
        session.decomposed()
    with pytest.raises(InputError, match="an object"):
        decompose(session, refine=False)
    session.opened().click(45 * session.opened().scale, 40 * session.opened().scale, 1)
    shares = decompose(session, refine=False)
    assert shares == sorted(shares) and shares[-1] > 0.9
    number = session.number
    session.choose(lambda edit: edit.with_region(0, Painted(chosen("green-fabric"))))
    assert session.number == number + 1
    made = downloads_of(session)
    assert [path.name for path in made.pictures] == ["sent-green-fabric.png"]
    assert made.work.name == "sent-work.zip"
    others = {path.name: path for path in made.others}
    names = {"edited.exr", "material.json", "command.txt", "edit.json", "mask.png"}
    assert names <= set(others)
    with Image.open(made.pictures[0]) as picture:
        assert picture.size == (120, 80)
    linear, alpha = photographs.read_exr(others["edited.exr"])
    assert linear.shape == (80, 120, 3) and (alpha == 1).all()
    session.choose(lambda edit: replace(edit, hide_background=True))
    others = {path.name: path for path in downloads_of(session).others}
    _, alpha = photographs.read_exr(others["edited.exr"])
    assert alpha[0, 0] == 0 and alpha[40, 45] == 1
    text = made.command
    assert text.startswith("brdfactory edit sent.png --mask mask.png --no-refine --material green")
    assert text.endswith(f"--weights {Path('known.safetensors').resolve()}")


def test_the_mask_that_is_written_is_the_one_that_was_given(
    sessions: Sessions, tmp_path: Path
) -> None:
    """One with a line of a pixel, which a second softening would shorten."""
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    given = np.where(disk(), 255, 0).astype(np.uint8)
    given[40, 5:32] = 255
    Image.fromarray(given).save(tmp_path / "mask.png")
    session.give_mask(tmp_path / "mask.png")
    decompose(session, refine=False)
    session.opened().click(
        45 * session.opened().scale, 40 * session.opened().scale, 2
    )  # not decomposed any more
    opened = session.decomposed()[0].decomposition.photograph
    assert download_files.write_masks(session, tmp_path, opened) == ["mask.png"]
    again = photograph.open_photograph(
        tmp_path / "sent.png", [tmp_path / "mask.png"], fit_mask=None
    )
    np.testing.assert_array_equal(again.coverage, opened.coverage)
    np.testing.assert_array_equal(again.regions, opened.regions)


@pytest.mark.parametrize("parts", [1, 2])
def test_masks_by_hand_are_fitted_and_written_as_they_were_given(
    sessions: Sessions, tmp_path: Path, parts: int
) -> None:
    """They are fitted again when they are read; what was fitted already would move farther."""
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    columns = np.arange(120)
    small = binary_erosion(disk(), iterations=2)
    session.opened().selection.paint(small, 1)
    if parts == 2:
        session.opened().selection.paint(small & (columns > 45), 2)
    marked = session.opened().selection.labels()
    decompose(session, refine=False)
    opened = session.decomposed()[0].decomposition.photograph
    assert ((opened.regions > 0) != (marked > 0)).sum() > 5  # what is drawn follows edges itself
    names = download_files.write_masks(session, tmp_path, opened)
    assert names == (["mask.png"] if parts == 1 else ["regions.png"])
    with Image.open(tmp_path / names[0]) as picture:
        written = np.array(picture)
    np.testing.assert_array_equal(written, 255 * marked if parts == 1 else marked)
    masks = [tmp_path / "mask.png"] if parts == 1 else []
    regions = tmp_path / "regions.png" if parts == 2 else None
    again = photograph.open_photograph(tmp_path / "sent.png", masks, regions, fit_mask=None)
    np.testing.assert_array_equal(again.regions, opened.regions)


def test_without_the_fit_the_masks_edge_stays_in_the_edit_in_saved_work_and_in_the_command(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    session.opened().selection.paint(binary_erosion(disk(), iterations=2), 1)
    marked = session.opened().selection.labels()
    decompose(session, refine=False)
    session.choose(lambda edit: edit.with_region(0, Painted(chosen("brass"))))
    fitted = session.decomposed()[0].decomposition.photograph.regions
    assert (fitted != marked).sum() > 5

    session.fit_mask = False
    made = downloads_of(session)  # of what was decomposed, which is as it was
    assert "--no-fit-mask" not in made.command and saved_in(made.work)["fit_mask"]
    decompose(session, refine=False)
    kept = session.decomposed()[0].decomposition.photograph
    np.testing.assert_array_equal(kept.regions, marked)
    assert session.edit is not None and session.edit.caption == "brass"  # it goes on
    made = downloads_of(session)
    assert "--no-fit-mask" in made.command and not saved_in(made.work)["fit_mask"]
    other = sessions.of("two")
    other.load_work(made.work)
    assert other.fit_mask is False
    decompose(other, refine=False)
    again = other.decomposed()[0].decomposition.photograph
    np.testing.assert_array_equal(again.regions, marked)


def saved_in(work: Path) -> dict:
    """What saved work says of the photograph and its decomposition."""
    with zipfile.ZipFile(work) as archive:
        return json.loads(archive.read("work.json"))


def normals_in(session: Session) -> np.ndarray:
    """The normals (N, 3) of what was decomposed, in the object."""
    decomposed = session.decomposed()[0].decomposition
    return decomposed.parts.n[0].movedim(0, -1).numpy()[decomposed.framed.mask]


@pytest.mark.parametrize("refine", [False, True])
def test_a_named_shape_has_its_normals_in_the_edit_in_saved_work_and_in_the_command(
    sessions: Sessions, tmp_path: Path, plain_material_files: None, refine: bool
) -> None:
    session = sessions.of("one")
    session.shape = "flat"  # chosen before the first photograph
    session.load(photo_in(tmp_path))
    assert session.shape == "flat"
    session.shape = None
    session.opened().selection.paint(disk(), 1)
    decompose(session, refine=False)
    session.choose(lambda edit: edit.with_region(0, Painted(chosen("brass"))))
    assert normals_in(session).std(0).max() > 0.2

    session.shape = "flat"
    made = downloads_of(session)  # of what was decomposed, which is as it was
    assert "--shape" not in made.command and saved_in(made.work)["shape"] is None
    decompose(session, refine)
    assert normals_in(session).std(0).max() < 1e-3
    assert session.edit is not None and session.edit.caption == "brass"  # it goes on
    made = downloads_of(session)
    assert "--shape flat" in made.command and saved_in(made.work)["shape"] == "flat"
    other = sessions.of("two")
    other.load_work(made.work)
    assert other.shape == "flat"
    decompose(other, refine)
    np.testing.assert_array_equal(normals_in(other), normals_in(session))
    session.load(tmp_path / "sent.png")  # another object, perhaps
    assert session.shape is None


def test_a_shape_that_does_not_suit_the_mask_is_said_beside_the_edit(
    sessions: Sessions, tmp_path: Path
) -> None:
    pytest.importorskip("gradio", reason="gradio is not installed (extra app)")
    from learn.app.edit_view import first_values, shape_line
    from learn.app.material_tab import MaterialTab
    from learn.app.object_tab import GUESSED, SHAPES, ObjectTab

    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    oblong = np.zeros((80, 120), bool)
    oblong[30:50, 20:100] = True
    session.opened().selection.paint(oblong, 1)
    session.fit_mask = False
    lines = {}
    tab = ObjectTab.__new__(ObjectTab)
    tab.session_of = lambda request: session
    for _, name in SHAPES:
        tab.take_shape(name, None)
        assert session.shape == (None if name == GUESSED else name)
        decompose(session, refine=False)
        lines[name] = shape_line(session)
        assert first_values(session)[4] == lines[name]
    assert [name for name in lines if name != GUESSED] == list(PRIMITIVES)
    warned = lines.pop("ball")
    assert warned.startswith("The outline of a ball overlaps the mask by only ")
    assert warned.endswith("correct the mask, or choose “Guess it” in step 1.")
    assert lines[GUESSED] == lines["flat"] == ""

    session.shape = "ball"
    edits = MaterialTab.__new__(MaterialTab)
    edits.session_of, edits.views = tab.session_of, [None] * 5
    *_, (*_, done) = edits.improved(None)
    assert done == f"Light and material are fitted more closely to the photograph now. {warned}"
    *_, (*_, again) = edits.improved(None)
    assert again == f"Light and material are improved already. {warned}"


@pytest.mark.parametrize(
    ("shape", "overlap", "warns"),
    [("box", 0.94, True), ("box", 0.95, False), ("flat", 1.0, False), (None, None, False)],
)
def test_only_a_shape_with_a_poor_outline_is_doubted(
    shape: str | None, overlap: float | None, warns: bool
) -> None:
    line = decomposition.shape_warning(shape, overlap, "leave --shape out")
    expected = (
        "The outline of a box overlaps the mask by only 94%: if edits look wrong, correct the mask,"
        " or leave --shape out"
    )
    assert line == (expected if warns else "")


@pytest.mark.parametrize(("key", "meant"), [("fit_mask", True), ("shape", None)])
def test_saved_work_that_says_nothing_of_the_fit_or_the_shape_is_decomposed_as_it_was(
    sessions: Sessions, tmp_path: Path, plain_material_files: None, key: str, meant: bool | None
) -> None:
    before = downloads_of(saved_by(sessions, tmp_path)).work
    old = tmp_path / "old.zip"
    with zipfile.ZipFile(before) as archive, zipfile.ZipFile(old, "w") as written:
        for name in archive.namelist():
            data = archive.read(name)
            if name == "work.json":
                manifest = json.loads(data)
                del manifest[key]
                data = json.dumps(manifest).encode()
            written.writestr(name, data)
    session = sessions.of("two")
    session.fit_mask, session.shape = False, "box"
    session.load_work(old)
    assert getattr(session, key) is meant


@pytest.mark.parametrize(("option", "is_fitted"), [([], True), (["--no-fit-mask"], False)])
def test_a_repeated_edit_fits_the_masks_edge_unless_told_not_to(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    option: list[str],
    is_fitted: bool,
) -> None:
    from brdfactory.command_line import run

    monkeypatch.chdir(tmp_path)
    photo_in(tmp_path)
    small = binary_erosion(disk(), iterations=2)
    Image.fromarray(np.where(small, 255, 0).astype(np.uint8)).save("mask.png")
    edit_file.write(Path("edit.json"), Edit((Painted(chosen("brass")),), hide_background=True))
    words = ["app", "sent.png", "--mask", "mask.png", "--repeat", "edit.json", "--out", "again"]
    assert run([*words, "--no-refine", *option]) == 0
    capsys.readouterr()
    with Image.open("again/edited.png") as picture:
        opacity = np.asarray(picture)[..., 3]
    moved = ((opacity > 127) != small).sum()
    assert moved > 20 if is_fitted else moved == 0


@pytest.mark.parametrize("command_name", ["app", "edit"])
def test_a_repeated_edit_has_the_shape_that_is_named_and_says_where_it_does_not_suit(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    command_name: str,
) -> None:
    from brdfactory.command_line import run

    monkeypatch.chdir(tmp_path)
    photo_in(tmp_path)
    oblong = np.zeros((80, 120), bool)
    oblong[28:52, 15:105] = True
    Image.fromarray(np.where(oblong, 255, 0).astype(np.uint8)).save("mask.png")
    edit_file.write(Path("edit.json"), Edit((Painted(chosen("brass")),)))
    material = ["--material", "brass"] if command_name == "edit" else ["--repeat", "edit.json"]
    words = [command_name, "sent.png", "--mask", "mask.png", "--no-fit-mask", "--no-refine"]
    pictures = {}
    for shape in (None, "flat", "ball"):
        named = [] if shape is None else ["--shape", shape]
        assert run([*words, *material, *named, "--out", f"{shape}"]) == 0
        said = capsys.readouterr().out
        warns = "The outline of a ball overlaps the mask by only" in said
        assert warns == (shape == "ball") and ("or leave --shape out" in said) == warns
        (path,) = {*Path(f"{shape}").glob("edited.png"), *Path(f"{shape}").glob("*brass*.png")}
        with Image.open(path) as picture:
            pictures[shape] = np.asarray(picture.convert("RGB"), float)[34:46, 25:95]
    differs = [np.abs(pictures[shape] - pictures[None]).mean() for shape in ("flat", "ball")]
    assert min(differs) > 3


def test_a_material_file_of_several_regions_gives_each_its_own_or_is_refused(
    sessions: Sessions, tmp_path: Path
) -> None:
    pytest.importorskip("gradio", reason="gradio is not installed (extra app)")
    from learn.app.edit_controls import FIRST
    from learn.app.material_tab import MaterialTab, gr

    session = sessions.of("one")
    session.viewer = Viewer(decomposed(2))
    session.edit = Edit((Painted(), Painted()))
    tab = MaterialTab.__new__(MaterialTab)
    tab.session_of = lambda request: session
    names = ("brass", "red-fabric", "chrome")

    def send(count: int, region: int = 2) -> str:
        """Send a file of so many regions for one region; the line that the page shows."""
        labels = [chosen(name).label.tolist() for name in names[:count]]
        stored = {"label": labels[0]} if count == 1 else {"labels": labels}
        (tmp_path / "material.json").write_text(json.dumps(stored))
        _, text = tab.take_material(region, FIRST, str(tmp_path / "material.json"), None)
        return str(text)

    assert "part 1: as it is; part 2: material.json. Left of the line: the photograph." in send(1)
    assert session.edit.regions == (Painted(), Painted(chosen("brass")))
    assert "material.json, region 1; part 2: material.json, region 2. Left" in send(2)
    assert session.edit.regions == (Painted(chosen("brass")), Painted(chosen("red-fabric")))
    with pytest.raises(gr.Error) as caught:
        send(3)
    assert str(caught.value.message) == (
        "<b>Give the photograph these regions, or keep one label in the file.</b><br>"
        "material.json: expected one material, or 2: one for each region, found 3."
    )
    assert session.edit.regions == (Painted(chosen("brass")), Painted(chosen("red-fabric")))
    session.viewer, session.edit = Viewer(decomposed(1)), Edit((Painted(),))
    with pytest.raises(gr.Error, match="expected one material, found 2"):
        send(2, region=1)


def downloads_of(session: Session, lines: list[str] | None = None) -> Downloads:
    """The files for download; `lines` is given what is said meanwhile."""
    steps = download_files.write(session)
    while True:
        try:
            line = next(steps)
        except StopIteration as ended:
            return ended.value
        if lines is not None:
            lines.append(line)


@pytest.fixture
def plain_material_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """The material.json of a stand-in for a network is not written, for which it has no weights."""
    monkeypatch.setattr(
        "learn.editing.material_file.write",
        lambda path, *rest: path.write_text("{}"),
    )


def saved_by(sessions: Sessions, tmp_path: Path) -> Session:
    """A session with two parts by clicks, an edit and two kept ones."""
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    session.opened().click(45 * session.opened().scale, 40 * session.opened().scale, 1)
    session.opened().click(75 * session.opened().scale, 40 * session.opened().scale, 2)
    decompose(session, refine=False)
    light = choices.light_of(next(iter(choices.light_names())), 45.0)
    own = choices.LightChoice("mine.exr", 45.0, light.map)
    for name, lit in (("brass", choices.LightChoice()), ("red-fabric", own)):
        session.choose(
            lambda e, n=name, lit=lit: replace(e.with_region(0, Painted(chosen(n))), light=lit)
        )
        session.keep()
    session.choose(lambda e: replace(e, brightness_stops=0.5))
    return session


def test_the_row_of_kept_pictures_marks_none_that_was_removed(
    sessions: Sessions, tmp_path: Path
) -> None:
    pytest.importorskip("gradio", reason="gradio is not installed (extra app)")
    from learn.app.edit_view import kept_row

    session = saved_by(sessions, tmp_path)
    kept = session.kept[0]
    session.put_beside(kept)
    assert kept_row(session).count('aria-pressed="true"') == 1
    session.keep()
    session.forget(kept)
    session.put_beside(kept)  # of which a click came late
    assert 'aria-pressed="true"' not in kept_row(session)


def test_kept_pictures_are_compared_brought_back_and_removed(
    sessions: Sessions, tmp_path: Path
) -> None:
    session = saved_by(sessions, tmp_path)
    session.keep()
    session.keep()  # the same once more
    assert len(session.kept) == 3
    session.put_beside(session.kept[1])
    assert session.left == str(session.kept[1].picture)
    path = session.kept[1].picture
    kept = session.kept_edit(path.name)
    session.forget(kept)
    assert not path.exists() and session.left == session.before
    assert [each.edit.brightness_stops for each in session.kept] == [0, 0.5]
    # a second click on the same button does not mean the picture that took its place
    with pytest.raises(InputError, match="a kept picture"):
        session.kept_edit(path.name)
    session.forget(kept)
    session.put_beside(kept)  # of which a click came late
    assert len(session.kept) == 2 and session.beside is None
    for number in range(10):
        session.choose(lambda e, n=number: replace(e, brightness_stops=-n / 10))
        session.keep()
    assert len(session.kept) == 12
    session.choose(lambda e: replace(e, brightness_stops=-2.0))
    with pytest.raises(InputError, match="at most 12 kept pictures"):
        session.keep()
    # another decomposition of the same photograph keeps them
    decompose(session, refine=False)
    assert len(session.kept) == 12 and all(each.picture.exists() for each in session.kept)
    session.load(tmp_path / "sent.png")
    assert session.kept == []


def test_pictures_for_download_are_named_after_photograph_and_material(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    session = saved_by(sessions, tmp_path)
    lines: list[str] = []
    made = downloads_of(session, lines)
    assert [line.split("size")[1] for line in lines] == [
        f", picture {number} of 3 …" for number in (1, 2, 3)
    ]
    assert [path.name for path in made.pictures] == [
        "sent-part-1-red-fabric-part-2-as-it-is-light-mine-exr-turned-by-45-brightness-pl.png",
        "sent-part-1-brass-part-2-as-it-is.png",
        "sent-part-1-red-fabric-part-2-as-it-is-light-mine-exr-turned-by-45.png",
        "sent-compared.jpg",
    ]
    for path in made.pictures[:3]:
        with Image.open(path) as picture:
            assert picture.size == (120, 80)
    session.opened().name = "Stuhl für Frau Öz (2).JPG"
    assert download_files.stem_of(session) == "Stuhl-für-Frau-Öz-2"


def test_saved_work_brings_photograph_mask_and_edits_back(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    session = saved_by(sessions, tmp_path)
    work = tmp_path / "work.zip"
    work.write_bytes(downloads_of(session).work.read_bytes())
    other = sessions.of("two")
    assert "Your saved work is open" in other.load_work(work)
    assert other.opened().name == "sent.png" and other.refined is False
    np.testing.assert_array_equal(
        other.opened().selection.labels(), session.opened().selection.labels()
    )
    decompose(other, refine=False)
    assert other.edit is not None and session.edit is not None
    assert other.edit.caption == session.edit.caption
    assert other.edit.regions == session.edit.regions
    assert [k.edit.caption for k in other.kept] == [k.edit.caption for k in session.kept]
    a, b = (each.decomposed()[0].view(each.edit, True) for each in (session, other))
    np.testing.assert_array_equal(a, b)
    assert not list(other.folder.glob("work-*"))  # nothing is left of what was unpacked


def test_saved_work_of_the_largest_photograph_opens_again_and_a_larger_one_is_refused(
    sessions: Sessions,
    tmp_path: Path,
    plain_material_files: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = saved_by(sessions, tmp_path)
    sent = session.opened().path.read_bytes()
    more = work_file.MOST_BYTES - opening.MOST_BYTES
    monkeypatch.setattr(opening, "MOST_BYTES", len(sent))
    monkeypatch.setattr(work_file, "MOST_BYTES", len(sent) + more)
    work = tmp_path / "work.zip"
    work.write_bytes(downloads_of(session).work.read_bytes())
    assert work.stat().st_size > len(sent)
    assert "Your saved work is open" in sessions.of("two").load_work(work)
    larger = tmp_path / "larger.png"
    larger.write_bytes(sent + b"-")
    with pytest.raises(InputError, match=r"larger.png: expected at most .*save it smaller"):
        sessions.of("three").load(larger)


def test_saved_work_of_other_hands_is_refused(sessions: Sessions, tmp_path: Path) -> None:
    session = sessions.of("one")
    path, edit = tmp_path / "work.zip", json.dumps({"regions": [{}]})
    good = {"work.json": json.dumps({"photograph": "a.png", "refined": False}), "edit.json": edit}

    def refused(match: str) -> None:
        with pytest.raises(InputError, match=match):
            session.load_work(path)
        assert session.photograph is None and not list(session.folder.iterdir())
        assert not (tmp_path / "outside.json").exists()

    def write(members: dict[str, str | bytes], method: int = zipfile.ZIP_DEFLATED) -> None:
        with zipfile.ZipFile(path, "w", method) as archive:
            for name, text in members.items():
                archive.writestr(name, text)

    path.write_bytes(b"no archive")
    refused("saved work, a zip archive")
    for name in ("../outside.json", "/outside.json", "kept-1/../../outside.json", "a.pkl"):
        write({**good, name: "{}"})
        refused("expected saved work, found")
    write({**good, "photograph.png": b"\0" * 1000}, zipfile.ZIP_LZMA)
    refused("expected saved work, found")
    write({"edit.json": edit})
    refused("saved work, with work.json")
    write(good)
    refused("one photograph, found 0")
    write({**good, "work.json": '{"photograph": "a.png", "refined": false, "kept": 13}'})
    refused("kept")
    named = '{"photograph": "a.png", "refined": false, "shape": %s}'
    write({**good, "work.json": named % '"teapot"'})
    refused(
        r"^work\.zip: work\.json: shape: expected one of box, cylinder, ball, flat, found 'teapot'"
        r" \(choose a file that “Download” made, NAME-work\.zip\)$"
    )
    write({**good, "work.json": named % "5"})
    refused(r"^work\.zip: work\.json: shape: expected")
    write({**good, "photograph.png": b"\0" * (130 << 20)})  # 130 KB as an archive
    refused("at most 128 MiB")
    write({**good, "photograph.png": b"no picture"})
    refused("work.zip: photograph.png: expected a picture")
    # a size in its table that is too small
    write({**good, "photograph.png": b"\0" * 5000})
    data = path.read_bytes()
    path.write_bytes(data.replace((5000).to_bytes(4, "little"), (50).to_bytes(4, "little")))
    refused("saved work, a zip archive")


def test_a_long_table_of_files_or_a_name_that_is_no_text_is_refused(
    sessions: Sessions, tmp_path: Path
) -> None:
    session, path = sessions.of("one"), tmp_path / "work.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(300):
            archive.writestr(f"{number}.txt", "")
    with pytest.raises(InputError, match="few files, found a long table"):
        session.load_work(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("wörk.json", "{}")  # the name is marked as UTF-8
    path.write_bytes(path.read_bytes().replace("wörk".encode(), b"w\xff\xffrk"))
    with pytest.raises(InputError, match=r"work\.zip: expected saved work, a zip archive"):
        session.load_work(path)


def test_saved_work_with_a_damaged_mask_leaves_what_is_open(
    sessions: Sessions, tmp_path: Path
) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    session.opened().click(60, 40, 1)
    before, path = session.opened(), tmp_path / "work.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(photo_in(tmp_path), "photograph.png")
        archive.writestr("mask.png", b"no picture")
        archive.writestr("edit.json", json.dumps({"regions": [{}]}))
        archive.writestr("work.json", json.dumps({"photograph": "a.png", "refined": False}))
    with pytest.raises(InputError, match=r"work\.zip: mask\.png: expected") as refusal:
        session.load_work(path)
    assert session.opened() is before and before.selection.clicks
    assert str(session.folder) not in str(refusal.value)
    with zipfile.ZipFile(path, "w") as archive:  # one kept picture is named, and none is there
        archive.write(photo_in(tmp_path), "photograph.png")
        archive.writestr("edit.json", json.dumps({"regions": [{}]}))
        kept = {"photograph": "a.png", "refined": False, "kept": 1}
        archive.writestr("work.json", json.dumps(kept))
    with pytest.raises(InputError) as refusal:
        session.load_work(path)
    assert str(tmp_path) not in str(refusal.value)


@pytest.mark.parametrize("name", ["photo.jpg_large", "photo", "x.j", "photo.jpg~"])
def test_work_on_a_photograph_of_any_name_can_be_opened_again(
    sessions: Sessions, tmp_path: Path, plain_material_files: None, name: str
) -> None:
    session = sessions.of("one")
    named = tmp_path / name
    named.write_bytes(photo_in(tmp_path).read_bytes())
    session.load(named)
    session.opened().click(60, 40, 1)
    decompose(session, refine=False)
    work = tmp_path / "work.zip"
    work.write_bytes(downloads_of(session).work.read_bytes())
    other = sessions.of("two")
    other.load_work(work)
    assert other.opened().name == name


def test_downloads_hold_the_edits_of_the_moment_at_which_they_were_asked_for(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    session = saved_by(sessions, tmp_path)
    assert session.edit is not None
    caption, going = session.edit.caption, download_files.write(session)
    next(going)
    session.choose(lambda e: replace(e, brightness_stops=3.0))
    session.forget(session.kept[0])
    with pytest.raises(StopIteration) as end:
        while True:
            next(going)
    work = tmp_path / "work.zip"
    work.write_bytes(end.value.value.work.read_bytes())
    other = sessions.of("two")
    other.load_work(work)
    decompose(other, refine=False)
    assert other.edit is not None and other.edit.caption == caption
    assert len(other.kept) == len(session.kept) + 1


def test_saved_work_holds_its_own_photograph_if_another_is_opened_meanwhile(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    session = saved_by(sessions, tmp_path)
    path = session.opened().path
    first, going = path.read_bytes(), download_files.write(session)
    next(going)
    other = tmp_path / f"other{path.suffix}"
    Image.fromarray(scene()[::-1]).save(other)
    session.load(other)
    assert path.read_bytes() != first
    with pytest.raises(StopIteration) as end:
        while True:
            next(going)
    with zipfile.ZipFile(end.value.value.work) as archive:
        assert archive.read(path.name) == first
    assert not list(session.folder.glob("work-*"))


def test_pictures_are_compared_without_a_background_that_is_hidden(
    sessions: Sessions, tmp_path: Path, plain_material_files: None
) -> None:
    session = saved_by(sessions, tmp_path)
    sheets = []
    for hide in (False, True):
        session.choose(lambda e, hide=hide: replace(e, hide_background=hide))
        compared = next(p for p in downloads_of(session).pictures if p.suffix == ".jpg")
        with Image.open(compared) as picture:
            sheets.append(np.array(picture, float))
    green = [((sheet[..., 1] - sheet[..., 0]) > 50).sum() for sheet in sheets]
    # one of the three or more pictures shows its green ground no longer
    assert green[1] < green[0] * 0.8


def test_the_transparency_of_a_photograph_of_several_parts_is_not_fitted() -> None:
    """A pale rim of the object, of the colour that the transparent pixels hide, stays in it."""
    rows, columns = np.mgrid[:160, :160]
    distance = np.hypot(rows - 80, columns - 80)
    inside = distance < 60
    seen = np.where(columns[..., None] > 80, (60, 60, 200), (200, 60, 50))
    seen = np.where(distance[..., None] < 57, seen, 120)
    cut_out = np.dstack([seen, 255 * inside]).astype(np.uint8)
    parts = np.where(inside, 1 + (columns > 80), 0).astype(np.uint8)
    opened = photograph.from_arrays(cut_out, inside, parts, fit_mask=None)
    np.testing.assert_array_equal(opened.regions, parts)
    # where the background is seen, the edge is fitted to it
    shown = np.dstack([seen, np.full(inside.shape, 255)]).astype(np.uint8)
    fitted = photograph.from_arrays(shown, inside, parts, fit_mask=None)
    assert (fitted.regions != parts).sum() > 500


def test_a_thread_between_the_pixels_of_the_view_is_seen_in_its_material() -> None:
    whole = np.full((900, 2400, 3), 120, np.uint8)
    regions = np.zeros((900, 2400), np.uint8)
    regions[100:700, 300:900], regions[100:700, 1203] = 1, 2
    whole[regions > 0] = (200, 60, 50)
    opened = photograph.from_arrays(whole, None, regions)
    small = viewer.reduced(
        decomposition.decompose(opened, Knowing(label_of("brass")), 64), 640
    ).photograph
    assert set(np.unique(small.regions)) == {0, 1, 2}
    assert (small.coverage[small.regions == 2] > 0).all()


def test_names_from_a_file_are_shown_as_they_are() -> None:
    text = "![x](http://host/seen.png) <b>a_b</b>"
    assert without_markup(text) == ("\\!\\[x\\]\\(http://host/seen.png\\) \\<b\\>a\\_b\\</b\\>")


def test_a_page_whose_session_ended_is_told_so(sessions: Sessions) -> None:
    sessions.begin("new")
    with pytest.raises(InputError, match="choose a photograph first"):
        sessions.of("new").opened()
    with pytest.raises(InputError, match="is no longer kept"):
        sessions.of("served before the program was started again").opened()


def test_a_page_that_is_loaded_again_has_its_session_back_by_its_key_alone(
    sessions: Sessions,
) -> None:
    first = sessions.begin("first")
    other = sessions.begin("other")
    assert len({first.key, other.key}) == 2 and len(first.key) >= 43  # 256 random bits
    sessions.close_later("first", 0.2)  # the page is left, to be loaded again
    assert sessions.begin("again", first.key) is first
    time.sleep(0.5)
    assert sessions.of("again") is first and first.folder.exists()
    # neither no key, nor a part of one, nor the old page's name brings a session back
    for number, key in enumerate(("", first.key[:-1], first.key + "x", "ü", "\ud800")):
        assert sessions.begin(f"new {number}", key) not in (first, other)
    assert sessions.of("first") is not first and sessions.of("first").is_lost
    assert sessions.of("again") is first and sessions.of("other") is other


def test_a_page_that_is_left_has_a_moment_to_return(sessions: Sessions) -> None:
    """A browser that asks whether to leave a page has reported to Gradio that it is left."""
    folders = [sessions.of(name).folder for name in ("left", "stayed")]
    for name in ("left", "stayed", "unknown"):
        sessions.close_later(name, 0.2)
    time.sleep(0.05)
    sessions.of("stayed")
    time.sleep(0.5)
    assert [folder.exists() for folder in folders] == [False, True]
    # a session that began meanwhile under the same name stays
    sessions.close_later("stayed", 0.2)
    sessions.close("stayed")
    later = sessions.of("stayed")
    time.sleep(0.4)
    assert later.folder.exists()


def test_an_error_says_first_what_to_do() -> None:
    pytest.importorskip("gradio", reason="gradio is not installed (extra app)")
    from learn.app.event_handling import for_people

    error = InputError("a<b>.pdf", "a picture", "another format", "save it as PNG")
    assert for_people(error) == (
        "<b>Save it as PNG.</b><br>a&lt;b&gt;.pdf: expected a picture, found another format."
    )
    error = InputError("the page", "a photograph", "none", "choose a photograph first")
    assert for_people(error) == "Choose a photograph first."


def test_display_values_of_a_photograph_come_back_as_they_were() -> None:
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, 2)
    radiance = photograph.from_arrays(grey, np.ones((16, 16), bool)).radiance
    np.testing.assert_array_equal(display_of(radiance, 1.0), grey)
    linear = np.random.default_rng(0).uniform(-0.1, 3, (16, 16, 3)).astype(np.float32)
    expected = tone.display(linear, 0.5)
    np.testing.assert_allclose(display_of(linear, 0.5), expected, atol=0.52)


def test_a_very_dark_photograph_is_marked_on_a_brighter_picture(
    sessions: Sessions, tmp_path: Path
) -> None:
    session, dark = sessions.of("one"), tmp_path / "dark.png"
    Image.fromarray(scene() // 12).save(dark)
    assert "very dark" in session.load(dark)
    assert session.opened().selection.display.mean() > 5 * (scene() // 12).mean()
    session.opened().click(450, 270, 1)
    # what is edited is the photograph as it is
    assert session.opened().to_edit().radiance.max() < 0.01
    assert "very dark" not in session.load(photo_in(tmp_path))
    np.testing.assert_array_equal(session.opened().selection.display, scene())


def test_a_black_object_is_refused_in_the_words_of_the_page(
    sessions: Sessions, tmp_path: Path
) -> None:
    session, black = sessions.of("one"), tmp_path / "night.png"
    Image.new("RGB", (120, 80)).save(black)
    session.load(black)
    session.opened().click(450, 270, 1)
    with pytest.raises(InputError, match=r"night\.png: .*\(mark an object that can be seen"):
        session.opened().to_edit()


def test_nothing_is_darkened_before_the_first_click() -> None:
    selection = Selection(scene())
    np.testing.assert_array_equal(overlay.draw(selection, 1.0), scene())
    selection.click(45, 40, 1)
    assert (overlay.draw(selection, 1.0)[0] < scene()[0]).all()


def test_an_edit_goes_on_with_a_new_decomposition_of_the_same_parts(
    sessions: Sessions, tmp_path: Path
) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    session.opened().click(450, 270, 1)
    decompose(session, refine=False)
    session.choose(lambda edit: edit.with_region(0, Painted(chosen("brass"))))
    edit, viewer = session.edit, session.viewer
    list(session.decompose(refine=False, goes_on=True))
    assert session.edit == edit and session.viewer is not viewer
    session.opened().click(600, 270, 2)  # another number of parts
    list(session.decompose(refine=False, goes_on=True))
    assert session.edit == Edit((Painted(), Painted()))
    session.choose(lambda edit: edit.with_region(0, Painted(chosen("brass"))))
    decompose(session, refine=False)  # by the button of step 1
    assert session.edit == Edit((Painted(), Painted()))


def test_a_refinement_can_be_stopped(sessions: Sessions, tmp_path: Path) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    session.opened().click(45 * session.opened().scale, 40 * session.opened().scale, 1)
    with pytest.raises(Stopped):
        for report in session.decompose(refine=True):
            if "refining" in report.text:
                session.stop.set()
    assert session.viewer is None and session.opened().to_edit().count == 1


def test_a_refinement_does_not_replace_a_later_decomposition(
    sessions: Sessions, tmp_path: Path
) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    session.opened().click(45 * session.opened().scale, 40 * session.opened().scale, 1)
    improving = session.decompose(refine=True, goes_on=True)
    next(improving)
    session.opened().click(60 * session.opened().scale, 40 * session.opened().scale, 2)
    decompose(session, refine=False)  # of the mask as it is now
    later = session.viewer
    with pytest.raises(Stopped):
        list(improving)
    assert session.viewer is later and not session.refined


def test_a_transparent_photograph_has_its_mask(sessions: Sessions, tmp_path: Path) -> None:
    path = tmp_path / "cut.png"
    alpha = np.where(disk(), 255, 0).astype(np.uint8)
    Image.fromarray(np.dstack([scene(), alpha])).save(path)
    session = sessions.of("one")
    assert "transparent" in session.load(path)
    opened = session.opened().to_edit()
    assert opened.cut_out and opened.count == 1
    session.opened().click(75 * session.opened().scale, 40 * session.opened().scale, 2)
    assert session.opened().to_edit().count == 2


def test_files_of_masks_are_taken_or_refused(sessions: Sessions, tmp_path: Path) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    mask, small = tmp_path / "mask.png", tmp_path / "small.png"
    Image.fromarray(np.where(disk(), 255, 0).astype(np.uint8)).save(mask)
    Image.new("L", (10, 10), 255).save(small)
    session.give_mask(mask)
    assert np.array_equal(session.opened().to_edit().mask, disk())
    with pytest.raises(InputError, match="a mask of the picture's size 120 × 80"):
        session.give_mask(small)
    Image.fromarray(disk().astype(np.uint8) + disk(half=True)).save(mask)
    session.give_regions(mask)
    assert session.opened().to_edit().count == 2


def test_a_soft_masks_object_is_what_is_at_least_half_covered(
    sessions: Sessions, tmp_path: Path
) -> None:
    grey = np.where(disk(), 128, 0).astype(np.uint8)
    grey[:, :50][disk()[:, :50]] = 127
    half = disk().copy()
    half[:, :50] = False
    assert half.any() and (disk() & ~half).any()
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    mask, cut = tmp_path / "mask.png", tmp_path / "cut.png"
    Image.fromarray(grey).save(mask)
    session.give_mask(mask)
    np.testing.assert_array_equal(session.opened().selection.labels() > 0, half)
    np.testing.assert_allclose(session.opened().to_edit().coverage, grey / 255, atol=1e-6)
    Image.fromarray(np.dstack([scene(), grey])).save(cut)
    session.load(cut)
    np.testing.assert_array_equal(session.opened().selection.labels() > 0, half)


def test_a_large_photograph_is_refused_by_its_header(
    sessions: Sessions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_decoding, "MOST_DECODED", 1_000_000)
    path = tmp_path / "large.png"
    Image.new("RGB", (600, 500)).save(path)
    # pixels that are cut off would be noticed if they were decoded
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=r"at most 0\.25 megapixels"):
        sessions.of("one").load(path)


def test_the_place_of_the_cross_is_marked_as_a_click_is(sessions: Sessions, tmp_path: Path) -> None:
    by_keys, by_mouse = sessions.of("one"), sessions.of("two")
    for session in (by_keys, by_mouse):
        session.load(photo_in(tmp_path))  # 120 × 80, shown 800 pixels wide
    assert "the object, 40% from the left and 50% from" in mark_place(
        by_keys, 0, "[[0.4, 0.5], true]"
    )
    assert "part 2" in mark_place(by_keys, 2, "[[0.6, 0.5], true]")
    assert "not the object" in mark_place(by_keys, 2, "[[1, 1], false]")
    for column, row, region in ((320, 266.6, 1), (480, 266.6, 2), (799, 532, 0)):
        by_mouse.opened().click(column, row, region)
    assert by_keys.opened().selection.marks == by_mouse.opened().selection.marks


@pytest.mark.parametrize(
    "place",
    [
        *("", "null", "{}", None),
        *("[[0.5], true]", "[[1.1, 0], true]", "[[NaN, 0], true]"),
        f"[[{10**400}, 0], true]",
    ],
)
def test_a_cross_that_is_nowhere_marks_nothing(sessions: Sessions, tmp_path: Path, place) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    with pytest.raises(InputError, match="a place in the picture"):
        mark_place(session, 1, place)


def test_a_line_of_the_cross_is_what_the_brush_draws_along_its_corners(
    sessions: Sessions, tmp_path: Path
) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))  # 120 × 80; the object is a disk about its middle
    corners = [[0.2, 0.15], [0.6, 0.15], [0.6, 0.85], [0.2, 0.85]]
    said = mark_line(session, 1, json.dumps([corners, True]))
    assert said == "Marked what the line encloses as the object: 4 corners."
    selection = session.opened().selection
    (line,) = selection.lines
    assert line.region == 1
    for number, region in ((3, 3), (0, 1)):
        mark_line(session, number, json.dumps([corners, True]))
        assert selection.lines[-1].region == region
    rows, columns = np.nonzero(line.inside)
    # inside a line of 12 of 800 pixels along x = 24 and 72, y = 12 and 68
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (25, 70, 13, 66)
    selection.clear()
    said = mark_line(session, 2, "[[[0.25, 0.5], [0.5, 0.5]], false]")
    assert said == "Painted along the line as part 2."
    (stroke,) = selection.strokes
    rows, columns = np.nonzero(stroke.covered)
    assert stroke.region == 2 and set(rows) == {39, 40} and (columns == 30).any()
    assert "not the object" in mark_line(session, 0, "[[[0.1, 0.1]], false]")  # a dot
    assert selection.strokes[-1].region == 0 and selection.strokes[-1].covered.sum() >= 2


@pytest.mark.parametrize(
    ("line", "match"),
    [
        *((bad, "a place in the picture") for bad in ("", "null", None, "{}", "[3, true]")),
        ("[[[0.5, 0.5], [1.1, 0]], false]", "a place in the picture"),
        ("[[[0.5, 0.5], [0.6, 0.5]], true]", "3 to 1000 corners, found 2"),
        ("[[], false]", "1 to 1000 corners, found 0"),
        (json.dumps([[[0.5, 0.5]] * 1001, False]), "1 to 1000 corners, found 1001"),
        ("[[[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]], true]", "a closed line around the object"),
    ],
)
def test_a_line_of_the_cross_without_corners_marks_nothing(
    sessions: Sessions, tmp_path: Path, line, match
) -> None:
    session = sessions.of("one")
    session.load(photo_in(tmp_path))
    with pytest.raises(InputError, match=match):
        mark_line(session, 1, line)
    assert not session.opened().selection.marks


def test_a_photograph_of_many_megapixels_is_made_smaller(
    sessions: Sessions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_decoding, "MOST_PIXELS", 3_000)
    session = sessions.of("one")
    path = photo_in(tmp_path)  # 120 × 80
    said = session.load(path)
    height, width = session.opened().selection.size
    assert (height, width) == (40, 60) and "the edit has 60 × 40 pixels. Now click" in said
    whole = Image.fromarray(np.uint8(255 * disk()))
    whole.save(tmp_path / "whole.png")
    session.give_mask(tmp_path / "whole.png")
    assert session.opened().to_edit().radiance.shape == (40, 60, 3)


def test_the_command_refuses_what_it_cannot_do(
    capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from brdfactory.command_line import run

    monkeypatch.chdir(tmp_path)
    # a page that was served after all; Gradio may be missing
    page = types.SimpleNamespace(serve=lambda *rest: None)
    monkeypatch.setitem(sys.modules, "learn.app.page", page)

    for words, part in (
        (["--port", "0"], "a port from 1"),
        (["--host", "example.org"], "an address of this computer"),
        (["photo.png"], "--repeat FILE with it"),
        (["--repeat", "edit.json", "--out", "x"], "PHOTO"),
        (["--no-refine"], "--no-refine: expected --repeat FILE with it"),
        (["--refine"], "--refine: expected --repeat FILE with it"),
        (["--no-fit-mask"], "--no-fit-mask: expected --repeat FILE with it"),
        (["--fit-mask"], "--fit-mask: expected --repeat FILE with it"),
        (["--shape", "box"], "--shape: expected --repeat FILE with it"),
        (["--overwrite"], "--overwrite: expected --repeat FILE with it"),
        ([*REPEATED, "--host", "127.0.0.1"], "--host: expected no --repeat"),
        ([*REPEATED, "--port", "0"], "--port: expected no --repeat"),
        ([*REPEATED, "--open"], "--open: expected no --repeat"),
    ):
        assert run(["app", *words]) == 1
        assert part in capsys.readouterr().err
    assert command.LOCAL == "127.0.0.1"


def test_a_number_of_evaluations_is_reported() -> None:
    from learn.refinement import RefinementSettings
    from learn.refinement.settings import Level

    level = Level(pixels=0, light=(32, 64), method="auto", rounds=1, iterations=2)
    settings = RefinementSettings(levels=(level,), outer_iterations=1)
    reports: list[tuple[int, int]] = []
    result = decomposed(1)
    network = Knowing(label_of("blue-rubber"))
    watched = decomposition.decompose(
        result.photograph, network, 64, settings, lambda *report: reports.append(report)
    )
    assert [number for number, _ in reports] == list(range(len(reports))) and len(reports) > 3
    assert {expected for _, expected in reports} == {6}
    quiet = decomposition.decompose(result.photograph, network, 64, settings)
    assert torch.equal(watched.parts.n, quiet.parts.n)
