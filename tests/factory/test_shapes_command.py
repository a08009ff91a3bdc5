"""`shapes list`, `preview` and `add` as a user calls them."""

import json

import pytest
from PIL import Image

from factory.planning.assets import resolve
from factory.shapes.catalogue import load
from manifests.cli import main
from manifests.schema import Job

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def shapes(*arguments):
    return main("factory", "", ("shapes",), ["shapes", *map(str, arguments)])


@pytest.fixture
def kettle(tmp_path):
    path = tmp_path / "kettle.obj"
    path.write_text(TETRAHEDRON)
    return path


def test_list_names_families_and_primitives(capsys):
    assert shapes("list") == 0
    said = capsys.readouterr().out
    assert all(
        word in said
        for word in ("car:0 … car:129", "chair:49", "sofa", "monitor", "sphere", "blob")
    )


def test_list_reports_each_mesh_of_a_folder_its_twins_and_what_is_refused(kettle, capsys):
    (kettle.parent / "pot.obj").write_text(TETRAHEDRON.replace("1 0 0", "1.0 0 0"))
    (kettle.parent / "broken.obj").write_text("v 0 0 nan\n" + TETRAHEDRON.split("\n", 1)[1])
    assert shapes("list", kettle.parent) == 1
    said = capsys.readouterr().out
    assert "4 triangles, 1 component, watertight" in said and "the same as kettle" in said
    assert (
        "broken: " in said
        and "finite coordinates" in said
        and "3 meshes, 1 refused, 1 duplicate" in said
    )


def test_preview_draws_seeds_primitives_and_files(kettle, tmp_path):
    out = tmp_path / "sheet.png"
    assert (
        shapes(
            "preview",
            "sphere:3",
            kettle,
            "--family",
            "chair",
            "--count",
            2,
            "--size",
            48,
            "--out",
            out,
        )
        == 0
    )
    with Image.open(out) as image:
        colours = {colour for _, colour in image.convert("RGB").getcolors(1 << 20)}
    assert image.width >= 3 * 48 and len(colours) > 20
    assert not list(tmp_path.glob(".sheet*"))


def test_preview_goes_on_past_a_broken_shape_and_fails(kettle, tmp_path, capsys):
    out = tmp_path / "sheet.png"
    assert shapes("preview", "chiar:1", "sphere:2", "--size", 32, "--out", out) == 1
    assert out.exists()
    assert "did you mean chair" in capsys.readouterr().err


def test_preview_makes_the_folder_before_it_renders(tmp_path, monkeypatch):
    out, seen = tmp_path / "new" / "deep" / "sheet.png", []

    def drawn(meshes, *_, **__):
        seen.append(out.parent.is_dir())
        return Image.new("RGB", (8, 8))

    monkeypatch.setattr("factory.shapes.contact_sheet.contact_sheet", drawn)
    assert shapes("preview", "sphere:2", "--size", 32, "--out", out) == 0
    assert seen == [True] and out.exists()


def test_preview_of_nothing_says_what_to_name(tmp_path, capsys):
    assert shapes("preview", "--out", tmp_path / "a.png") == 1
    assert "expected shapes or --family" in capsys.readouterr().err


def test_add_copies_a_cleaned_mesh_with_its_licence(kettle, tmp_path, capsys):
    library = tmp_path / "mine"
    arguments = (
        "add",
        kettle,
        "--library",
        library,
        "--licence",
        "CC-BY-4.0 Ada",
        "--category",
        "object",
    )
    assert shapes(*arguments) == 0
    assert shapes(*arguments) == 0  # a second time changes nothing
    note = json.loads((library / "object" / "kettle.json").read_text())
    mesh = load(str(library / "object" / "kettle.obj"))
    assert (
        note["hash"] == mesh.hash
        and note["licence"] == "CC-BY-4.0 Ada"
        and note["source"] == "kettle.obj"
    )
    assert sorted(p.name for p in (library / "object").iterdir()) == ["kettle.json", "kettle.obj"]


@pytest.mark.parametrize("named", ["", "object", "object/armchair.obj", "object/armchair.obj?up=y"])
def test_a_job_knows_category_and_licence_of_a_mesh_in_a_library(kettle, tmp_path, named, capsys):
    library, file = tmp_path / "mine", kettle.with_name("armchair.obj")
    file.write_bytes(kettle.read_bytes())
    arguments = ("--library", library, "--licence", "CC-BY-4.0 Ada", "--category", "object")
    assert shapes("add", file, *arguments) == 0
    job = Job(shapes=(f"mine/{named}",), materials=("brass",), lights=("softboxes-1",))
    (shape,) = resolve(job, tmp_path).shapes
    assert (shape.category, shape.licence) == ("object", "CC-BY-4.0 Ada")
    capsys.readouterr()
    assert shapes("list", library) == 0
    assert "[CC-BY-4.0 Ada]" in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    "other", ["{", "[]", "{}", '{"name": "b", "category": "sofa", "licence": "CC0"}']
)
def test_other_json_beside_a_mesh_says_nothing_of_it(kettle, tmp_path, other):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.obj").write_bytes(kettle.read_bytes())
    (tmp_path / "meshes" / "a.json").write_text(other)
    job = Job(shapes=("meshes/",), materials=("brass",), lights=("softboxes-1",))
    (shape,) = resolve(job, tmp_path).shapes
    assert (shape.category, shape.licence) == ("object", "unstated")


def test_a_mesh_of_the_library_that_was_damaged_since_is_written_again(kettle, tmp_path):
    arguments = ("add", kettle, "--library", tmp_path / "mine", "--category", "object")
    assert shapes(*arguments) == 0
    path = tmp_path / "mine" / "object" / "kettle.obj"
    whole = path.read_bytes()
    for damaged in (b"", whole[:-5], whole.replace(b"1", b"2", 1)):
        path.write_bytes(damaged)
        assert shapes(*arguments) == 0
        assert path.read_bytes() == whole
    path.unlink()
    assert shapes(*arguments) == 0
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    "damaged",
    [b"", b"{", b"[]", b"\xff", b"[" * 100_000],
    ids=["empty", "cut", "a list", "no text", "deep"],
)
def test_a_damaged_note_of_the_library_says_what_to_do_and_so_it_works(
    kettle, tmp_path, capsys, damaged
):
    arguments = ("add", kettle, "--library", tmp_path / "mine", "--category", "object")
    assert shapes(*arguments) == 0
    note = tmp_path / "mine" / "object" / "kettle.json"
    whole = note.read_bytes()
    note.write_bytes(damaged)
    assert shapes(*arguments) == 1
    assert (
        "kettle.json: expected a mesh's note as JSON" in (said := capsys.readouterr().err)
        and "delete it" in said
    )
    note.unlink()
    assert shapes(*arguments) == 0
    assert note.read_bytes() == whole


def test_add_refuses_a_broken_file_in_one_line(tmp_path, capsys):
    bad = tmp_path / "bad.stl"
    bad.write_bytes(b"")
    assert shapes("add", bad, "--library", tmp_path / "mine") == 1
    said = capsys.readouterr().err.strip().splitlines()
    assert (
        any("expected a mesh, found an empty file" in line for line in said)
        and not (tmp_path / "mine").exists()
    )


def test_help_explains_a_shape(capsys):
    with pytest.raises(SystemExit) as stop:
        shapes("--help")
    assert stop.value.code == 0 and "FAMILY:SEED" in capsys.readouterr().out
