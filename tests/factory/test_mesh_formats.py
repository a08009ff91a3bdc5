"""Each mesh format read rightly: against trimesh's own readers, and against areas and places known
beforehand.
"""

import base64
import io
import struct
import warnings

import numpy as np
import pytest
import trimesh

from factory.shapes.files import from_bytes
from factory.shapes.lofts import ellipsoid
from factory.shapes.mesh_import import open_mesh
from factory.shapes.rounded_boxes import rounded_box
from manifests.errors import InputError
from tests.support.mesh_files import Glb, glb, obj_text, off_text, ply, stl_text

# area 12; its fan covers 16
L_SHAPE = np.array([(0, 2, 0), (0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 4, 0), (2, 2, 0)], float)
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], float)


def read(data, kind):
    """The Raw of a file's content."""
    return from_bytes(data.encode() if isinstance(data, str) else data, f".{kind}", f"test.{kind}")


def soup(raw):
    """Triangles (F, 3, 3), each from its least corner on, sorted: the mesh, whatever the order of
    vertices and faces.
    """
    corners = np.asarray(raw.vertices, float)[raw.faces]
    first = np.lexsort(np.moveaxis(np.round(corners, 9), 2, 0)[::-1], axis=1)[:, :1]
    corners = np.take_along_axis(corners, ((first + np.arange(3)) % 3)[..., None], axis=1)
    return corners[np.lexsort(np.round(corners, 9).reshape(-1, 9).T[::-1])]


