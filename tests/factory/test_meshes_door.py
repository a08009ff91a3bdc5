"""Meshes from outside: read, cleaned, turned outward and to our axes; real ones too."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from factory.planning.shape_names import list_sources, locate
from factory.shapes.catalogue import load
from factory.shapes.closed_surface import Surface, signed_volume
from factory.shapes.libraries import category_of, find
from factory.shapes.library import add
from factory.shapes.lofts import ellipsoid
from factory.shapes.mesh_import import open_mesh
from factory.shapes.rounded_boxes import rounded_box
from manifests.errors import InputError
from manifests.schema import Job

SWEET_HOME = Path("/usr/share/sweethome3d/furniture")


def arrow():
    """A closed body in our axes that has no symmetry: long to the front (+x), a fin on top (+z), a
    bump on the left (+y).
    """
    parts = [
        rounded_box([2.0, 0.6, 0.4], 0.1),
        rounded_box([0.3, 0.1, 0.5], 0.04).moved(-0.6, 0, 0.4),
        ellipsoid([0.4, 0.4, 0.2]).moved(0.5, 0.35, 0),
    ]
    starts = np.cumsum([0] + [len(p.vertices) for p in parts])
    return Surface(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, starts[:-1], strict=True)]),
    )


def write_obj(path, vertices, faces, materials=None):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    for k, face in enumerate(faces.tolist()):
        if materials is not None and (k == 0 or materials[k] != materials[k - 1]):
            lines.append(f"usemtl {materials[k]}")
        lines.append("f " + " ".join(str(i + 1) for i in face))
    path.write_text("\n".join(lines) + "\n")
    return path


def in_y_up(vertices):
    """Our vertices as an OBJ has them: y up, front +z, so left is +x."""
    return vertices[:, [1, 2, 0]]


def reference(tmp_path):
    vertices, faces = arrow()
    return open_mesh(write_obj(tmp_path / "ours.obj", vertices, faces), up="z", front="x")


def test_an_obj_comes_y_up_with_its_front_at_z(tmp_path):
    vertices, faces = arrow()
    mesh = open_mesh(write_obj(tmp_path / "a.obj", in_y_up(vertices), faces))
    assert mesh.hash == reference(tmp_path).hash
    extent = np.ptp(mesh.vertices, axis=0)
    assert extent[0] > extent[2] > 0 and extent[0] > extent[1]


@pytest.mark.parametrize(
    ("up", "front", "turn"), [("y", "z", np.eye(3)), ("-z", "y", None), ("x", "-y", None)]
)
def test_up_and_front_name_any_two_axes_and_never_mirror(tmp_path, up, front, turn):
    from factory.shapes.mesh_import import world_from_file

    vertices, faces = arrow()
    rotation = world_from_file("a", up, front)
    assert np.isclose(np.linalg.det(rotation), 1)
    mesh = open_mesh(write_obj(tmp_path / "a.obj", vertices @ rotation, faces), up=up, front=front)
    assert mesh.hash == reference(tmp_path).hash
    assert open_mesh(f"{tmp_path / 'a.obj'}?up={up}&front={front}").hash == mesh.hash
    signed = "&".join(
        f"{key}={axis if axis[0] == '-' else '+' + axis}"
        for key, axis in (("up", up), ("front", front))
    )
    assert open_mesh(f"{tmp_path / 'a.obj'}?{signed}").hash == mesh.hash


@pytest.mark.parametrize("option", ["up", "front=", "crease", "segments", "segments="])
def test_an_option_without_a_value_is_refused(tmp_path, option):
    path = write_obj(tmp_path / "a.obj", *arrow())
    with pytest.raises(InputError, match=option.rstrip("=")):
        open_mesh(f"{path}?{option}")


def test_a_mark_in_a_folder_s_name_stays_part_of_the_path(tmp_path, monkeypatch):
    """Of a mesh with reading options and of a member of a library, also in a job's shapes."""
    place = tmp_path / "my #1 ? é"
    place.mkdir()
    vertices, faces = arrow()
    write_obj(place / "a.obj", vertices, faces)
    expected = open_mesh(str(place / "a.obj"), up="z", front="x")
    again = open_mesh(f"{place}/a.obj?up=z&front=x")
    np.testing.assert_array_equal(again.vertices, expected.vertices)
    catalogue = "id#1=arrow\nname#1=arrow\nmodel#1=/a.obj\n"
    with zipfile.ZipFile(place / "all.sh3f", "w") as library:
        library.writestr("PluginFurnitureCatalog.properties", catalogue)
        library.write(place / "a.obj", "a.obj")
    (entry,) = find(place / "all.sh3f")
    member = open_mesh(entry.place)
    options = dict(zip(("up", "front"), ("y", "z"), strict=True))
    np.testing.assert_array_equal(
        member.vertices, open_mesh(str(place / "a.obj"), **options).vertices
    )
    for text in ("my #1 ? é/a.obj?up=z", entry.place.replace(f"{tmp_path}/", "")):
        job = Job(shapes=(text,), materials=("brass",), lights=("city",))
        (source,) = list_sources(job, tmp_path)
        assert source.place == f"{tmp_path}/{text}"
    monkeypatch.chdir(place)
    assert locate("my #1 ? é/a.obj?up=z", tmp_path) == f"{tmp_path}/my #1 ? é/a.obj?up=z"


