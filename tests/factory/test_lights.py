"""Lights: one convention whatever they come from, and one line for a file that holds none."""

import importlib.util
import io
import shutil
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from factory.commands import lights as command
from factory.lights import files, library, load, names, procedural
from factory.lights.catalogue import wheel_maps
from factory.lights.light import from_pixels
from factory.lights.preview import diffuse_sphere, mirror_sphere, sphere_normals
from manifests.cli import main
from manifests.errors import InputError
from shaders import envmap, frames


def encode(pixels):
    """RGBE bytes (H, W, 4) of positive pixels."""
    brightest = pixels.max(-1)
    exponent = np.where(brightest > 0, np.floor(np.log2(np.maximum(brightest, 1e-30))) + 1, -128)
    mantissa = np.floor(pixels / 2.0 ** exponent[..., None] * 256)
    bytes_ = np.concatenate([mantissa, exponent[..., None] + 128], axis=-1)
    return np.where(brightest[..., None] > 0, bytes_, 0).astype(np.uint8)


def in_file(L):
    """A light-frame map (H, W, 3) with the columns that it has in a file."""
    return envmap.roll(L, L.shape[1] // 4)


def header(height, width, extra=""):
    return f"#?RADIANCE\n{extra}FORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()


def new_style(row):
    """One scanline (W, 4) run-length coded by component: runs of the same byte as runs, the rest as
    literals of one.
    """
    out = bytearray([2, 2, len(row) >> 8, len(row) & 255])
    for component in row.T:
        column = 0
        while column < len(component):
            end = column
            while (
                end < len(component) and end - column < 127 and component[end] == component[column]
            ):
                end += 1
            out += (
                bytes([128 + end - column, component[column]])
                if end - column > 1
                else bytes([1, component[column]])
            )
            column = end
    return bytes(out)


def old_style(row):
    """One scanline (W, 4) with repeats written as 1 1 1 n."""
    out, column = bytearray(), 0
    while column < len(row):
        end = column + 1
        while end < len(row) and (row[end] == row[column]).all():
            end += 1
        out += bytes(row[column])
        repeats = end - column - 1
        while repeats:
            out += bytes([1, 1, 1, repeats & 255])
            repeats >>= 8
        column = end
    return bytes(out)


def write_hdr(path, pixels, scanline=new_style, extra=""):
    path.write_bytes(
        header(*pixels.shape[:2], extra) + b"".join(scanline(row) for row in encode(pixels))
    )
    return path


def write_exr(path, pixels, dtype=np.float32):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels.astype(dtype)}) as file:
        file.write(str(path))
    return path


@pytest.fixture
def drawn(rng):
    """A map (16, 32, 3) with a wide range and runs of equal texels, exact in RGBE up to its 8
    bits.
    """
    L = np.repeat(
        rng.uniform(0.1, 1.0, (16, 4, 3)) * 10.0 ** rng.integers(-3, 4, (16, 4, 1)), 8, axis=1
    )
    L[3, 5:29] = 0.0
    return L


# Reading


@pytest.mark.parametrize(
    "scanline", [new_style, old_style, lambda row: row.tobytes()], ids=["new", "old", "flat"]
)
def test_each_scanline_style_of_radiance_files_reads_the_same_pixels(tmp_path, drawn, scanline):
    pixels, _ = files.read(write_hdr(tmp_path / "a.hdr", drawn, scanline))
    # the mantissa of the brightest component has 8 bits, the first of them 1: a step is at most
    # 1/128 of it
    assert (np.abs(pixels - drawn).max(-1) <= drawn.max(-1) / 128 + 1e-12).all()
    assert (pixels[3, 5:29] == 0).all()


def test_old_style_repeats_longer_than_255_use_shifted_counts(tmp_path):
    L = np.full((300, 600, 3), 0.75)
    pixels, _ = files.read(write_hdr(tmp_path / "a.hdr", L, old_style))
    assert np.ptp(pixels) == 0 and pixels[0, 0, 0] == pytest.approx(0.75, rel=1 / 256)