def area(raw):
    a, b, c = (raw.vertices[raw.faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def theirs(data, kind):
    """What trimesh reads."""
    return trimesh.load_scene(
        io.BytesIO(data), file_type=kind, process=False, skip_materials=True
    ).to_mesh()


def random_mesh(rng):
    vertices, faces = (
        rounded_box([1, 2, 0.5], 0.1) if rng.random() < 0.5 else ellipsoid([1, 0.5, 0.3], 8, 12)
    )
    chosen = rng.choice(len(faces), int(rng.integers(1, len(faces))), replace=False)
    return np.asarray(vertices, np.float32).astype(float), faces[chosen]


def refused(data, kind, *said):
    with pytest.raises(InputError) as problem:
        read(data, kind)
    line = str(problem.value)
    assert (
        "\n" not in line
        and line.startswith(f"test.{kind}")
        and all(words in line for words in said)
    ), line


# Against trimesh


@pytest.mark.parametrize("kind", ["ply", "stl", "stl_ascii", "off", "glb"])
def test_what_trimesh_reads_rightly_is_read_alike(kind, rng):
    for _ in range(12):
        vertices, faces = random_mesh(rng)
        data = trimesh.Trimesh(vertices, faces, process=False).export(file_type=kind)
        data = data.encode() if isinstance(data, str) else data
        ours, other = read(data, kind[:3]), theirs(data, kind[:3])
        np.testing.assert_array_equal(soup(ours), soup(other))


def test_trees_of_nodes_are_placed_as_trimesh_places_them(rng):
    for _ in range(20):
        made, roots = Glb(), []
        meshes = []
        for _ in range(3):
            vertices, faces = random_mesh(rng)
            points = made.accessor(
                vertices.astype(np.float32), stride=int(rng.choice([0, 12, 16, 40]))
            )
            kind = rng.choice([np.uint16, np.uint32])
            meshes.append(
                made.mesh(
                    {
                        "attributes": {"POSITION": points},
                        "indices": made.accessor(faces.astype(kind).ravel()),
                    }
                )
            )
        for _ in range(5):
            keys = {"mesh": int(rng.choice(meshes))}
            if rng.random() < 0.3:
                keys["matrix"] = (
                    np.r_[rng.normal(size=(3, 4)) * [1, 1, 1, 0], [[*rng.normal(size=3), 1]]]
                    .ravel()
                    .tolist()
                )
            else:
                quaternion = rng.normal(size=4)
                keys |= {
                    "translation": rng.normal(size=3).tolist(),
                    "scale": rng.normal(size=3).tolist(),
                }
                keys["rotation"] = (quaternion / np.linalg.norm(quaternion)).tolist()
            if roots and rng.random() < 0.5:
                keys["children"] = [roots.pop()]
            roots.append(made.node(**keys))
        data = made.bytes(roots)
        np.testing.assert_allclose(
            soup(read(data, "glb")), soup(theirs(data, "glb")), rtol=1e-9, atol=1e-9
        )


# Polygons, in every format that has them


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("kind", ["obj", "off", "ply"])
def test_an_l_shaped_polygon_has_its_area_in_every_format(kind, first):
    polygon = np.roll(np.arange(6), first).tolist()
    data = {"obj": obj_text, "off": off_text, "ply": ply}[kind](L_SHAPE, [polygon])
    raw = read(data, kind)
    assert area(raw) == pytest.approx(12) and len(raw.faces) == 4


def test_polygons_that_cross_themselves_are_told(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(
        obj_text([(0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 1, 2, 3), (0, 1, 4)])
    )
    assert "1 polygons that cross themselves cut as they come" in open_mesh(path).report.line()


# OBJ


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        # files put together, each with its mark
        lambda text: text.replace("v 1.0 0.0 0.0", "\ufeffv 1.0 0.0 0.0"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.removesuffix("\n"),
        lambda text: text.replace("f 1 2", "f 1 \\\n2"),
        lambda text: text.replace("v 1.0 0.0", "v 1.0 \\\n 0.0").replace("\n", "\r\n"),
        lambda text: text.replace("f 1 2 3", "f 1//7 2/5 3/4/9"),
        lambda text: text.replace("f 1 2 3 4", "f -5 -4 -3 -2"),
        lambda text: text.replace("f", "g caf\xe9 \\x\nusemtl a \\\nf").replace(
            "v 1.0", "o #1\nv 1e0"
        ),
        lambda text: text.replace("\nf", " # the last one\nf").replace("3 4\n", "3 4# four\n"),
        lambda text: "# c:\\models\\\n#\n\n  \n" + text,
        lambda text: "f 1 2 3 4\nf 2 5 3\n" + text.partition("f")[0],  # faces before their vertices
        # with colours
        lambda text: text.replace("v 1.0 0.0 0.0", "v +1.000e+00 .0 0. 0.5 0.5 0.5"),
        lambda text: "vn 0 0 1\nvt 0 0\ns off\nl 1 2\np 1\n" + text,
    ],
)
def test_an_obj_is_the_same_however_it_is_written(change):
    plain = obj_text(SQUARE, [(0, 1, 2, 3), (1, 4, 2)])
    changed = change(plain)
    assert changed != plain
    raw = read(changed.encode("latin-1" if "\xe9" in changed else "utf-8"), "obj")
    np.testing.assert_array_equal(soup(raw), soup(read(plain, "obj")))
    assert raw.notes == ()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("f 0 1 2", "'f 0 1 2'"),  # index 0 is none: it was taken for the vertex after the last one
        ("f 1/1 0/1 2/1", "'f 1/1 0/1 2/1'"),
        ("f 1 2 -9", "line 8"),
        ("f 1 2 9", "vertex 9"),
        ("f 1 2 99999999999999999999", "line 8"),
        ("f 1 2 3.5", "line 8"),
        ("f 1 2 1_0", "line 8"),
        ("v 1,5 0 0", "'v 1,5 0 0'"),
        ("v 1_0 0 0", "'v 1_0 0 0'"),
        ("v 1 0", "line 8"),
        ("v 0x10 0 0", "line 8"),
        ("v \u0661 0 0", "line 8"),
        ("f 1 2 \0 3", "binary data"),
    ],
)
def test_an_obj_line_that_means_nothing_is_refused(line, says):
    refused(obj_text(SQUARE, [(0, 1, 2, 3), (1, 4, 2)]) + line + "\n", "obj", says)


def test_lines_of_unknown_kind_are_told_and_not_passed_over_in_silence():
    raw = read("V 0 0 0\nsurf 0 1 2\nsurf 0 1 3\n" + obj_text(SQUARE, [(0, 1, 2)]), "obj")
    assert raw.notes == ("3 lines of unknown kind passed over, most of them 'surf'",)


def test_text_of_sixteen_bits_is_refused():
    for kind, text in (
        ("obj", obj_text(SQUARE, [(0, 1, 2)])),
        ("stl", stl_text(SQUARE, [(0, 1, 2)])),
        ("off", off_text(SQUARE, [(0, 1, 2)])),
    ):
        refused(text.encode("utf-16"), kind)


