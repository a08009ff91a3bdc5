"""The public functions of the contract say what they take and what they return."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import manifests

FOLDER = Path(manifests.__file__).parent
MODULES = sorted(FOLDER.rglob("*.py"))


def public_functions(node: ast.AST) -> Iterator[ast.FunctionDef]:
    """Functions and methods whose names, and whose classes' names, have no underscore in front;
    __init__ too.
    """
    for each in ast.iter_child_nodes(node):
        if isinstance(each, ast.ClassDef) and not each.name.startswith("_"):
            yield from public_functions(each)
        elif isinstance(each, ast.FunctionDef) and (
            each.name == "__init__" or not each.name.startswith("_")
        ):
            yield each


def unannotated(source: str) -> list[str]:
    found = []
    for function in public_functions(ast.parse(source)):
        given = function.args
        every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
        found += [
            f"{function.name}: {a.arg}"
            for a in every
            if a and a.annotation is None and a.arg not in ("self", "cls")
        ]
        if function.returns is None and function.name != "__init__":
            found.append(f"{function.name}: its result")
    return found


def test_what_is_not_annotated_is_found():
    assert unannotated("class A:\n def f(self, x, *y: int): pass") == ["f: x", "f: its result"]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(FOLDER).as_posix())
def test_public_functions_of_the_contract_are_annotated(path):
    assert unannotated(path.read_text(encoding="utf-8")) == []