@pytest.mark.parametrize("kind", ["ply", "stl", "off", "glb"])
def test_every_format_gives_the_same_shape(tmp_path, kind):
    vertices, faces = arrow()
    report = in_y_up(vertices) if kind == "glb" else vertices
    path = tmp_path / f"a.{kind}"
    trimesh.Trimesh(report, faces, process=False).export(path)
    mesh, ours = open_mesh(path), reference(tmp_path)
    assert (
        mesh.report.watertight
        and mesh.report.triangles == ours.report.triangles
        and mesh.report.components == 3
    )
    order, expected = (v[np.lexsort(np.round(v, 3).T)] for v in (mesh.vertices, ours.vertices))
    # float32 files; ties of the sort may swap neighbours on a grid of 1e-3
    assert np.abs(order - expected).max() < 2e-3


def test_what_comes_out_fills_the_unit_sphere(tmp_path):
    vertices, faces = arrow()
    mesh = open_mesh(write_obj(tmp_path / "a.obj", vertices * 1e4 + 7e5, faces))
    assert abs(np.linalg.norm(mesh.vertices, axis=1).max() - 1) < 1e-9


def test_broken_pieces_are_dropped_and_named(tmp_path):
    vertices, faces = arrow()
    doubled = np.concatenate([vertices, vertices[:50], [[9, 9, 9]]])
    turned = faces[:40, ::-1]
    extra = np.concatenate([faces, faces[:30] % len(vertices), turned, [[3, 3, 8]]])
    mesh = open_mesh(write_obj(tmp_path / "a.obj", in_y_up(doubled), extra))
    assert mesh.hash == reference(tmp_path).hash
    assert "51 unused vertices dropped" in mesh.report.cleaned
    assert (
        "1 faces of no area dropped" in mesh.report.cleaned
        and "70 doubled faces dropped" in mesh.report.cleaned
    )


@pytest.mark.parametrize(
    "white",
    [
        lambda line: "  " + line,
        lambda line: line.replace(" ", "\t"),
        lambda line: "\t" + line + " \r",
    ],
)
def test_an_obj_s_words_are_parted_by_any_white_space(tmp_path, white):
    """Some lines only: a file of which some were dropped would be a mesh as well."""
    vertices, faces = arrow()
    names = np.where(np.arange(len(faces)) < 99, "top", "foot")
    path = write_obj(tmp_path / "a.obj", in_y_up(vertices), faces, names)
    plain = open_mesh(f"{path}?segments=materials")
    path.write_text(
        "".join(
            (white(line) if k % 3 else line) + "\n"
            for k, line in enumerate(path.read_text().splitlines())
        )
    )
    mesh = open_mesh(f"{path}?segments=materials")
    assert mesh.hash == plain.hash and mesh.report.triangles == len(faces)


