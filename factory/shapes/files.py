"""Mesh files read into raw triangles, their size bounded before any memory is taken.

OBJ is read here, line by line (names of materials are wanted, nothing outside the file is opened); PLY, STL, OFF and GLB by trimesh,
after their headers have said how many triangles there will be. No texture, library or second file is ever followed.
"""

import io
import json
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manifests.problems import Problem, closest

FORMATS = (".obj", ".ply", ".glb", ".stl", ".off")
MAXIMUM_TRIANGLES = 2_000_000
BYTES_A_TRIANGLE = 250  # more than any format spends on one, OBJ with normals and texture coordinates included
MORE = "reduce the mesh, with Blender's Decimate modifier for instance (the limit is fixed but for `factory shapes`: --max-triangles)"
AGAIN = "export it again"


@dataclass(frozen=True)
class Raw:
    """vertices (V, 3) and faces (F, 3) as they stand in the file; material (F,) indexes materials, the OBJ's names."""

    vertices: np.ndarray
    faces: np.ndarray
    materials: tuple[str, ...] = ()
    material: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def read(path, maximum=MAXIMUM_TRIANGLES):
    """The Raw triangles of a file. Raises Problem: missing, not a mesh, truncated, or more than `maximum` triangles."""
    path = Path(path)
    kind = path.suffix.lower()
    if not path.is_file():
        near = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        raise Problem(
            path, "a mesh file", "a folder" if path.is_dir() else "nothing", closest(path.name, near) if near else "check the path"
        )
    check_format(path, kind)
    size = path.stat().st_size
    with open(path, "rb") as file:
        return parse(file, kind, size, path, maximum)


def check_format(where, kind):
    """Raises Problem if a file's ending is not one that is read."""
    if kind not in FORMATS:
        remedy = "export it as binary glTF (.glb)" if kind == ".gltf" else "convert it to one of these"
        raise Problem(where, f"one of {', '.join(FORMATS)}", f"'{kind or 'no ending'}'", remedy)


def parse(file, kind, size, where, maximum=MAXIMUM_TRIANGLES):
    """The Raw triangles of an open binary file of `size` bytes; where: its name in errors."""
    if size == 0:
        raise Problem(where, "a mesh", "an empty file", AGAIN)
    heavy = Problem(where, f"at most {maximum:,} triangles", f"{size:,} bytes", MORE) if size > maximum * BYTES_A_TRIANGLE else None
    if heavy and kind == ".obj":  # has no header: counting would read all of it
        raise heavy
    count = {".obj": _count_obj, ".ply": _count_ply, ".stl": _count_stl, ".off": _count_off, ".glb": _count_glb}[kind](file, size, where)
    if count > maximum:
        raise Problem(where, f"at most {maximum:,} triangles", f"{count:,}", MORE)
    if heavy:  # few triangles among much else: textures, points
        raise heavy
    if count == 0:
        raise Problem(where, "a mesh with triangles", "none", "check that the file holds a surface, not points or curves")
    file.seek(0)
    try:
        return _parse_obj(file, where) if kind == ".obj" else _through_trimesh(file, kind, where)
    except Problem:
        raise
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, struct.error, NotImplementedError, UnicodeDecodeError) as error:
        said = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise Problem(
            where, f"a readable {kind[1:].upper()} file", f"'{said}'", f"{AGAIN}, or open it in a viewer to see whether it is whole"
        ) from None


def _through_trimesh(file, kind, where):
    import trimesh

    scene = trimesh.load_scene(file, file_type=kind[1:], process=False, skip_materials=True)
    mesh = scene.to_mesh()
    if not len(mesh.faces):
        raise Problem(where, "a mesh with triangles", "none", "check that the file holds a surface, not points or curves")
    return Raw(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))


# Triangles that a file announces, from its header or by streaming through it


