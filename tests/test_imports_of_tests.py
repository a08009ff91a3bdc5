"""No test module imports another one: what tests share stands in tests/support."""

import ast
import re

import pytest


def imported(text, module):
    """Dotted names that the module with this text imports, relative ones resolved."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module.split(".")[: -node.level] if node.level else []
            base = ".".join([*package, *filter(None, [node.module])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def of_tests(names):
    """Those that are, or come from, a test module or a conftest.py."""
    return [name for name in names if re.search(r"(^|\.)(test_\w+|conftest)(\.|$)", name)]


def test_no_module_of_the_tests_imports_a_test_module(root):
    offenders = {}
    for path in (root / "tests").rglob("*.py"):
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        if names := of_tests(imported(path.read_text(), module)):
            offenders[module] = names
    assert not offenders, "move what is shared to tests/support"


def test_every_folder_of_tests_is_a_package(root):
    """Otherwise two modules of one name would be one."""
    folders = {path.parent for path in (root / "tests").rglob("*.py")}
    assert [str(f) for f in folders if not (f / "__init__.py").is_file()] == []


@pytest.mark.parametrize(
    "line",
    [
        "import test_two",
        "import tests.learn.test_two",
        "from tests.learn import test_two",
        "from tests.learn.test_two import SIZE",
        "from .test_two import SIZE",
        "from . import test_two",
        "def f():\n    from ..learn.test_two import SIZE",
        "from tests.learn.engines.conftest import unit",
    ],
)
def test_each_way_to_import_a_test_is_seen(line):
    assert of_tests(imported(line, "tests.learn.test_one"))


def test_what_is_shared_may_be_imported():
    line = "from tests.support import synthetic\nimport pytest\nfrom tests.fuzz.latest import a"
    assert of_tests(imported(line, "tests.learn.test_one")) == []
