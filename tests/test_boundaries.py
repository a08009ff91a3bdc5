"""Which package may import what: factory → {manifests, shaders} ← learn, enforced by imports in
fresh interpreters and by ruff.
"""

import ast
import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# package → what a machine that runs it need not have
ABSENT = {
    "factory": ("torch", "learn", "brdfactory"),
    "learn": ("bpy", "factory", "brdfactory"),
    "shaders": ("torch", "bpy", "factory", "learn", "manifests", "brdfactory"),
    "manifests": ("torch", "bpy", "factory", "learn", "brdfactory"),
}

# Imports every module below a package with some names made absent; prints the first failure.
IMPORT_ALL = """
import importlib, pkgutil, sys
package, absent = sys.argv[1], set(sys.argv[2].split(","))
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"{name} is absent", name=name)
sys.meta_path.insert(0, Absent())
root = importlib.import_module(package)
for module in pkgutil.walk_packages(root.__path__, package + "."):
    if not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            # of the extras `cuda`, `app` and `sftp`
            if error.name not in {"triton", "gradio", "paramiko"}:
                raise
"""


def import_all(package, absent):
    """The error text of importing everything in a package without the absent ones; '' if all went
    well.
    """
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL, package, ",".join(absent)],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    return "" if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


@pytest.mark.parametrize("package", ABSENT)
def test_each_package_imports_without_what_it_must_not_need(package):
    if package == "learn" and importlib.util.find_spec("torch") is None:
        pytest.skip("learn needs torch, which is not installed")
    assert import_all(package, ABSENT[package]) == ""


def test_the_probe_sees_a_forbidden_import():
    assert "numpy is absent" in import_all("shaders", ("numpy",))


