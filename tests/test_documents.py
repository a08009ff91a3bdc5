"""What the documents say is true: their code runs, their commands run, the names they give exist.

Commands run in an empty folder, in the order of the page, at a smaller size: SMALLER lists every
substitution, and nothing else is changed. `make` lines are checked without being carried out;
`.ci/run` carries them out.
"""

import argparse
import importlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from PIL import Image

from brdfactory import command_line
from manifests.schema import Job
from tests.support import whole_dataset

DOCUMENTS = ("README.md", "docs/conventions.md")
# pages whose blocks of Python are run here
WITH_CODE = (
    "README.md",
    "docs/conventions.md",
    "docs/how-to-choose.md",
    "docs/labels.md",
    "docs/layer-in-a-model.md",
    "docs/materials.md",
    "docs/python.md",
)
# pages whose blocks run in another test, and which
RUN_ELSEWHERE = (
    "docs/blender.md",  # tests/render/test_asset_library.py
    "docs/dataset.md",  # tests/manifests/test_dataset_page.py
    "docs/exporting.md",  # tests/manifests/test_exporting.py
    "docs/first-data-set.md",  # tests/test_notebooks.py runs commands and blocks of all these
    "docs/first-edit.md",
    "docs/first-layer.md",
    "docs/installing.md",
    "docs/pytorch-data.md",  # test_the_page_on_torch_reads_a_data_set
)
SMALLER = [
    # two pictures show that the command works
    (r"^(python -m (?:brd)?factory render .*)$", r"\1 --limit 2"),
    (r"--size \d+", "--size 24"),
    (r"--samples \d+", "--samples 4"),
    (r"--workers \d+", "--workers 1"),
    (r"^(python -m (?:learn|brdfactory) agree .*)$", r"\1 --limit 2"),
    # all materials under five lights take minutes; tests/learn/test_interactive.py makes a page
    (r" --interactive\b", ""),
    # the reader's photograph is as small, and so is its object
    (r"--around 120,80 520,460", "--around 2,2 46,46"),
    # tests/learn/test_editing_wired.py refines
    (r"^(python -m (?:learn|brdfactory) (?:edit|transfer) .*)$", r"\1 --no-refine"),
]
USERS_FILES = {"my-chair.obj": "manifests/jobs/meshes/vase.obj"}  # what a reader has and we do not


def photographs(folder):
    """A reader's pictures: a shaded ball, with a mask beside it and cut out."""
    y, x = np.mgrid[-1:1:48j, -1:1:48j]
    inside = x * x + y * y < 0.7
    shade = np.where(inside, 90 + 80 * np.sqrt(np.clip(0.7 - x * x - y * y, 0, 1)) - 60 * y, 30)
    picture = np.repeat(np.clip(shade, 0, 255).astype(np.uint8)[..., None], 3, -1)
    Image.fromarray(picture).save(folder / "photo.jpg")
    Image.fromarray((255 * inside).astype(np.uint8)).save(folder / "mask.png")
    for name in "abc":
        Image.fromarray(np.dstack([picture, (255 * inside).astype(np.uint8)])).save(
            folder / f"{name}.png"
        )


def blocks(root, document, language):
    text = (root / document).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.M | re.S)


def commands(root):
    """Every command line of the documents, with its document."""
    for document in DOCUMENTS:
        for block in blocks(root, document, "sh"):
            for line in re.sub(r"\\\n\s*", "", block).splitlines():
                line = line.partition("  #")[0].strip()
                if line and not line.startswith("#"):
                    yield document, line


def test_the_pages_with_python_blocks_are_those_whose_blocks_are_run(root):
    written = [
        page
        for page in (*pages(root), "CHANGELOG.md", *log_pages(root))
        if blocks(root, page, "python")
    ]
    assert sorted(written) == sorted((*WITH_CODE, *RUN_ELSEWHERE))
    fences = re.findall(
        r"^```(\S+)",
        "".join((root / page).read_text(encoding="utf-8") for page in pages(root)),
        flags=re.M,
    )
    # another spelling of a language would not be found
    assert set(fences) <= {"python", "sh", "json", "text"}