def test_faces_of_two_corners_are_dropped_and_named(tmp_path):
    vertices, faces = arrow()
    path = write_obj(tmp_path / "a.obj", in_y_up(vertices), faces)
    path.write_text(path.read_text() + "f 1 2\nf 3 4\n")
    mesh = open_mesh(path)
    assert (
        mesh.hash == reference(tmp_path).hash
        and "2 faces of fewer than three corners dropped" in mesh.report.cleaned
    )


def test_split_vertices_are_welded(tmp_path):
    vertices, faces = arrow()
    nearly = in_y_up(vertices)[faces.ravel()] + np.random.default_rng(2).uniform(
        -1e-9, 1e-9, (faces.size, 3)
    )
    mesh = open_mesh(write_obj(tmp_path / "a.obj", nearly, np.arange(faces.size).reshape(-1, 3)))
    assert (
        mesh.report.watertight
        and mesh.report.components == 3
        and mesh.report.triangles == len(faces)
    )
    assert any("doubled vertices welded" in note for note in mesh.report.cleaned)


def test_faces_wound_at_random_all_turn_outward(tmp_path):
    vertices, faces = arrow()
    turn = np.random.default_rng(5).random(len(faces)) < 0.5
    mixed = np.where(turn[:, None], faces[:, ::-1], faces)
    mesh = open_mesh(write_obj(tmp_path / "a.obj", in_y_up(vertices), mixed))
    assert mesh.hash == reference(tmp_path).hash
    assert signed_volume(mesh.vertices, mesh.faces) > 0 and mesh.report.back_faces < 1e-3


def test_an_open_bowl_inside_out_is_turned_by_what_is_seen(tmp_path):
    """A box without its floor: its volume says little, but from most sides its outer side is
    seen.
    """
    vertices, faces = rounded_box([1, 1, 1], 0.1)
    open_box = faces[vertices[faces][..., 2].mean(1) > -0.3]
    mesh = open_mesh(write_obj(tmp_path / "a.obj", in_y_up(vertices), open_box[:, ::-1]))
    right = open_mesh(write_obj(tmp_path / "b.obj", in_y_up(vertices), open_box))
    assert mesh.hash == right.hash and f"{len(open_box)} faces turned round" in mesh.report.cleaned


