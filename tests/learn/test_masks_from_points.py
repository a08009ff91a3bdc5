"""Masks from coordinates: `learn mask`, brdfactory.make_mask, and what both refuse."""

import numpy as np
import pytest
from PIL import Image

import brdfactory as bf
from learn.__main__ import COMMANDS
from learn.data import photographs
from learn.selection.points import Points, select
from manifests.cli import main
from manifests.errors import InputError

SIZE = (240, 160)  # width and height
CENTRE, RADIUS, HOLE = (140, 70), 50, 22
RECTANGLE = [(86, 16), (194, 124)]


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A red ring with a blue hole before a grey wall: picture, disk and hole."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    distance = np.hypot(columns - CENTRE[0], rows - CENTRE[1])
    picture = np.full((*SIZE[::-1], 3), 150.0)
    picture[distance < RADIUS] = (190, 40, 30)
    picture[distance < HOLE] = (20, 40, 160)
    picture += np.random.default_rng(0).normal(0, 4, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8), distance < RADIUS, distance < HOLE


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / (one | other).sum())


def command(*words: object) -> int:
    return main("learn", "", COMMANDS, ["mask", *map(str, words)])


@pytest.mark.parametrize(
    "around",
    [
        RECTANGLE,
        RECTANGLE[::-1],
        [(194, 16), (86, 124)],
        [f"{100 * x / 240}%,{100 * y / 160}%" for x, y in RECTANGLE],
        [("35.8%", 16), (194, "77.5%")],
        [(140, 10), (196, 50), (180, 125), (95, 125), (84, 45)],
    ],
)
def test_a_line_of_either_kind_finds_the_object(around):
    picture, disk, hole = scene()
    mask = bf.make_mask(picture, around)
    assert mask.dtype == bool and mask.shape == disk.shape
    assert overlap(mask | hole, disk) > 0.95
    assert not mask[:10].any() and not mask[:, :80].any()


def test_a_bay_of_the_colour_that_is_outside_a_line_is_background_however_deep_it_is():
    rows, columns = np.mgrid[:160, :240]
    corner = (rows > 20) & (rows < 140) & (columns > 60) & (columns < 180)
    corner &= (rows > 110) | (columns < 90)  # an L, which fills a third of its rectangle
    picture = np.where(corner[..., None], (200, 180, 60), (120 + columns / 4)[..., None])
    picture = picture + np.random.default_rng(0).normal(0, 4, picture.shape)
    mask = bf.make_mask(np.clip(picture, 0, 255).astype(np.uint8), [(56, 16), (184, 144)])
    assert overlap(mask, corner) > 0.93


def test_a_small_piece_beside_the_object_is_background_unless_it_is_marked():
    rows, columns = np.mgrid[:160, :240]
    disk = np.hypot(columns - 120, rows - 80) < 50
    speck = np.hypot(columns - 178, rows - 28) < 6
    picture = np.full((160, 240, 3), 130, np.uint8)
    picture[disk | speck] = (190, 40, 30)
    around = [(65, 20), (190, 136)]
    assert not bf.make_mask(picture, around)[speck].any()
    mask = bf.make_mask(picture, around, on_object=[(178, 28)])
    assert mask[speck].mean() > 0.7 and overlap(mask, disk | speck) > 0.93


def test_an_object_of_the_colour_that_is_outside_a_line_is_still_selected():
    picture = np.full((160, 240, 3), 128, np.uint8)
    around = [(60, 20), (180, 140)]
    mask = bf.make_mask(picture, around)
    assert mask[50:110, 90:150].all() and not mask[:15].any()


def test_a_point_of_the_background_inside_a_line_frees_what_is_around_it():
    picture, disk, hole = scene()
    assert bf.make_mask(picture, RECTANGLE)[hole].all()
    mask = bf.make_mask(picture, RECTANGLE, on_background=[CENTRE])
    assert mask[hole].mean() < 0.2 and mask[disk & ~hole].mean() > 0.93


