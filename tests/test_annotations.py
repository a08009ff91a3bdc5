"""Public functions of every package say what they take and what they return."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGES = ("brdfactory", "factory", "learn", "manifests", "shaders")
ROOT = Path(__file__).resolve().parents[1]
FOLDERS = sorted({path.parent for package in PACKAGES for path in (ROOT / package).rglob("*.py")})


def public_functions(node: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Functions and methods whose names, and whose classes' names, have no underscore in front;
    __init__ too.
    """
    for each in ast.iter_child_nodes(node):
        if isinstance(each, ast.ClassDef) and not each.name.startswith("_"):
            yield from public_functions(each)
        elif isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef):
            if each.name == "__init__" or not each.name.startswith("_"):
                yield each
        elif isinstance(each, ast.If | ast.Try | ast.With):
            yield from public_functions(each)


def unannotated(source: str) -> list[str]:
    """What lacks an annotation, as "line: function: argument"."""
    missing = []
    for function in public_functions(ast.parse(source)):
        given = function.args
        every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
        names = [a.arg for a in every if a and a.annotation is None]
        names = [name for name in names if name not in ("self", "cls")]
        if function.returns is None and function.name != "__init__":
            names.append("its result")
        missing += [f"{function.lineno}: {function.name}: {name}" for name in names]
    return missing


def test_what_is_not_annotated_is_found():
    assert unannotated("class A:\n def f(self, x, *y: int): pass") == [
        "2: f: x",
        "2: f: its result",
    ]
    assert unannotated("if True:\n def f() -> None: pass\n async def g(): pass") == [
        "3: g: its result"
    ]
    assert unannotated("class _A:\n def f(self, x): pass\ndef _g(x): pass") == []


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_public_functions_are_annotated(folder):
    assert [
        f"{path.relative_to(ROOT)}:{text}"
        for path in sorted(folder.glob("*.py"))
        for text in unannotated(path.read_text(encoding="utf-8"))
    ] == []
