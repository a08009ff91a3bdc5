"""Claims of `python -m factory materials`: fits, adds, resumes, lists, draws and reports; refuses
in one line.
"""

import json
import os
import struct

import msgspec
import numpy as np
import pytest
from PIL import Image

from factory.__main__ import COMMANDS
from factory.planning.material_names import choose_entries
from manifests import materials
from manifests.cli import main
from manifests.described_materials import DESCRIBED
from manifests.errors import InputError
from manifests.materials import load_catalogue
from tests.support.merl_file import smooth, write_binary


def run(*arguments):
    return main(
        "factory", "test", [c for c in COMMANDS if c == "materials"], [*map(str, arguments)]
    )


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A folder with one measured material, fitted into a catalogue with one closure (quick, and
    none of its tolerances matter here).
    """
    folder = tmp_path_factory.mktemp("own")
    write_binary(folder / "own-wood.binary", lambda h, d: 0.1 * smooth(h, d))
    assert run("materials", "add", folder, "--closures", 1, "--out", folder / "own.json") == 0
    return folder


def test_a_users_measurement_becomes_a_material(own):
    catalogue = materials.load_catalogue(own / "own.json")
    wood = catalogue["own-wood"]
    assert wood.label.shape == (3, 3, 2, 6) and np.isfinite(wood.label).all()
    assert wood.mixture.weights.max() > 0 and len(wood.mixture.kinds) == 1
    assert len(wood.errors.nodes_vs_label.l1) == 6 and wood.errors.nodes_vs_label.display_l2 == ()
    assert wood.source == "MERL .binary"


def test_a_second_call_takes_the_fits_that_are_kept(own, capsys):
    kept = list((own / "own.json.fits").iterdir())
    before = [os.stat(file).st_mtime_ns for file in kept], (own / "own.json").read_bytes()
    assert run("materials", "add", own, "--closures", 1, "--out", own / "own.json") == 0
    assert [os.stat(file).st_mtime_ns for file in (own / "own.json.fits").iterdir()] == before[0]
    assert (own / "own.json").read_bytes() == before[1]


def another_number(data):
    """The same fit with the first number of its label changed: right JSON, but not what was
    fitted.
    """
    entry = json.loads(data)
    entry["label"][0] += 0.5
    return json.dumps(entry).encode()


DAMAGE = {
    "empty": lambda data: b"",
    "cut": lambda data: data[:-10],
    "another number": another_number,
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_fit_is_fitted_again(own, damage):
    (kept,) = (own / "own.json.fits").iterdir()
    whole, catalogue = kept.read_bytes(), (own / "own.json").read_bytes()
    kept.write_bytes(damage(whole))
    assert run("materials", "add", own, "--closures", 1, "--out", own / "own.json") == 0
    assert (kept.read_bytes(), (own / "own.json").read_bytes()) == (whole, catalogue)


def test_a_material_cannot_be_added_beside_one_whose_numbers_no_fit_gives(own, tmp_path, capsys):
    catalogue = json.loads((own / "own.json").read_text())
    catalogue["materials"][0] |= {
        "name": "earlier",
        "label": [1e19, *catalogue["materials"][0]["label"][1:]],
    }
    (tmp_path / "own.json").write_text(json.dumps(catalogue))
    assert run("materials", "add", own, "--closures", 1, "--out", tmp_path / "own.json") == 1
    assert "'earlier': expected natural logarithms up to 14, found 1e+19" in capsys.readouterr().err


@pytest.mark.parametrize("l1", [[], [0.1], [0.1] * 7, [1e308] * 6, [-1.0] * 6])
def test_errors_that_no_fit_has_are_refused_where_a_catalogue_is_read(own, tmp_path, capsys, l1):
    catalogue = json.loads((own / "own.json").read_text())
    catalogue["materials"][0]["errors"]["nodes_vs_label"]["l1"] = l1
    (tmp_path / "own.json").write_text(json.dumps(catalogue))
    assert run("materials", "report", tmp_path / "own.json", "--out", tmp_path / "out") == 1
    assert "own.json: materials[0].errors.nodes_vs_label.l1" in capsys.readouterr().err


@pytest.mark.parametrize("command", [("report",), ("preview", "--catalogue")])
def test_a_catalogue_without_materials_is_refused_where_some_are_needed(
    own, tmp_path, capsys, command
):
    catalogue = json.loads((own / "own.json").read_text()) | {"materials": []}
    (tmp_path / "own.json").write_text(json.dumps(catalogue))
    assert run("materials", *command, tmp_path / "own.json", "--out", tmp_path / "out") == 1
    assert "own.json: expected a material to " in capsys.readouterr().err


def test_another_recipe_is_another_fit(own):
    from factory.materials import fitting, recipe, sources

    (source,) = sources.load(own).values()
    first, second = (fitting.key(source, recipe.Recipe(closures=c), {}) for c in ((1,), (2,)))
    assert first != second


def test_adding_under_other_light_maps_is_refused(own, capsys):
    assert (
        run(
            "materials",
            "add",
            own,
            "--closures",
            1,
            "--light",
            "gradient-1",
            "--out",
            own / "own.json",
        )
        == 1
    )
    assert "give no --light, or another --out" in capsys.readouterr().err


def test_the_list_shows_every_material(own, capsys):
    assert run("materials", "list", "--catalogue", own / "own.json") == 0
    assert "own-wood" in capsys.readouterr().out


def test_the_list_has_every_name_once_by_family_and_within_the_terminals_width(capsys):
    assert run("materials", "list") == 0
    printed = capsys.readouterr().out
    everyday, measured = printed.split("Measured materials:\n")
    catalogue = load_catalogue()
    listed = {}
    for line in measured.splitlines()[:-1]:
        if not line.startswith("  "):
            family = line
        else:
            names = [name for name in line.strip().split(", ") if name]
            listed |= {name.rstrip(","): family for name in names}
    assert listed == {m.name + "*" * (m.split == "test"): m.family for m in catalogue.values()}
    words = everyday.replace(",", " ").split()
    assert set(DESCRIBED) <= set(words)
    assert max(map(len, printed.splitlines())) <= 100


def test_the_list_has_the_errors_of_fits_if_they_are_asked_for(capsys):
    assert run("materials", "list", "--errors") == 0
    header, *lines = capsys.readouterr().out.splitlines()
    columns = ["name", "family", "split", "closures", "L–N", "worst", "N–M", "display", "L2"]
    assert header.split() == columns
    brass = next(line for line in lines if line.startswith("brass "))
    errors = load_catalogue()["brass"].errors
    assert f"{errors.nodes_vs_label.mean:.3f} {errors.nodes_vs_label.worst:6.3f}" in brass


def test_the_contact_sheet_shows_balls_on_a_ground(own):
    arguments = (
        "--catalogue",
        own / "own.json",
        "--light",
        "gradient-1",
        "--size",
        24,
        "--out",
        own / "sheet.png",
    )
    assert run("materials", "preview", *arguments) == 0
    picture = np.asarray(Image.open(own / "sheet.png"))
    assert picture.shape == (40, 24, 3)
    assert (picture[0, 0] == 24).all() and picture[12, 12].max() > 60


def test_a_report_says_what_made_it_and_whether_limits_are_kept(own):
    assert run("materials", "report", own / "own.json", "--out", own / "report") == 0
    data = json.loads((own / "report" / "report.json").read_text())
    assert {"command", "commit", "machine", "date"} <= set(data)
    expected = np.mean(
        materials.load_catalogue(own / "own.json")["own-wood"].errors.nodes_vs_label.l1
    )
    assert data["figures"]["agreement_median"] == pytest.approx(expected, rel=1e-3)
    assert (
        "| limit |" in (own / "report" / "report.md").read_text()
        and (own / "report" / "errors.png").stat().st_size > 10_000
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("fit", "{folder}", "--light", "{folder}/maps.npz:black", "--out", "{folder}/o.json"),
            "a light map of a mean",
        ),
        (
            ("fit", "{folder}", "--light", "{folder}/maps.npz:text", "--out", "{folder}/o.json"),
            "a finite light map",
        ),
        (
            ("fit", "{folder}", "--light", "{folder}/maps.npz:none", "--out", "{folder}/o.json"),
            "an array 'none'",
        ),
        (
            ("fit", "{folder}", "--light", "{folder}/torn.npz:black", "--out", "{folder}/o.json"),
            "an .npz file of light maps",
        ),
        (
            ("fit", "{folder}/none.npz", "--out", "{folder}/o.json"),
            "none.npz: expected an npz of Neural-BRDF weights",
        ),
        (
            ("fit", "{folder}", "--only", "own-wod", "--out", "{folder}/o.json"),
            "did you mean own-wood",
        ),
        (
            ("fit", "{folder}", "--closures", "0", "--out", "{folder}/o.json"),
            "--closures: expected ascending counts from 1",
        ),
        (
            ("fit", "{folder}", "--tolerance", "7", "--out", "{folder}/o.json"),
            "--tolerance: expected 0.0001 to 1, found 7",
        ),
        (
            ("fit", "{folder}", "--workers", "0", "--out", "{folder}/o.json"),
            "--workers: expected at least 1",
        ),
        (("preview", "brazz", "--out", "{folder}/p.png"), "did you mean brass"),
        (("list", "--catalogue", "{folder}/broken.json"), "broken.json"),
    ],
)
def test_mistakes_end_in_one_line(own, capsys, arguments, message):
    (own / "broken.json").write_text('{"materials": 7}')
    np.savez(own / "maps.npz", black=np.zeros((4, 8, 3)), text=np.full((4, 8, 3), "a"))
    (own / "torn.npz").write_bytes((own / "maps.npz").read_bytes()[:500])
    assert run("materials", *(a.format(folder=own) for a in arguments)) == 1
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error


def test_a_truncated_measurement_ends_the_fit_in_one_line(tmp_path, capsys):
    (tmp_path / "cut.binary").write_bytes(struct.pack("<3i", 90, 90, 180) + b"\0" * 64)
    assert run("materials", "fit", tmp_path, "--out", tmp_path / "o.json") == 1
    assert (
        "cut.binary: expected 34992012 bytes after such a header, found 76"
        in capsys.readouterr().err
    )


# --- the built-in catalogue


@pytest.fixture(scope="module")
def merl():
    return materials.load_catalogue(materials.BUILT_IN[0])


def test_the_built_in_catalogue_holds_merls_hundred(merl):
    from factory.materials.families import HELD_OUT

    assert len(merl) == 100
    assert {m.name for m in merl.values() if m.split == "test"} == HELD_OUT
    assert len({m.hash for m in merl.values()}) == 100  # no twins


def test_labels_are_bounded_and_in_canonical_order(merl):
    from shaders.label_model import HIGH, LOW

    for m in merl.values():
        assert (m.label >= LOW - 1e-4).all() and (m.label <= HIGH + 1e-4).all(), m.name
        assert (np.diff(m.label[:, :, 1].mean((0, 2))) >= -1e-4).all(), m.name


def test_written_errors_are_those_of_the_written_numbers(merl):
    """Label against nodes needs no measurement: taken again for a few; four digits are written."""
    from shaders import errors, samples

    s = samples.held_out_samples()
    for name in ("brass", "blue-rubber", "white-fabric", "specular-black-phenolic"):
        m = merl[name]
        result = errors.relative_l1(
            m.mixture.evaluate(*s.cosines), errors.label_values(m.label, s), s
        )
        np.testing.assert_allclose(result, m.errors.nodes_vs_label.l1, rtol=2e-3)


def test_the_catalogue_keeps_its_limits(merl):
    from factory.materials import report

    result = report.figures(list(merl.values()))
    assert {key for _, key, _, _ in report.LIMITS} <= set(result)
    assert [
        (text, result[key], limit)
        for text, key, limit, _ in report.LIMITS
        if not result[key] <= limit
    ] == []


def test_every_test_material_knows_its_nearest_training_one(merl):
    for m in merl.values():
        if m.split == "test":
            assert merl[m.nearest_train.name].split == "train" and m.nearest_train.distance > 0
        else:
            assert m.nearest_train is None


def test_a_name_that_is_not_there_lists_the_closest(merl):
    with pytest.raises(InputError, match=r"did you mean .*red-fabric"):
        materials.find("red-fabrik", merl)


def test_a_job_that_asks_for_an_everyday_word_is_told_what_looks_like_it():
    with pytest.raises(InputError, match="look like leather: natural-209"):
        choose_entries(["leather"])


def test_an_unknown_key_in_a_catalogue_is_refused(tmp_path, own):
    text = (own / "own.json").read_text().replace('"family"', '"famliy"', 1)
    (tmp_path / "typo.json").write_text(text)
    with pytest.raises(InputError, match="famliy"):
        materials.read_catalogue(tmp_path / "typo.json")


def catalogue_of(folder, name, file):
    """A catalogue of one built-in material under another name, in a folder of its own."""
    entry = materials.read_catalogue(materials.BUILT_IN[0]).materials[0]
    entry = msgspec.structs.replace(entry, name=name)
    path = folder / name / file
    path.parent.mkdir()
    materials.write(materials.Catalogue(title="own", credit="none", materials=(entry,)), path)
    return path


def test_two_catalogues_of_one_name_are_refused(tmp_path):
    first, second = (catalogue_of(tmp_path, name, "mine.json") for name in ("felt", "cork"))
    with pytest.raises(InputError, match=r"'mine' of .*felt/mine.json, too .*rename"):
        choose_entries(["felt"], [first, second])
    assert [each.name for each in choose_entries(["mine"], [first, first])] == ["felt"]


def test_a_name_of_two_different_materials_is_refused_unless_a_set_says_which(tmp_path):
    own = catalogue_of(tmp_path, "chrome", "mine.json")  # another material by a built-in name
    with pytest.raises(InputError, match=r"merl and mine \(name one: .* or mine/chrome\)"):
        choose_entries(["chrome"], [own])
    (mine,) = choose_entries(["mine/chrome"], [own])
    (built_in,) = choose_entries(["chrome"])
    assert mine.name == built_in.name == "chrome" and mine.hash != built_in.hash
    with pytest.raises(InputError, match="one material of a name"):
        choose_entries(["merl/chrome", "mine/chrome"], [own])
    # a copy of the built-in one is no other material
    same = materials.read_catalogue(materials.BUILT_IN[0]).materials[0].name
    copy = catalogue_of(tmp_path, same, "copy.json")
    assert choose_entries([same], [copy])[0].hash == choose_entries([same])[0].hash


def test_a_catalogue_by_the_name_of_a_data_sets_own_leaves_the_built_in_materials(tmp_path):
    own = catalogue_of(tmp_path, "felt", "materials.json")
    names = [each.name for each in choose_entries(["brass", "materials/felt"], [own])]
    assert names == ["brass", "felt"]
