"""`shapes collect`: meshes of packages, with licence and credit, on two sides."""

import json
import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest

from factory.shapes import packages
from factory.shapes.catalogue import load
from factory.shapes.libraries import CATALOGUE
from factory.shapes.packages import Package, Source, collect, cover, side_of
from manifests.cli import main
from manifests.errors import InputError

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def obj_of(mesh, scale=1) -> str:
    """An OBJ of a mesh, in the mesh's own axes."""
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices * scale]
    return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]) + "\n"


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A folder with two packages, which are listed: a furniture library, and a folder of OBJ."""
    furniture = {"bowl1": "sphere:2", "bowl2": "sphere:3", "cup": "torus", "door": "cube"}
    lines = ["license=Public domain"]
    folder = tmp_path / "root" / "share"
    folder.mkdir(parents=True)
    with zipfile.ZipFile(folder / "Set.sh3f", "w") as archive:
        for number, (name, spec) in enumerate(furniture.items(), 1):
            archive.writestr(f"{name}/{name}.obj", obj_of(load(spec)))
            lines += [
                f"name#{number}={name}",
                f"model#{number}=/{name}/{name}.obj",
                f"creator#{number}=Ada",
                f"category#{number}={'Doors' if name == 'door' else 'Kitchen'}",
            ]
        archive.writestr(CATALOGUE, "\n".join(lines))
    parts = tmp_path / "root" / "robots" / "meshes"
    parts.mkdir(parents=True)
    (parts / "mug.obj").write_text(obj_of(load("sphere:1")))
    (parts / "twin.obj").write_text(obj_of(load("torus")))
    (parts / "speck.obj").write_text(TETRAHEDRON)
    (parts / "wire.obj").write_text(obj_of(load("cube"), (1, 0.02, 0.02)))
    listed = {
        "homes": Package(
            "debian",
            "homes",
            "1.0",
            "apt-get install homes",
            (Source("share/Set.sh3f", "CC0-1.0", "the set's authors", skip_sections=("Doors",)),),
        ),
        "robots": Package(
            "pypi",
            "robots",
            "2.0",
            "pip install robots",
            (Source("robots/meshes/*.obj", "MIT", "a laboratory", "up=z&front=x"),),
        ),
    }
    monkeypatch.setattr(packages, "packages", lambda: listed)
    return tmp_path / "root"


def test_meshes_come_with_licence_author_side_and_hash(root, tmp_path):
    said: list[str] = []
    rows = collect(root, tmp_path / "out", report=said.append)
    names = {row["name"]: row for row in rows}
    assert set(names) <= {
        "Set-bowl1",
        "Set-bowl2",
        "Set-cup",
        "robots-mug",
        "robots-twin",
    }
    assert {"Set-bowl1", "Set-bowl2", "robots-mug"} <= set(names)
    assert names["Set-bowl1"]["licence"] == "CC0-1.0, Ada"
    assert names["robots-mug"]["licence"] == "MIT, a laboratory"
    assert names["robots-mug"]["package"] == "robots" and names["robots-mug"]["version"] == "2.0"
    for row in rows:
        path = tmp_path / "out" / row["side"] / row["category"] / f"{row['name']}.obj"
        assert load(str(path)).hash == row["hash"]
        note = json.loads(path.with_suffix(".json").read_text())
        assert note["licence"] == row["licence"] and note["hash"] == row["hash"]
    assert json.loads((tmp_path / "out" / "meshes.json").read_text()) == rows
    assert any(line.startswith("robots-speck: left out, 4 triangles") for line in said)
    assert any(line.startswith("robots-wire: left out, it covers") for line in said)


def test_a_mesh_that_two_packages_bring_is_kept_once(root, tmp_path):
    said: list[str] = []
    rows = collect(root, tmp_path / "out", report=said.append)
    hashes = [row["hash"] for row in rows]
    assert len(set(hashes)) == len(hashes)
    # y up in the library and z up in the folder: one torus lies, the other stands
    assert {"Set-cup", "robots-twin"} <= {row["name"] for row in rows}
    (root / "robots" / "meshes" / "zwin.obj").write_text(obj_of(load("torus")))
    said.clear()
    again = collect(root, tmp_path / "again", report=said.append)
    assert len(again) == len(rows)
    assert any("the same mesh as robots-" in line for line in said)


def test_variants_of_one_object_share_a_side_and_the_sides_are_halves(root, tmp_path):
    rows = {row["name"]: row for row in collect(root, tmp_path / "out")}
    assert rows["Set-bowl1"]["side"] == rows["Set-bowl2"]["side"] == side_of("homes/bowl")
    sides = [side_of(f"homes/{number}") for number in range(1000)]
    assert 450 < sides.count("test") < 550
    assert side_of("sweethome3d-furniture/cup") == "development"  # recorded: it must not change


def test_one_makers_meshes_share_a_side_and_a_module_is_read(tmp_path, monkeypatch):
    root = tmp_path / "root" / "node_modules"
    for number, folder in enumerate(("acme-one", "acme-two", "acme-3")):
        (root / "pads" / folder).mkdir(parents=True)
        for hand in ("left", "right"):
            scale = (1, 1 + 0.1 * number, 1.5 if hand == "left" else 1.7)
            text = obj_of(load("sphere:2"), np.array(scale))
            (root / "pads" / folder / f"{hand}.obj").write_text(text)
    torus = load("torus")
    (root / "pot").mkdir()
    (root / "pot" / "pot.js").write_text(
        f"exports.positions={torus.vertices.tolist()};\nexports.cells={torus.faces.tolist()};"
    )
    pads = Source("node_modules/pads/*/*.obj", "MIT", "Acme", maker_is_one=True)
    pot = Source("node_modules/pot/pot.js", "public domain", "Ada", "up=z&front=x")
    listed = {
        name: Package("npm", name, "1.0", f"npm install {name}", (source,))
        for name, source in {"pads": pads, "pot": pot}.items()
    }
    monkeypatch.setattr(packages, "packages", lambda: listed)
    rows = collect(tmp_path / "root", tmp_path / "out")
    of_pads = [row for row in rows if row["package"] == "pads"]
    assert len(of_pads) == 6 and {row["side"] for row in of_pads} == {side_of("pads/acme")}
    assert "pads-acme-one-left" in {row["name"] for row in of_pads}
    (pot,) = (row for row in rows if row["package"] == "pot")
    assert pot["hash"] == torus.hash and pot["licence"] == "public domain, Ada"


def test_all_meshes_of_a_package_for_testing_only_are_on_the_test_side(root, tmp_path, monkeypatch):
    listed = packages.packages()
    before = {row["side"] for row in collect(root, tmp_path / "out", ["homes"])}
    assert "development" in before
    listed["homes"] = msgspec.structs.replace(listed["homes"], test_only=True)
    monkeypatch.setattr(packages, "packages", lambda: listed)
    assert {row["side"] for row in collect(root, tmp_path / "again", ["homes"])} == {"test"}


def test_most_takes_one_variant_of_each_object(root, tmp_path):
    rows = collect(root, tmp_path / "out", ["homes"], most=1, report=lambda line: None)
    assert all(sum(row["side"] == side for row in rows) <= 1 for side in packages.SIDES)
    all_sides = collect(root, tmp_path / "more", ["homes"], most=5, report=lambda line: None)
    assert sum(row["name"].startswith("Set-bowl") for row in all_sides) == 1


def test_unknown_and_missing_packages_are_refused(root, tmp_path):
    with pytest.raises(InputError, match=r"--package.*found house.*homes"):
        collect(root, tmp_path / "out", ["house"])
    with pytest.raises(InputError, match=r"the meshes of homes.*apt-get install homes"):
        collect(tmp_path / "nothing", tmp_path / "out", ["homes"])
    with pytest.raises(InputError, match="none below it"):
        collect(tmp_path / "nothing", tmp_path / "out")
    (root / "share" / "Set.sh3f").unlink()
    rows = collect(root, tmp_path / "out", report=lambda line: None)
    assert {row["package"] for row in rows} == {"robots"}


def test_what_hardly_shows_is_left_out():
    assert cover(load("sphere:3")) == pytest.approx(np.pi / 4 / 1.02**2, abs=0.02)


def test_the_list_of_packages_is_complete():
    listed = packages.packages()
    assert "sweethome3d-furniture" in listed
    for package in listed.values():
        assert package.sources and package.version
        for source in package.sources:
            assert source.licence and source.credit and not Path(source.path).is_absolute()


def test_the_command_prints_how_many(root, tmp_path, capsys):
    arguments = ["collect", "--root", str(root), "--library", str(tmp_path / "out")]
    assert main("factory", "", ("shapes",), ["shapes", *arguments]) == 0
    assert "homes: " in capsys.readouterr().out
    assert main("factory", "", ("shapes",), ["shapes", *arguments, "--most", "0"]) == 1
    assert "--most: expected 1 or more" in capsys.readouterr().err
