"""Bad input to `learn edit` and `learn transfer`: one line with the remedy and exit status 1, or
dealt with.
"""

import importlib
import json
import struct
import zlib

import numpy as np
import pytest
import torch
from PIL import Image

from learn.__main__ import COMMANDS
from learn.data import framing, photographs, picture_decoding
from learn.editing import edit_files, photograph, targets, transfer
from learn.editing.edit import EditOptions
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.encoder_decoder import EncoderDecoder
from learn.networks.weights import save_weights
from manifests.cli import main
from manifests.errors import InputError
from manifests.material_words import ALIKE
from manifests.materials import load_catalogue
from shaders import tone
from tests.support.synthetic import matte, write_dataset

SIZE = (48, 64)


@pytest.fixture
def disc():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return (x - 30) ** 2 + (y - 24) ** 2 < 18**2


@pytest.fixture
def files(tmp_path, disc):
    """A photograph, its mask, and a folder for results."""
    values = np.clip(60 + 2 * np.mgrid[: SIZE[0], : SIZE[1]][0], 0, 255).astype(np.uint8)
    Image.fromarray(np.dstack([values] * 3)).save(tmp_path / "photo.png")
    Image.fromarray(disc.astype(np.uint8) * 255).save(tmp_path / "mask.png")
    return tmp_path


def message(capsys, *arguments):
    """(exit status, the line on stderr) of a command."""
    status = main("learn", "test", COMMANDS, [str(a) for a in arguments])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("learn:")]
    assert len(lines) <= 1
    return status, lines[0] if lines else ""


def edit(files, *more, photo="photo.png", mask="mask.png", material="brass"):
    masks = ["--mask", files / mask] if mask else []
    return [
        "edit",
        files / photo,
        *masks,
        "--material",
        material,
        "--no-refine",
        "--out",
        files / "out",
        *more,
    ]


def test_no_mask_is_refused_with_the_option_to_give(files, capsys):
    status, line = message(capsys, *edit(files, mask=None))
    assert status == 1 and "--mask FILE" in line


def test_a_mask_that_is_empty_or_of_another_size_is_refused(files, capsys):
    Image.new("L", SIZE[::-1]).save(files / "empty.png")
    Image.new("L", (10, 10), 255).save(files / "other.png")
    status, line = message(capsys, *edit(files, mask="empty.png"))
    assert status == 1 and "pixels or more in the mask" in line
    status, line = message(capsys, *edit(files, mask="other.png"))
    assert status == 1 and "64 × 48" in line and "10 × 10" in line


