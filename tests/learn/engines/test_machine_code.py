"""First use: what is compiled, kept, loaded and said; and life without a compiler or a folder to
keep things in.
"""

import hashlib
import shutil
import subprocess
import sys

import pytest

from learn.engines import machine_code

RENDER = """
import sys, torch
from learn.layer import render
assert "numba" not in sys.modules, "imported before use"
torch.set_num_threads(1)
n = torch.zeros(1, 2, 2, 3); n[..., 2] = 1.0
seen = render(n, torch.full((1, 108), 0.3), torch.ones(1, 8, 16, 3), method="exact")
print("numba" in sys.modules, seen.mean().item())
"""


def run(cache, program=RENDER, **environment):
    import os

    environment = os.environ | {"BRDFACTORY_CACHE": str(cache)} | environment
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """(folder with the kernel of a first use, the process that compiled it); copy the folder before
    you change it.
    """
    folder = tmp_path_factory.mktemp("compiled")
    return folder, run(folder)


@pytest.fixture
def kernels(compiled, tmp_path):
    """A copy of that folder."""
    return shutil.copytree(compiled[0], tmp_path / "copy")


def test_first_use_compiles_and_says_so_and_the_second_loads_without_numba(compiled):
    folder, first = compiled
    second = run(folder)
    assert "compiling the kernel distant.forward" in first.stderr and str(folder) in first.stderr
    assert second.stderr == ""
    assert first.stdout.split() == ["True", second.stdout.split()[1]]
    assert second.stdout.split()[0] == "False"


def test_methods_are_imported_without_numba():
    """The kernels' sizes come from learn.engines.layout, so that cached kernels need no numba."""
    code = (
        "import sys; from learn.methods import NAMES, load; [load(name) for name in NAMES];"
        " print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"]


def test_a_damaged_file_is_compiled_again(kernels):
    (kept,) = (kernels / "kernels").glob("distant.forward-*")
    content = kept.read_bytes()
    kept.write_bytes(content[:-100])
    again = run(kernels)
    assert "compiling" in again.stderr
    assert (
        hashlib.sha256(kept.read_bytes()[machine_code.DIGEST :]).digest()
        == kept.read_bytes()[: machine_code.DIGEST]
    )


@pytest.mark.parametrize("count", [0, 40])
def test_a_kernel_that_the_disk_has_no_room_for_is_used_and_not_kept(
    tmp_path, small_files, monkeypatch, capsys, count
):
    monkeypatch.setenv("BRDFACTORY_CACHE", str(tmp_path))
    monkeypatch.setattr(machine_code, "_compile", lambda name: bytes(range(64)))
    with small_files(count):
        assert machine_code._machine_code("distant.forward") == bytes(range(64))
    assert "cannot keep it" in capsys.readouterr().err
    assert list((tmp_path / "kernels").iterdir()) == []
    assert machine_code._machine_code("distant.forward") == bytes(range(64))
    (kept,) = (tmp_path / "kernels").iterdir()
    assert len(kept.read_bytes()) == machine_code.DIGEST + 64


def test_a_folder_that_cannot_be_written_costs_time_and_nothing_else(tmp_path):
    (tmp_path / "kernels").write_text("a file where the folder should be")
    done = run(tmp_path)
    assert "cannot keep it" in done.stderr and "BRDFACTORY_CACHE" in done.stderr
    assert float(done.stdout.split()[1]) > 0


def test_without_numba_and_without_kept_code_the_layer_still_renders(tmp_path, compiled):
    hide = "import sys; sys.modules['numba'] = None; sys.modules['llvmlite'] = None\n"
    hide += (
        "import importlib.util as u; find = u.find_spec; u.find_spec = lambda name, *a: None if"
        " name == 'numba' else find(name, *a)\n"
    )
    done = run(
        tmp_path,
        hide
        + RENDER.replace('assert "numba" not in sys.modules, "imported before use"', "").replace(
            '"numba" in sys.modules', "0"
        ),
    )
    assert float(done.stdout.split()[1]) == pytest.approx(
        float(compiled[1].stdout.split()[1]), rel=1e-5
    )
    assert "numba is not installed" in done.stderr


def test_the_key_covers_every_module_that_a_kernel_is_made_of():
    assert machine_code.sources("general") == [
        "compilation",
        "distant",
        "exponentials",
        "general",
        "halfway",
        "layout",
        "machine_code",
        "splines",
        "triples",
        "vector",
    ]


def test_the_key_changes_with_any_source(tmp_path, monkeypatch):
    folder = tmp_path / "engines"
    folder.mkdir()
    for name in machine_code.sources("general"):
        (folder / f"{name}.py").write_text(
            (machine_code.Path(machine_code.__file__).parent / f"{name}.py").read_text()
        )
    monkeypatch.setattr(machine_code, "__file__", str(folder / "machine_code.py"))
    keys = {machine_code._key.__wrapped__("general")}
    for name in machine_code.sources("general"):
        with open(folder / f"{name}.py", "a") as file:
            file.write("\n# a change\n")
        keys.add(machine_code._key.__wrapped__("general"))
    assert len(keys) == 1 + len(machine_code.sources("general"))