def test_lines_without_end_are_refused_before_they_are_held():
    refused(b"v 0 0 0\nf 1 1 1" + b" 1" * (3 << 20), "obj", "lines of at most 4 MiB")
    refused(
        b"v 0 0 0\nf 1 1 1" + b" 1 1 1 1 1 1 1 1\\\n" * (1 << 18), "obj", "lines of at most 4 MiB"
    )


# PLY


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"count": "int", "index": "uint"},
        {"count": "ushort", "index": "uchar", "scalar": "double"},
        {"count": "char", "index": "short"},
        {"index": "uint64"},
        {"faces_first": True},
        {"more": ("uchar", "float")},
        {"more": (("list", "uchar", "float"), "double")},
    ],
)
def test_a_ply_of_any_types_and_mixed_polygons_is_read(form, keys):
    polygons = [(0, 1, 2, 3), (1, 4, 2), (0, 1, 4, 2, 3), (1, 4, 2)]
    raw = read(ply(SQUARE, polygons, form, **keys), "ply")
    np.testing.assert_array_equal(soup(raw), soup(read(obj_text(SQUARE, polygons), "obj")))


def test_plys_of_one_length_of_list_are_read_as_those_of_several(rng):
    for _ in range(10):
        vertices, faces = random_mesh(rng)
        raw = read(ply(vertices, faces.tolist(), more=("uchar",)), "ply")
        np.testing.assert_array_equal(raw.faces, faces)
        np.testing.assert_array_equal(raw.vertices, vertices)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"\xef\xbb\xbf" + data,
        lambda data: data.replace(b"\n", b"\r\n"),
        lambda data: data.replace(b"\n", b"\r"),
        lambda data: data.replace(b"comment a test", b"comment end_header\nobj_info x\ncomment"),
        lambda data: data.replace(b"3 0 1 2", b"3 0.0 1 2.0"),
        lambda data: data.replace(b"vertex_indices", b"vertex_index"),
        lambda data: (
            data.replace(b"element face", b"element other 0\nproperty int a\nelement face")
            + b"\n\n"
        ),
    ],
)
def test_a_text_ply_is_the_same_however_it_is_written(change):
    plain = ply(SQUARE, [(0, 1, 2), (1, 4, 2)], "ascii")
    np.testing.assert_array_equal(soup(read(change(plain), "ply")), soup(read(plain, "ply")))


def test_a_binary_ply_may_have_a_header_of_windows():
    head, end, data = ply(SQUARE, [(0, 1, 2)]).partition(b"end_header\n")
    raw = read((head + end).replace(b"\n", b"\r\n") + data, "ply")
    np.testing.assert_array_equal(raw.vertices, SQUARE)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data[:-3], "as its header says, found the end of the file"),
        (lambda data: data + b"abc", "3 bytes more"),
        (lambda data: data.replace(b"property float z", b"property float w"), "no z"),
        (lambda data: data.replace(b"uchar int", b"float int"), "a line of a PLY header"),
        (lambda data: data.replace(b"uchar int", b"uchar float"), "whole numbers"),
        (lambda data: data.replace(b"face 2", b"face -2"), "a line of a PLY header"),
        (
            lambda data: data.replace(b"face 2", b"face 99999999999999999999"),
            "a line of a PLY header",
        ),
        (lambda data: data.replace(b"face 2", b"face 3"), "the end of the file"),
        (lambda data: data.replace(b"face 2", b"face 0"), "none"),
        (
            lambda data: data.replace(
                b"format binary_little_endian", b"format binary_middle_endian"
            ),
            "a line of a PLY header",
        ),
        (
            lambda data: data.replace(
                b"property list uchar int vertex_indices", b"property int vertex_indices"
            ),
            "a list vertex_indices",
        ),
        (lambda data: data[: data.index(b"end_header")], "a PLY header"),
        (lambda data: data.replace(b"\x03\0\0\0\0", b"\x03\xff\xff\xff\xff"), "vertex 0"),
    ],
)
def test_a_ply_that_lies_is_refused(change, says):
    data = ply(SQUARE, [(0, 1, 2), (1, 4, 2)])
    assert change(data) != data
    refused(change(data), "ply", says)