def test_a_point_on_a_part_of_the_colour_of_the_wall_frees_what_is_around_it():
    picture, disk, hole = scene()
    picture[hole] = picture[0, 0]  # as if the wall were seen through the hole
    around = [(80, 10), (200, 130)]
    assert bf.make_mask(picture, around)[hole].mean() < 0.2
    mask = bf.make_mask(picture, around, on_object=[CENTRE])
    assert mask[hole].mean() > 0.9 and overlap(mask, disk) > 0.9


def test_what_is_within_a_second_line_is_left_out_up_to_its_edges():
    picture, disk, hole = scene()
    mask = bf.make_mask(picture, RECTANGLE, without=[(128, 58), (152, 82)])
    assert mask[hole].mean() < 0.05 and mask[disk & ~hole].mean() > 0.93


def test_points_alone_make_a_mask_and_further_ones_correct_it():
    picture, disk, hole = scene()
    one = bf.make_mask(picture, on_object=[CENTRE])
    assert overlap(one, hole) > 0.9
    both = bf.make_mask(picture, on_object=["175,70", CENTRE])
    assert overlap(both, disk) > 0.9


def test_several_lines_enclose_an_object_of_several_pieces(tmp_path):
    rows, columns = np.mgrid[:200, :400]
    pieces = [np.hypot(columns - x, rows - 100) < 50 for x in (100, 300)]
    picture = np.full((200, 400, 3), 90, np.uint8)
    picture[pieces[0] | pieces[1]] = (220, 200, 40)
    Image.fromarray(picture).save(tmp_path / "two.png")
    lines = [[(40, 40), (160, 160)], [(240, 40), (360, 160)]]
    found = select(tmp_path / "two.png", Points(lines)).labels() > 0
    assert overlap(found, pieces[0] | pieces[1]) > 0.95


def test_a_small_piece_with_a_line_of_its_own_is_kept():
    rows, columns = np.mgrid[:200, :400]
    large, small = (np.hypot(columns - x, rows - 100) < r for x, r in ((120, 80), (300, 9)))
    picture = np.full((200, 400, 3), 90, np.uint8)
    picture[large | small] = (220, 200, 40)
    mask = bf.make_mask(picture, [(30, 10), (210, 190)])
    assert overlap(mask, large) > 0.95
    selection = select(picture, Points([[(30, 10), (210, 190)], [(285, 85), (315, 115)]]))
    assert (selection.labels() > 0)[small].mean() > 0.8


def test_radiance_is_exposed_before_edges_are_sought():
    picture, disk, hole = scene()
    radiance = ((picture / 255.0) ** 2.2 * 1e-4).astype(np.float32)
    assert overlap(bf.make_mask(radiance, RECTANGLE) | hole, disk) > 0.95


def test_pixels_are_those_of_the_file_if_a_large_photograph_is_made_smaller(tmp_path):
    picture, disk, hole = scene()
    large = Image.fromarray(picture).resize((6240, 4160), Image.Resampling.NEAREST)  # 26 megapixels
    large.save(tmp_path / "large.png", compress_level=1)
    around = [f"{26 * x},{26 * y}" for x, y in RECTANGLE]
    mask = bf.make_mask(tmp_path / "large.png", around)
    assert mask.shape == (2080, 3120)
    small = mask[6::13, 6::13]
    assert overlap(small | hole, disk) > 0.95
    np.testing.assert_array_equal(bf.make_mask(np.asarray(large), around), mask)


def test_points_may_be_an_array_and_a_number_is_no_point():
    picture, _, _ = scene()
    marks = {"on_object": [(175, 70)], "on_background": [CENTRE]}
    mask = bf.make_mask(picture, np.array(RECTANGLE), **marks)
    arrays = {name: np.array(points) for name, points in marks.items()}
    np.testing.assert_array_equal(mask, bf.make_mask(picture, RECTANGLE, **arrays))
    for flat in ({"around": (86, 16, 194, 124)}, {"on_object": CENTRE}):
        with pytest.raises(InputError, match=r"expected points X,Y, found (86|140) "):
            bf.make_mask(picture, **flat)