def test_what_is_no_picture_is_refused(files, capsys):
    whole = (files / "photo.png").read_bytes()
    (files / "cut.png").write_bytes(whole[: len(whole) // 2])
    (files / "text.png").write_text("a picture, honestly")
    for name in ("cut.png", "text.png", "none.png"):
        status, line = message(capsys, *edit(files, photo=name))
        assert status == 1 and name in line and "expected" in line


def test_an_unknown_material_lists_the_closest_names(files, capsys):
    status, line = message(capsys, *edit(files, material="brasss"))
    assert status == 1 and "did you mean brass" in line
    assert not (files / "out").exists()


@pytest.mark.parametrize("word", ["silk", "silck", "Silk"])
def test_an_everyday_word_is_answered_with_what_looks_like_it(files, capsys, word):
    status, line = message(capsys, *edit(files, material=word))
    assert (
        status == 1
        and "look like silk: satin_white, vch_silk_blue" in line
        and "a picture of it" in line
    )


@pytest.mark.parametrize(
    "text, remedy",
    [("goldd", "did you mean gold?"), ("shiny wood", "look like wood: cherry-235")],
)
def test_an_everyday_word_with_an_error_or_an_adjective_is_understood(files, capsys, text, remedy):
    status, line = message(capsys, *edit(files, material=text))
    assert status == 1 and remedy in line


def test_a_part_of_a_name_lists_names_that_have_it(files, capsys):
    status, line = message(capsys, *edit(files, material="phenolic"))
    assert status == 1 and "did you mean black-phenolic" in line and "red-phenolic" in line


def test_every_material_that_stands_for_a_word_is_in_the_catalogue():
    assert {name for names in ALIKE.values() for name in names} <= set(load_catalogue())


def test_nothing_is_overwritten_unless_asked(files, capsys):
    (files / "out").mkdir()
    for name in ("edit.json", "edited.png", "normals.png"):
        (files / "out" / name).write_text("mine")
        status, line = message(capsys, *edit(files))
        assert (
            status == 1 and "--overwrite" in line and (files / "out" / name).read_text() == "mine"
        )
        (files / "out" / name).unlink()


def test_numbers_outside_their_range_are_refused(files, capsys):
    for option, value in (
        ("--tolerance", "0"),
        ("--tolerance", "nan"),
        ("--detail", "2"),
        ("--brightness", "-3.5"),
        ("--brightness", "nan"),
        ("--exposure", "-1"),
        ("--white-balance", "1,2"),
    ):
        status, line = message(capsys, *edit(files, option, value))
        assert status == 1 and option in line


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_predict_refuses_an_exposure_that_is_none(files, capsys, value):
    status, line = message(
        capsys,
        "predict",
        files / "photo.png",
        "--mask",
        files / "mask.png",
        "--exposure",
        value,
        "--out",
        files / "out",
    )
    assert status == 1 and "--exposure" in line and not (files / "out").exists()


@pytest.mark.parametrize("command", ["edit", "predict"])
def test_no_command_writes_over_what_it_reads(files, capsys, command):
    (files / "photo.png").rename(files / "normals.png")
    (files / "mask.png").rename(files / "disc.png")
    before = (files / "normals.png").read_bytes()
    more = ["--material", "brass"] if command == "edit" else []
    words = [
        command,
        files / "normals.png",
        "--mask",
        files / "disc.png",
        *more,
        "--out",
        files,
        "--overwrite",
    ]
    status, line = message(capsys, *words)
    assert (
        status == 1
        and "normals.png" in line
        and "another --out" in line
        and (files / "normals.png").read_bytes() == before
    )


def test_a_file_where_a_folder_is_to_be_is_told_before_any_work(files, capsys):
    (files / "out").write_text("mine")
    status, line = message(capsys, *edit(files))
    assert status == 1 and "a file" in line and "--out" in line


def test_a_white_balance_without_bounds_is_refused(files, capsys):
    status, line = message(capsys, *edit(files, "--white-balance", "1e-30,1,1e30"))
    assert status == 1 and "from 0.01 to 100" in line


def test_a_material_that_reflects_more_than_numbers_hold_is_refused(files, capsys):
    (files / "m.json").write_text(json.dumps({"label": [13.9] * 108}))
    status, line = message(capsys, *edit(files, material=files / "m.json"))
    assert status == 1 and "logarithms of κ up to 4.4" in line
    (files / "m.json").write_text("[" * 100_000)
    status, line = message(capsys, *edit(files, material=files / "m.json"))
    assert status == 1 and "m.json" in line


def test_coloured_regions_are_told_apart_and_turned_as_the_file_says(files):
    values = np.zeros((*SIZE, 3), np.uint8)
    values[:, 20:30], values[:, 30:40] = (255, 0, 0), (0, 130, 0)  # of one grey
    Image.fromarray(values).save(files / "colours.png")
    result = photographs.read_labels(files / "colours.png", SIZE)
    assert result[0, 25] == 2 and result[0, 35] == 1 and result[0, 5] == 0
    turned, exif = Image.fromarray(values).transpose(Image.Transpose.ROTATE_90), Image.Exif()
    exif[0x0112] = 6  # turn it right for showing
    turned.save(files / "turned.png", exif=exif)
    np.testing.assert_array_equal(photographs.read_labels(files / "turned.png", SIZE), result)


@pytest.mark.parametrize("transparent", [False, True])
def test_what_is_black_or_transparent_in_a_palette_is_no_region(files, transparent):
    """Programs that make palettes put colours into them in any order."""
    index = np.ones(SIZE, np.uint8)
    index[10:20, 20:40], index[20:34, 20:40] = 0, 2
    picture = Image.fromarray(index, "P")
    picture.putpalette([250, 0, 0, *((9, 9, 9) if transparent else (0, 0, 0)), 0, 0, 250])
    picture.save(files / "regions.png", **({"transparency": 1} if transparent else {}))
    labels = photographs.read_labels(files / "regions.png", SIZE)
    np.testing.assert_array_equal(labels, np.array([1, 0, 2], np.uint8)[index])


@pytest.mark.parametrize(
    ("command", "words"),
    [("edit", "--overwrite replaces it"), ("evaluate-network", "the same command continues")],
)
def test_a_command_that_is_stopped_says_how_to_go_on(capsys, monkeypatch, command, words):
    def stopped(options):
        raise KeyboardInterrupt

    module = importlib.import_module(f"learn.commands.{command.replace('-', '_')}")
    monkeypatch.setattr(module, "run", stopped)
    given = {
        "edit": ["edit", "p.png", "--material", "brass", "--out", "o"],
        "evaluate-network": ["evaluate-network", "w", "--data", "d", "--out", "o"],
    }
    assert main("learn", "test", COMMANDS, given[command]) == 130
    assert words in capsys.readouterr().err


def test_a_detail_out_of_range_is_told_the_ends_that_are_allowed(files, capsys):
    status, line = message(capsys, *edit(files, "--detail", "2"))
    assert status == 1 and "from 0 to 1" in line


@pytest.mark.parametrize(
    "text", ['{"labels": 5}', '{"label": [-1e4]}', '{"label": -Infinity}', '{"label": [NaN]}']
)
@pytest.mark.parametrize("times", [1, 108])
def test_a_material_file_out_of_range_or_shape_is_refused(files, capsys, text, times):
    key, value = next(iter(json.loads(text).items()))
    (files / "m.json").write_text(
        json.dumps({key: value * times if isinstance(value, list) else value})
    )
    status, line = message(capsys, *edit(files, material=files / "m.json"))
    assert status == 1 and "m.json" in line
    if times == 108 and isinstance(value, list):
        assert "natural logarithms from -80 to 14" in line and "found" in line


def test_weights_of_a_network_that_takes_nothing_apart_are_refused(files, capsys):
    network = EncoderDecoder(Ranges(torch.zeros(108), torch.ones(108)))
    save_weights(files / "one.safetensors", network, network.state_dict(), "{}", 128)
    normals = Compact(Ranges(torch.zeros(108), torch.ones(108)))
    save_weights(
        files / "part.safetensors", normals, normals.state_dict(), '{"parts": ["normals"]}', 128
    )
    for name in ("one", "part"):
        status, line = message(capsys, *edit(files, "--weights", files / f"{name}.safetensors"))
        assert status == 1 and "predicts normals, material and light" in line


def test_what_a_dataset_does_not_need_and_a_photograph_has_not_is_refused(files, capsys, rng):
    write_dataset(
        files / "data", [matte("a", 0.2), matte("b", 0.6)], rng, size=32, seeds=1, rotations=(0,)
    )
    for option, value in (
        ("--mask", files / "mask.png"),
        ("--regions", files / "mask.png"),
        ("--white-balance", "grey"),
    ):
        status, line = message(
            capsys, *edit(files, option, value, photo="data", mask=None, material="a")
        )
        assert status == 1 and option in line and "dataset" in line
    status, line = message(capsys, *edit(files, "--record", "1"))
    assert status == 1 and "--record" in line and "dataset" in line


def test_options_that_would_have_no_effect_are_refused(files, capsys):
    regions = np.zeros(SIZE, np.uint8)
    regions[10:20, 20:40], regions[20:34, 20:40] = 1, 2
    Image.fromarray(regions).save(files / "regions.png")
    for options, words in (
        (("--mask", "alpha"), "--mask alpha"),
        (("--mask", files / "mask.png", "--regions", files / "regions.png"), "--regions"),
        (
            ("--mask", files / "mask.png", "--no-refine", "--refinement-method", "auto"),
            "--refinement-method",
        ),
    ):
        status, line = message(capsys, *edit(files, *options))
        assert status == 1 and words in line
    status, line = message(
        capsys,
        *("transfer", files / "photo.png", files / "other.png", "--light-rotation", "90"),
        *("--out", files / "out"),
    )
    assert status == 1 and "--light-rotation" in line and "--light" in line
    assert not (files / "out").exists()


def test_an_exr_edit_of_somebodys_own_is_not_overwritten(files, capsys, disc):
    photographs.write_exr(files / "photo.exr", np.full((*SIZE, 3), 0.3, np.float32))
    (files / "out").mkdir()
    (files / "out" / "edited.exr").write_text("mine")
    status, line = message(capsys, *edit(files, photo="photo.exr"))
    assert (
        status == 1
        and "--overwrite" in line
        and (files / "out" / "edited.exr").read_text() == "mine"
    )
    status, line = message(capsys, *edit(files, "--overwrite", photo="photo.exr"))
    assert (status, line) == (0, "")
    edited, _ = photographs.read_exr(files / "out" / "edited.exr")
    assert edited.shape == (*SIZE, 3) and edited[disc].std() > 0


def test_transfer_without_masks_names_its_own_options(files, capsys):
    Image.new("RGB", (40, 30)).save(files / "other.png")
    status, line = message(
        capsys, "transfer", files / "photo.png", files / "other.png", "--out", files / "swap"
    )
    assert status == 1 and "--mask-dir" in line and "NAME.mask.png" in line


def test_wrong_usage_ends_with_two(files, capsys):
    with pytest.raises(SystemExit) as end:
        main("learn", "test", COMMANDS, ["edit", str(files / "photo.png")])
    assert end.value.code == 2


def test_an_object_of_a_few_pixels_is_refused(files):
    Image.new("RGB", (4, 4), (90, 80, 70)).save(files / "four.png")
    Image.fromarray(np.pad(np.full((2, 2), 255, np.uint8), 1)).save(files / "four-mask.png")
    with pytest.raises(InputError, match="16 pixels or more in the mask, found 4"):
        photograph.open_photograph(files / "four.png", [files / "four-mask.png"])


@pytest.mark.parametrize("mode", ["L", "LA", "P", "CMYK", "I;16", "1", "RGBA"])
def test_any_mode_is_read(files, mode):
    source = Image.open(files / "photo.png")
    deep = mode == "I;16"
    picture = (
        Image.fromarray(np.asarray(source)[..., 0].astype(np.uint16) * 257)
        if deep
        else source.convert(mode)
    )
    name = files / f"mode.{'tiff' if mode == 'CMYK' else 'png'}"
    picture.save(name)
    opened = photograph.open_photograph(name, [files / "mask.png"])
    assert opened.radiance.shape == (*SIZE, 3) and np.isfinite(opened.radiance).all()
    if mode not in ("1", "P"):
        seen = photograph.open_photograph(files / "photo.png", [files / "mask.png"]).radiance
        np.testing.assert_allclose(opened.radiance, seen, atol=0.03)  # CMYK moves a step or two


def test_of_an_animation_the_first_frame_is_taken(files):
    frames = [Image.new("RGB", SIZE[::-1], (shade, shade, shade)) for shade in (200, 10)]
    frames[0].save(files / "moving.gif", save_all=True, append_images=frames[1:])
    opened = photograph.open_photograph(files / "moving.gif", [files / "mask.png"])
    assert opened.radiance.min() > 0.5


def test_a_photograph_turned_by_its_camera_is_set_upright(files):
    picture = Image.new("RGB", (48, 64), (90, 80, 70))
    exif = picture.getexif()
    exif[274] = 6  # turn by 90° to see it upright
    picture.save(files / "turned.jpg", exif=exif)
    assert photograph.open_photograph(
        files / "turned.jpg", [files / "mask.png"]
    ).radiance.shape == (
        *SIZE,
        3,
    )


def test_too_many_pixels_are_refused_before_they_are_read(files, monkeypatch):
    monkeypatch.setattr(picture_decoding, "MOST_DECODED", 1000)
    with pytest.raises(InputError, match="megapixels"):
        photograph.open_photograph(files / "photo.png", [files / "mask.png"])


def test_regions_that_are_none_are_refused(files):
    smooth = np.add.outer(np.arange(SIZE[0]), np.arange(SIZE[1])).astype(np.uint8)
    Image.fromarray(smooth).save(files / "smooth.png")
    with pytest.raises(InputError, match="1 to 8 values besides 0"):
        photograph.open_photograph(files / "photo.png", [files / "mask.png"], files / "smooth.png")
    corner = np.zeros(SIZE, np.uint8)
    corner[:3, :3] = 5
    Image.fromarray(corner).save(files / "corner.png")
    with pytest.raises(InputError, match="region 1"):
        photograph.open_photograph(files / "photo.png", [files / "mask.png"], files / "corner.png")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "JSON with"),
        ('{"other": 1}', "JSON with"),
        ('{"label": [1, 2]}', "108 numbers"),
        ('{"label": [' + ", ".join(["NaN"] * 108) + "]}", "logarithms"),
        ('{"label": [' + ", ".join(["5000"] * 108) + "]}", "logarithms"),
        ("[1]", "JSON with"),
    ],
)
def test_a_material_file_without_a_material_is_refused(tmp_path, text, words):
    file = tmp_path / "material.json"
    file.write_text(text)
    with pytest.raises(InputError, match=words):
        targets.resolve_labels(str(file), None)