def _count_obj(file, size, where):
    """Corners beyond the second of each face, plus vertices beyond four a triangle (a cloud of points is no mesh)."""
    triangles, vertices, seen = 0, 0, 0
    for line in _lines(file, where):
        seen += 1
        key = line.split(None, 1)[:1]  # tabs and indents are white space as well
        if key == [b"f"]:
            triangles += max(len(line.split()) - 3, 0)
        elif key == [b"v"]:
            vertices += 1
    if vertices == 0:
        raise Problem(where, "an OBJ file with 'v' and 'f' lines", f"{seen} lines, no vertex among them", AGAIN)
    return triangles if triangles == 0 else max(triangles, vertices // 4)


def _lines(file, where, longest=1 << 20):
    """Lines of an OBJ, none longer than a megabyte: a binary file in disguise is refused early."""
    file.seek(0)
    while line := file.readline(longest):
        if len(line) == longest or b"\0" in line:
            raise Problem(where, "an OBJ file's text", "binary data", "check the file's ending")
        yield line


def _count_ply(file, size, where):
    head = file.read(1 << 16)
    match = re.search(rb"element\s+face\s+(\d+)", head)
    if not head.startswith(b"ply") or b"end_header" not in head or not match:
        raise Problem(where, "a PLY header with faces", f"'{_glimpse(head)}'", "check the file's ending, or that it holds more than points")
    vertices = int(re.search(rb"element\s+vertex\s+(\d+)", head)[1]) if b"element vertex" in head else 0
    if int(match[1]) + vertices > size:  # each takes at least a byte
        raise Problem(
            where, f"{int(match[1]):,} faces and {vertices:,} vertices as its header says", f"{size:,} bytes", "download or export it again"
        )
    return max(int(match[1]), vertices // 4)


def _count_stl(file, size, where):
    head = file.read(84)
    if len(head) == 84 and size == 84 + 50 * struct.unpack("<I", head[80:])[0]:
        return struct.unpack("<I", head[80:])[0]
    if not head.lstrip().startswith(b"solid"):
        announced = struct.unpack("<I", head[80:])[0] if len(head) == 84 else 0
        raise Problem(
            where,
            f"{84 + 50 * announced:,} bytes for the {announced:,} triangles its header announces",
            f"{size:,}",
            "download or export it again",
        )
    file.seek(0)
    return sum(line.lstrip().startswith(b"facet") for line in _lines(file, where))


def _count_off(file, size, where):
    words = re.sub(rb"#[^\n]*", b"", file.read(4096)).split()
    if not words or words[0] != b"OFF" or len(words) < 3 or not (words[1].isdigit() and words[2].isdigit()):
        raise Problem(where, "'OFF' and the counts of vertices and faces", f"'{_glimpse(b' '.join(words))}'", AGAIN)
    if int(words[1]) + int(words[2]) > size:
        raise Problem(where, f"{int(words[2]):,} faces as its header says", f"{size:,} bytes", "download or export it again")
    return max(int(words[2]), int(words[1]) // 4)


def _count_glb(file, size, where):
    """Triangles of the whole scene, each mesh as often as the nodes show it; compressed and outside data are refused."""
    head = file.read(20)
    if len(head) < 20 or head[:4] != b"glTF":
        raise Problem(where, "a binary glTF header", f"'{_glimpse(head)}'", "check the file's ending")
    length, kind = struct.unpack("<I4s", head[12:20])
    if kind != b"JSON" or length > min(size, 64 << 20):
        raise Problem(where, "a JSON chunk of at most 64 MiB first", f"{kind!r} of {length:,} bytes", "download or export it again")
    try:
        scene = json.loads(file.read(length))
        if needs := [name for name in scene.get("extensionsRequired", ()) if "draco" in name.lower() or "meshopt" in name.lower()]:
            raise Problem(where, "plain geometry", f"the compression {needs[0]}", "export it without compression")
        if any("uri" in buffer for buffer in scene.get("buffers", ())):
            raise Problem(where, "all data inside the file", "a buffer elsewhere", "export it as one .glb")
        each = [sum(_glb_triangles(scene, p) for p in mesh["primitives"]) for mesh in scene.get("meshes", ())]
        shown = sum(each[node["mesh"]] * _instances(scene, index) for index, node in enumerate(scene.get("nodes", ())) if "mesh" in node)
    except Problem:
        raise
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise Problem(where, "a readable glTF scene", f"'{type(error).__name__}: {error}'"[:120], "download or export it again") from None
    return shown


def _glb_triangles(scene, primitive):
    accessor = scene["accessors"][primitive.get("indices", primitive["attributes"]["POSITION"])]
    vertices = scene["accessors"][primitive["attributes"]["POSITION"]]["count"]
    if "sparse" in accessor or min(accessor["count"], vertices) < 0:
        raise ValueError("sparse or negative accessor")
    return max(accessor["count"] // 3 if primitive.get("mode", 4) == 4 else accessor["count"], vertices // 4)


def _instances(scene, node):
    """How often a node is shown: the number of ways from a root. glTF wants one; a file that doubles at each level is a bomb."""
    parents = (
        [index for index, other in enumerate(scene["nodes"]) if node in other.get("children", ())] if len(scene["nodes"]) < 2000 else [0]
    )
    if len(parents) > 1:
        raise ValueError("a node with two parents")
    return 1


def _glimpse(data):
    return data[:24].decode("ascii", "replace").replace("\n", " ").strip()


def _parse_obj(file, where):
    """Vertices, faces (polygons as fans) and material names of an OBJ file."""
    vertices, corners, lengths, material, names, current, lines = [], [], [], [], {}, 0, 0
    for number, line in enumerate(_lines(file, where), 1):
        words = line.split()
        key = words[0] if words else b""
        try:
            if key == b"v":
                vertices.append((float(words[1]), float(words[2]), float(words[3])))
            elif key == b"f":
                polygon = [int(word.split(b"/", 1)[0]) for word in words[1:]]
                polygon = [index - 1 if index > 0 else len(vertices) + index for index in polygon]
                if len(polygon) < 3:  # some exporters write lines so
                    lines += 1
                    continue
                if min(polygon) < 0 or max(polygon) >= 1 << 31:
                    raise ValueError
                corners.extend(polygon)
                lengths.append(len(polygon))
                material.append(current)
            elif key == b"usemtl":
                current = names.setdefault(b" ".join(words[1:]).decode("utf-8", "replace"), len(names) + 1)
        except (ValueError, IndexError):
            raise Problem(f"{where}: line {number}", "a vertex or face", f"'{_glimpse(line)}'", AGAIN) from None
    faces, owner = _fans(np.array(corners, np.int64), np.array(lengths, np.int64))
    if len(faces) and faces.max() >= len(vertices):
        raise Problem(where, f"faces among its {len(vertices)} vertices", f"vertex {faces.max() + 1}", "download or export it again")
    notes = (f"{lines} faces of fewer than three corners dropped",) if lines else ()
    return Raw(np.array(vertices, float).reshape(-1, 3), faces, ("", *names), np.array(material, np.int64)[owner], notes)


def _fans(corners, lengths):
    """Polygons, one after another, as triangles (F, 3) around each first corner; and the polygon (F,) each came from."""
    triangles = lengths - 2
    owner = np.repeat(np.arange(len(lengths)), triangles)
    step = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    start = (np.cumsum(lengths) - lengths)[owner]
    return np.stack([corners[start], corners[start + step + 1], corners[start + step + 2]], axis=1).reshape(-1, 3), owner


def from_bytes(data, kind, where, maximum=MAXIMUM_TRIANGLES):
    """As `read`, for a file already in memory."""
    return parse(io.BytesIO(data), kind, len(data), where, maximum)