def test_the_command_writes_a_mask_and_a_preview_of_an_upright_photograph(tmp_path, capsys):
    picture, disk, hole = scene()
    turned = Image.fromarray(picture).transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[0x0112] = 6  # the viewer turns it back
    photo, out = tmp_path / "my photo.png", tmp_path / "new" / "mask.png"
    turned.save(photo, exif=exif)
    words = [photo, "--around", "86,16", "194,124", "--without", "128,58", "152,82", "--out", out]
    assert command(*words) == 0
    said = capsys.readouterr().out
    assert f"brdfactory edit '{photo}' --mask {out}" in said
    assert "The object covers 16% of the picture." in said
    mask = photographs.read_mask(out, disk.shape)
    assert {round(float(value), 6) for value in np.unique(mask)} == {0, 1}
    assert mask[hole].mean() < 0.2 and mask[disk & ~hole].mean() > 0.93
    with Image.open(out.with_suffix(".preview.jpg")) as preview:
        assert preview.size == SIZE
        # inside it is green over red; outside the photograph is darker
        red, green, _ = np.asarray(preview)[70, 175].astype(int)
        assert 80 < green < 110 and 90 < red < 120
    before = out.read_bytes()
    assert command(*words) == 1
    assert "expected no earlier result" in capsys.readouterr().err
    assert command(photo, "--object", "175,70", "--out", out, "--overwrite") == 0
    assert out.read_bytes() != before


@pytest.mark.parametrize("left", ["-5%", "-12", "-0.5%", "1e-5", "-2E0"])
def test_a_corner_may_lie_left_of_the_photograph_and_above_it(left, tmp_path, capsys):
    Image.fromarray(scene()[0]).save(tmp_path / "photo.png")
    masks = []
    for name, corner in (("at.png", "0,0"), ("beyond.png", f"{left},{left}")):
        out = tmp_path / name
        assert command(tmp_path / "photo.png", "--around", corner, "194,124", "--out", out) == 0
        masks.append(out.read_bytes())
    assert masks[0] == masks[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--around: expected a line around the object, or --object, found neither"),
        (["--background", "5,5"], "found neither"),
        (["--around", "20,20"], "--around: expected two corners"),
        (["--around", "20", "40,40"], "expected points X,Y, found 20 "),
        (["--around", "a,b", "40,40"], "expected points X,Y, found a,b "),
        (["--around", "300,20", "400,90"], "one that encloses nothing"),
        (["--around", "20,20", f"{'9' * 400},90"], "a point of the picture or near it, 240 × 160"),
        (["--around", "0,0", "240,160"], "found the whole picture"),
        (["--around", "9,9", "90,90", "--without", "20,20"], "--without: expected two corners"),
        (["--around", "-5%", "40,40"], "expected points X,Y, found -5% "),
        (["--around", "-.5,3", "40,40"], "expected points X,Y, found -.5,3 "),
        (["--without", "-2%,9", "--around", "9,9", "90,90"], "--without: expected two corners"),
        (["--object", "-3,10"], "--object: expected a point of the picture, 240 × 160 pixels"),
        (["--around", "9,9", "90,90", "--background", "-1.5%,-2"], "--background: expected"),
        (["--object", "240,10"], "--object: expected a point of the picture, 240 × 160 pixels"),
        (["--around", "86,16", "194,124", "--background", "5,200"], "--background: expected"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_and_nothing_is_written(words, message, tmp_path, capsys):
    Image.fromarray(scene()[0]).save(tmp_path / "photo.png")
    assert command(tmp_path / "photo.png", *words, "--out", tmp_path / "mask.png") == 1
    said = capsys.readouterr().err
    assert message in said and len(said.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["photo.png"]


def test_the_mask_is_a_png_and_messages_of_python_name_its_arguments(tmp_path, capsys):
    Image.fromarray(scene()[0]).save(tmp_path / "photo.png")
    line = ["--around", "86,16", "194,124"]
    assert command(tmp_path / "photo.png", *line, "--out", tmp_path / "mask.jpg") == 1
    assert "expected a name that ends in .png, found .jpg" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"^on_object: expected a point of the picture"):
        bf.make_mask(scene()[0], on_object=[(-3, 5)])
    with pytest.raises(InputError, match=r"^around: expected a line .* or on_object"):
        bf.make_mask(scene()[0])
