"""Fitting a mask's edge to its photograph: what it mends, what it leaves, and when it is done."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, label

import brdfactory as bf
from learn.__main__ import COMMANDS
from learn.data import framing, photographs
from learn.editing import decomposition, mask_edges, photograph
from learn.editing.backgrounds import background_behind, fill_by_nearby_mean, fill_from_nearest
from learn.editing.compositor import Compositor
from learn.layer import predictions
from manifests import exr
from manifests.cli import main
from manifests.errors import InputError
from shaders import tone

SIZE = 96
Y, X = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
RADIUS = 28.0
INK, WALL = np.array([0.5, 0.1, 0.05]), np.array([0.1, 0.2, 0.4])


def disc(radius, centre=(0.0, 0.0)):
    """Coverage (SIZE, SIZE) of a disc."""
    return np.clip(radius - np.hypot(Y - centre[0], X - centre[1]) + 0.5, 0, 1)


def picture(coverage, noise=0.0):
    """Linear radiance (H, W, 3) float32 of a shaded object before a wall with a slope."""
    rng = np.random.default_rng(0)
    rows = np.linspace(-1, 1, coverage.shape[0])[:, None, None]
    L = coverage[..., None] * INK * (1 + 0.3 * rows)
    L = L + (1 - coverage[..., None]) * WALL * (1 - 0.3 * rows)
    return (L * (1 + noise * rng.normal(size=L.shape))).astype(np.float32)


TRUE = disc(RADIUS)
DAMAGED = {
    "narrow": disc(RADIUS - 2) >= 0.5,
    "wide": disc(RADIUS + 2) >= 0.5,
    "shifted": disc(RADIUS, (2, 0)) >= 0.5,
}


def error(coverage):
    return float(np.abs(coverage - TRUE).sum())


@pytest.mark.parametrize("name", DAMAGED)
def test_a_mask_beside_its_object_is_moved_onto_it(name):
    given = DAMAGED[name].astype(np.float32)
    fitted = mask_edges.fit(picture(TRUE, 0.02), given)
    assert error(fitted) < 0.2 * error(gaussian_filter(given, mask_edges.SOFTENING))
    # and no farther from the given edge than the band
    untouched = np.abs(mask_edges.signed_distance(given > 0.5)) > mask_edges.band_width(given > 0.5)
    assert (fitted[untouched] == given[untouched]).all()


def test_where_object_and_background_look_alike_the_given_mask_stays():
    given = DAMAGED["shifted"]
    grey = picture(np.ones_like(TRUE), 0.05)
    fitted = mask_edges.fit(grey, given) >= 0.5
    assert np.abs(mask_edges.signed_distance(given))[fitted != given].max() < 1.5


def test_where_the_true_edge_is_out_of_reach_the_given_one_stays_and_is_not_torn():
    given = disc(RADIUS - 12) >= 0.5
    fitted = mask_edges.fit(picture(TRUE, 0.1), given)
    assert ((fitted >= 0.5) != given).sum() < 0.06 * given.sum()


def test_holes_thin_parts_and_gaps_survive():
    """A ring with a thin handle, beside a second one, all of a mask that is a pixel too wide."""
    ring = np.clip(disc(16, (0, -26)) - disc(3, (0, -26)), 0, 1)
    handle = (np.abs(Y) <= 1) & (X > -11) & (X < 14)
    neighbour = disc(10, (0, 28))
    true = np.maximum.reduce([ring, handle.astype(float), neighbour])
    given = mask_edges.signed_distance(true >= 0.5) > -1
    fitted = mask_edges.fit(picture(true), given) >= 0.5
    for before, after in ((true >= 0.5, fitted), (true < 0.5, ~fitted)):
        assert label(before)[1] == label(after)[1] == 2
    assert fitted[SIZE // 2 - 1 : SIZE // 2 + 1, 38:62].all()


def test_an_object_that_the_frame_cuts_off_ends_there():
    true = TRUE[:, SIZE // 2 :]
    given = DAMAGED["narrow"][:, SIZE // 2 :]
    fitted = mask_edges.fit(picture(true), given)
    assert np.abs(fitted - true)[:, :3].sum() < 1
    # an object that fills the picture has no edge
    assert (mask_edges.fit(picture(true), np.ones_like(true)) == 1).all()


def test_specks_of_the_other_colour_make_neither_holes_nor_islands():
    """A knot of the wall's colour at the object's edge, and one of its own beside it."""
    colours = TRUE.copy()
    knot, stain = (disc(1.7, (0, across)) > 0.5 for across in (RADIUS - 2.5, RADIUS + 2.5))
    colours[knot], colours[stain] = 0, 1
    fitted = mask_edges.fit(picture(colours), (TRUE >= 0.5).astype(float)) >= 0.5
    assert label(fitted)[1] == label(~fitted)[1] == 1


def test_fixed_pixels_stay_as_they_are():
    fixed = Y < 0
    given = DAMAGED["narrow"].astype(np.float32)
    fitted = mask_edges.fit(picture(TRUE), given, fixed)
    assert ((fitted >= 0.5) == (given >= 0.5))[fixed].all()
    assert error(fitted * ~fixed + TRUE * fixed) < 0.2 * error(given * ~fixed + TRUE * fixed)


def test_the_background_behind_an_edge_keeps_its_texture():
    """Stripes across the edge, which the nearest pixel outside would smear over it."""
    stripes = np.where(X.astype(int) % 4 < 2, 0.1, 0.5)[..., None] * np.ones(3)
    seen = TRUE[..., None] * INK + (1 - TRUE[..., None]) * stripes
    soft = (TRUE > 0.02) & (TRUE < 0.7)
    off = [
        np.abs(behind - stripes)[soft].mean()
        for behind in (background_behind(seen, TRUE), fill_from_nearest(seen, TRUE < 0.02))
    ]
    assert off[0] < 0.7 * off[1]


def test_a_thread_of_which_no_pixel_shows_the_own_colour_leaves_the_background_alone():
    """What is seen there is a mixture, by which the background would be mixed with the old one."""
    stripes = np.where(Y.astype(int) % 4 < 2, 0.1, 0.5)[..., None] * np.ones(3)
    thread = np.clip(1 - np.abs(X) / 2, 0, 0.7)
    seen = thread[..., None] * INK + (1 - thread[..., None]) * stripes
    near = fill_by_nearby_mean(seen, thread < 0.02)
    np.testing.assert_allclose(background_behind(seen, thread), near, rtol=1e-6)


@pytest.mark.parametrize("alpha", [None, TRUE])
def test_beyond_the_frame_no_background_is_seen(alpha):
    """An object that the frame cuts off is framed in a square with black beyond the photograph."""
    cut_off = TRUE[:, SIZE // 2 :]
    seen = picture(cut_off)
    box = (0, -SIZE // 2, SIZE)
    behind = compositor_of(seen, cut_off, alpha, box).background()[:, SIZE // 2 :]
    soft = (cut_off > 0) & (cut_off < 0.98)
    # the slope of the wall is all that is not known
    np.testing.assert_allclose(behind[soft], picture(np.zeros_like(cut_off))[soft], rtol=0.1)


def compositor_of(seen, coverage, alpha, box):
    """A compositor of a photograph (H, W, 3) that knows nothing but what is behind its object."""
    result = Compositor.__new__(Compositor)
    result._background = result._share = None
    result.coverage = framing.cut_square(coverage, box)
    read = SimpleNamespace(radiance=seen, alpha=alpha, cut_out=False)
    result.decomposition = SimpleNamespace(photograph=read, framed=SimpleNamespace(box=box))
    return result


def test_beyond_the_frame_nothing_is_transparent():
    """An object whose soft edge runs along the frame, in a picture with a transparent corner."""
    first = int(SIZE / 2 - RADIUS)  # of the columns, at the disc's left end
    coverage = TRUE[:, first:]
    alpha = np.ones_like(coverage)
    alpha[-10:, -10:] = 0
    compositor = compositor_of(picture(coverage), coverage, alpha, (0, -first, SIZE))
    share = compositor.share()[:, first:]
    soft = (coverage > 0) & (coverage < 1)
    assert soft[:, 0].sum() > 5
    np.testing.assert_allclose(share[soft], coverage[soft], rtol=1e-6)


def shown(coverage):
    return np.rint(tone.display(picture(coverage), 1.0)).astype(np.uint8)


def opened(mask, **options):
    return photograph.from_arrays(shown(TRUE), mask, **options)


def test_masks_without_grey_are_fitted_unless_asked_otherwise():
    hard, grey = DAMAGED["narrow"], disc(RADIUS - 2).astype(np.float32)
    assert opened(hard).given is None  # functions of other commands leave masks as they are
    fitted = opened(hard, fit_mask=None)
    assert (fitted.given == hard).all() and (fitted.given_regions == hard).all()
    assert error(fitted.mask) < 0.2 * error(hard)
    kept = opened(hard, fit_mask=False)
    assert kept.given is None and (kept.mask == hard).all()
    assert (opened(grey, fit_mask=None).coverage == grey).all()
    assert error(opened(grey, fit_mask=True).coverage) < 0.3 * error(grey)


def test_an_edge_between_regions_stays_and_their_outer_edge_moves():
    hard = DAMAGED["narrow"]
    regions = np.where(hard, np.where(X < 0, 1, 2), 0).astype(np.uint8)
    fitted = photograph.from_arrays(shown(TRUE), None, regions, fit_mask=None)
    assert (fitted.regions[hard] == regions[hard]).all()
    assert error(fitted.mask) < 0.2 * error(hard)
    for number, side in ((1, X < -8), (2, X > 8)):
        assert (fitted.regions[(TRUE > 0.9) & side] == number).all()
    assert (fitted.given_regions == regions).all()


def test_transparency_is_left_alone_and_cannot_be_fitted():
    cut_out = np.dstack([shown(TRUE), 255 * DAMAGED["narrow"].astype(np.uint8)])
    assert photograph.from_arrays(cut_out, fit_mask=None).given is None
    with pytest.raises(InputError, match="transparency"):
        photograph.from_arrays(cut_out, fit_mask=True)


def test_a_region_of_a_few_pixels_is_not_fitted_away():
    """A speck of the background's colour: the whole mask stays as it was given."""
    speck = (np.abs(Y + 40) < 2) & (np.abs(X + 40) < 2)
    regions = np.where(speck, 2, DAMAGED["narrow"]).astype(np.uint8)
    fitted = photograph.from_arrays(shown(TRUE), None, regions, fit_mask=None)
    assert (fitted.regions == 2).sum() >= photographs.LEAST_PIXELS