def test_a_text_ply_with_commas_is_refused_and_not_cut_short():
    """numpy.fromstring stops at the comma, with a warning at most."""
    for data in (
        ply(SQUARE, [(0, 1, 2)], "ascii").replace(b"2.0", b"2,5"),
        ply(SQUARE, [(0, 1, 2)], "ascii") + b"3 0 1 4\n",
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            refused(data, "ply", "line")


# STL and OFF


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.upper(),
        lambda text: text.replace("solid a", "solid vertex 1 2 3 facet"),
        lambda text: text.replace("\n", "\n\t\n"),
        lambda text: (
            text.replace("outer loop\n", "outer loop ")
            .replace("\nvertex", " vertex")
            .replace("0\nendloop", "0 endloop")
        ),
        lambda text: text.replace("endfacet\nfacet", "endfacet\nendsolid a\nsolid b\nfacet", 1),
    ],
)
def test_a_text_stl_is_the_same_however_it_is_written(change):
    plain = stl_text(SQUARE, [(0, 1, 2), (1, 4, 2)])
    np.testing.assert_array_equal(soup(read(change(plain), "stl")), soup(read(plain, "stl")))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("vertex 2.0", "vertex 2,5"), "'vertex 2,5 0.0 0.0'"),
        (lambda text: text.replace("vertex 2.0 0.0 0.0\n", ""), "a triangle between"),
        (lambda text: text.partition("endsolid")[0], "'endsolid' at the end"),
        (lambda text: text.partition("endloop")[0], "'endsolid' at the end"),
        (lambda text: text.replace("endloop", "vertex 0 0 1\nendloop"), "a triangle between"),
        (lambda text: "solid a\nendsolid a\n", "none"),
    ],
)
def test_a_text_stl_that_is_damaged_is_refused(change, says):
    refused(change(stl_text(SQUARE, [(0, 1, 2), (1, 4, 2)])), "stl", says)


def test_a_binary_stl_may_begin_with_solid():
    data = trimesh.Trimesh(SQUARE, [(0, 1, 2), (1, 4, 2)], process=False).export(file_type="stl")
    np.testing.assert_array_equal(soup(read(b"solid" + data[5:], "stl")), soup(theirs(data, "stl")))
    for count in (0, 1, 3, 2**32 - 1):
        refused(
            data[:80] + struct.pack("<I", count) + data[84:],
            "stl",
            "triangles its header announces",
        )


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("OFF\n", "# a comment\nOFF "),
        lambda text: text.replace("\n", " # and so on\n\n"),
        lambda text: text.replace("OFF", "COFF").replace("0.0\n", "0.0 255 0 0 255\n"),
        lambda text: text.replace("3 0 1 2", "3 0 1 2 0.5 0.5 0.5"),
    ],
)
def test_an_off_is_the_same_however_it_is_written(change):
    plain = off_text(SQUARE, [(0, 1, 2), (1, 4, 2)])
    np.testing.assert_array_equal(soup(read(change(plain), "off")), soup(read(plain, "off")))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda text: text.replace("3 0 1 2\n", ""),
            "expected 5 vertices and 2 faces, found the end after 5 and 1",
        ),
        (lambda text: text.replace("3 0 1 2", "9 0 1 2"), "'9 0 1 2'"),
        (lambda text: text.replace("3 0 1 2", "-3 0 1 2"), "'-3 0 1 2'"),
        (lambda text: text.replace("3 0 1 2", "3 0 1 -1"), "vertex 0"),
        (lambda text: text.replace("3 0 1 2", "3 0 1 7"), "vertex 8"),
        (lambda text: text.replace("1.0", "1,0", 1), "line"),
        (lambda text: text.replace("5 2 0", "5 -2 0"), "the counts of vertices and faces"),
        (lambda text: text.replace("OFF", "4OFF"), "the counts of vertices and faces"),
    ],
)
def test_an_off_that_lies_is_refused(change, says):
    refused(change(off_text(SQUARE, [(0, 1, 2), (1, 4, 2)])), "off", says)


# GLB


