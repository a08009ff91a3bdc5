"""Materials of a shape's segments: one Blender material each, which shows a mixture or an id."""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import bpy

from factory.render import materials
from shaders import nodes
from shaders.mixture import Mixture

MOST_GROUPS = 512  # node groups in memory: more than there are materials in a catalogue


class SegmentMaterials:
    """Materials of the segments 1, 2, …, which are kept from shape to shape."""

    def __init__(self) -> None:
        self._surfaces: list[Any] = []
        self._ids: list[Any] = []  # for each of them the group that emits its number
        self._mixtures: list[Any] = []  # of the segments, the groups that `set` chose
        # by mixture, least recently used first
        self._groups: OrderedDict[tuple, Any] = OrderedDict()

    def of_new_shape(self, segments: int) -> list[Any]:
        """Return the materials of a shape with so many segments, whose mixtures are to be set."""
        self._mixtures = []
        for number in range(len(self._surfaces) + 1, segments + 1):
            self._surfaces.append(materials.new(f"surface {number}"))
            self._ids.append(materials.id_emission(number))
        return self._surfaces[:segments]

    def set(self, mixtures: Sequence[Mixture]) -> None:
        """Choose a mixture for each segment, in the order of their ids."""
        self._mixtures = [self._group(mixture) for mixture in mixtures]

    def show(self, ids: bool) -> None:
        """Show ids, or the mixtures that are set."""
        groups = self._ids if ids else self._mixtures
        for surface, group in zip(self._surfaces, groups, strict=False):
            materials.show(surface, group)

    def _group(self, mixture: Mixture) -> Any:
        """Return the node group of a mixture, built on first use.

        If there are too many groups, the least recently used one is removed.
        """
        key = mixture.key
        if key not in self._groups:
            self._groups[key] = materials.build(nodes.graph(mixture))
        self._groups.move_to_end(key)
        if len(self._groups) > MOST_GROUPS:
            bpy.data.node_groups.remove(self._groups.popitem(last=False)[1])
        return self._groups[key]
