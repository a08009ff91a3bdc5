"""A test that skips for an unexpected reason fails the run; one on the list does not."""

import shutil
import subprocess
import sys

import pytest

from tests.skips import EXPECTED, unexpected

SKIPS = {
    "in a test": "import pytest\ndef test_a():\n    pytest.skip({reason!r})\n",
    "by a mark": "import pytest\n@pytest.mark.skip(reason={reason!r})\ndef test_a():\n    pass\n",
    "at the top of a module": "import pytest\npytest.skip({reason!r}, allow_module_level=True)\n",
    "in a fixture": (
        "import pytest\n@pytest.fixture\ndef f():\n    pytest.skip({reason!r})\ndef test_a(f):\n   "
        " pass\n"
    ),
}


def ended(root, folder, text):
    """The finished pytest process of one module beside a passing test, with this repository's
    conftest.py.
    """
    tests = folder / "tests"
    tests.mkdir()
    for name in ("__init__.py", "conftest.py", "skips.py"):
        shutil.copy(root / "tests" / name, tests)
    (tests / "test_one.py").write_text(text)
    (tests / "test_two.py").write_text("def test_b():\n    pass\n")
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-p",
        "no:hypothesispytest",
        ".",
    ]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("where", SKIPS)
def test_an_unexpected_skip_fails_the_run_and_is_named(root, tmp_path, where):
    done = ended(root, tmp_path, SKIPS[where].format(reason="bpy is not installed"))
    assert done.returncode == 1, done.stdout
    assert (
        "test_one.py" in done.stdout
        and "skips.py does not expect it" in done.stdout
        and "bpy is not installed" in done.stdout
    )


def test_an_expected_skip_leaves_the_run_green(root, tmp_path):
    done = ended(
        root,
        tmp_path,
        SKIPS["in a test"].format(reason="mitsuba is not installed: pip install .[witness]"),
    )
    assert done.returncode == 0, done.stdout


def test_what_tests_need_is_not_on_the_list():
    for module in ("bpy", "torch", "numba", "ruff", "jsonschema", "scipy"):
        assert unexpected([("a test", f"could not import '{module}': No module named '{module}'")])
    assert unexpected([("a test", "numba is not installed: no kernels to test")])
    assert all(why for why in EXPECTED.values())
