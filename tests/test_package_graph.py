"""The packages of learn and factory are layered: each imports only from those below it, so that
there is no cycle.
"""

import ast
from collections import defaultdict

import pytest

LAYERS = {  # from the bottom up
    "learn": (
        "primitives",
        "engines",
        "methods",
        "layer",
        "data",
        "networks",
        "figures",
        "selection",
        "metrics",
        "training",
        "refinement",
        "baselines",
        "editing",
        "app",
        "agreement",
        "evaluation",
        "commands",
        "experiments",
    ),
    "factory": (
        "blender_extension",  # runs inside Blender and imports nothing of the others
        "shapes",
        "materials",
        "lights",
        "render",
        "planning",
        "execution",
        "preview",
        "commands",
    ),
}


def imports_between(root, program):
    """{(package, imported package): [file: module]} of a program's modules, imports inside
    functions included.
    """
    edges = defaultdict(list)
    for path in sorted((root / program).rglob("*.py")):
        parts = path.relative_to(root / program).parts
        if len(parts) == 1:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = node.module == program
                names = [f"{program}.{a.name}" for a in node.names] if inner else [node.module]
            else:
                continue
            for name in names:
                steps = name.split(".")
                if steps[0] == program and len(steps) > 1 and steps[1] != parts[0]:
                    edges[parts[0], steps[1]].append(f"{path.relative_to(root)}: {name}")
    return edges


@pytest.mark.parametrize("program", LAYERS)
def test_every_package_stands_in_a_layer(root, program):
    packages = {p.parent.name for p in (root / program).glob("*/__init__.py")}
    assert packages == set(LAYERS[program])


@pytest.mark.parametrize("program", LAYERS)
def test_no_package_imports_from_its_own_height_or_above(root, program):
    height = {name: number for number, name in enumerate(LAYERS[program])}
    edges = imports_between(root, program)
    assert len(edges) > len(height) / 2  # else the walk has found nothing
    upward = [
        place for (a, b), places in edges.items() if height[b] >= height[a] for place in places
    ]
    assert not upward
