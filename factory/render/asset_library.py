"""Materials as a Blender file of assets, which Blender's asset browser lists.

Each material is an asset to drop onto an object; its node group is an asset too, for shader graphs
of one's own. Both have a preview picture, tags, a description with source and licence, and a place
in a catalogue: `blender_assets.cats.txt`, beside the file.

The file is not the same byte for byte when it is written again, because Blender writes addresses of
its memory into it.
"""

import contextlib
import errno
import io
import tempfile
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from factory.render import materials as node_groups
from manifests.files import replacing, transaction, write_text
from manifests.materials import Material
from shaders import nodes

CATALOGUES = "blender_assets.cats.txt"  # the name under which Blender looks for it
MATERIALS, GROUPS = "Measured materials", "Measured materials, node groups"
# so that a catalogue keeps its id when the library is written again
_NAMESPACE = uuid.UUID("5d1f0e0c-6b0e-5f43-9d3a-6f2c8d8f4a11")
COLUMN, ROW = 220.0, 170.0  # of nodes in the node editor


def write(
    path: Path,
    materials: Sequence[Material],
    previews: Mapping[str, np.ndarray],
    watch: Callable[[Iterable[Material]], Iterable[Material]] = lambda items: items,
) -> None:
    """Write a .blend file with the materials as assets, and its catalogues beside it.

    path       of the .blend file; an existing one is replaced, and so are the catalogues
    previews   {material's name: (height, width, 4) uint8 display values and opacity}
    watch      wraps the iterable, to show progress
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for material in watch(materials):
        _add(material, previews[material.name])
    # Blender writes to a path, and keeps the earlier file under another name
    with tempfile.TemporaryDirectory(prefix="brdfactory-") as folder:
        draft = Path(folder) / "library.blend"
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                bpy.ops.wm.save_as_mainfile(filepath=str(draft), compress=True, copy=True)
        except RuntimeError as error:  # so Blender reports some errors of files
            raise OSError(str(error).strip()) from None
        _require_whole(draft, [material.name for material in materials])
        with transaction():
            with replacing(path) as file:
                file.write(draft.read_bytes())
            write_text(path.parent / CATALOGUES, catalogues({m.family for m in materials}))


def _require_whole(draft: Path, names: Sequence[str]) -> None:
    """Raise OSError if a file lacks assets: Blender does not report every error of a full disk."""
    held: list[str] = []
    with contextlib.suppress(OSError), bpy.data.libraries.load(str(draft)) as (content, _):
        held = [*content.materials, *content.node_groups]
    if sorted(held) != sorted([*names, *names]):
        raise OSError(errno.ENOSPC, "Blender wrote a part of its file; is the disk full?", draft)


def catalogues(families: Iterable[str]) -> str:
    """Return the text of the catalogues: one of materials and one of groups for each family."""
    places = [(top, family) for top in (MATERIALS, GROUPS) for family in sorted(set(families))]
    lines = [f"{_catalogue_id(top, '')}:{top}:{top}" for top in (MATERIALS, GROUPS)]
    lines += [
        f"{_catalogue_id(top, family)}:{top}/{family}:{top}-{family}" for top, family in places
    ]
    return "\n".join(["# Catalogues of the materials in this folder", "", "VERSION 1", "", *lines])


def _catalogue_id(top: str, family: str) -> str:
    """Return the id of a catalogue."""
    return str(uuid.uuid5(_NAMESPACE, f"{top}/{family}"))


def _add(material: Material, preview: np.ndarray) -> None:
    """Add one material and its node group to the open file, as assets."""
    group = node_groups.build(nodes.graph(material.mixture))
    group.name = material.name
    _arrange(group)
    surface = node_groups.new(material.name)
    node_groups.show(surface, group)
    _arrange(surface.node_tree)
    for each, top in ((surface, MATERIALS), (group, GROUPS)):
        if each.name != material.name:  # Blender shortens a name of more than 63 bytes
            raise ValueError(
                f"{material.name}: expected a name that Blender holds, found {each.name} (use a"
                " shorter name)"
            )
        each.use_fake_user = True
        each.asset_mark()
        data = each.asset_data
        data.catalog_id = _catalogue_id(top, material.family)
        data.author, data.license = material.source, material.licence
        data.description = _description(material)
        for tag in tags(material):
            data.tags.new(tag, skip_if_exists=True)
        _set_preview(each, preview)


def tags(material: Material) -> tuple[str, ...]:
    """Return the words under which the asset browser's search finds a material."""
    words = material.name.replace("_", "-").split("-")
    return tuple(
        dict.fromkeys(
            ["brdfactory", material.family, *(w for w in words if not w.isdigit() and len(w) > 1)]
        )
    )


def _description(material: Material) -> str:
    return (
        f"{material.family}; measured: {material.source}. Licence: {material.licence}. Relative L1"
        f" to the measurement {material.errors.nodes_vs_source.mean:.3f}. In a material of your"
        " own, switch off Bump Map Correction (Material Properties, Settings, Surface)."
    )


def _set_preview(each: bpy.types.ID, preview: np.ndarray) -> None:
    """Give an asset its picture; Blender's first row is the lowest."""
    image = each.preview_ensure()
    image.image_size = preview.shape[1::-1]
    image.image_pixels_float.foreach_set((preview[::-1].astype(np.float32) / 255).ravel())


def _arrange(tree: bpy.types.NodeTree) -> None:
    """Place the nodes in columns by their distance from the output, which is rightmost."""
    depth: dict[str, int] = dict.fromkeys((node.name for node in tree.nodes), 0)
    links = [(link.from_node.name, link.to_node.name) for link in tree.links]
    changed = True
    while changed:
        changed = False
        for source, target in links:
            if depth[source] < depth[target] + 1:
                depth[source], changed = depth[target] + 1, True
    used: dict[int, int] = {}
    for node in tree.nodes:
        column = depth[node.name]
        row = used[column] = used.get(column, -1) + 1
        node.location = (-COLUMN * column, -ROW * row)