def test_the_exposure_line_is_divided_out(tmp_path, drawn):
    plain, _ = files.read(write_hdr(tmp_path / "a.hdr", drawn))
    exposed, _ = files.read(
        write_hdr(tmp_path / "b.hdr", drawn, extra="EXPOSURE=4\nEXPOSURE=0.5\n")
    )
    np.testing.assert_allclose(exposed * 2, plain, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_openexr_files_read_as_written(tmp_path, drawn, dtype):
    pixels, _ = files.read(write_exr(tmp_path / "a.exr", drawn, dtype))
    np.testing.assert_array_equal(pixels, drawn.astype(dtype).astype(np.float32))


def test_a_grey_openexr_file_lights_all_three_channels(tmp_path, drawn):
    grey = drawn[..., 0].astype(np.float32)
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": grey}) as file:
        file.write(str(tmp_path / "grey.exr"))
    pixels, _ = files.read(tmp_path / "grey.exr")
    np.testing.assert_array_equal(pixels, np.repeat(grey[..., None], 3, axis=-1))


# Convention


def test_every_light_has_mean_luminance_one_at_both_sizes():
    for name in names():
        light = load(name)
        for L in (light.L64, light.L_full):
            # float32 texels, summed in float64
            assert envmap.mean_radiance(L) @ envmap.LUMINANCE == pytest.approx(1.0, abs=1e-5), name
        assert (
            light.L64.shape == (64, 128, 3)
            and light.L64.dtype == np.float32
            and (light.L64 >= 0).all()
        )


def test_the_layers_map_is_the_full_map_averaged_by_solid_angle():
    light = load("softboxes-5")
    np.testing.assert_allclose(
        light.L64, envmap.resize(light.L_full, 64, 128), rtol=1e-5, atol=1e-6
    )


def test_scale_times_map_gives_back_the_file(tmp_path, drawn):
    light = load(write_exr(tmp_path / "a.exr", drawn))
    np.testing.assert_allclose(in_file(light.L_full) * light.scale, drawn, rtol=1e-5)


@pytest.mark.parametrize("azimuth_deg", [0.0, 75.0, 180.0, 285.0])
def test_a_lit_texel_lies_where_blenders_look_up_puts_it(tmp_path, azimuth_deg):
    """Blender: u = ½ − atan2(y, x)/2π, v = ½ + atan2(z, hypot)/π from the bottom row, at world
    rotation 0.
    """
    height, width, row, column = 64, 128, 20, 37
    pixels = np.zeros((height, width, 3))
    pixels[row, column] = 1.0
    light = load(write_exr(tmp_path / "a.exr", pixels))
    u, latitude = (column + 0.5) / width, np.pi * (0.5 - (row + 0.5) / height)
    longitude = 2 * np.pi * (0.5 - u)
    w_world = np.array(
        [
            np.cos(longitude) * np.cos(latitude),
            np.sin(longitude) * np.cos(latitude),
            np.sin(latitude),
        ]
    )

    azimuth = np.radians(azimuth_deg)
    # 75° is no whole texel: the nearest one
    seen = envmap.roll(light.L64, round(azimuth_deg / 360 * width))
    w_light = frames.world_from_light(azimuth).T @ w_world
    lit = np.unravel_index(seen[..., 0].argmax(), (height, width))
    apart = np.degrees(
        np.arccos(np.clip(envmap.directions(height, width)[0][lit] @ w_light, -1, 1))
    )
    assert apart < (0.01 if azimuth_deg % (360 / width) == 0 else 360 / width / 2)


def test_a_width_that_is_no_multiple_of_four_keeps_its_energy(rng):
    pixels = rng.uniform(0.1, 5.0, (9, 18, 3))
    light = from_pixels(pixels, "odd", "0" * 64, "CC0", "test")
    assert light.L_full.shape == (9, 20, 3)
    np.testing.assert_allclose(
        envmap.mean_radiance(light.L_full) * light.scale, envmap.mean_radiance(pixels), rtol=1e-6
    )


def test_the_wheels_eight_maps_are_found_without_importing_bpy():
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("the bpy wheel, which holds the maps, is not installed")
    code = (
        "import sys; from factory.lights import names, load; print(*names()[:8],"
        " load('city').licence, 'bpy' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert result == [
        "city",
        "courtyard",
        "forest",
        "interior",
        "night",
        "studio",
        "sunrise",
        "sunset",
        "CC0",
        "False",
    ]


@pytest.mark.blender
def test_blender_reads_the_same_radiance_from_an_hdr_file(tmp_path, rng):
    bpy = pytest.importorskip("bpy")
    L = rng.uniform(0.1, 1.0, (8, 16, 3)) * 10.0 ** rng.integers(-2, 3, (8, 16, 1))
    image = bpy.data.images.load(str(write_hdr(tmp_path / "a.hdr", L)))
    image.colorspace_settings.name = "Non-Color"
    theirs = np.array(image.pixels[:], dtype=np.float32).reshape(8, 16, 4)[::-1, :, :3]
    bpy.data.images.remove(image)
    np.testing.assert_allclose(files.read(tmp_path / "a.hdr")[0], theirs, rtol=1e-6)


# Computed lights


def test_computed_lights_repeat_for_a_seed_and_differ_between_seeds():
    for family in procedural.FAMILIES:
        np.testing.assert_array_equal(procedural.pixels(family, 3), procedural.pixels(family, 3))
    assert load("softboxes").hash == load("softboxes-0").hash != load("softboxes-1").hash
    assert not np.array_equal(load("softboxes-0").L64, load("softboxes-1").L64)
    assert not np.array_equal(load("one-texel-1").L64, load("one-texel-2").L64)


def test_one_texel_lights_exactly_one_texel_of_the_layers_map():
    for seed in range(8):
        assert (load(f"one-texel-{seed}").L64.max(-1) > 0).sum() == 1


# Preview


def test_the_preview_ball_under_constant_light_is_white_and_the_mirror_shows_the_map():
    light = load("constant")
    _, mask = sphere_normals(33)
    # 32×64 texels summed at their centres: the cosine's edge leaves 0.5 %
    np.testing.assert_allclose(diffuse_sphere(light.L64, 33)[mask], 1.0, atol=0.005)
    np.testing.assert_allclose(mirror_sphere(light.L_full, 33)[mask], 1.0, rtol=1e-6)


def test_the_mirror_ball_shows_the_sky_above_and_the_ground_below():
    ball = mirror_sphere(load("gradient").L_full, 65)
    assert ball[5, 32, 0] > ball[32, 32, 0] > ball[60, 32, 0]


# Bad input: one line that says where, what was expected, what was found and the remedy


def bad_cases(folder, good):
    """(name, path, part of the message) of files that hold no usable light."""
    whole_exr = write_exr(folder / "good.exr", good).read_bytes()
    whole_hdr = write_hdr(folder / "good.hdr", good).read_bytes()
    png = io.BytesIO()
    Image.fromarray(np.zeros((8, 16, 3), np.uint8)).save(png, "PNG")
    levels = np.linspace(0, 1, 256)[np.random.default_rng(1).integers(0, 256, (64, 128, 3))]
    nan, infinite, negative = good.copy(), good.copy(), good.copy()
    nan[2, 3, 1], infinite[2, 3, 1], negative[2, 3] = np.nan, np.inf, -10 * good.mean()

    def raw(name, data):
        (folder / name).write_bytes(data)
        return folder / name

    return {
        "missing": (folder / "nowhere.exr", "no such file"),
        "folder": (folder, "a folder"),
        "empty": (raw("empty.hdr", b""), "an empty file"),
        "truncated exr": (raw("cut.exr", whole_exr[: len(whole_exr) // 2]), "truncated"),
        "only the exr's first bytes": (raw("first.exr", whole_exr[:8]), "truncated"),
        "truncated hdr": (
            raw("cut.hdr", whole_hdr[: len(whole_hdr) * 2 // 3]),
            "the file ends early",
        ),
        "hdr header alone": (raw("head.hdr", header(16, 32)), "the file ends early"),
        "hdr without size": (
            raw("size.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\nhello\n" + b"0" * 99),
            "-Y height +X width",
        ),
        "hdr of another colour space": (
            raw("xyz.hdr", whole_hdr.replace(b"rgbe\n\n", b"xyze\n\n")),
            "32-bit_rle_xyze",
        ),
        "hdr run over the line": (
            raw("run.hdr", header(16, 32) + b"\x02\x02\x00\x20" + b"\xff\x01" * 600),
            "a run that is longer",
        ),
        "huge hdr": (raw("huge.hdr", header(400_000, 800_000)), "800000×400000"),
        "PNG called exr": (raw("png.exr", png.getvalue()), "a PNG picture"),
        "PNG": (raw("plain.png", png.getvalue()), "a PNG picture"),
        "JPG called hdr": (raw("jpg.hdr", b"\xff\xd8\xff\xe0" + b"0" * 60), "a JPEG picture"),
        "text": (raw("text.exr", b"hello world, this is no light"), "begins with"),
        "8-bit levels": (write_exr(folder / "levels.exr", levels), "256 levels"),
        "negative": (write_exr(folder / "negative.exr", negative), "1 negative texels"),
        "NaN": (write_exr(folder / "nan.exr", nan), "NaN or infinity in 1 texels"),
        "infinite": (write_exr(folder / "inf.exr", infinite), "NaN or infinity in 1 texels"),
        "black": (write_exr(folder / "black.exr", 0 * good), "black everywhere"),
        "square": (write_exr(folder / "square.exr", good[:, :16]), "16×16"),
    }


def test_each_bad_file_is_told_in_one_line_with_where_found_and_remedy(tmp_path, drawn):
    for case, (path, words) in bad_cases(tmp_path, drawn).items():
        with pytest.raises(InputError) as caught:
            load(path)
        message = str(caught.value)
        assert words in message, (case, message)
        assert message.startswith(str(path)) and "\n" not in message and caught.value.remedy, (
            case,
            message,
        )


def test_a_huge_openexr_header_is_refused_before_its_pixels_are_read(tmp_path, drawn, monkeypatch):
    monkeypatch.setattr(files, "MAX_HEIGHT", 8)
    opened = []
    real = OpenEXR.File
    monkeypatch.setattr(OpenEXR, "File", lambda *a, **k: opened.append(k) or real(*a, **k))
    write_exr(tmp_path / "a.exr", drawn)
    opened.clear()
    with pytest.raises(InputError, match="at most 16×8 pixels"):
        load(tmp_path / "a.exr")
    assert opened == [{"header_only": True}]


def test_small_negative_ripple_of_lossy_files_becomes_zero(tmp_path, drawn):
    rippled = drawn.copy()
    rippled[3, 7] = -0.01 * envmap.mean_radiance(drawn).mean()
    assert load(write_exr(tmp_path / "a.exr", rippled)).L_full.min() == 0.0


def test_an_unknown_name_is_answered_with_the_closest_ones():
    with pytest.raises(InputError, match=r"did you mean .*courtyard"):
        load("courtyrd")
    with pytest.raises(InputError):
        load("softboxes-")


def test_noise_of_every_kind_never_ends_in_anything_but_a_problem(tmp_path, drawn, rng):
    np.savez_compressed(tmp_path / "a.npz", L=drawn)
    written = (
        write_hdr(tmp_path / "a.hdr", drawn),
        write_exr(tmp_path / "a.exr", drawn),
        tmp_path / "a.npz",
    )
    for whole in (path.read_bytes() for path in written):
        for trial in range(60):
            damaged = bytearray(whole)
            for place in rng.integers(0, len(whole), 3):
                damaged[place] = rng.integers(0, 256)
            path = tmp_path / f"{trial}.bin"
            path.write_bytes(damaged[: rng.integers(1, len(whole) + 1)])
            try:
                light = load(path)
            except InputError:
                continue
            assert np.isfinite(light.L64).all()


# Commands


def run(*arguments):
    return main("factory", "lights", ("lights",), ["lights", *map(str, arguments)])


def test_add_copies_once_lists_the_licence_and_load_finds_it(tmp_path, drawn, capsys):
    path = write_exr(tmp_path / "My Harbour.exr", drawn)
    home = tmp_path / "library"
    assert run("add", path, "--library", home, "--licence", "CC-BY-4.0") == 0
    assert run("add", path, "--library", home) == 0  # the same map again: nothing twice
    assert sorted(p.name for p in home.iterdir()) == ["lights.json", "my-harbour.exr"]
    light = load("my-harbour", library=home)
    assert (light.licence, light.source) == ("CC-BY-4.0", "My Harbour.exr")
    other = write_exr(tmp_path / "my harbour.exr", drawn + 1)
    assert run("add", other, "--library", home) == 1
    assert "another map called 'my-harbour'" in capsys.readouterr().err


def test_add_takes_every_map_of_an_npz_but_those_that_are_there_under_another_name(
    tmp_path, rng, capsys
):
    fresh = np.exp(rng.standard_normal((64, 128, 3))).astype(np.float32)
    turned = envmap.roll(3 * in_file(load("city").L64), 40)
    np.savez(tmp_path / "maps.npz", Lagoon=fresh, copy=turned, again=fresh * 2)
    home = tmp_path / "library"
    assert run("add", tmp_path / "maps.npz", "--library", home, "--licence", "CC0") == 0
    report = capsys.readouterr().out
    assert "copy: city again, left out" in report and "again: lagoon again, left out" in report
    assert sorted(p.name for p in home.iterdir()) == ["lagoon.npz", "lights.json"]
    light = load("lagoon", library=home)
    assert light.licence == "CC0"
    np.testing.assert_allclose(light.scale * in_file(light.L_full), fresh, rtol=1e-5)


@pytest.mark.parametrize("kind", ["exr", "npz"])
def test_a_map_that_was_not_listed_when_a_run_was_killed_is_listed_by_the_next(
    tmp_path, drawn, kind
):
    if kind == "exr":
        path = write_exr(tmp_path / "lamp.exr", drawn)
    else:
        np.savez(path := tmp_path / "maps.npz", lamp=drawn)
    home = tmp_path / "library"
    assert run("add", path, "--library", home, "--licence", "CC0") == 0
    listed = (home / "lights.json").read_bytes()
    (home / "lights.json").unlink()
    assert run("add", path, "--library", home, "--licence", "CC0") == 0
    assert (home / "lights.json").read_bytes() == listed
    (home / "lights.json").unlink()
    (home / f"lamp.{kind}").write_bytes(b"another one's")
    assert run("add", path, "--library", home, "--licence", "CC0") == 1
    assert (home / f"lamp.{kind}").read_bytes() == b"another one's"


def test_an_npz_is_judged_by_its_headers_and_never_unpickled(tmp_path, drawn, monkeypatch):
    np.savez(tmp_path / "objects.npz", L=np.array([{"a": 1}], dtype=object))
    np.savez(tmp_path / "two.npz", a=drawn, b=drawn)
    np.savez(tmp_path / "square.npz", a=drawn[:, :16])
    for name, words in (
        ("objects", "of object"),
        ("two", r"several \('a', 'b'"),
        ("square", r"\(16, 16, 3\)"),
    ):
        with pytest.raises(InputError, match=words):
            load(tmp_path / f"{name}.npz")
    np.savez(tmp_path / "large.npz", a=drawn)
    monkeypatch.setattr(files, "MAX_HEIGHT", 8)
    monkeypatch.setattr(np.lib.format, "read_array", None)  # must not be reached
    with pytest.raises(InputError, match="H from 4 to 8"):
        load(tmp_path / "large.npz")


def test_a_damaged_list_is_told_in_one_line(tmp_path):
    (tmp_path / "lights.json").write_text("{")
    with pytest.raises(InputError, match=r"lights\.json: expected JSON"):
        library.read_list(tmp_path)


def test_list_shows_builtin_and_own_maps_and_fails_for_a_bad_one(
    tmp_path, drawn, capsys, monkeypatch
):
    monkeypatch.setattr("factory.lights.catalogue.wheel_maps", dict)
    write_exr(tmp_path / "mine.exr", drawn)
    assert run("list", tmp_path) == 0
    shown = capsys.readouterr().out
    assert "mine" in shown and "softboxes" in shown and "32×16" in shown
    (tmp_path / "bad.hdr").write_bytes(b"")
    assert run("list", tmp_path) == 1
    assert "an empty file" in capsys.readouterr().out


def test_preview_writes_one_row_a_light(tmp_path, capsys):
    assert (
        run("preview", "constant", "softboxes-2", "--size", "16", "--out", tmp_path / "p.png") == 0
    )
    with Image.open(tmp_path / "p.png") as picture:
        assert picture.size == (64, 32)
    assert run("preview", "nonsuch", "--out", tmp_path / "q.png") == 1
    assert not (tmp_path / "q.png").exists()


def test_help_needs_no_heavy_import():
    code = (
        f"import sys; import {command.__name__}; sys.exit(bool({{'numpy', 'PIL', 'OpenEXR', 'bpy'}}"
        " & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_two_files_of_one_name_in_a_library_are_refused(tmp_path):
    ramp = np.linspace(2.0, 0.1, 8 * 16, dtype=np.float32).reshape(8, 16, 1)
    for name, factor in (("lamp.npz", 1.0), ("lamp.NPZ", 2.0), ("other.npz", 3.0)):
        with open(tmp_path / name, "wb") as file:
            np.savez(file, L=factor * ramp[:, ::-1] * np.ones(3, np.float32))
    with pytest.raises(InputError) as caught:
        load("lamp", tmp_path)
    assert str(caught.value) == (
        f"{tmp_path}: expected one map under a name, found lamp.NPZ and lamp.npz"
        " (rename or remove one of the files)"
    )
    (tmp_path / "lamp.NPZ").rename(tmp_path / "lamp-2.NPZ")
    assert {load(name, tmp_path).name for name in ("lamp", "lamp-2")} == {"lamp", "lamp-2"}


@pytest.mark.parametrize("name", ["constant", "softboxes-7", "blender-city"])
def test_a_map_of_a_library_that_has_the_name_of_a_built_in_light_is_refused(tmp_path, drawn, name):
    path = write_exr(tmp_path / f"{name}.exr", drawn)
    with pytest.raises(InputError) as caught:
        load(name, tmp_path)
    assert str(caught.value) == (
        f"light '{name}': expected one map under a name, found {path} and the built-in light"
        " (rename the file, or give its path in place of the name)"
    )
    assert load(path).name == name  # a path is not ambiguous
    assert load("gradient", tmp_path).name == "gradient"  # nor is another name


def test_a_copy_of_a_built_in_light_in_a_library_is_that_light(tmp_path):
    wheel = wheel_maps()
    if not wheel:
        pytest.skip("the bpy wheel, which holds the maps, is not installed")
    shutil.copy(wheel["city"], tmp_path)
    assert load("city", tmp_path).hash == load("city").hash


def test_add_refuses_the_name_of_a_built_in_light(tmp_path, drawn, capsys):
    home = tmp_path / "library"
    path = write_exr(tmp_path / "Gradient.exr", drawn)
    np.savez(tmp_path / "maps.npz", Gradient=drawn)
    for where in (path, tmp_path / "maps.npz"):
        assert run("add", where, "--library", home) == 1
        said = capsys.readouterr().err
        assert "expected a name that is still free, found the built-in light 'gradient'" in said
        assert "(rename " in said and not home.exists()