def test_a_mask_with_too_much_edge_is_softened_instead(monkeypatch):
    """Specks all over a large photograph would take gigabytes."""
    hard = DAMAGED["narrow"]
    count = int(mask_edges.band_about(hard, mask_edges.band_width(hard)).sum())
    monkeypatch.setattr(mask_edges, "MOST_IN_BAND", count)
    assert opened(hard, fit_mask=None).given is not None
    monkeypatch.setattr(mask_edges, "MOST_IN_BAND", count - 1)
    ragged = opened(hard, fit_mask=None)
    assert ragged.given is None
    np.testing.assert_array_equal(ragged.coverage, opened(hard, fit_mask=False).coverage)


def test_files_in_units_of_their_own_are_fitted_too(tmp_path):
    L = 5000 * picture(TRUE)
    exr.write(tmp_path / "a.exr", {c: L[..., k] for k, c in enumerate("RGB")})
    fitted = photograph.from_arrays(
        tmp_path / "a.exr", DAMAGED["wide"], fit_mask=None, exposure=1e-3
    )
    assert error(fitted.mask) < 0.2 * error(DAMAGED["wide"])


class Read(Exception):
    """Raised in the place of a decomposition, with the photograph that it was given."""


@pytest.mark.parametrize(("choice", "is_fitted"), [({}, True), ({"fit_mask": False}, False)])
def test_python_passes_the_choice_on(monkeypatch, choice, is_fitted):
    def decompose(read, *_, **__):
        raise Read(read)

    monkeypatch.setattr(decomposition, "decompose", decompose)
    with pytest.raises(Read) as raised:
        bf.edit(shown(TRUE), DAMAGED["narrow"], refine=False, **choice)
    assert (raised.value.args[0].given is not None) == is_fitted