def one_mesh(made=None, indices=(0, 1, 2, 1, 4, 2), mode=4, **keys):
    """A Glb of the square and a triangle; keys: of the accessor of its vertices."""
    made = made or Glb()
    primitive = {
        "attributes": {"POSITION": made.accessor(SQUARE.astype(np.float32), **keys)},
        "mode": mode,
    }
    if indices is not None:
        primitive["indices"] = made.accessor(np.array(indices, np.uint16))
    return made, made.mesh(primitive)


def plain_glb(**keys):
    made, mesh = one_mesh(**keys)
    return made.bytes([made.node(mesh=mesh)])


EXPECTED = SQUARE[[(0, 1, 2), (1, 4, 2)]]


@pytest.mark.parametrize("sparse", [(2, 4), (0, 1, 2, 3, 4)])
def test_sparse_positions_are_put_in(sparse):
    """trimesh leaves them as they stand in the dense part."""
    np.testing.assert_array_equal(soup(read(plain_glb(sparse=sparse), "glb")), EXPECTED)


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, (0, 1, 2, 1, 4, 2), [(0, 1, 2), (1, 4, 2)]),
        (5, (0, 1, 3, 2), [(0, 1, 3), (3, 1, 2)]),
        (6, (1, 4, 2, 3, 0), [(1, 4, 2), (1, 2, 3), (1, 3, 0)]),
        (5, None, [(0, 1, 2), (2, 1, 3), (2, 3, 4)]),
    ],
)
def test_lists_strips_and_fans_are_wound_alike(mode, indices, faces):
    raw = read(plain_glb(mode=mode, indices=indices), "glb")
    np.testing.assert_array_equal(raw.vertices[raw.faces], SQUARE[np.array(faces)])


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int16, np.uint16])
def test_quantised_positions_are_read_with_and_without_their_norm(kind):
    made = Glb()
    values = (SQUARE * 50).astype(kind)
    plain, normal = made.accessor(values), made.accessor(values, normalized=True)
    for accessor, unit in ((plain, 50), (normal, 50 / np.iinfo(kind).max)):
        mesh = made.mesh(
            {
                "attributes": {"POSITION": accessor},
                "indices": made.accessor(np.array([0, 1, 2, 1, 4, 2], np.uint8)),
            }
        )
        raw = read(
            made.bytes([made.node(mesh=mesh)], extensionsRequired=["KHR_mesh_quantization"]), "glb"
        )
        np.testing.assert_allclose(soup(raw), EXPECTED * unit, rtol=1e-12)


def test_a_mirror_turns_the_sense_of_winding():
    made, mesh = one_mesh()
    raw = read(made.bytes([made.node(mesh=mesh, scale=[-1, 1, 1])]), "glb")
    a, b, c = np.moveaxis(raw.vertices[raw.faces], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_a_camera_on_the_way_hides_nothing_and_scenes_may_be_missing():
    made, mesh = one_mesh()
    inner = made.node(mesh=mesh)
    outer = made.node(children=[inner], camera=0, translation=[1, 0, 0])
    camera = {"cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]}
    for data in (made.bytes([outer], **camera), made.bytes(None, **camera)):
        np.testing.assert_array_equal(soup(read(data, "glb")), EXPECTED + np.array([1, 0, 0]))
    made.scene["nodes"] = []
    np.testing.assert_array_equal(soup(read(made.bytes(), "glb")), EXPECTED)


def test_data_may_stand_in_the_scene_itself():
    made, mesh = one_mesh()
    made.node(mesh=mesh)
    inside = "data:application/octet-stream;base64," + base64.b64encode(bytes(made.data)).decode()
    np.testing.assert_array_equal(
        soup(read(made.bytes([0], buffers=[{"byteLength": len(made.data), "uri": inside}]), "glb")),
        EXPECTED,
    )
    for uri in ("file:///etc/passwd", "../a.bin", "http://x/a.bin", ""):
        refused(
            made.bytes([0], buffers=[{"byteLength": 3, "uri": uri}]), "glb", "a buffer elsewhere"
        )
    for uri in ("data:,abc", "data:;base64,a*c=", "data:"):
        refused(made.bytes([0], buffers=[{"byteLength": 3, "uri": uri}]), "glb", "base64")


def test_what_is_left_out_of_a_scene_is_told():
    made, mesh = one_mesh()
    made.scene["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": 0}]
    made.scene["meshes"][mesh]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 1})
    raw = read(
        made.bytes([made.node(mesh=mesh, skin=0, extensions={"EXT_mesh_gpu_instancing": {}})]),
        "glb",
    )
    assert set(raw.notes) == {
        "1 skins left as they are bound",
        "1 instanced copies left out",
        "1 morph targets left out",
        "1 primitives of points or lines left out",
    }