def test_importing_a_package_starts_neither_blender_nor_torch():
    code = (
        "import sys, brdfactory, factory, manifests, shaders, learn; sys.exit(bool({'bpy', 'torch'}"
        " & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_the_factory_imported_is_ours_and_not_factory_boys(root):
    """factory_boy on PyPI installs a package called `factory` too."""
    spec = importlib.util.find_spec("factory")
    assert spec.origin == str(root / "factory" / "__init__.py")
    assert importlib.util.find_spec("factory.declarations") is None


@pytest.mark.parametrize(
    ("program", "light"),
    [
        ("brdfactory", ("numpy", "bpy", "torch")),
        ("factory", ("numpy", "bpy", "trimesh")),
        ("learn", ("numpy", "torch")),
    ],
)
def test_help_loads_no_heavy_library(program, light):
    code = (
        f"import sys, runpy; sys.argv = ['{program}', '--help']\n"
        f"try: runpy.run_module('{program}', run_name='__main__')\n"
        "except SystemExit as end: assert not end.code\n"
        f"assert not set({light}) & set(sys.modules), set({light}) & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "usage: " in done.stdout


def banned(root, package):
    settings = tomllib.loads((root / package / "ruff.toml").read_text())
    return set(settings["lint"]["flake8-tidy-imports"]["banned-api"])


@pytest.mark.parametrize("package", ABSENT)
def test_ruff_refuses_each_forbidden_import_in_its_folder(root, package):
    pytest.importorskip("ruff", reason="ruff is not installed")
    names = banned(root, package)
    assert names >= set(ABSENT[package]) - {"manifests"}
    for name in sorted(names):
        command = [
            sys.executable,
            "-m",
            "ruff",
            "check",
            "--no-cache",
            "--output-format",
            "concise",
            "--select",
            "TID251",
        ]
        offending = f"import {name}\n\nprint({name})\n"
        done = subprocess.run(
            [*command, "--stdin-filename", f"{package}/new_module.py", "-"],
            input=offending,
            capture_output=True,
            text=True,
            cwd=root,
        )
        assert done.returncode == 1 and f"`{name}` is banned" in done.stdout, (
            name,
            done.stdout,
            done.stderr,
        )


def imports(path):
    """(line, top-level name) of every import statement in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name.partition(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.lineno, node.module.partition(".")[0]


@pytest.mark.parametrize("package", ABSENT)
def test_no_module_names_a_forbidden_import_even_inside_a_function(root, package):
    """A lazy import would pass the fresh interpreter above and fail a user later."""
    forbidden = set(ABSENT[package])
    result = [
        f"{path}:{line}: {name}"
        for path in sorted((root / package).rglob("*.py"))
        for line, name in imports(path)
        if name in forbidden
    ]
    assert not result


def test_only_the_rendering_modules_import_blender(root):
    result = {
        path.relative_to(root).parts[:2]
        for path in (root / "factory").rglob("*.py")
        for _, name in imports(path)
        if name == "bpy"
    }
    # the extension runs inside a user's Blender
    assert result <= {("factory", "render"), ("factory", "blender_extension")}


# Calls that write files past manifests.files, and why they may: (module, the call without its
# arguments).
WRITERS = {
    ("manifests/files.py", "os.open"): "the one home of writing whole files",
    ("manifests/files.py", "os.replace"): "the same",
    ("manifests/line_files.py", "os.open"): "lines are appended, whole or not at all",
    ("manifests/store.py", "os.link"): "a whole file takes its place unless another has it",
    ("manifests/store.py", "os.replace"): "the same where there are no links",
    ("manifests/lock.py", "os.open"): "a lock is an empty file",
    (
        "factory/execution/pool.py",
        "open",
    ): "a worker's complaints, read while it lives and then thrown away",
    ("factory/execution/forecast.py", "tempfile.TemporaryDirectory"): "three shots made on trial",
    (
        "factory/execution/uploads.py",
        "tempfile.TemporaryDirectory",
    ): "a data set on its way to an object store",
    (
        "manifests/cached_store.py",
        "tempfile.TemporaryDirectory",
    ): "copies of objects for one verification",
    (
        "factory/render/validation/benchmark.py",
        "tempfile.TemporaryDirectory",
    ): "pictures made to be timed",
    (
        "factory/render/validation/speed_accuracy_settings.py",
        "tempfile.TemporaryDirectory",
    ): "scenes that another renderer reads",
    (
        "factory/render/validation/bare_loop_peer.py",
        "….save",
    ): "run in a process of its own, without this project's packages",
    (
        "factory/render/validation/blenderproc_peer.py",
        "….save",
    ): "run by another Python, without this project's packages",
    (
        "learn/experiments/training/step_profile.py",
        "tempfile.TemporaryDirectory",
    ): "a run made to be timed",
    (
        "learn/evaluation/ladder_pictures.py",
        "tempfile.TemporaryDirectory",
    ): "a picture that is written to be read as a photograph",
    (
        "factory/render/asset_library.py",
        "tempfile.TemporaryDirectory",
    ): "Blender writes to a path; the whole file is then copied",
    (
        "factory/blender_extension/__init__.py",
        "….write_text",
    ): "a job, inside Blender, which has no manifests",
    ("learn/experiments/layer/cold_start.py", "tempfile.TemporaryDirectory"): "an empty cache",
    (
        "learn/experiments/editing/mitsuba_comparison.py",
        "tempfile.TemporaryDirectory",
    ): "what two processes hand each other",
    ("learn/experiments/editing/mitsuba_comparison.py", "….savez"): "the same",
    (
        "learn/experiments/editing/mitsuba_descent.py",
        "….savez",
    ): "the same; the process has no manifests",
    (
        "learn/experiments/layer/mitsuba_rival.py",
        "tempfile.TemporaryDirectory",
    ): "as mitsuba_comparison",
    ("learn/experiments/layer/mitsuba_rival.py", "….savez"): "the same",
    ("learn/experiments/layer/mitsuba_sphere.py", "….savez"): "as mitsuba_descent",
}
INTO_MEMORY = {"buffer", "data", "file", "png"}  # first arguments that are streams
# modules of ours whose save() goes through manifests.files
OURS = {"checkpoint", "weights", "priors", "edit"}
SHUTIL_THAT_WRITES_NO_FILE = {"rmtree", "get_terminal_size"}


def writing(call):
    """What a call is, if it may write a file itself: "os.replace", "open", "….write_text"; None
    otherwise.
    """
    function = call.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    owner = ast.unparse(function.value) if isinstance(function, ast.Attribute) else ""
    known = owner if owner in ("os", "shutil", "tempfile", "tarfile") else "…"
    text = f"{known}.{name}" if owner else name
    first = ast.unparse(call.args[0]) if call.args else ""
    keywords = {each.arg: ast.unparse(each.value) for each in call.keywords}
    mode = ast.unparse(call.args[1]) if len(call.args) > 1 else keywords.get("mode", "")
    if name == "open":
        if owner == "os":
            return text if "O_CREAT" in mode else None
        if owner == "tarfile":
            return None if keywords.get("fileobj") == "file" else text
        return text if mode[:1] in "'\"" and set(mode) & set("wax+") else None
    if name == "replace":
        # of a path; of a text it has two
        return text if owner == "os" or (len(call.args) == 1 and not keywords) else None
    if name in ("write_text", "write_bytes"):
        return text if owner not in ("", "files") else None
    if name in ("save", "savefig", "savez", "savez_compressed", "ParquetWriter"):
        return text if owner not in ("", *OURS) and first not in INTO_MEMORY else None
    if (owner == "shutil" and name not in SHUTIL_THAT_WRITES_NO_FILE) or text == "os.link":
        return text
    if name in ("rename", "save_file", "tofile", "imsave", "mkstemp", "TemporaryDirectory"):
        return text
    return None


def test_every_file_is_written_by_the_one_home_of_writing(root):
    """A library, or a plain open(), may pass over the error of a full disk, and leaves half a file
    where it does not.
    """
    result = {}
    for package in ABSENT:
        for path in sorted((root / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and (text := writing(node)):
                    result.setdefault((path.relative_to(root).as_posix(), text), []).append(
                        node.lineno
                    )
    assert {key: lines for key, lines in result.items() if key not in WRITERS} == {}
    assert WRITERS.keys() - result.keys() == set()  # an exception that is not used is removed


@pytest.mark.parametrize(
    "line",
    [
        "open(path, 'w')",
        "path.open(mode='ab')",
        "path.write_text(text)",
        "draft.replace(path)",
        "figure.savefig(path)",
        "image.save(path, 'PNG')",
        "np.savez(path, a=a)",
        "shutil.copyfile(a, b)",
        "tarfile.open(path, 'w')",
        "os.open(path, os.O_CREAT)",
        "pyarrow.parquet.ParquetWriter(path, schema)",
    ],
)
def test_the_probe_sees_a_file_written_past_it(line):
    assert writing(ast.parse(line).body[0].value)