def test_transfer_needs_two_pictures_of_different_names(files, capsys):
    status, line = message(capsys, "transfer", files / "photo.png", "--out", files / "out")
    assert status == 1 and "two or more" in line
    status, line = message(
        capsys, "transfer", files / "photo.png", files / "photo.png", "--out", files / "out"
    )
    assert status == 1 and "twice" in line
    status, line = message(
        capsys,
        "transfer",
        files / "photo.png",
        files / "mask.png",
        "--mask-dir",
        files / "masks",
        "--out",
        files / "out",
    )
    assert status == 1 and "no such file" in line


def test_transfer_does_not_write_two_results_into_one_file(tmp_path):
    names = ("a", "b-in-c", "a-in-b", "c")
    options = EditOptions(tmp_path / "none.pt", None, 0.01, 0.0)
    with pytest.raises(ValueError, match=r"found a-in-b-in-c\.png twice"):
        transfer.run([tmp_path / f"{name}.png" for name in names], None, tmp_path, options)


def test_edits_into_files_of_one_name_have_files_of_their_own(tmp_path):
    texts = ["x/m.json", "y/m.json", "m-2.json"]
    names = edit_files.reserve_names(tmp_path / "p.png", texts, [], tmp_path / "out", False)
    assert len(set(names)) == 3


