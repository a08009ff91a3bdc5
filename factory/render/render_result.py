"""The passes of a render as float32 arrays, copied in memory without a file or a view transform.

A background process can read Blender's Render Result through a file only (5 ms for 256², and an EXR
to parse) or through the compositor's viewer (which Blender 5 no longer has). A render engine,
however, can read its own result: Cycles' `render` method is wrapped so that the passes are copied
when Cycles is done (0.15 ms). The copy has the bits that Blender would have written to a float EXR
(tests/render/test_film.py).
"""

import contextlib
from collections.abc import Iterator

import bpy
import numpy as np

from manifests.quiet import silenced

_passes: dict[str, np.ndarray] = {}  # of the last render: name → (height, width, channels)
_copying = True


def _copy_passes(engine: bpy.types.RenderEngine) -> None:
    """Copy the passes of the engine's result, with row 0 at the top."""
    result = engine.get_result()
    _passes.clear()
    for layer in result.layers:
        for each in layer.passes:
            flat = np.empty(result.resolution_x * result.resolution_y * each.channels, np.float32)
            each.rect.foreach_get(flat)
            _passes[each.name] = flat.reshape(
                result.resolution_y, result.resolution_x, each.channels
            )[::-1]


def hook_cycles() -> None:
    """Wrap Cycles' render method, once per process, so that each render's passes are copied."""
    (cycles,) = (
        c
        for c in bpy.types.RenderEngine.__subclasses__()
        if getattr(c, "bl_idname", "") == "CYCLES"
    )
    if hasattr(cycles, "render_without_hook"):
        return
    cycles.render_without_hook = cycles.render

    def render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
        engine.render_without_hook(depsgraph)
        if _copying:
            _copy_passes(engine)

    cycles.render = render


@contextlib.contextmanager
def without_copies() -> Iterator[None]:
    """Copy nothing inside the block, to time Blender alone."""
    global _copying
    _copying = False
    try:
        yield
    finally:
        _copying = True


def render_passes(scene: bpy.types.Scene) -> dict[str, np.ndarray]:
    """Render a scene; return {pass: (height, width, channels) float32}, row 0 at the top.

    Raises  RuntimeError if Cycles has not finished
    """
    # Persistent data misses new samples, seeds and bounces: Cycles' own properties tag nothing.
    # TIME is the tag that costs least: without `refresh` every mesh would be sent to Cycles again.
    scene.update_tag(refresh={"TIME"})
    _passes.clear()
    with silenced(1):
        outcome = bpy.ops.render.render(scene=scene.name)
    if outcome != {"FINISHED"} or "Combined" not in _passes:
        raise RuntimeError(
            f"Cycles: expected a finished picture, found {outcome} with {sorted(_passes)} (render"
            " the shot in a new process)"
        )
    return dict(_passes)
