"""An extension for Blender: it lists the material library, and makes data sets of the selection.

It runs inside Blender, whose Python has none of this program's packages, so it imports none of
them. Data sets are rendered by another Python, which the preferences name.
"""

import json
import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty

LIBRARY = "brdfactory materials"  # the asset library's name in Blender's preferences
EXPORTED = {"MESH", "CURVE", "SURFACE", "META", "FONT"}  # types of objects that have surfaces
INTERVAL = 0.5  # seconds between looks at the factory's progress
LOG = "brdfactory.log"


def list_library(folder: str) -> None:
    """Add a folder to Blender's asset libraries, or change the folder of the one that is there."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    for library in libraries:
        if library.name == LIBRARY:
            library.path = folder
            return
    libraries.new(name=LIBRARY, directory=folder)


def _library_changed(preferences: Any, _: Any) -> None:
    if preferences.library:
        list_library(bpy.path.abspath(preferences.library))


class Preferences(bpy.types.AddonPreferences):
    """The Python that has brdfactory, and the folder of the material library."""

    bl_idname = __package__
    __annotations__ = {
        "python": StringProperty(
            name="Python",
            description="The Python in which brdfactory is installed, with its extra factory",
            subtype="FILE_PATH",
            default="python3.11",
        ),
        "library": StringProperty(
            name="Material library",
            description="The folder of library.blend, from: brdfactory materials export --blend",
            subtype="DIR_PATH",
            update=_library_changed,
        ),
        "workers": IntProperty(
            name="Processes", description="Pictures that render at once", default=1, min=1, max=64
        ),
    }

    def draw(self, _: Any) -> None:
        """Show the fields."""
        for name in ("python", "library", "workers"):
            self.layout.prop(self, name)


class MakeDataSet(bpy.types.Operator):
    """Export the selected objects, and render them in measured materials into a data set"""

    bl_idname = "brdfactory.make_data_set"
    bl_label = "Make a Data Set of the Selection"
    __annotations__ = {
        "folder": StringProperty(
            name="Folder", subtype="DIR_PATH", description="Where meshes, job and data set go"
        ),
        "materials": StringProperty(
            name="Materials",
            default="brass, red-fabric",
            description="Names, or sets such as merl/test, with commas between them",
        ),
        "lights": StringProperty(
            name="Lights", default="city", description="Names or files, with commas between them"
        ),
        "views": StringProperty(
            name="Views",
            default="0, 6, 12, 18",
            description="Numbers from 0 to 23, 15 degrees from one to the next",
        ),
        "size": IntProperty(name="Picture size", default=128, min=8, max=4096, subtype="PIXEL"),
        "samples": IntProperty(name="Samples per pixel", default=64, min=1, max=65536),
        "tier": EnumProperty(
            name="Light transport",
            items=[
                ("full", "Full", "Shadows and interreflection"),
                ("shadow", "Shadow", "Shadows without interreflection"),
                ("direct", "Direct", "Neither shadows nor interreflection"),
            ],
        ),
    }

    _process: "subprocess.Popen[bytes] | None" = None
    _timer: Any = None

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Return whether a selected object has a surface."""
        return context.mode == "OBJECT" and bool(_exported(context))

    def invoke(self, context: Any, _: Any) -> set[str]:
        """Ask for the settings."""
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: Any) -> set[str]:
        """Export, write the job, and start the factory."""
        if not self.folder:
            self.report({"ERROR"}, "Choose a folder for the data set")
            return {"CANCELLED"}
        try:
            job = self._job(context)
        except ValueError:
            self.report({"ERROR"}, f"Views: numbers with commas expected, found {self.views!r}")
            return {"CANCELLED"}
        folder = Path(bpy.path.abspath(self.folder))
        self._log = folder / LOG
        try:
            (folder / "meshes").mkdir(parents=True, exist_ok=True)
            for each, name in zip(_exported(context), job["shapes"], strict=True):
                _export(context, each, folder / name)
            (folder / "job.json").write_text(json.dumps(job, indent=1) + "\n", encoding="utf-8")
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    self._command(context, folder), stdout=log, stderr=subprocess.STDOUT
                )
        except (OSError, RuntimeError) as error:
            self.report({"ERROR"}, f"brdfactory did not start: {error}")
            return {"CANCELLED"}
        if bpy.app.background:
            self._process.wait()
            return self._finish(context)
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(INTERVAL, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Show the progress; Escape stops the factory, and the same operator continues it."""
        assert self._process is not None
        if event.type == "ESC":
            self._process.terminate()
            self._process.wait()
            self._release(context)
            self.report({"WARNING"}, "Stopped; run it again to continue")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        line = _last_line(self._log)
        context.workspace.status_text_set(f"brdfactory: {line}  (Escape stops it)")
        if share := re.search(r"(\d+)%", line):
            context.window_manager.progress_update(int(share[1]))
        if self._process.poll() is None:
            return {"RUNNING_MODAL"}
        self._release(context)
        return self._finish(context)

    def _release(self, context: Any) -> None:
        """Remove the timer and the progress."""
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    def _finish(self, _: Any) -> set[str]:
        """Report what the factory said last."""
        assert self._process is not None
        line = _last_line(self._log)
        if self._process.returncode:
            self.report({"ERROR"}, f"brdfactory failed: {line} (all of it: {self._log})")
            return {"CANCELLED"}
        self.report({"INFO"}, f"{line} (folder: {self._log.parent})")
        return {"FINISHED"}

    def _job(self, context: Any) -> dict[str, Any]:
        """Return the job. Raises ValueError for views that are no numbers."""
        names = file_names([each.name for each in _exported(context)])
        return {
            "name": "selection",
            "shapes": [f"meshes/{name}.obj" for name in names],
            "materials": _listed(self.materials),
            "lights": _listed(self.lights),
            "views": [int(view) for view in _listed(self.views)],
            "tiers": [self.tier],
            "samples": self.samples,
            "camera": {"size": [self.size, self.size]},
        }

    def _command(self, context: Any, folder: Path) -> list[str]:
        """Return the words that start the factory."""
        preferences = context.preferences.addons[__package__].preferences
        python = preferences.python
        if os.sep in python:  # otherwise a name to look for
            python = bpy.path.abspath(python)
        job, data = str(folder / "job.json"), str(folder / "data")
        return [
            *(python, "-P", "-m", "brdfactory", "render", job, "--out", data),
            *("--workers", str(preferences.workers)),
        ]


def file_names(names: Sequence[str]) -> list[str]:
    """Return a file name without ending for each object's name, all different."""
    results: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() or "object"
        number, result = 1, plain
        while result in results:
            number += 1
            result = f"{plain}-{number}"
        results.append(result)
    return results


def _exported(context: Any) -> list[Any]:
    """Return the selected objects that have surfaces, in the order of their names."""
    objects = (each for each in context.selected_objects if each.type in EXPORTED)
    return sorted(objects, key=lambda each: each.name)


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _export(context: Any, each: Any, path: Path) -> None:
    """Write one object with its modifiers as OBJ, y up, and leave the selection as it was."""
    selected = list(context.selected_objects)
    for other in selected:
        other.select_set(other is each)
    try:
        bpy.ops.wm.obj_export(
            filepath=str(path),
            export_selected_objects=True,
            apply_modifiers=True,
            export_triangulated_mesh=True,
            export_materials=False,
            export_uv=False,
            export_normals=False,
            forward_axis="NEGATIVE_Z",
            up_axis="Y",
        )
    finally:
        for other in selected:
            other.select_set(True)


def _last_line(log: Path) -> str:
    """Return the last line of a log; a progress bar ends its lines by carriage returns."""
    try:
        text = log.read_bytes()[-4096:].decode("utf-8", "replace")
    except OSError:
        return ""
    lines = [line.strip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    return lines[-1] if lines else ""


class Panel(bpy.types.Panel):
    """The operator's place: the sidebar of the 3D view."""

    bl_idname = "BRDFACTORY_PT_panel"
    bl_label = "brdfactory"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "brdfactory"

    def draw(self, _: Any) -> None:
        """Show the button."""
        self.layout.operator(MakeDataSet.bl_idname, icon="RENDER_STILL")


def _show_in_menu(menu: Any, _: Any) -> None:
    menu.layout.separator()
    menu.layout.operator(MakeDataSet.bl_idname)


CLASSES = (Preferences, MakeDataSet, Panel)


def register() -> None:
    """Add the classes and the menu entry to Blender."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.VIEW3D_MT_object.append(_show_in_menu)


def unregister() -> None:
    """Remove them."""
    bpy.types.VIEW3D_MT_object.remove(_show_in_menu)
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
