"""Pixels as Cycles leaves them on its film: float32, read in memory, through no file and no view
transform.

Blender offers a background process no way to the Render Result but a file (5 ms for 256², and an
EXR to parse) or the compositor's viewer (gone in Blender 5). A render engine, however, may ask for
its own result: Cycles' `render` method is wrapped so that, when Cycles is done, the passes are
copied (0.15 ms). The copy equals what Blender would have written to a float EXR, bit for bit
(tests/render/test_film.py).
"""

import contextlib

import bpy
import numpy as np

from manifests.quiet import silenced

_passes = {}
_tapping = True


def _copy_passes(engine):
    """The result's passes: name → (height, width, channels) float32, row 0 at the top."""
    result = engine.get_result()
    _passes.clear()
    for layer in result.layers:
        for each in layer.passes:
            flat = np.empty(result.resolution_x * result.resolution_y * each.channels, np.float32)
            each.rect.foreach_get(flat)
            _passes[each.name] = flat.reshape(
                result.resolution_y, result.resolution_x, each.channels
            )[::-1]


def hook_cycles():
    """Wraps Cycles' render method, once a process, so that each render's passes are kept."""
    (cycles,) = (
        c
        for c in bpy.types.RenderEngine.__subclasses__()
        if getattr(c, "bl_idname", "") == "CYCLES"
    )
    if hasattr(cycles, "render_untapped"):
        return
    cycles.render_untapped = cycles.render

    def render(engine, depsgraph):
        engine.render_untapped(depsgraph)
        if _tapping:
            _copy_passes(engine)

    cycles.render = render


@contextlib.contextmanager
def untapped():
    """Inside the block nothing is copied: for timing Blender as it comes."""
    global _tapping
    _tapping = False
    try:
        yield
    finally:
        _tapping = True


def render_passes(scene):
    """Renders a scene; returns its passes, name → (height, width, channels) float32, row 0 at the
    top.

    Raises  RuntimeError if Cycles left nothing
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