@pytest.mark.parametrize(
    ("option", "choice", "is_fitted"), [("", None, True), ("--no-fit-mask", False, False)]
)
def test_the_command_passes_the_choice_on_and_records_it(
    tmp_path, capsys, monkeypatch, option, choice, is_fitted
):
    monkeypatch.setattr(predictions, "method_for", lambda label: "auto")
    Image.fromarray(shown(TRUE)).save(tmp_path / "a.png")
    Image.fromarray(255 * DAMAGED["narrow"].astype(np.uint8)).save(tmp_path / "m.png")
    words = f"edit {tmp_path}/a.png --mask {tmp_path}/m.png --material white-acrylic --no-refine"
    words += f" --out {tmp_path}/out {option}"
    assert main("learn", "", COMMANDS, words.split()) == 0
    report = json.loads((tmp_path / "out" / "edit.json").read_text())
    assert (report["fit_mask"], report["mask_fitted"]) == (choice, is_fitted)
    capsys.readouterr()


CHOICES = [(None, "", True), (False, "--no-fit-mask", False)]


@pytest.mark.parametrize(("choice", "option", "is_fitted"), CHOICES)
@pytest.mark.parametrize("command", ["transfer", "predict", "edit another"])
def test_masks_of_other_commands_and_of_pictures_of_materials_are_fitted_alike(
    tmp_path, monkeypatch, capsys, command, choice, option, is_fitted
):
    """Each picture is read as `edit` reads its photograph."""
    read = []

    def open_photograph(*arguments, **named):
        read.append((Path(arguments[0]).name, opens(*arguments, **named)))
        return read[-1][1]

    opens = photograph.open_photograph
    monkeypatch.setattr(photograph, "open_photograph", open_photograph)
    monkeypatch.setattr(predictions, "method_for", lambda label: "auto")
    for name in "ab":
        Image.fromarray(shown(TRUE)).save(tmp_path / f"{name}.png")
        mask = 255 * DAMAGED["narrow"].astype(np.uint8)
        Image.fromarray(mask).save(tmp_path / f"{name}.mask.png")
    a, b, mask = (str(tmp_path / name) for name in ("a.png", "b.png", "a.mask.png"))
    words = {
        "transfer": ["transfer", a, b, "--no-refine"],
        "predict": ["predict", a, "--mask", mask],
        "edit another": ["edit", a, "--mask", mask, "--material", b, "--no-refine"],
    }[command]
    words += ["--out", str(tmp_path / "out"), *([option] if option else [])]
    assert main("learn", "", COMMANDS, words) == 0
    capsys.readouterr()
    assert {name for name, _ in read} == ({"a.png"} if command == "predict" else {"a.png", "b.png"})
    for _, each in read:
        assert (each.given is not None) == is_fitted
        assert error(each.mask) < 0.2 * error(DAMAGED["narrow"]) or not is_fitted
    if command == "transfer":
        report = json.loads((tmp_path / "out" / "transfer.json").read_text())
        assert report["fit_mask"] is choice
        assert [each["mask_fitted"] for each in report["pictures"]] == [is_fitted, is_fitted]