def changed(*steps):
    """A plain GLB whose scene is changed: (path of keys, value), …"""
    made, mesh = one_mesh(sparse=(2, 4))
    made.node(mesh=mesh)
    scene = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(made.data)}],
        **made.scene,
        "scenes": [{"nodes": [0]}],
    }
    for path, value in steps:
        place = scene
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
    return glb(scene, bytes(made.data))


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("accessors", 0, "type"), "VEC2", "expected positions of type VEC3, found VEC2"),
        (("accessors", 0, "type"), "VEC9", "positions of type VEC3"),
        (("accessors", 0, "componentType"), 5125, "positions of type VEC3"),
        (("accessors", 0, "componentType"), 7, "a known type of numbers"),
        (("accessors", 0, "count"), -1, "a readable glTF scene"),
        (("accessors", 0, "count"), 6, "within a buffer view"),
        (("accessors", 0, "count"), 2**40, "at most 2,000,000 triangles"),
        (("accessors", 0, "count"), 1e400, "a readable glTF scene"),
        (("accessors", 0, "byteOffset"), 4, "within a buffer view"),
        (("accessors", 0, "byteOffset"), 2**50, "within a buffer view"),
        (("accessors", 0, "bufferView"), 99, "bufferViews below"),
        (("accessors", 0, "sparse", "indices", "byteOffset"), 2, "within a buffer view"),
        (
            ("accessors", 0, "sparse", "indices", "componentType"),
            5126,
            "sparse indices as unsigned",
        ),
        (("accessors", 0, "sparse", "values", "bufferView"), 1, "within a buffer view"),
        (("accessors", 0, "sparse", "count"), 2**33, "within a buffer view"),
        (("accessors", 1, "componentType"), 5126, "indices as unsigned"),
        (("accessors", 1, "type"), "VEC3", "indices as unsigned"),
        (("accessors", 1, "count"), 4, "three corners for each triangle"),
        (("bufferViews", 0, "byteStride"), 4, "found a step of 4"),
        (("bufferViews", 0, "byteStride"), 0, "found a step of 0"),
        (("bufferViews", 0, "byteStride"), 1000, "within a buffer view"),
        (("bufferViews", 0, "byteLength"), 10**6, "within a buffer view"),
        (("bufferViews", 0, "byteOffset"), 10**6, "within a buffer view"),
        (("bufferViews", 0, "buffer"), 1, "buffers below 1"),
        (("buffers", 0, "byteLength"), 10**6, "a buffer of 1,000,000 bytes"),
        (("buffers",), [], "buffers below 0"),
        (("meshes", 0, "primitives", 0, "attributes"), {}, "a POSITION"),
        (("meshes", 0, "primitives", 0, "attributes", "POSITION"), 9, "accessors below 2"),
        (("meshes", 0, "primitives", 0, "mode"), 7, "mode 7"),
        (("meshes", 0, "primitives", 0, "mode"), 1, "none"),
        (("nodes", 0, "mesh"), 3, "meshes below 1"),
        (("nodes", 0, "children"), [0], "a node with two parents"),
        (("nodes", 0, "children"), [5], "nodes below 1"),
        (("nodes", 0, "scale"), [1, 2], "3 numbers in a node's scale"),
        (("nodes", 0, "scale"), ["a"], "a readable glTF scene"),
        (("scenes", 0, "nodes"), [0, 0], "a node with two parents"),
        (("scene",), 4, "scenes below 1"),
        (
            ("extensionsRequired",),
            ["EXT_meshopt_compression"],
            "the compression EXT_meshopt_compression",
        ),
        (("extensionsRequired",), ["MADE_UP_geometry"], "MADE_UP_geometry"),
        (("meshes",), {}, "a readable glTF scene"),
    ],
)
def test_a_glb_that_lies_is_refused(path, value, says):
    np.testing.assert_array_equal(soup(read(changed(), "glb")), EXPECTED)
    refused(changed((path, value)), "glb", says)


