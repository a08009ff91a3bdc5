"""The pages of the site that are made from code and from results: command line, API, schemas,
gallery, reports.

`docs/hooks.py` adds them when the site is built; none is in the repository.
"""

import argparse
import base64
import hashlib
import html
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
from safetensors import safe_open

import brdfactory
from brdfactory import command_line
from learn.experiments import __main__ as experiments
from manifests import publish

WIDTH = 88
NO_HEADING = "    options:\n      show_root_heading: false\n"
COLUMNS = "| | |\n|---|---|"
BRDFACTORY = {  # heading: names of the package
    "Edit photographs": ("edit", "decompose", "Decomposition", "EditedPicture", "Picture"),
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


def all_files(root: Path) -> dict[str, str | bytes]:
    """Return {path in the site: contents} of everything that is made; root: the repository."""
    results = root / "docs" / "results"
    made: dict[str, str | bytes] = {
        "reference/command-line.md": command_page(),
        "reference/experiments.md": experiments_page(),
        "reference/brdfactory.md": brdfactory_page(),
        "reference/layer.md": layer_page(),
        "reference/shaders.md": shaders_page(),
        "reference/schemas.md": schemas_page(),
        "results/index.md": reports_page(results),
        "results/weights.md": weights_page(root / "learn" / "weights"),
        "jobs/index.md": jobs_page(root / "docs" / "jobs"),
    }
    for name, text in publish.documents().items():
        made[f"reference/{name}"] = text
    return made | gallery(results / "photographs")


def cell(text: str) -> str:
    """Return text as it can stand in a cell of a table of Markdown; `code` stays code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return _escaped(" ".join(text.replace("`", "'").split()))
    shown = [f"`{part}`" if i % 2 else _escaped(part) for i, part in enumerate(parts)]
    return " ".join("".join(shown).split())


def _escaped(text: str) -> str:
    """Return text without a meaning in Markdown; braces would be read as attributes."""
    escaped = re.sub(r"([\\*_\[\]])", r"\\\1", html.escape(text, quote=False))
    for character in "{}|":
        escaped = escaped.replace(character, f"&#{ord(character)};")
    return escaped


# The command line


def command_page() -> str:
    """Return the page of `brdfactory`'s commands, in the groups of its help."""
    parsers = _parsers(command_line.parser())
    page = [
        "# Command line",
        f"{command_line.DESCRIPTION} `python -m factory COMMAND` and `python -m learn COMMAND` are"
        " the same commands. Every command has `--help`. The exit status is 0 for success, 1 for"
        " bad input, which ends in one line with the remedy, and 2 for wrong usage, unless the"
        " command says otherwise.",
        "This page is made from the argument parsers.",
    ]
    for title, commands in command_line.GROUPS.items():
        page.append(f"## {title[:1].upper()}{title[1:]}")
        for command in commands:
            page += _command(parsers[command], f"brdfactory {command}", 3)
    return "\n\n".join(page) + "\n"


def experiments_page() -> str:
    """Return the page of the commands that measure what docs/results holds."""
    parser = argparse.ArgumentParser(prog="python -m learn.experiments")
    subparsers = parser.add_subparsers()
    page = [
        "# Command line of the experiments",
        "These commands make the figures of [the reports](../results/index.md). This page is made"
        " from the argument parsers.",
    ]
    for register in experiments.COMMANDS.values():
        register(subparsers)
    for title, commands in experiments.GROUPS.items():
        page.append(f"## {title}")
        for command in commands:
            name = f"python -m learn.experiments {command}"
            page += _command(subparsers.choices[command], name, 3, command)
    return "\n\n".join(page) + "\n"


def _parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return {name: each for action in _subcommands(parser) for name, each in action.choices.items()}


def _subcommands(parser: argparse.ArgumentParser) -> list[argparse._SubParsersAction]:
    return [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]


def _command(
    parser: argparse.ArgumentParser, name: str, level: int, title: str = ""
) -> Iterator[str]:
    """Yield the paragraphs of one command and of its actions."""

    def formatter(prog: str) -> argparse.HelpFormatter:
        return argparse.HelpFormatter(prog, width=WIDTH)

    parser.formatter_class = formatter
    shown = formatter(parser.prog)
    title = title or name.removeprefix("brdfactory ")
    yield f"{'#' * level} {title}"
    described, _, example = (parser.description or "").partition("Example: ")
    yield html.escape(described.strip(), quote=False).replace("*", r"\*")
    usage = parser.format_usage().removeprefix("usage: ").replace("\n       ", "\n")
    yield f"```text\n{usage.rstrip()}\n```"
    for group in parser._action_groups:
        actions = [
            action
            for action in group._group_actions
            if not isinstance(action, argparse._HelpAction | argparse._SubParsersAction)
        ]
        if actions:
            rows = [_option(shown, action) for action in actions]
            if group.title not in ("positional arguments", "options"):
                yield f"{str(group.title).capitalize()}:"
            yield "\n".join([COLUMNS, *rows])
    if parser.epilog:
        yield f"```text\n{textwrap.dedent(parser.epilog).strip()}\n```"
    if example:
        yield f"```text\n{example.strip()}\n```"
    for action in _subcommands(parser):
        for word, each in action.choices.items():
            yield from _command(each, f"{name} {word}", level + 1, f"{title} {word}")


def _option(shown: argparse.HelpFormatter, action: argparse.Action) -> str:
    """Return the row of one argument; of two spellings, the metavar follows the last."""
    words = ", ".join(action.option_strings)
    value = "" if action.nargs == 0 else shown._format_args(action, _metavar(shown, action))
    name = f"{words} {value}".strip()
    return f"| `{name}` | {cell(shown._expand_help(action))} |"


def _metavar(shown: argparse.HelpFormatter, action: argparse.Action) -> str:
    is_option = bool(action.option_strings)
    get: Callable[[argparse.Action], str] = (
        shown._get_default_metavar_for_optional
        if is_option
        else shown._get_default_metavar_for_positional
    )
    return get(action)


# Python


def brdfactory_page() -> str:
    """Return the page of the package `brdfactory`. Raises KeyError for a name without a group."""
    names = [name for group in BRDFACTORY.values() for name in group]
    if set(names) != set(brdfactory.__all__):
        missing = sorted(set(brdfactory.__all__) ^ set(names))
        raise KeyError(f"site_pages.BRDFACTORY and brdfactory.__all__ differ in {missing}")
    page = [
        "# Python: brdfactory",
        "`import brdfactory as bf` has these names. [From Python](../python.md) shows how they are"
        " used together. Pages of this section are made from the docstrings.",
    ]
    for title, group in BRDFACTORY.items():
        page.append(f"## {title}")
        page += [f"::: {brdfactory._HOMES[name]}.{name}" for name in group]
    return "\n\n".join(page) + "\n"


def layer_page() -> str:
    """Return the page of the layer and of what feeds it."""
    page = [
        "# Python: the layer and its data",
        "[Choosing a rendering method](../how-to-choose.md) explains `method` and `tolerance`.",
        f"::: learn.layer.rendering\n{NO_HEADING}      members: []",
    ]
    for title, names in LAYER.items():
        page.append(f"## {title}")
        page += [f"::: {name}" for name in names]
    return "\n\n".join(page) + "\n"


def shaders_page() -> str:
    """Return the page of the maths that the factory and the layer share."""
    page = [
        "# Python: shared maths",
        "These modules need numpy alone; several functions take tensors too."
        " [Conventions](../conventions.md) defines the frames and units.",
    ]
    for title, module in SHADERS.items():
        page += [f"## {title}", f"::: {module}\n{NO_HEADING}"]
    return "\n\n".join(page) + "\n"


# Schemas


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


# Results


def gallery(folder: Path) -> dict[str, str | bytes]:
    """Return the gallery's page and its pictures, of the page that one command has made."""
    text = (folder / "index.html").read_text(encoding="utf-8")
    report = json.loads((folder / "report.json").read_text())
    known = json.loads((folder / "sources.json").read_text())
    judged = json.loads((folder / "judged.json").read_text())
    rows = dict(
        re.findall(r"<h2>([^<]+)</h2>\s*<img src=['\"]data:image/jpeg;base64,([^'\"]+)", text)
    )
    if set(rows) != set(known["photographs"]):
        raise KeyError("docs/results/photographs: index.html and sources.json name other pictures")
    materials, made = report["materials"], report["made"]
    verdicts = {name: judged[name].partition(":")[0].partition(" for ")[0] for name in rows}
    counts = {verdict: list(verdicts.values()).count(verdict) for verdict in VERDICTS}
    summary = ", ".join(
        f"{count} photographs {VERDICTS[verdict]}" for verdict, count in counts.items()
    )
    refined = "refined" if report["refined"] else "not refined"
    page = [
        "# Gallery",
        f"{len(rows) * len(materials)} edits of {len(rows)} photographs by other people, in"
        f" {', '.join(materials[:-1])} and {materials[-1]}."
        " Whether an edit works was judged by eye, by those who wrote the program:"
        f" {summary}. None was left out.",
        f"The weights are `{report['weights'].split()[0]}`, {refined}; the network never saw these"
        " photographs. Each row shows the photograph, the picture rendered again from its"
        " decomposition, normals, light, and the edits.",
        "![A photograph of an espresso cup and two edits of it](results/photographs/hero.jpg)",
        "*A larger example: left a photograph that comes with the program"
        " (`example:espresso-cup`), then two edits of its regions.*",
        f"`make gallery` makes them. These are of commit {made['commit']} and {made['date']}, by"
        f" `{made['command']}`, whose first argument is the folder of the pictures' packages."
        " [Editing a photograph](editing.md#limitations) says what to expect.",
    ]
    files: dict[str, str | bytes] = {}
    for verdict, title in TITLES.items():
        page.append(f"## {title}")
        for name in (name for name in rows if verdicts[name] == verdict):
            package, source = known["photographs"][name]
            about = known["packages"][package]
            files[f"gallery/{name}.jpg"] = base64.b64decode(rows[name])
            page += [
                f"### {name.replace('-', ' ').capitalize()}",
                f"[![{name}: photograph, decomposition and edits](gallery/{name}.jpg)"
                f"{{ loading=lazy }}](gallery/{name}.jpg)",
                cell(judged[name]),
                f"*Photograph:* {cell(source)} of {package} {about['version']};"
                f" {cell(_licence(about['licence'], source))}; {cell(about['credit'])}.",
            ]
    return files | {"gallery.md": "\n\n".join(page) + "\n"}


def _licence(text: str, source: str) -> str:
    """Return a package's licence, or of several, "…: a X, b Y", that of the picture `source`."""
    stem = Path(source).stem
    return next((part for part in re.split(r"[:,] ", text) if part.startswith(f"{stem} ")), text)


VERDICTS = {"Works": "work", "Half works": "half work", "Fails": "fail"}
TITLES = {"Works": "Edits that work", "Half works": "Edits that half work", "Fails": "Failures"}


def reports_page(results: Path) -> str:
    """Return a list of all reports, with the command and date of each."""
    rows = ["| report | what it measures | made by |", "|---|---|---|"]
    for path in sorted(results.glob("*/*.md")):
        text = path.read_text(encoding="utf-8")
        title = text.partition("\n")[0].removeprefix("# ")
        link = path.relative_to(results).as_posix()
        name = link.removesuffix("/report.md").removesuffix(".md")
        rows.append(f"| [{name}]({link}) | {cell(title)} | {_stamp(path, text)} |")
    return "\n\n".join(
        [
            "# Reports",
            "Most figures of this site come from these reports. Each was made by a command, given"
            " as it was at its commit; [the changelog](../changelog.md#command-line) has the"
            " names that have changed since."
            " [The gallery](../gallery.md) has edits of photographs;"
            " [the weights](weights.md) say how they were made;"
            " [evaluation](../evaluation.md#results) summarises how good edits are.",
            "\n".join(rows),
        ]
    )


def weights_page(folder: Path) -> str:
    """Return what the metadata of the committed weights say of how they were made."""
    page = [
        "# How the weights were made",
        "This page is read from the weights themselves."
        " [Training](../learning.md#the-committed-weights) has the stages, their data and what each"
        " gained; [evaluation](../evaluation.md#data-that-the-weights-saw) says how data that"
        " weights saw are kept out of tests. `make weights` trains new ones.",
    ]
    for path in sorted(folder.glob("*.safetensors")):
        with safe_open(path, "np") as opened:
            metadata = opened.metadata()
        run = json.loads(metadata["run"])
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
        start = run.get("start") or "from random weights"
        facts = {
            "network": f"`{metadata['network']}`, pictures of {metadata['size']}²",
            "began with": start.replace(".safetensors", ""),
            "optimiser's steps of the last stage": f"{int(metadata.get('step', 0)):,}",
            "file": f"{path.stat().st_size / 1e6:.1f} MB, SHA-256 `{digest}…`",
        }
        if "step" not in metadata:
            del facts["optimiser's steps of the last stage"]
        page += [
            f"## {path.stem}",
            cell(f"{run['about'][:1].upper()}{run['about'][1:].rstrip('.')}."),
            "\n".join([COLUMNS, *(f"| {name} | {value} |" for name, value in facts.items())]),
            "The run of the last stage:",
            f"```json\n{json.dumps(run, indent=1)}\n```",
        ]
    return "\n\n".join(page) + "\n"


def _stamp(path: Path, text: str) -> str:
    """Return a report's command, commit and date, from its JSON or else from its text."""
    data = path.with_suffix(".json")
    made = next(_stamps(json.loads(data.read_text()) if data.is_file() else None), None)
    if made is None:
        line = re.search(r"`(python [^`]+)`[^\n]*?commit (\w+), (\d{4}-\d\d-\d\d)", text)
        made = dict(zip(("command", "commit", "date"), line.groups(), strict=True)) if line else {}
    if not made:
        return "see the report"
    return f"`{made['command']}`, {made['commit'][:7]}, {made['date']}"


def _stamps(data: Any) -> Iterator[dict[str, str]]:
    """Yield what `manifests.provenance` wrote into a report, wherever it stands."""
    if isinstance(data, dict):
        if {"command", "commit", "date"} <= set(data):
            yield data
        for value in data.values():
            yield from _stamps(value)
    elif isinstance(data, list):
        for value in data:
            yield from _stamps(value)


def jobs_page(folder: Path) -> str:
    """Return a list of the jobs whose pictures the reports measure."""
    files = sorted(folder.rglob("*.json"))
    rows = ["| job | what it is for |", "|---|---|"]
    for path in files:
        about = json.loads(path.read_text()).get("about", "")
        name = path.relative_to(folder).as_posix()
        rows.append(f"| [{name}]({name}) | {cell(about)} |")
    return (
        "# Jobs of the reports\n\nThese jobs rendered the pictures that the"
        " [reports](../results/index.md) measure. [Writing jobs](../writing-jobs.md) explains"
        " their keys.\n\n" + "\n".join(rows) + "\n"
    )