@pytest.mark.parametrize("document", WITH_CODE)
def test_python_blocks_of_a_document_run_from_top_to_bottom(root, document, tmp_path, monkeypatch):
    code = blocks(root, document, "python")
    photographs(tmp_path)
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in code:
        exec(compile(block, document, "exec"), names)


def test_the_page_on_torch_reads_a_data_set(root, tmp_path, monkeypatch):
    pytest.importorskip("torch")
    whole_dataset.write_dataset(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in blocks(root, "docs/pytorch-data.md", "python"):
        exec(compile(block, "docs/pytorch-data.md", "exec"), names)


def test_the_worked_jobs_are_jobs_and_one_has_every_key(root):
    jobs = blocks(root, "docs/writing-jobs.md", "json")
    decoded = [msgspec.json.decode(job, type=Job) for job in jobs]
    assert len(decoded) >= 7
    assert set(json.loads(jobs[-1])) == set(Job.__struct_encode_fields__)


@pytest.mark.parametrize("number, count", [(0, 24), (3, 120), (5, 120)])
def test_a_worked_job_has_as_many_pictures_as_its_page_says(root, tmp_path, number, count):
    pytest.importorskip("scipy")
    from factory.execution.run import make_plan
    from factory.planning.assets import resolve

    shutil.copy(root / USERS_FILES["my-chair.obj"], tmp_path / "my-chair.obj")
    page = (root / "docs/writing-jobs.md").read_text(encoding="utf-8")
    text = blocks(root, "docs/writing-jobs.md", "json")[number]
    assert re.match(
        rf"```\n\nThis makes {count:,} pictures\b", page[page.index(text) + len(text) :]
    )
    job = msgspec.json.decode(text, type=Job)
    assert len(make_plan(job, resolve(job, tmp_path))) == count


@pytest.mark.long
@pytest.mark.blender
def test_every_command_of_the_documents_runs(root, tmp_path):
    for module in ("bpy", "torch"):
        pytest.importorskip(module)
    for name, source in USERS_FILES.items():
        shutil.copy(root / source, tmp_path / name)
    photographs(tmp_path)
    (tmp_path / "mask.png").unlink()  # which the first command makes
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / "not-a-map.png")
    environment = {
        **os.environ,
        "PYTHONPATH": str(root),
        "PATH": f"{os.path.dirname(sys.executable)}{os.pathsep}{os.environ['PATH']}",
    }
    ran = 0
    for document, command in commands(root):
        if command.startswith("make "):
            done = subprocess.run(
                [*shlex.split(command), "--dry-run"],
                cwd=root,
                capture_output=True,
                text=True,
                timeout=60,
            )
        else:
            command = re.sub(r"^brdfactory ", "python -m brdfactory ", command)
            assert re.match(r"python -m (brdfactory|factory|learn) ", command), (
                f"{document}: how is '{command}' to be run?"
            )
            for pattern, smaller in SMALLER:
                command = re.sub(pattern, smaller, command)
            arguments = [sys.executable, *shlex.split(command)[1:]]
            done = subprocess.run(
                arguments,
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                timeout=300,
            )
            ran += 1
        assert done.returncode == 0, (
            f"{document}: {command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        )
    assert ran >= 5


def test_every_file_that_a_document_names_exists(root):
    missing = []
    for document in (*pages(root), "CHANGELOG.md", *log_pages(root)):
        text = re.sub(
            r"^```.*?^```", "", (root / document).read_text(encoding="utf-8"), flags=re.M | re.S
        )
        named = re.findall(
            r"`((?:docs|brdfactory|factory|learn|manifests|shaders|tests)/[\w./-]*)`", text
        )
        named += re.findall(r"\]\(((?!https?:)[^)#]+)\)", text)
        base = (root / document).parent
        missing += [
            f"{document}: {name}"
            for name in named
            if not ((root / name).exists() or (base / name).exists())
        ]
    assert not missing


def pages(root):
    """Names of all documents that tell of the present: not the log."""
    return [
        *DOCUMENTS,
        "CONTRIBUTING.md",
        *sorted(
            f"docs/{path.name}"
            for path in (root / "docs").glob("*.md")
            if path.name not in ("log.md", "conventions.md")
        ),
    ]


def log_pages(root):
    """Names of the log's pages, which tell of the past."""
    return [
        "docs/log.md",
        *sorted(f"docs/log/{path.name}" for path in (root / "docs/log").glob("*.md")),
    ]


def told_commands(root):
    """(document, program, words) of every whole command in a block or between backquotes; `…` and
    NAME alone tell of a command's name.
    """
    for document in pages(root):
        text = (root / document).read_text(encoding="utf-8")
        names = "|".join(command_line.COMMANDS)  # a sentence may begin with the program's name
        programs = (
            rf"(?:python -m (factory|learn(?:\.experiments)?)"
            rf"|(?:python -m )?(brdfactory)(?= (?:{names})\b))"
        )
        inline = re.findall(rf"`{programs} ([^`]*)`", text)
        lines = re.findall(rf"^(?: {{4}}|)(?:for .*; do )?{programs} (.*)$", text, flags=re.M)
        for one, other, line in inline + lines:
            program = one or other
            words = shlex.split(re.split(r"\s{2,}#|; done", line)[0])
            if words[-1] not in ("--help", "...", "…") and len(words) > 1:
                yield document, program, words


def test_every_command_that_a_document_names_can_be_given_so(root, capsys):
    ran, refused = [], []
    for document, program, words in told_commands(root):
        home = "brdfactory.command_line" if program == "brdfactory" else f"{program}.__main__"
        commands = importlib.import_module(home).COMMANDS
        parser = argparse.ArgumentParser()
        subparsers = parser.add_subparsers(required=True)
        if program == "brdfactory":
            parser = command_line.parser()
        elif program == "learn.experiments":
            commands[words[0]](subparsers)
        else:
            folder = f"{program}.commands"
            module = importlib.import_module(f"{folder}.{words[0].replace('-', '_')}")
            module.register(subparsers)
        assert words[0] in commands
        try:
            parser.parse_args(words)
            ran.append(words)
        except SystemExit:
            refused.append(
                f"{document}: {program} {' '.join(words)}:"
                f" {capsys.readouterr().err.splitlines()[-1]}"
            )
    assert not refused
    assert len(ran) > 40


def test_the_makefile_helps_with_every_target_it_offers(root):
    text = (root / "Makefile").read_text()
    targets = re.search(r"^\.PHONY: (.*)$", text, flags=re.M)[1].split()
    shown = subprocess.run(
        ["make", "help"], cwd=root, capture_output=True, text=True, check=True
    ).stdout
    assert {t for t in targets if t != "help" and f"make {t} " not in shown} == set()


def test_weights_are_made_with_meshes_only_where_a_library_is_named(root):
    def lines(*words):
        made = ["make", "--dry-run", "weights", *words]
        done = subprocess.run(made, cwd=root, capture_output=True, text=True, check=True)
        return [line for line in done.stdout.splitlines() if " render " in line]

    plain, more = lines(), lines("WEIGHTS_MESHES=lib", "WEIGHTS_PART=2/60")
    assert len(plain) == 2 and "geometry-meshes" not in "".join(plain)
    assert len(more) == 3
    assert "render geometry-meshes --assets lib --shard 2/60 --out out/weights/geometry" in more[2]


def test_constraints_pin_versions_and_name_no_address(root):
    lines = [
        line
        for line in (root / "constraints.txt").read_text().splitlines()
        if line and not line.startswith("#")
    ]
    assert lines and all(
        re.fullmatch(r'[\w.-]+==[\w.!]+(; python_version [<>=]+ "[\d.]+")?', line) for line in lines
    )  # no '+cpu', no address, no range
