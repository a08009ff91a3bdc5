"""Mesh import: a file becomes a Mesh, cleaned, oriented, rotated to our axes, scaled and hashed.

A place is a path; the name of one mesh of a collection (a folder, a zip of Sweet Home 3D's) may
follow after '#'. Reading options may follow after '?', so that a job file can carry them:
"chairs/a.obj?up=z&front=-y", "BlendSwap-CC-0.sh3f#armchair?segments=materials".
"""

from pathlib import Path
from urllib.parse import parse_qsl

import numpy as np

from factory.shapes.cleaning import clean, orient
from factory.shapes.creases import CREASE_DEG
from factory.shapes.files import check_format, from_bytes, read
from factory.shapes.libraries import category_of, member
from factory.shapes.mesh import Mesh, finish
from factory.shapes.raw import MAXIMUM_TRIANGLES, Raw
from manifests import inputs
from manifests.errors import InputError, closest
from manifests.wording import number_of

AXES = {
    sign + axis: (1.0 if sign == "+" else -1.0) * np.eye(3)[k]
    for sign in "+-"
    for k, axis in enumerate("xyz")
}
# these come y up, front +z; the others as our world: z up, front +x
Y_UP = (".obj", ".glb", ".sh3f")
OPTIONS = ("up", "front", "segments", "crease", "category")
OWN_MATERIALS = "of the file not read"
OWN_SEGMENT = "segment-"  # material names that `shapes add` writes: they always become segments


def open_mesh(
    place: str | Path,
    *,
    up: str | None = None,
    front: str | None = None,
    crease_deg: float = CREASE_DEG,
    segments: str = "one",
    category: str | None = None,
    name: str | None = None,
    maximum_triangles: int = MAXIMUM_TRIANGLES,
) -> Mesh:
    """Return the Mesh of a file.

    place              PATH, or PATH#MEMBER of a library; with
                       ?up=…&front=…&segments=…&crease=…&category=…
    up, front          "+x", "-x", … "z": the file's axes that point up and to the front; None: y
                       and z for OBJ and GLB, z and x for others
    crease_deg         faces that meet at less than this angle look smooth
    segments           "one", or "materials": a segment for each of an OBJ's materials; other
                       formats are refused
    category, name     None: from the file's and the folders' names
    maximum_triangles  more are refused before memory is taken
    Raises             InputError
    """
    path, chosen, options = split_place(place)
    up, front = options.get("up", up), options.get("front", front)
    segments, category = options.get("segments", segments), options.get("category", category)
    crease_deg = _angle(place, options.get("crease", crease_deg))
    kind = Path(path).suffix.lower()
    if chosen is not None or kind == ".sh3f":
        data, inner, kind = member(path, chosen, maximum_triangles)
        check_format(f"{path}#{inner}", kind)
        raw, label = from_bytes(data, kind, f"{path}#{inner}", maximum_triangles), inner
    else:
        raw, label = read(path, maximum_triangles), Path(path).stem
    vertices, faces, kept, cleaned = clean(raw.vertices, raw.faces, place)
    faces, inner_share, turned = orient(vertices, faces)
    rotation = world_from_file(
        place, up or ("+y" if kind in Y_UP else "+z"), front or ("+z" if kind in Y_UP else "+x")
    )
    segment, parts, part = _segments(raw, kept, segments, place)
    return finish(
        name or label,
        category or category_of(path, chosen or ""),
        vertices @ rotation.T,
        faces,
        segment=segment,
        parts=parts,
        part=part,
        crease_deg=crease_deg,
        back_faces=inner_share,
        cleaned=(*raw.notes, *_note_on_materials(raw), *cleaned, *turned),
    )


def has_own_materials(report: str) -> bool:
    """Return whether the line of a mesh's report says that its file has materials of its own."""
    return OWN_MATERIALS in report


def _note_on_materials(raw: Raw) -> tuple[str, ...]:
    """Return a note on materials of the file. Those of `shapes add` are names of segments."""
    names = [name for name in raw.materials if name and not name.startswith(OWN_SEGMENT)]
    count = raw.own_materials or len(names)
    return (f"{number_of(count, 'material')} {OWN_MATERIALS}",) if count else ()


def split_place(place: str | Path) -> tuple[str, str | None, dict[str, str]]:
    """Return (path, member or None, options) of "PATH#MEMBER?key=value&…".

    A '#' or '?' that belongs to an existing path stays in it.
    """
    path, rest = inputs.split_path(str(place))
    chosen, _, query = rest.partition("?")
    # a plus is the sign of an axis
    options = dict(parse_qsl(query.replace("+", "%2B"), keep_blank_values=True))
    for key, value in options.items():
        if key not in OPTIONS:
            raise InputError(
                place, f"options among {', '.join(OPTIONS)}", f"'{key}'", closest(key, OPTIONS)
            )
        if not value:
            raise InputError(place, f"a value of the option {key}", "none", f"write {key}=VALUE")
    return path, chosen.removeprefix("#") if chosen else None, options


def world_from_file(place: str | Path, up: str, front: str) -> np.ndarray:
    """Return the rotation (3, 3) from the file's axes to ours: `up` to +z, `front` to +x.

    Raises  InputError if they are not two axes
    """
    named = []
    for label, axis in (("up", up), ("front", front)):
        text = axis if axis[:1] in "+-" and axis else f"+{axis}"
        if text not in AXES:
            raise InputError(
                f"{place}: {label}",
                "an axis such as y, +z or -x",
                f"'{axis}'",
                "name one of the six",
            )
        named.append(AXES[text])
    if abs(named[0] @ named[1]) > 0.5:
        raise InputError(
            f"{place}: up and front",
            "two different axes",
            f"'{up}' and '{front}'",
            "pass --up and --front",
        )
    return np.stack([named[1], np.cross(named[0], named[1]), named[0]])


def _angle(place, value):
    try:
        angle = float(value)
    except ValueError:
        angle = float("nan")
    if not 0 <= angle <= 180:
        raise InputError(
            f"{place}: crease",
            "an angle from 0 to 180 degrees",
            f"'{value}'",
            "45 suits most meshes",
        )
    return angle


def _segments(raw, kept, requested, place):
    """Return segments, part names and parts of the kept faces.

    Parts are the OBJ's materials, and so are segments if requested.
    """
    if requested not in ("one", "materials"):
        raise InputError(
            f"{place}: segments",
            "'one' or 'materials'",
            f"'{requested}'",
            closest(requested, ("one", "materials")),
        )
    if raw.material is None and requested == "materials":
        raise InputError(
            f"{place}: segments",
            "an OBJ file, since no materials of others are read",
            "a file of another format",
            "save it as OBJ with usemtl lines, or leave segments out",
        )
    if raw.material is None:
        return None, ("body",), None
    used, part = np.unique(raw.material[kept], return_inverse=True)
    names = [raw.materials[k] or "body" for k in used]
    part = part.reshape(-1)
    own = all(name.startswith(OWN_SEGMENT) for name in names)
    if requested == "one" and not own:
        return None, tuple(names), part
    if len(names) > 255:
        raise InputError(place, "at most 255 materials", str(len(names)), "use segments=one")
    order = np.argsort(np.argsort(names)) if own else np.arange(len(names))
    return order[part] + 1, tuple(names), part
