"""Names in the code are the field's terms (docs/glossary.md): those that were replaced do not come
back.
"""

import ast
import re

RETIRED = {  # the name that was, and the term that stands for it
    "Album": "RenderedSplit",
    "Apart": "Decomposition",
    "Cycles": "RenderedDataset",
    "How": "EditOptions",
    "Manner": "RunOptions",
    "Mix": "MixedDataset",
    "Pool": "DataSplit",
    "Problem": "InputError",
    "Relit": "RelitDataset",
    "Setup": "WorkerConfig",
    "Way": "Strategy",
    "anew": "again",
    "apart": "decomposition, difference or separate",
    "average": "ema_decay, or mean",
    "ball": "sphere",
    "capture": "source",
    "claim": "reserve_outputs",
    "decay": "weight_decay",
    "door": "mesh import",
    "enlarging": "upsampling",
    "expose": "render_passes",
    "film": "render result",
    "glow": "id emission",
    "matte_first": "gloss curriculum",
    "noted": "metadata",
    "pace": "latency",
    "passes": "outer_iterations",
    "promise": "tolerance check",
    "proof": "ablation, or validation",
    "pull": "gradient_bound",
    "rate": "learning_rate",
    "reach": "trust_region",
    "room": "preview_lighting, or space",
    "settle": "pin_settings",
    "sheet": "montage or contact_sheet",
    "shelf": "library",
    "spoiled": "perturbed, or damaged",
    "starts": "initialisations",
    "startup": "cold start",
    "study": "ablation",
    "take_apart": "separate_causes, or decompose",
    "taken": "what it is: chosen, selected, duration",
    "tap": "sample direction, or hook",
    "tap_cycles": "hook_cycles",
    "taps": "sample_directions",
    "together": "joint_iterations",
    "told": "report, summary or metadata",
    "twins": "duplicates",
    "way": "strategy",
    "way_down": "descent",
    "ways": "plan",
}
# may be a field or an argument, no variable and no function
LOCAL = {"found": "what it is: result, records, missing", "wanted": "requested, or target"}
# Words of the table that are terms too. Not in RETIRED at all: `side`, a key of dataset.json and
# the length of a square; `steps`, which training counts; `stride`, a convolution's and an array's;
# `integral`, which is one.
ALLOWED = {  # a retired name: {where it may stand: why}
    "Pool": {"factory/execution/pool.py": "of processes"},
    "apart": {"learn/engines/": "kernels are cached by their source, which stays"},
    "average": {"learn/training/": "the average of weights, a part of checkpoints"},
    "glow": {"factory/lights/": "the sky's, about the sun"},
    "passes": {
        "factory/render/": "Cycles' render passes",
        "learn/engines/": "passes over the light, and a compiler's",
    },
    "reach": {
        "factory/shapes/": "how far a part of a shape extends",
        "learn/engines/": "how far a lobe does; kernels are cached by their source",
    },
    "room": {"learn/engines/": "places of a buffer; kernels are cached by their source"},
    "starts": {
        "factory/shapes/": "where rows of an array begin",
        "factory/materials/label_fit.py": "where rows of an array begin",
        "learn/methods/sampling.py": "where rows of an array begin",
        "manifests/export.py": "where parts of an archive begin",
    },
}


# where no function has a participle alone as its name, such as `merged`: `merge_groups` says what
# is done, and to what
WITHOUT_PARTICIPLES = (
    "brdfactory",
    "factory/render/estimators",
    "learn/layer",
    "learn/methods",
    "learn/metrics",
    "learn/refinement",
    "learn/training",
    "manifests",
)


def participles(text):
    """Line and name of each function and method that a participle alone names.

    Properties and context managers may be named so: they are not called to do something, or stand
    after `with`.
    """
    for node in ast.parse(text).body:
        for each in node.body if isinstance(node, ast.ClassDef) else [node]:
            if not isinstance(each, ast.FunctionDef):
                continue
            marks = " ".join(map(ast.unparse, each.decorator_list))
            name = each.name.strip("_")
            if re.search("property|manager", marks):
                continue
            if name.endswith("ed") and "_" not in name:
                yield f"{each.lineno}: {each.name}"


def names_in(tree):
    """(name, line, whether it is an argument) of each name that a syntax tree gives to
    something.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno, False
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno, True
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno, False


def replaced(text, path=""):
    """Each retired name in a module's text, with its line and what to write instead."""
    for name, line, is_argument in names_in(ast.parse(text)):
        allowed = any(path.startswith(place) for place in ALLOWED.get(name, ()))
        if (name in RETIRED and not allowed) or (name in LOCAL and not is_argument):
            yield f"{line}: {name}: {RETIRED.get(name) or LOCAL[name]}"


def test_a_retired_name_is_seen():
    assert list(replaced("class Apart:\n    pass\n")) == ["1: Apart: Decomposition"]
    assert list(replaced("def reach(): pass\n", "learn/a.py")) == ["1: reach: trust_region"]
    assert list(replaced("def reach(): pass\n", "factory/shapes/a.py")) == []
    assert list(replaced("def f(tap): pass\n")) == ["1: tap: sample direction, or hook"]
    assert list(replaced("def f(found):\n    found = [found]\n")) == [
        "2: found: what it is: result, records, missing"
    ]


def test_no_retired_name_is_in_the_code(root):
    packages = ("brdfactory", "factory", "learn", "manifests", "shaders")
    paths = [path for package in packages for path in sorted((root / package).rglob("*.py"))]
    assert len(paths) > 200  # else the walk has seen nothing
    assert [
        f"{path.relative_to(root)}:{text}"
        for path in paths
        for text in replaced(path.read_text(encoding="utf-8"), path.relative_to(root).as_posix())
    ] == []


def test_a_participle_is_seen():
    assert list(participles("def merged(): pass\n")) == ["1: merged"]
    assert list(participles("class A:\n    def _merged(self): pass\n")) == ["2: _merged"]
    assert list(participles("class A:\n    @property\n    def merged(self): pass\n")) == []
    assert list(participles("def merged_groups(): pass\n")) == []


def test_functions_are_named_by_more_than_a_participle(root):
    paths = [p for place in WITHOUT_PARTICIPLES for p in sorted((root / place).rglob("*.py"))]
    assert len(paths) > 100  # else the walk has seen nothing
    assert [
        f"{path.relative_to(root)}:{text}"
        for path in paths
        for text in participles(path.read_text(encoding="utf-8"))
    ] == []