def test_a_folder_without_a_name_in_place_of_a_picture_is_refused_in_a_line(
    files, capsys, monkeypatch
):
    monkeypatch.chdir(files)
    (files / "masks").mkdir()
    (files / "masks" / "photo.png").write_bytes((files / "mask.png").read_bytes())
    status, line = message(capsys, "transfer", ".", "photo.png", "--out", "out")
    assert status == 1 and "expected a data set (dataset.json), found none" in line
    status, line = message(
        capsys, "transfer", "photo.png", ".", "--mask-dir", "masks", "--out", "out"
    )
    assert status == 1 and "the mask of ., found no such file" in line
    status, line = message(capsys, *edit(files, material="."))
    assert status == 1 and "expected" in line


def deep_png(path, values):
    """A 16-bit RGB PNG of (H, W, 3) uint16, which Pillow can read and cannot write."""
    height, width = values.shape[:2]
    lines = b"".join(b"\0" + line.astype(">u2").tobytes() for line in values)
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines)),
        (b"IEND", b""),
    ]
    report = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(report))


def test_sixteen_bit_colour_keeps_its_upper_eight_bits(files):
    values = np.random.default_rng(0).integers(0, 1 << 16, (*SIZE, 3), dtype=np.uint16)
    deep_png(files / "deep.png", values)
    radiance, _ = photographs.read(files / "deep.png", files / "mask.png")
    # the lower eight are gone
    np.testing.assert_allclose(tone.srgb(radiance), values / 65535, atol=1 / 255)


def test_a_picture_of_twenty_megapixels_is_cut_to_its_object(files):
    values = np.zeros((3648, 5472, 4), np.uint8)
    values[1000:2000, 3000:4500] = (200, 100, 50, 255)
    Image.fromarray(values).save(files / "large.png", compress_level=1)
    framed = framing.frame_object(*photographs.read(files / "large.png"), 128, 1.0)
    assert framed.radiance.shape == (128, 128, 3) and framed.box[2] == pytest.approx(
        1500 * framing.MARGIN, rel=0.02
    )
    seen = tone.display(framed.radiance[60:68, 60:68], 1.0)
    np.testing.assert_allclose(seen, np.broadcast_to([200, 100, 50], seen.shape), atol=1)
