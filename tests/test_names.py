"""Names in the code are the field's terms (docs/glossary.md): those that were replaced do not come
back.
"""

import ast

RETIRED = {  # the name that was, and the term that stands for it
    "Album": "RenderedSplit",
    "Apart": "Decomposition",
    "Cycles": "RenderedDataset",
    "How": "EditOptions",
    "Manner": "RunOptions",
    "Mix": "MixedDataset",
    "Problem": "InputError",
    "Relit": "RelitDataset",
    "Setup": "WorkerConfig",
    "Way": "Strategy",
    "claim": "reserve_outputs",
    "expose": "render_passes",
    "settle": "pin_settings",
    "spoiled": "perturbed, or damaged",
    "tap_cycles": "hook_cycles",
    "take_apart": "separate_causes, or decompose",
    "told": "report, summary or metadata",
    "twins": "duplicates",
}
# may be a field or an argument, no variable
LOCAL = {"found": "what it is: result, records, missing", "wanted": "requested, or target"}


def names_in(tree):
    """(name, line, whether it is a local variable) of each name that a syntax tree gives to
    something.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno, False
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno, False
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno, True


def replaced(text):
    """Each retired name in a module's text, with its line and what to write instead."""
    for name, line, is_variable in names_in(ast.parse(text)):
        if name in RETIRED or (is_variable and name in LOCAL):
            yield f"{line}: {name}: {RETIRED.get(name) or LOCAL[name]}"


def test_a_retired_name_is_seen():
    assert list(replaced("class Apart:\n    pass\n")) == ["1: Apart: Decomposition"]
    assert list(replaced("def f(found):\n    found = [found]\n")) == [
        "2: found: what it is: result, records, missing"
    ]


def test_no_retired_name_is_in_the_code(root):
    packages = ("factory", "learn", "manifests", "shaders")
    paths = [path for package in packages for path in sorted((root / package).rglob("*.py"))]
    assert len(paths) > 200  # else the walk has seen nothing
    assert [
        f"{path.relative_to(root)}:{text}"
        for path in paths
        for text in replaced(path.read_text(encoding="utf-8"))
    ] == []
