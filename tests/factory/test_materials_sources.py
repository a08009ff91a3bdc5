"""Claims about where materials come from: MERL's binary files, neural weights, ABC's table;
refusals by place and remedy.
"""

import os
import struct
import tracemalloc

import numpy as np
import pytest

from factory.materials import abc, families, merl_binary, nbrdf, sources
from manifests.errors import InputError
from shaders import samples
from tests.support.merl_file import smooth, write_binary


def test_a_merl_file_is_read_at_its_cell_centres(tmp_path):
    theta_h, theta_d = write_binary(tmp_path / "own.binary", smooth)
    measured = merl_binary.read(tmp_path / "own.binary")
    for i, j in ((0, 0), (5, 3), (11, 8)):
        np.testing.assert_allclose(
            measured(np.cos(theta_h[i]), np.cos(theta_d[j])),
            smooth(theta_h[i], theta_d[j]),
            rtol=1e-6,
        )


def test_directions_that_were_not_measured_are_left_out_of_the_mean(tmp_path):
    theta_h, theta_d = write_binary(tmp_path / "own.binary", smooth, hole=(4, 2, slice(0, 3)))
    result = merl_binary.read(tmp_path / "own.binary")(np.cos(theta_h[4]), np.cos(theta_d[2]))
    np.testing.assert_allclose(result, smooth(theta_h[4], theta_d[2]), rtol=1e-6)


def test_a_cell_without_any_measurement_takes_the_nearest_one(tmp_path):
    theta_h, theta_d = write_binary(tmp_path / "own.binary", smooth, hole=(11, 2, slice(None)))
    result = merl_binary.read(tmp_path / "own.binary")(np.cos(theta_h[11]), np.cos(theta_d[2]))
    np.testing.assert_allclose(result, smooth(theta_h[10], theta_d[2]), rtol=1e-6)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected a header of 12 bytes, found 0 bytes"),
        (
            struct.pack("<3i", 90, 90, -180),
            "expected a header of three sizes such as 90, 90, 180, found 90, 90, -180",
        ),
        (struct.pack("<3i", 2**30, 2**30, 2**30), "a header of three sizes"),
        (
            struct.pack("<3i", 90, 90, 180) + b"\0" * 800,
            r"expected 34992012 bytes after such a header, found 812",
        ),
        (
            struct.pack("<3i", 2, 2, 2) + struct.pack("<24d", *[np.nan] * 24),
            "expected finite values",
        ),
        (
            struct.pack("<3i", 2, 2, 2) + struct.pack("<24d", *[-1.0] * 24),
            "expected a measurement at every θ_d",
        ),
    ],
)
def test_a_broken_merl_file_is_refused_in_one_line(tmp_path, content, message):
    (tmp_path / "bad.binary").write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        merl_binary.read(tmp_path / "bad.binary")
    assert "\n" not in str(caught.value) and "bad.binary" in str(caught.value)


def test_a_folder_without_merl_files_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"expected files that end in .binary, found none"):
        sources.load(tmp_path)


def network(rng):
    return rng.normal(size=nbrdf.PARAMETERS).astype(np.float32) * 0.2


def test_a_neural_brdf_is_its_three_layers_averaged_over_the_azimuth(rng):
    weights = network(rng)
    w1, b1, rest = weights[:126].reshape(6, 21), weights[126:147], weights[147:]
    w2, b2, w3, b3 = (
        rest[:441].reshape(21, 21),
        rest[441:462],
        rest[462:525].reshape(21, 3),
        rest[525:],
    )
    theta_h, theta_d = 0.3, 0.4  # small enough that every azimuth is above the horizon
    values = []
    for phi in 2 * np.pi * np.arange(16) / 16:
        x = np.array(
            [
                np.sin(theta_h),
                0,
                np.cos(theta_h),
                *(np.sin(theta_d) * np.array([np.cos(phi), np.sin(phi)])),
                np.cos(theta_d),
            ]
        )
        x = np.maximum(np.maximum(x @ w1 + b1, 0) @ w2 + b2, 0) @ w3 + b3
        values.append(np.maximum(np.expm1(x), 0))
    result = nbrdf.NeuralBRDF(weights)(np.cos(theta_h), np.cos(theta_d))
    np.testing.assert_allclose(result, np.mean(values, 0), rtol=1e-6)


def test_neural_weights_are_found_by_name_and_unknown_names_listed(tmp_path, rng):
    np.savez(
        tmp_path / "own.npz",
        names=np.array(["felt", "steel", "satin_blue_rgb"]),
        weights=np.stack([network(rng)] * 3),
    )
    result = sources.load(tmp_path / "own.npz")
    assert list(result) == ["felt", "satin_blue", "steel"]
    assert (result["satin_blue"].family, result["steel"].family) == ("fabric", "metal")
    with pytest.raises(
        InputError,
        match=r"expected a material named 'stel', found none of that name \(did you mean steel",
    ):
        sources.load(tmp_path / "own.npz", ["stel"])


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"names": np.array(["a"])}, "expected an npz with `names` and `weights`"),
        (
            {"names": np.array(["a"]), "weights": np.zeros((1, 7))},
            r"expected weights \(N, 675\) beside N names, found weights \(1, 7\)",
        ),
        (
            {"names": np.array(["a"]), "weights": np.full((1, 675), np.inf)},
            "expected finite weights",
        ),
        (
            {"names": np.array([{"a": 1}], dtype=object), "weights": np.zeros((1, 675))},
            "found 'an array of object'",
        ),
    ],
)
def test_an_archive_of_other_things_is_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError, match=message):
        nbrdf.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("name", ["../felt", "a/b", "", ".", "a\nb", "x" * 101, "a\\b"])
