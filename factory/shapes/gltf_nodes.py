"""The nodes of a glTF scene: which meshes it shows, and where.

world_from_node (4, 4): a point p of the node's mesh lies at world_from_node @ (p, 1)
"""

from collections import Counter
from pathlib import Path

import numpy as np

from factory.shapes.gltf_schema import DOWNLOAD, Document, Node, item
from manifests.errors import InputError


def meshes_shown(
    document: Document, where: str | Path
) -> tuple[list[tuple[int, np.ndarray]], Counter[str]]:
    """Return the meshes that the scene's nodes show, and counts of what is ignored.

    Returns  [(mesh, world_from_node)] per node that shows a mesh; the ignored parts' counts
    Raises   InputError: a node that is reached twice
    """
    shown: list[tuple[int, np.ndarray]] = []
    ignored: Counter[str] = Counter()
    seen: set[int] = set()
    waiting = [(node, np.eye(4)) for node in reversed(_roots(document, where))]
    while waiting:
        index, world_from_parent = waiting.pop()
        node = item(document.nodes, index, "nodes", where)
        if index in seen:  # in a circle, or twice as many on each level: a bomb
            raise InputError(
                where,
                "a tree of nodes",
                f"a node with two parents, number {index}",
                DOWNLOAD,
            )
        seen.add(index)
        with np.errstate(all="ignore"):
            world_from_node = world_from_parent @ _parent_from_node(node, where)
        waiting += [(child, world_from_node) for child in reversed(node.children)]
        if node.mesh is not None:
            item(document.meshes, node.mesh, "meshes", where)
            shown.append((node.mesh, world_from_node))
            ignored["skins"] += node.skin is not None
            ignored["instances"] += "EXT_mesh_gpu_instancing" in node.extensions
    if not document.nodes:  # a file of meshes alone
        shown = [(mesh, np.eye(4)) for mesh in range(len(document.meshes))]
    return shown, ignored


def _roots(document: Document, where: str | Path) -> list[int]:
    """Return the root nodes of the scene, or all nodes without a parent."""
    if document.scenes:
        return item(document.scenes, document.scene, "scenes", where).nodes
    children = {child for node in document.nodes for child in node.children}
    return [index for index in range(len(document.nodes)) if index not in children]


def _parent_from_node(node: Node, where: str | Path) -> np.ndarray:
    """Return parent_from_node (4, 4): its matrix, or translation, rotation and scale."""
    matrix = np.eye(4)
    for name, count in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
        value = getattr(node, name)
        if value is None:
            continue
        if len(value) != count:
            raise InputError(
                where, f"{count} numbers in a node's {name}", str(len(value)), DOWNLOAD
            )
        step = np.eye(4)
        if name == "matrix":
            step = np.reshape(value, (4, 4)).T
        elif name == "translation":
            step[:3, 3] = value
        elif name == "scale":
            step[:3, :3] = np.diag(value)
        else:
            step[:3, :3] = _rotation(np.array(value, float))
        with np.errstate(all="ignore"):
            matrix = matrix @ step
    return matrix


def _rotation(q: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of a quaternion x, y, z, w; the identity for length 0."""
    length = np.linalg.norm(q)
    if not length > 0:
        return np.eye(3)
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