def test_pictures_with_transparency_stay_as_they_are_beside_others_whose_masks_are_fitted(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(predictions, "method_for", lambda label: "auto")
    grey = np.rint(255 * disc(RADIUS - 2)).astype(np.uint8)
    Image.fromarray(np.dstack([shown(TRUE), grey])).save(tmp_path / "cut.png")
    Image.fromarray(np.dstack([shown(TRUE), grey])).save(tmp_path / "other.png")
    Image.fromarray(shown(TRUE)).save(tmp_path / "a.png")
    Image.fromarray(grey).save(tmp_path / "a.mask.png")
    words = ["transfer", "--no-refine", "--fit-mask", "--out", str(tmp_path / "out")]
    cut, other = str(tmp_path / "cut.png"), str(tmp_path / "other.png")
    assert main("learn", "", COMMANDS, [*words, str(tmp_path / "a.png"), cut]) == 0
    report = json.loads((tmp_path / "out" / "transfer.json").read_text())
    fitted = {each["name"]: each["mask_fitted"] for each in report["pictures"]}
    assert fitted == {"a": True, "cut": False} and report["fit_mask"] is True
    edit = ["edit", str(tmp_path / "a.png"), "--mask", str(tmp_path / "a.mask.png"), "--fit-mask"]
    edit += ["--material", cut, "--no-refine", "--out", str(tmp_path / "edit")]
    assert main("learn", "", COMMANDS, edit) == 0
    capsys.readouterr()
    assert main("learn", "", COMMANDS, [*words, "--overwrite", cut, other]) == 1
    assert "--fit-mask: expected a mask besides the pictures' own" in capsys.readouterr().err


def test_a_data_set_has_no_mask_to_fit(tmp_path):
    with pytest.raises(InputError, match="--fit-mask: expected a photograph"):
        photograph.open_photograph(tmp_path, fit_mask=True)