def test_a_moebius_strip_has_no_sides_and_is_accepted(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    across = np.linspace(-0.3, 0.3, 2)
    u, v = np.meshgrid(angle, across, indexing="ij")
    points = np.stack(
        [
            (1 + v * np.cos(u / 2)) * np.cos(u),
            (1 + v * np.cos(u / 2)) * np.sin(u),
            v * np.sin(u / 2),
        ],
        -1,
    ).reshape(-1, 3)
    faces = (
        [(2 * k, 2 * k + 2, 2 * k + 3) for k in range(39)]
        + [(2 * k, 2 * k + 3, 2 * k + 1) for k in range(39)]
        + [(78, 1, 0), (78, 0, 79)]
    )
    mesh = open_mesh(write_obj(tmp_path / "a.obj", points, np.array(faces)))
    assert mesh.report.components == 1 and np.isfinite(mesh.corner_normals).all()


def test_twins_have_one_hash_whatever_their_names(tmp_path):
    vertices, faces = arrow()
    one = open_mesh(write_obj(tmp_path / "one.obj", vertices, faces))
    two = open_mesh(
        write_obj(tmp_path / "two.obj", vertices * 2.5 + 1, faces), name="other", category="sofa"
    )
    assert one.hash == two.hash and (one.name, two.name, two.category) == ("one", "other", "sofa")


def test_materials_become_parts_always_and_segments_on_request(tmp_path):
    vertices, faces = arrow()
    names = ["red" if k < 100 else "blue" for k in range(len(faces))]
    path = write_obj(tmp_path / "a.obj", vertices, faces, names)
    plain, split = open_mesh(path), open_mesh(f"{path}?segments=materials")
    assert plain.segments == 1 and plain.parts == ("red", "blue")
    assert (
        split.segments == 2
        and (split.segment == split.part + 1).all()
        and (split.segment == 1).sum() == 100
    )
    assert plain.hash != split.hash


def test_a_mesh_put_into_a_library_comes_back_the_same(tmp_path):
    chair = load("chair:5")
    path = add(
        type(chair)(**{**vars(chair), "name": "chair-5"}), tmp_path, source="chair:5", licence="CC0"
    )
    back = open_mesh(path)
    assert (
        back.hash == chair.hash
        and back.segments == 2
        and back.category == "chair"
        and back.name == "chair-5"
    )
    assert sorted(p.name for p in path.parent.iterdir()) == ["chair-5.json", "chair-5.obj"]
    assert add(back, tmp_path, source="again", licence="CC0") == path
    other = load("chair:6")
    with pytest.raises(InputError, match="another mesh of that name"):
        add(type(other)(**{**vars(other), "name": "chair-5"}), tmp_path, source="x", licence="CC0")
    with pytest.raises(InputError, match="pass --name"):
        add(chair, tmp_path, source="x", licence="CC0")  # "chair:5" is no file name


def test_shapenet_folders_are_named_by_synset_and_model(tmp_path):
    vertices, faces = arrow()
    folder = tmp_path / "03001627" / "1a2b" / "models"
    folder.mkdir(parents=True)
    write_obj(folder / "model_normalized.obj", vertices, faces)
    (entry,) = find(tmp_path)
    assert (entry.name, entry.category) == ("03001627-1a2b", "chair")


@pytest.mark.parametrize(
    ("path", "category"),
    [
        ("a/Chairs/x.obj", "chair"),
        ("a/armChair_01.obj", "chair"),
        ("a/sofa/led_tv.obj", "monitor"),
        ("cars/x.obj", "car"),
        ("carpet.obj", "object"),
        ("scarf/oscar.obj", "object"),
    ],
)
def test_categories_come_from_words_of_names_the_nearest_first(path, category):
    assert category_of(path) == category


def test_the_lent_meshes_pass_the_door(shared_data):
    entries = find(shared_data / "meshes")
    small = [entry for entry in entries if Path(entry.place).stat().st_size < 500_000]
    assert len(entries) == 12 and {entry.category for entry in entries} == {
        "car",
        "chair",
        "sofa",
        "monitor",
    }
    hashes = set()
    for entry in small:
        mesh = open_mesh(entry.place)
        assert abs(np.linalg.norm(mesh.vertices, axis=1).max() - 1) < 1e-9
        assert np.abs(np.linalg.norm(mesh.corner_normals, axis=2) - 1).max() < 1e-6
        # an armchair with an open inside: 7.1 %
        assert mesh.report.back_faces < 0.08, (entry.name, mesh.report.line())
        hashes.add(mesh.hash)
    assert len(hashes) == len(small) == 10


def test_a_lent_chair_stands_on_its_legs_and_looks_to_the_front(shared_data):
    chair = open_mesh(shared_data / "meshes" / "chair" / "BlendSwap-CC-0__plasticChair.obj")
    x, _, z = chair.vertices.T
    assert np.ptp(z) > np.ptp(x)
    assert x[z > np.quantile(z, 0.9)].mean() < x.mean()  # the back's top is behind


def test_sweet_homes_furniture_opens_from_its_zips():
    if not SWEET_HOME.is_dir():
        pytest.skip("needs Debian's package sweethome3d-furniture")
    entries = find(SWEET_HOME / "BlendSwap-CC-0.sh3f")
    chairs = [entry for entry in entries if entry.category == "chair"]
    assert (
        len(entries) > 100
        and len(chairs) >= 5
        and all("Public domain" in entry.licence for entry in entries)
    )
    mesh = open_mesh(chairs[0].place)
    assert mesh.category == "chair" and mesh.report.triangles > 100
