"""The extension for Blender: its zip is the same each time, Blender installs it, and its operator
exports the selection, writes a job and starts the factory.
"""

import ast
import json
import os
import subprocess
import sys
import tomllib
import zipfile
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

from factory.__main__ import COMMANDS
from manifests.cli import main
from manifests.store import Store

pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")
pytestmark = pytest.mark.blender

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "factory" / "blender_extension"


def build(path, *arguments):
    command = ["materials", "extension", "--out", str(path), *arguments]
    return main("factory", "test", [c for c in COMMANDS if c == "materials"], command)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("extension") / "brdfactory.zip"
    assert build(path) == 0
    return path


def test_the_zip_is_the_same_whenever_it_is_built(archive, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    assert build(tmp_path / "again.zip") == 0
    assert (tmp_path / "again.zip").read_bytes() == archive.read_bytes()
    assert build(archive) == 1 and "--overwrite" in capsys.readouterr().err
    assert build(archive, "--overwrite") == 0
    names = {path.name for path in SOURCES.iterdir() if path.is_file()}
    members = zipfile.ZipFile(archive).infolist()
    assert {member.filename for member in members} == names
    assert {member.date_time for member in members} == {(1980, 1, 1, 0, 0, 0)}


def test_blenders_own_check_accepts_the_zip_and_refuses_a_damaged_one(archive, tmp_path):
    """`blender --command extension validate` runs this file of Blender's."""
    folder = Path(find_spec("bpy").origin).parent
    (check,) = folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")

    def validate(path):
        command = [sys.executable, str(check), "validate", str(path)]
        return subprocess.run(command, capture_output=True, text=True)

    done = validate(archive)
    assert done.returncode == 0 and "Success" in done.stdout, done.stdout + done.stderr
    damaged = tmp_path / "damaged.zip"
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(damaged, "w") as target:
        for name in source.namelist():
            text = source.read(name).replace(b'blender_version_min = "4.2.0"', b"")
            target.writestr(name, text)
    assert validate(damaged).returncode != 0


def test_the_manifest_agrees_with_the_repository():
    manifest = tomllib.loads((SOURCES / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"]
    assert manifest["license"] == [f"SPDX:{project['license']}"]
    assert manifest["blender_version_min"] == "4.2.0"


def test_the_extension_needs_nothing_but_blender():
    tree = ast.parse((SOURCES / "__init__.py").read_text())
    names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    tops = {name.split(".")[0] for name in names}
    assert tops <= {"bpy", *sys.stdlib_module_names}


# Installs the zip as a user does, selects a cone and a text, and runs the operator.
USE = """
import contextlib, io, json, sys
import bpy
import addon_utils
archive, library, settings, preferences = sys.argv[1], sys.argv[2], *map(json.loads, sys.argv[3:5])
addon_utils.enable("bl_pkg")
bpy.ops.extensions.package_install_files(
    filepath=archive, repo="user_default", enable_on_install=True)
own = bpy.context.preferences.addons["bl_ext.user_default.brdfactory"].preferences
for name, value in preferences.items():
    setattr(own, name, value)
for folder in (library + "-before", library):
    own.library = folder
libraries = [(l.name, l.path) for l in bpy.context.preferences.filepaths.asset_libraries]
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
bpy.ops.mesh.primitive_cube_add(size=9)
bpy.ops.mesh.primitive_cone_add(vertices=8)
cone = bpy.context.object
cone.name = "Cone: über"
cone.modifiers.new("subdivision", "SUBSURF").levels = 1
bpy.ops.object.light_add()
light = bpy.context.object
bpy.context.view_layer.objects["Cube"].select_set(False)
cone.select_set(True)
text = ""
output = io.StringIO()
try:
    with contextlib.redirect_stdout(output):
        outcome = sorted(bpy.ops.brdfactory.make_data_set(**settings))
except RuntimeError as error:
    outcome, text = ["ERROR"], str(error)
selected = sorted(each.name for each in bpy.context.selected_objects)
import bl_ext.user_default.brdfactory as extension
names = extension.file_names(["Cone", "cone", "!!", "Über 1"])
addon_utils.disable("bl_ext.user_default.brdfactory")
gone = not hasattr(bpy.types, "BRDFACTORY_PT_panel")
print()
print(json.dumps({"outcome": outcome, "text": text + output.getvalue(), "libraries": libraries,
                  "selected": selected, "names": names, "gone": gone}))
"""


def use(archive, folder, python, **settings):
    """What the operator reports, in a Blender whose preferences name that Python."""
    arguments = [archive, folder / "assets", json.dumps(settings | {"folder": str(folder / "set")})]
    arguments.append(json.dumps({"python": str(python), "workers": 1}))
    environment = os.environ | {
        "BLENDER_USER_RESOURCES": str(folder / "user"),
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        [sys.executable, "-P", "-c", USE, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def stub(folder, text):
    """An interpreter that writes its arguments down and prints."""
    path = folder / "python-stub"
    path.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > "{folder}/arguments"\n{text}\n')
    path.chmod(0o755)
    return path


def test_the_operator_exports_the_selection_and_starts_the_python_of_the_preferences(
    archive, tmp_path
):
    python = stub(tmp_path, 'printf " 50%% of it\\r100%%\\n8 pictures made\\n"')
    result = use(archive, tmp_path, python, views="0, 3", size=64, tier="direct", lights="night")
    assert result["outcome"] == ["FINISHED"] and result["gone"]
    assert "8 pictures made" in result["text"] and str(tmp_path / "set") in result["text"]
    folder = tmp_path / "set"
    assert json.loads((folder / "job.json").read_text()) == {
        "name": "selection",
        "shapes": ["meshes/cone-ber.obj"],
        "materials": ["brass", "red-fabric"],
        "lights": ["night"],
        "views": [0, 3],
        "tiers": ["direct"],
        "samples": 64,
        "camera": {"size": [64, 64]},
    }
    assert (tmp_path / "arguments").read_text().split("\n")[:-1] == [
        *("-P", "-m", "brdfactory", "render", str(folder / "job.json")),
        *("--out", str(folder / "data"), "--workers", "1"),
    ]
    assert [path.name for path in (folder / "meshes").iterdir()] == ["cone-ber.obj"]
    lines = (folder / "meshes" / "cone-ber.obj").read_text().splitlines()
    points = [[float(x) for x in line.split()[1:4]] for line in lines if line.startswith("v ")]
    assert len(points) > 9  # the modifier is applied
    upper = [max(abs(x), abs(z)) for x, y, z in points if y > 0]
    lower = [max(abs(x), abs(z)) for x, y, z in points if y < 0]
    assert max(upper) < 0.8 * max(lower)  # y is up: the cone is narrow there
    assert result["selected"] == ["Cone: über", "Point"]
    assert result["names"] == ["cone", "cone-2", "object", "ber-1"]
    # the second folder has replaced the first
    own = [path for name, path in result["libraries"] if name == "brdfactory materials"]
    assert [Path(path) for path in own] == [tmp_path / "assets"]


@pytest.mark.parametrize(
    ("script", "settings", "said"),
    [
        ("echo no such material; exit 1", {}, "no such material"),
        (None, {}, "did not start"),
        ("true", {"views": "front"}, "numbers with commas"),
    ],
)
def test_what_goes_wrong_is_reported(archive, tmp_path, script, settings, said):
    python = tmp_path / "no-python" if script is None else stub(tmp_path, script)
    result = use(archive, tmp_path, python, **settings)
    assert result["outcome"] == ["ERROR"] and said in result["text"]


class Context:
    """What `modal` uses of Blender's context, which has no window here."""

    def __init__(self):
        self.shown, self.progress, self.removed = [], [], []
        self.workspace = SimpleNamespace(status_text_set=self.shown.append)
        self.window_manager = SimpleNamespace(
            progress_update=self.progress.append,
            progress_end=lambda: self.removed.append("progress"),
            event_timer_remove=self.removed.append,
        )


def running(tmp_path, returncode):
    """An operator whose factory has written half a progress bar."""
    from factory.blender_extension import MakeDataSet

    log = tmp_path / "set" / "brdfactory.log"
    log.parent.mkdir()
    log.write_bytes("rendering:  10%|#\rrendering:  50%|█████".encode())
    ended = []
    process = SimpleNamespace(
        returncode=returncode,
        poll=lambda: returncode,
        terminate=lambda: ended.append("terminated"),
        wait=lambda: None,
    )
    operator = SimpleNamespace(_process=process, _log=log, _timer="timer", reports=[], ended=ended)
    operator.report = lambda kind, text: operator.reports.append((*kind, text))
    for name in ("_release", "_finish"):
        setattr(operator, name, partial(getattr(MakeDataSet, name), operator))
    return operator, partial(MakeDataSet.modal, operator)


def test_while_the_factory_runs_its_progress_shows(tmp_path):
    context = Context()
    operator, modal = running(tmp_path, None)
    assert modal(context, SimpleNamespace(type="MOUSEMOVE")) == {"PASS_THROUGH"}
    assert modal(context, SimpleNamespace(type="TIMER")) == {"RUNNING_MODAL"}
    assert context.progress == [50] and "50%" in context.shown[-1] and not context.removed
    assert modal(context, SimpleNamespace(type="ESC")) == {"CANCELLED"}
    assert operator.ended == ["terminated"] and operator.reports[-1][0] == "WARNING"
    assert context.removed == ["timer", "progress"] and context.shown[-1] is None


@pytest.mark.parametrize(
    ("returncode", "outcome", "kind"), [(0, "FINISHED", "INFO"), (1, "CANCELLED", "ERROR")]
)
def test_when_the_factory_ends_its_last_words_are_reported(tmp_path, returncode, outcome, kind):
    context = Context()
    operator, modal = running(tmp_path, returncode)
    assert modal(context, SimpleNamespace(type="TIMER")) == {outcome}
    assert operator.reports[-1][0] == kind and "50%" in operator.reports[-1][1]
    assert context.removed == ["timer", "progress"]


def test_the_operator_makes_a_data_set(archive, tmp_path):
    result = use(
        archive,
        tmp_path,
        sys.executable,
        views="0",
        size=16,
        samples=1,
        tier="direct",
        materials="brass",
    )
    assert result["outcome"] == ["FINISHED"], result["text"]
    (record,) = Store(tmp_path / "set" / "data").records()
    assert set(record.materials) == {"brass"}