def test_a_material_whose_name_would_lead_out_of_a_folder_is_refused(tmp_path, rng, name):
    """Fits are kept in files that are named after the materials."""
    np.savez(
        tmp_path / "own.npz", names=np.array([name, "felt"]), weights=np.stack([network(rng)] * 2)
    )
    with pytest.raises(InputError, match=r"own\.npz: expected names of letters"):
        sources.load(tmp_path / "own.npz")


def test_an_archive_that_swells_is_refused_before_it_is_unpacked(tmp_path):
    # 162 MB from 0.2 MB
    np.savez_compressed(
        tmp_path / "own.npz", names=np.array(["felt"]), weights=np.zeros((30_000, 675))
    )
    tracemalloc.start()
    with pytest.raises(InputError, match=r"expected at most 67,108,864 bytes, found 162,000,000"):
        nbrdf.load(tmp_path / "own.npz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6


@pytest.mark.parametrize("name", ["own.npz", "own.binary", "folder/own.binary"])
def test_a_pipe_as_a_source_is_refused_and_not_waited_for(tmp_path, name):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="found a pipe"):
        sources.load((tmp_path / name) if "/" not in name else tmp_path / "folder")


@pytest.mark.parametrize(
    "row",
    [
        "a,1,1,1,1,1,1,1,1",
        "a,1,1,1,1,1,1,1,1,nan",
        "a,1,1,1,1,1,1,1,1,x",
        ",1,1,1,1,1,1,1,1,1",
        'a,"' + "1" * 200_000,
    ],
)
def test_a_row_of_the_abc_table_that_is_none_is_refused(tmp_path, row):
    (tmp_path / "abc.csv").write_text("name,kd_r,kd_g,kd_b,A_r,A_g,A_b,B,C,ior\n" + row + "\n")
    with pytest.raises(InputError, match=r"abc\.csv: line [12]: expected numbers under kd_r"):
        abc.load(tmp_path / "abc.csv")


def test_the_abc_table_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "abc.csv").write_text(
        "\ufeffname,kd_r,kd_g,kd_b,A_r,A_g,A_b,B,C,ior\na,1,1,1,1,1,1,1,1,1.5\n", encoding="utf-8"
    )
    assert list(abc.load(tmp_path / "abc.csv")) == ["a"]


def test_a_torn_archive_is_refused(tmp_path, rng):
    np.savez(tmp_path / "own.npz", names=np.array(["felt"]), weights=network(rng)[None])
    (tmp_path / "torn.npz").write_bytes((tmp_path / "own.npz").read_bytes()[:1500])
    with pytest.raises(InputError, match=r"torn\.npz"):
        nbrdf.load(tmp_path / "torn.npz")


def test_twenty_of_merls_hundred_are_held_out_of_every_larger_family():
    assert len(families.HELD_OUT) == 20
    held = {families.family(name) for name in families.HELD_OUT}
    assert {
        "metal",
        "metallic paint",
        "paint",
        "phenolic",
        "plastic",
        "fabric",
        "rubber",
        "wood",
    } <= held
    assert (
        all(families.split(name) == "test" for name in families.HELD_OUT)
        and families.split("chrome") == "train"
    )


def test_colours_of_one_epfl_stuff_stay_on_one_side():
    for stem in ("acrylic_felt", "colodur", "paper", "satin"):
        assert (
            len({families.rgl_split(f"{stem}_{colour}") for colour in ("green", "orange", "white")})
            == 1
        )


# --- the lent data


@pytest.fixture(scope="module")
def merl(shared_data):
    return sources.load(shared_data / "brdf" / "merl_nbrdf.npz")


def test_merls_hundred_have_their_families(merl):
    assert len(merl) == 100 and not families.HELD_OUT - set(merl)
    assert "other" not in {s.family for s in merl.values()}


def test_measurements_are_symmetric_finite_and_not_negative(merl):
    s = samples.held_out_samples()
    for name in ("chrome", "blue-rubber", "red-fabric"):
        f = merl[name].measured(s.cos_h, s.cos_d)
        assert np.isfinite(f).all() and (f >= 0).all()


def test_the_neural_fits_and_the_abc_table_tell_of_the_same_materials(merl, shared_data):
    """Two fits of the same measurements by different people: each nearer to its namesake than to a
    stranger, median within 20 %.
    """
    table = abc.load(shared_data / "brdf" / "abc_merl100.csv")
    assert set(table) == set(merl)
    some = {name: merl[name] for name in sorted(merl)[::8]}
    mean = {name: l1.mean() for name, l1 in abc.relative_distances(some, table).items()}
    assert np.median(list(mean.values())) < 0.2
    shuffled = dict(
        zip(table, [*list(table.values())[37:], *list(table.values())[:37]], strict=True)
    )
    strangers = {name: l1.mean() for name, l1 in abc.relative_distances(some, shuffled).items()}
    assert all(mean[name] < strangers[name] for name in mean)