def test_indices_beyond_the_vertices_and_positions_without_data_are_refused():
    refused(plain_glb(indices=(0, 1, 9)), "glb", "vertex 10")
    refused(plain_glb(indices=(0, 1, 65535)), "glb", "vertex 65536")
    refused(
        changed((("accessors", 0), {"count": 5, "componentType": 5126, "type": "VEC3"})),
        "glb",
        "positions with data",
    )


def test_a_glb_cut_short_or_of_another_version_is_refused():
    data = plain_glb()
    for cut in range(0, len(data), 7):
        refused(data[:cut], "glb")
    refused(data[:4] + struct.pack("<I", 1) + data[8:], "glb", "version 1")
    deep = b"[" * 100_000
    refused(
        struct.pack("<4sIII4s", b"glTF", 2, 20 + len(deep), len(deep), b"JSON") + deep,
        "glb",
        "a readable glTF scene",
    )


def test_a_sparse_accessor_without_a_base_takes_no_more_memory_than_triangles_may():
    refused(
        changed(
            (("accessors", 1), {"count": 3 * 2_000_001, "componentType": 5125, "type": "SCALAR"})
        ),
        "glb",
        "at most 2,000,000",
    )


# Modules of npm packages


MODULE = "var a = 1;\nexports.positions=[[0,0,0],[1,0,0],[0,1,0],[0,0,1]];exports.cells=CELLS;"
CELLS = "[[0,2,1],[0,1,3],[0,3,2],[1,2,3]]"


def module(change=lambda text: text):
    return change(MODULE.replace("CELLS", CELLS)).encode()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text,
        lambda text: text.replace("exports.", "export const ").replace("=", " = "),
        lambda text: '{"cells": ' + CELLS + text[len("var a = 1;") :],
        lambda text: text.replace("],[", "] ,\n [").replace("=[", "= [ "),
        lambda text: text.replace(
            "exports.positions", "exports.repositions=[[1]];exports.positions"
        ),
    ],
)
def test_a_module_with_positions_and_cells_is_the_same_however_it_is_written(change):
    raw = read(module(change), "js")
    assert len(raw.vertices) == 4
    np.testing.assert_array_equal(raw.faces, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_polygons_of_a_module_are_cut():
    square = "exports.positions=[[0,0,0],[1,0,0],[1,1,0],[0,1,0]];exports.cells=[[0,1,2,3]]"
    assert area(read(square.encode(), "js")) == pytest.approx(1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("cells", "sells"), "cells: expected a module that exports"),
        (lambda text: text.replace("positions", "places"), "positions: expected a module"),
        (lambda text: text[:-6], "cells: expected a module"),
        (lambda text: text.replace("[0,2,1]", "[0,2,9]"), "faces among its 4 vertices, found v"),
        (lambda text: text.replace("[0,2,1]", "[0,2,-1]"), "cells: expected a module"),
        (lambda text: text.replace("[0,2,1]", "[f(),2,1]"), "cells: expected a module"),
        (lambda text: text.replace("[1,0,0]", "[1,0]"), "positions: expected a module"),
        (lambda text: text.replace("[1,0,0]", "[NaN,0,0]"), "positions: expected a module"),
        (lambda text: "module.exports = require('./mesh')", "cells: expected a module"),
    ],
)
def test_a_module_without_plain_arrays_is_refused(change, said):
    refused(module(change), "js", said)


def test_a_module_of_too_many_triangles_is_refused_before_they_are_held():
    with pytest.raises(InputError, match="at most 3 triangles, found 4"):
        from_bytes(module(), ".js", "mesh.js", 3)
    polygon = "exports.positions=[[0,0,0]];exports.cells=[[" + ",".join("0" * 99) + "]]"
    with pytest.raises(InputError, match="at most 50 triangles, found 97"):
        from_bytes(polygon.encode(), ".js", "mesh.js", 50)
    # 3,000 cells of one corner do not hide a polygon
    hidden = polygon.replace("cells=[[", "cells=[" + "[0]," * 3000 + "[")
    with pytest.raises(InputError, match="at most 50 triangles, found 97"):
        from_bytes(hidden.encode(), ".js", "mesh.js", 50)
    with pytest.raises(InputError, match="bytes"):
        from_bytes(b" " * 10_000 + module(), ".js", "mesh.js", 20)
