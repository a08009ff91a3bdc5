"""Bad mesh files: one line that says where, what was expected, what was found, and the remedy;
before memory is taken.
"""

import json
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from factory.shapes.libraries import CATALOGUE, find
from factory.shapes.mesh_import import open_mesh
from factory.shapes.raw import MAXIMUM_TRIANGLES
from manifests.errors import InputError

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def refused(path, *said, **options):
    """The one line with which a file is refused."""
    with pytest.raises(InputError) as problem:
        open_mesh(path, **options)
    line = str(problem.value)
    assert "\n" not in line and str(path).split("#")[0] in line
    for words in said:
        assert words in line, line
    return line


def written(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def glb(scene, binary=b""):
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def test_segments_of_materials_are_refused_where_none_are_read(tmp_path):
    path = written(tmp_path / "a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(InputError) as caught:
        open_mesh(f"{path}?segments=materials")
    assert str(caught.value) == (
        f"{path}?segments=materials: segments: expected an OBJ file, since no materials of others"
        " are read, found a file of another format (save it as OBJ with usemtl lines, or leave"
        " segments out)"
    )


def test_missing_file_names_the_nearest(tmp_path):
    written(tmp_path / "kettle.obj", TRIANGLE)
    refused(
        tmp_path / "ketle.obj",
        "expected a mesh file, found no such file",
        "did you mean kettle.obj?",
    )
    refused(tmp_path, "expected a mesh file, found a folder")


def test_wrong_ending(tmp_path):
    refused(
        written(tmp_path / "a.step", TRIANGLE),
        "expected one of .obj, .ply, .glb, .stl, .off, found '.step'",
        "convert",
    )
    refused(written(tmp_path / "a.gltf", "{}"), "binary glTF")


@pytest.mark.parametrize("kind", ["obj", "ply", "glb", "stl", "off"])
def test_empty_and_nonsense_files(tmp_path, kind):
    refused(written(tmp_path / f"empty.{kind}", b""), "expected a mesh, found an empty file")
    refused(written(tmp_path / f"noise.{kind}", np.random.default_rng(0).bytes(5000)))
    refused(written(tmp_path / f"words.{kind}", "once upon a time\n" * 50))


def test_not_finite(tmp_path):
    for word in ("nan", "inf", "-inf", "1e999"):
        refused(
            written(tmp_path / "a.obj", TRIANGLE.replace("v 1 0 0", f"v {word} 0 0")),
            "expected finite coordinates, found 1 vertex",
            "number 2",
        )


def test_no_area(tmp_path):
    refused(
        written(tmp_path / "line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
        "expected a mesh with a surface, found 1 triangle of no area",
    )
    refused(
        written(tmp_path / "point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n"),
        "expected a mesh of some extent, found a size of 0",
    )
    refused(
        written(tmp_path / "cloud.obj", "v 1 1 1\n" * 9),
        "expected a mesh with triangles, found none",
    )


def test_faces_beyond_the_vertices(tmp_path):
    refused(
        written(tmp_path / "a.obj", TRIANGLE.replace("f 1 2 3", "f 1 2 7")),
        "expected faces among its 3 vertices, found vertex 7",
    )
    refused(
        written(tmp_path / "b.obj", TRIANGLE.replace("f 1 2 3", "f 1 2 -9")),
        "line 4",
        "expected a vertex or face",
    )
    refused(
        written(tmp_path / "c.obj", TRIANGLE.replace("v 1 0 0", "v 1 zero 0")),
        "line 2",
        "'v 1 zero 0'",
    )


def test_non_manifold_is_accepted_with_a_note(tmp_path):
    fan = "v 0 0 0\nv 0 1 0\nv 1 0 0\nv -1 0 .5\nv -1 0 -.5\nf 1 2 3\nf 1 2 4\nf 1 2 5\n"
    mesh = open_mesh(written(tmp_path / "fan.obj", fan))
    assert mesh.report.crowded_edges == 1 and "1 crowded edges" in mesh.report.line()


def memory_while(action):
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_ten_million_triangles_are_refused_before_memory_is_taken(tmp_path):
    """A sparse STL of 500 MB, a PLY and a GLB that only announce them: none costs more than a
    megabyte to refuse.
    """
    count = 10_000_000
    stl = tmp_path / "huge.stl"
    with open(stl, "wb") as file:
        file.write(b"\0" * 80 + struct.pack("<I", count))
        file.truncate(84 + 50 * count)
    ply = tmp_path / "huge.ply"
    with open(ply, "wb") as file:
        header = (
            "ply\nformat binary_little_endian 1.0\nelement vertex 5000000\nproperty float"
            f" x\nelement face {count}\n"
        )
        file.write(f"{header}property list uchar int vertex_indices\nend_header\n".encode())
        file.truncate(190_000_000)
    big = tmp_path / "huge.obj"
    with open(big, "wb") as file:
        file.truncate(MAXIMUM_TRIANGLES * 250 + 1)
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
    }
    scene |= {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]}
    scene |= {
        "accessors": [
            {"count": 100, "componentType": 5126, "type": "VEC3"},
            {"count": 3 * count, "componentType": 5125, "type": "SCALAR"},
        ]
    }
    files = {
        stl: "10,000,000",
        ply: "10,000,000",
        big: "500,000,001 bytes",
        written(tmp_path / "huge.glb", glb(scene)): "10,000,000",
    }
    remedy = "reduce the mesh", "`factory shapes`: --max-triangles"  # `render` has no such option
    for path, result in files.items():
        peak = memory_while(
            lambda path=path, result=result: refused(
                path, "at most 2,000,000 triangles", result, *remedy
            )
        )
        # a header and a chunk of reading; 10 M triangles would be 360 MB
        assert peak < 2_000_000, (path, peak)


def test_the_bound_can_be_raised_and_lowered(tmp_path):
    path = written(tmp_path / "two.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 .2\nf 1 2 3 4\n")
    refused(path, "expected at most 1 triangle, found 2", maximum_triangles=1)
    assert open_mesh(path, maximum_triangles=2).report.triangles == 2


def test_a_polygon_of_many_corners_counts_as_its_triangles(tmp_path):
    corners = "".join(f"v {np.cos(t)} {np.sin(t)} 0\n" for t in np.linspace(0, 6, 500))
    path = written(tmp_path / "ngon.obj", corners + "f " + " ".join(map(str, range(1, 501))) + "\n")
    refused(path, "expected at most 400 triangles, found 498", maximum_triangles=400)
    assert open_mesh(path).report.triangles == 498


def test_headers_that_lie_are_refused(tmp_path):
    refused(
        written(tmp_path / "cut.stl", b"\0" * 80 + struct.pack("<I", 1000) + b"\0" * 100),
        "50,084 bytes for the 1,000 triangles",
        "found 184",
    )
    header = (
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty"
        b" float z\nelement face 100000\n"
    )
    refused(
        written(
            tmp_path / "cut.ply",
            header + b"property list uchar int vertex_indices\nend_header\n0 0 0\n",
        ),
        "100,000 faces",
    )
    refused(
        written(tmp_path / "cut.off", "OFF\n3 9999 0\n0 0 0\n"), "9,999 faces as its header says"
    )


def test_glb_refuses_compression_outside_files_and_shared_nodes(tmp_path):
    refused(
        written(tmp_path / "a.glb", glb({"extensionsRequired": ["KHR_draco_mesh_compression"]})),
        "the compression KHR_draco",
    )
    refused(
        written(
            tmp_path / "b.glb", glb({"buffers": [{"uri": "../../etc/passwd", "byteLength": 3}]})
        ),
        "a buffer elsewhere",
        "one .glb",
    )
    doubled = {
        "meshes": [{"primitives": []}],
        "nodes": [{"children": [2]}, {"children": [2]}, {"mesh": 0}],
    }
    refused(written(tmp_path / "c.glb", glb(doubled)), "a node with two parents")
    refused(
        written(
            tmp_path / "d.glb",
            b"glTF" + b"\2\0\0\0\xff\0\0\0" + struct.pack("<I4s", 1 << 31, b"JSON"),
        ),
        "a JSON chunk of at most 64 MiB",
    )


def library(path, models, catalogue=True):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        lines = ["license=Public domain"]
        for number, (name, content) in enumerate(models.items(), 1):
            archive.writestr(f"set/{name}/{name}.obj", content)
            lines += [
                f"name#{number}={name}",
                f"model#{number}=/set/{name}/{name}.obj",
                f"creator#{number}=Ada",
            ]
        if catalogue:
            archive.writestr(CATALOGUE, "\n".join(lines))
    return path


def test_a_furniture_library_lists_and_opens_its_meshes(tmp_path):
    path = library(tmp_path / "lib.sh3f", {"armChair1": TRIANGLE, "lamp": TRIANGLE})
    entries = find(tmp_path)
    assert [(e.name, e.category, e.licence) for e in entries] == [
        ("armChair1", "chair", "Public domain, Ada"),
        ("lamp", "object", "Public domain, Ada"),
    ]
    assert open_mesh(entries[0].place).category == "chair"
    refused(f"{path}#armChair", "after '#', found 'armChair'", "armChair1")
    refused(path, "after '#', found no name", "armChair1")


def test_meshes_of_a_library_that_share_a_stem_are_both_opened(tmp_path):
    path = tmp_path / "lib.sh3f"
    members = {f"{folder}/chair.obj": k for k, folder in enumerate(("old", "new", "chair-2"), 1)}
    members["set/chair-2.obj"] = 4
    with zipfile.ZipFile(path, "w") as archive:
        lines = [f"model#{k}=/{member}" for member, k in members.items()]
        for member, k in members.items():
            archive.writestr(member, f"v 0 0 0\nv {k} 0 0\nv 0 1 0\nf 1 2 3\n")
        archive.writestr(CATALOGUE, "\n".join([*lines, "model#5=/old/chair.obj"]))
    hashes = {entry.name: open_mesh(entry.place).hash for entry in find(path)}
    # the last one in the catalogue keeps the name that it has had
    assert list(hashes) == ["chair", "chair-2", "chair-3", "chair-4"]
    assert len(set(hashes.values())) == len(members)
    written(tmp_path / "last.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert hashes["chair"] == open_mesh(tmp_path / "last.obj").hash


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    path = library(tmp_path / "bomb.sh3f", {"bomb": b"v 0 0 0\n" * 8_000_000})  # 64 MB from 90 kB
    peak = memory_while(
        lambda: refused(
            f"{path}#bomb", "bytes unpacked", "64,000,000", "`factory shapes`: --max-triangles"
        )
    )
    assert peak < 10_000_000


def test_broken_libraries(tmp_path):
    refused(f"{written(tmp_path / 'a.sh3f', b'no zip at all')}#x", "a zip file of meshes")
    refused(
        f"{library(tmp_path / 'b.sh3f', {'x': TRIANGLE}, catalogue=False)}#x",
        f"a library with {CATALOGUE}",
    )
    refused(
        f"{tmp_path / 'none.sh3f'}#x",
        "expected a .sh3f library, a zip file of meshes, found no such file",
    )


def test_wrong_options(tmp_path):
    path = written(tmp_path / "a.obj", TRIANGLE)
    refused(path, "expected an axis such as y, +z or -x, found 'w'", up="w")
    refused(path, "two different axes", up="z", front="-z")
    refused(f"{path}?upp=z", "options among up, front", "did you mean up?")
    refused(path, "an angle from 0 to 180 degrees", crease_deg=200)
    refused(path, "'one' or 'materials'", segments="material")
