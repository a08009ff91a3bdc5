"""The site's pages of results: gallery, reports, weights and jobs."""

import base64
import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from safetensors import safe_open
from site_cells import COLUMNS, cell


def gallery(folder: Path) -> dict[str, str | bytes]:
    """Return the gallery's page and its pictures, of the page that one command has made."""
    text = (folder / "index.html").read_text(encoding="utf-8")
    report = json.loads((folder / "report.json").read_text())
    known = json.loads((folder / "sources.json").read_text())
    judged = json.loads((folder / "judged.json").read_text())
    picture = r"<img src=['\"]data:image/jpeg;base64,([^'\"]+)"
    rows = dict(re.findall(rf"<h2>([^<]+)</h2>\s*(?:<div[^>]*>)?{picture}", text))
    shaped = {f"{name} as {shape}": name for name, shape in known["shapes"].items()}
    if set(rows) != {*known["photographs"], *shaped}:
        raise KeyError("docs/results/photographs: index.html and sources.json name other pictures")
    materials, made = report["materials"], report["made"]
    first = [name for name in rows if name not in shaped]
    verdicts = {name: judged[name].partition(":")[0].partition(" for ")[0] for name in first}
    counts = {verdict: list(verdicts.values()).count(verdict) for verdict in VERDICTS}
    summary = ", ".join(
        f"{count} photographs {VERDICTS[verdict]}" for verdict, count in counts.items()
    )
    refined = "refined" if report["refined"] else "not refined"
    page = [
        "# Gallery",
        f"{len(rows) * len(materials)} edits of {len(first)} photographs by other people, in"
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
    groups = {
        title: [name for name in first if verdicts[name] == verdict]
        for verdict, title in TITLES.items()
    }
    if shaped:
        groups["Some of them again, with their shape given"] = list(shaped)
    for title, names in groups.items():
        page.append(f"## {title}")
        for name in names:
            package, source = known["photographs"][shaped.get(name, name)]
            about = known["packages"][package]
            file = f"gallery/{name.replace(' ', '-')}.jpg"
            files[file] = base64.b64decode(rows[name])
            page += [
                f"### {name.replace('-', ' ').capitalize()}",
                f"[![{name}: photograph, decomposition and edits]({file}){{ loading=lazy }}]"
                f"({file})",
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
        " [The committed weights](../committed-weights.md) has the stages, their data and what"
        " each gained; [how edits are measured](../evaluation-methods.md#data-that-the-weights-saw)"
        " says how data that weights saw are kept out of tests. `make weights` trains new ones.",
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
