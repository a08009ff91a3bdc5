"""The site's pages of the Python packages and of the JSON schemas, made from code."""

import html
import inspect
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec
from site_cells import cell

import brdfactory
from manifests import publish

NO_HEADING = "    options:\n      show_root_heading: false\n"
BRDFACTORY = {  # heading: names of the package
    "Edit photographs": (
        "edit",
        "decompose",
        "make_mask",
        "Decomposition",
        "EditedPicture",
        "Picture",
    ),
    "Materials and lights": ("material", "blend", "Material", "light"),
    "Render": ("render", "RenderLayer"),
    "Data sets": ("load_job", "generate", "Records", "Job"),
    "Mistakes": ("InputError",),
}
LAYER = {
    "The layer": ("learn.layer.rendering.render", "learn.layer.rendering.RenderLayer"),
    "Records as tensors": ("learn.data.records.Records", "learn.data.records.Sample"),
}
SHADERS = {
    "Frames": "shaders.frames",
    "Environment maps": "shaders.envmap",
    "The reflectance model": "shaders.dsbrdf",
    "Materials by description": "shaders.principled",
    "Tone mapping": "shaders.tone",
}


def brdfactory_page() -> str:
    """Return the page of the package `brdfactory`. Raises KeyError for a name without a group."""
    names = [name for group in BRDFACTORY.values() for name in group]
    if set(names) != set(brdfactory.__all__):
        missing = sorted(set(brdfactory.__all__) ^ set(names))
        raise KeyError(f"site_reference.BRDFACTORY and brdfactory.__all__ differ in {missing}")
    page = [
        "# Python: brdfactory",
        "`import brdfactory as bf` has these names. [From Python](../python.md) shows how they are"
        " used together. Pages of this section are made from the docstrings.",
    ]
    homes = brdfactory._HOMES
    return _page(
        page, {t: [f"{homes[name]}.{name}" for name in group] for t, group in BRDFACTORY.items()}
    )


def layer_page() -> str:
    """Return the page of the layer and of what feeds it."""
    page = [
        "# Python: the layer and its data",
        "[Choosing a rendering method](../how-to-choose.md) explains `method` and `tolerance`.",
        f"::: learn.layer.rendering\n{NO_HEADING}      members: []",
    ]
    return _page(page, LAYER)


def shaders_page() -> str:
    """Return the page of the maths that the factory and the layer share."""
    page = [
        "# Python: shared maths",
        "These modules need numpy alone; several functions take tensors too."
        " [Conventions](../conventions.md) defines the frames and units.",
    ]
    return _page(page, {title: [f"{module}\n{NO_HEADING}"] for title, module in SHADERS.items()})


def _page(beginning: Sequence[str], groups: Mapping[str, Sequence[str]]) -> str:
    """Return a page: its beginning, then each group's heading and what is documented below it."""
    page = list(beginning)
    for title, names in groups.items():
        page += [f"## {title}", *(f"::: {name}" for name in names)]
    return "\n\n".join(page) + "\n"


def schemas_page() -> str:
    """Return the page of every key of every file that has a JSON Schema."""
    page = [
        "# JSON schemas",
        "The files of a data set, jobs and training runs, as the code declares them."
        " [The data set on disk](../dataset.md) explains those of a data set, with examples.",
    ]
    described: set[str] = set()
    for name, type_ in publish.TYPES.items():
        schema = msgspec.json.schema(type_)
        top = schema.get("$ref", "").rpartition("/")[2]
        file = f"{name}.schema.json"
        page.append(f"## {name}\n\nThe whole schema: [{file}]({file}).")
        definitions = schema["$defs"]
        for each in sorted(definitions, key=lambda key: (key != top, key)):
            if each in described:
                continue
            described.add(each)
            page += _definition(each, definitions[each])
    return "\n\n".join(page) + "\n"


def _definition(name: str, schema: dict[str, Any]) -> Iterator[str]:
    """Yield the paragraphs of one type."""
    yield f"### {name}"
    sentences, meanings = _described(inspect.cleandoc(schema.get("description", "")))
    if sentences:
        yield html.escape(sentences, quote=False)
    required = schema.get("required", [])
    rows = ["| key | type | default | meaning |", "|---|---|---|---|"]
    for key, value in schema.get("properties", {}).items():
        default = "required" if key in required else f"`{json.dumps(value.get('default'))}`"
        if key not in required and len(default) > 40:
            default = "see the schema"
        rows.append(f"| `{key}` | {_type(value)} | {default} | {cell(meanings.pop(key, ''))} |")
    yield "\n".join(rows)


def _described(text: str) -> tuple[str, dict[str, str]]:
    """Return a docstring's sentences, and {key: meaning} of its columns."""
    sentences: list[str] = []
    meanings: dict[str, str] = {}
    keys: list[str] = []
    for line in text.split("\n"):
        if match := re.match(r"^([a-z]\w*(?:, \w+)*) {2,}(\S.*)$", line):
            keys = match[1].split(", ")
            meanings.update(dict.fromkeys(keys, match[2]))
        elif line.startswith("  ") and keys:
            meanings.update({key: f"{meanings[key]} {line.strip()}" for key in keys})
        else:
            keys = []
            sentences.append(line)
    return "\n".join(sentences).strip(), meanings


def _type(schema: dict[str, Any]) -> str:
    """Return a type and its limits in few words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(_type(each) for each in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if schema.get("type") == "array":
        items = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
        lengths = [schema.get("minItems"), schema.get("maxItems")]
        exact = f"{lengths[0]} × " if lengths[0] is not None and lengths[0] == lengths[1] else ""
        return f"list of {exact}{_type(items)}" if items else "list"
    words = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = [f"{sign} {schema[key]:,}" for key, sign in words.items() if key in schema]
    if "pattern" in schema:
        limits.append(f"`{schema['pattern']}`")
    return " ".join(
        [str(schema.get("type", "any")), *(["(" + ", ".join(limits) + ")"] * bool(limits))]
    )
