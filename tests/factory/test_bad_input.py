"""Whatever is wrong with a job, a manifest or the disk: one line, exit 1 or 2, and nothing that was
written is lost.
"""

import json
import subprocess

import msgspec
import pytest

from factory.commands import export, preview
from manifests.cli import main
from manifests.errors import InputError
from manifests.schema import Dataset
from manifests.store import Store
from manifests.verification import faults_of

COMMANDS = ("plan", "render", "status", "verify", "preview", "export")


@pytest.fixture
def command(capsys):
    """A function of words: (exit status, what it said on stderr)."""

    def run(*words):
        try:
            status = main("factory", "", COMMANDS, [str(word) for word in words])
        except SystemExit as exit_:  # argparse: wrong usage
            status = exit_.code
        return status, capsys.readouterr().err

    return run


def one_line(text):
    lines = [
        line
        for line in text.splitlines()
        if line.strip() and "it/s" not in line and "shape" not in line.split(":")[0]
    ]
    return len(lines) == 1 and "Traceback" not in text


@pytest.fixture
def a_job(tmp_path, small_job, light_file):
    """A good job file, its light beside it."""
    (tmp_path / "lamp.exr").write_bytes(light_file.read_bytes())
    value = msgspec.to_builtins(msgspec.structs.replace(small_job, lights=("lamp.exr",)))
    (tmp_path / "job.json").write_text(json.dumps(value))
    return tmp_path / "job.json", value


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"shapes": ["cube"', "expected JSON, found a mistake in it: Input data was truncated"),
        (
            '{"shapes": ["cube"], "materials": ["small"], "lights": ["lamp.exr"], "sampels": 3}',
            "did you mean samples",
        ),
        (
            '{"shapes": ["cube"], "materials": ["small"], "lights": ["lamp.exr"], "samples": "3"}',
            "samples: expected int",
        ),
        (
            '{"shapes": ["../cube.obj"], "materials": ["small"], "lights": ["lamp.exr"]}',
            "a path inside",
        ),
        (
            '{"shapes": ["cube"], "materials": ["small"], "lights": ["../lamp.exr"]}',
            "a path inside",
        ),
        ('{"shapes": ["cube"], "materials": ["small"], "lights": ["/lamp.exr"]}', "a path inside"),
        ('{"shapes": ["cube"], "materials": ["small"], "lights": ["lmap.exr"]}', "lmap.exr"),
        ('{"shapes": ["cube.obj"], "materials": ["small"], "lights": ["lamp.exr"]}', "cube.obj"),
        ('{"shapes": ["cube"], "materials": ["brsas"], "lights": ["lamp.exr"]}', "did you mean"),
        ("", "expected JSON"),
        ("\x00\x01\x02", "expected JSON"),
    ],
)
@pytest.mark.parametrize("verb", ["plan", "render"])
def test_a_bad_job_file_is_refused_in_one_line_before_anything_is_written(
    command, a_job, catalogue, tmp_path, verb, text, says
):
    path, _ = a_job
    path.write_text(text)
    words = ["--out", tmp_path / "data"] if verb == "render" else ["--no-probe"]
    status, said = command(verb, path, "--catalogue", catalogue, *words)
    assert status == 1 and says in said and one_line(said)
    assert not (tmp_path / "data").exists()


ONE_CUBE = ["render", "--mesh", "cube", "--material", "m", "--light", "l", "--out", "X"]


@pytest.mark.parametrize(
    ("words", "says", "status"),
    [
        (["render"], "--out", 2),
        (["render", "--out", "X"], "no --mesh and no --material and no --light", 1),
        (["render", "job.json", "--mesh", "cube", "--out", "X"], "both", 1),
        (
            ["render", "demo", "--samples", "64", "--out", "X"],
            "render --samples: expected no job beside it, found 'demo'",
            1,
        ),
        (
            ["render", "demo", "--light-resolution", "full", "--out", "X"],
            "write it into a copy of the job file, or leave --light-resolution out",
            1,
        ),
        (["render", "dmeo", "--out", "X"], "did you mean demo", 1),
        (["render", "demo", "--out", "X", "--workers", "0"], "--workers", 2),
        (["render", "demo", "--out", "X", "--workers", "1000000"], "a number from 1 to 1024", 1),
        (["render", "demo", "--out", "X", "--shard", "9/8"], "1 ≤ I ≤ N", 1),
        (["render", "demo", "--out", "X", "--shard", "²/3"], "1 ≤ I ≤ N, found '²/3'", 1),
        (["render", "demo", "--out", "X", "--shard", "1/" + "9" * 5000], "1 ≤ I ≤ N", 1),
        ([*ONE_CUBE, "--size", "9" * 5000], "pixels from 4 to 8192", 1),
        ([*ONE_CUBE, "--views", "9" * 5000], "numbers from 0 to 23", 1),
        (["render", "demo", "--out", "X", "--device", "abacus"], "--device", 2),
        ([*ONE_CUBE, "--views", "24"], "numbers from 0 to 23", 1),
        ([*ONE_CUBE, "--size", "0"], "pixels from 4 to 8192", 1),
        (["plan"], "expected a job", 1),
        (
            ["plan", "nowhere.json"],
            "nowhere.json: expected a JSON file, found no such file (check the path",
            1,
        ),
        (["status", "nowhere"], "a data set", 1),
        (["verify", "nowhere"], "a data set", 1),
        (["preview", "nowhere"], "a data set", 1),
        (["paint"], "no command 'paint'", 2),
    ],
)
def test_wrong_usage_is_told_with_the_remedy(command, tmp_path, monkeypatch, words, says, status):
    monkeypatch.chdir(tmp_path)
    result, said = command(*words)
    assert result == status and says in said
    assert status == 2 or one_line(said)
    assert not (tmp_path / "X").exists() and not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--fov", "150", "--fov: expected float <= 120.0, found 150.0"),
        ("--fov", "-5", "--fov: expected float >= 1.0, found -5.0"),
        ("--fov", "nan", "--fov: expected degrees from 1 to 120, found nan"),
        ("--fov", "inf", "--fov: expected degrees from 1 to 120, found inf"),
        ("--samples", "2000000", "--samples: expected int <= 1048576, found 2000000"),
        (
            "--seed",
            "99999999999999999999",
            "--seed: expected int <= 9223372036854775807, found 99999999999999999999",
        ),
        ("--seed", "-4", "--seed: expected int >= 0, found -4"),
    ],
)
def test_a_number_that_no_job_file_may_hold_leaves_the_dataset_as_it_is(
    command, render, small_job, catalogue, light_file, tmp_path, option, value, says
):
    render(small_job, tmp_path / "data", limit=1)
    before = (tmp_path / "data" / "dataset.json").read_bytes()
    words = (
        "--mesh",
        "cube",
        "--material",
        "small",
        "--light",
        light_file,
        "--catalogue",
        catalogue,
        "--out",
        tmp_path / "data",
    )
    status, said = command("render", *words, f"{option}={value}", "--limit", "1")
    assert status == 1 and says in said and one_line(said)
    assert (tmp_path / "data" / "dataset.json").read_bytes() == before


def test_a_job_file_with_windows_byte_order_mark_is_read(command, a_job, catalogue):
    path, _ = a_job
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert command("plan", path, "--catalogue", catalogue, "--no-probe") == (0, "")


def test_the_help_of_render_names_every_preset(capsys):
    from factory.planning import jobs

    with pytest.raises(SystemExit):
        main("factory", "", COMMANDS, ["render", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    listed = text.partition("Presets: ")[2].partition(";")[0]
    assert listed.split(", ") == list(jobs.presets())


@pytest.mark.parametrize("name", ["dataset.json", "materials.json"])
@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda value: b"{", "expected JSON"),
        (
            lambda value: json.dumps({**value, "flavour": 1}).encode(),
            "expected a known key, found 'flavour'",
        ),
        (lambda value: json.dumps({**value, "version": 7}).encode(), "version"),
        (lambda value: json.dumps({**value, "version": "one"}).encode(), "expected"),
    ],
)
def test_a_damaged_manifest_is_named_and_left_as_it_is_or_written_again(
    command, render, small_job, tmp_path, name, damage, says
):
    render(small_job, tmp_path / "data", limit=1)
    path = tmp_path / "data" / name
    path.write_bytes(damage(json.loads(path.read_text())))
    before = path.read_bytes()
    for verb in ("verify", "preview"):
        status, said = command(verb, tmp_path / "data")
        assert status == 1 and says in said and name in said
        # the other faults are listed, too
        assert one_line(said) or (verb, name) == ("verify", "materials.json")
    if name == "materials.json":  # all of them are known to the job, which writes them again
        render(small_job, tmp_path / "data")
        assert command("verify", tmp_path / "data")[0] == 0
        return
    with pytest.raises(InputError, match=name):
        render(small_job, tmp_path / "data")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b'{"id": "0123456789abcdef01234567"}\n', "the key 'shape'|missing required field"),
        (b'{"id": "../../../escape"}\n', "matching regex"),
        (b"not json\n", "expected a record"),
        (b'{"id": 7}\n', "str"),
    ],
)
def test_a_damaged_record_line_is_found_and_repaired_without_losing_the_others(
    command, render, small_job, tmp_path, line, says
):
    import re

    render(small_job, tmp_path / "data")
    path = Store(tmp_path / "data").record_files()[0]
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:5]) + line + b"".join(lines[5:]))
    status, said = command("verify", tmp_path / "data")
    assert status == 1 and re.search(says, said) and ":6" in said
    status, said = command("status", tmp_path / "data")
    assert status == 1 and ":6" in said and one_line(said)
    assert command("verify", tmp_path / "data", "--repair")[0] == 0
    assert path.read_bytes() == b"".join(lines)
    assert command("verify", tmp_path / "data")[0] == 0


def test_a_record_that_points_outside_is_found_and_nothing_outside_is_touched(
    command, render, small_job, tmp_path
):
    render(small_job, tmp_path / "data", limit=2)
    (tmp_path / "outside.exr").write_bytes(b"mine")
    path = Store(tmp_path / "data").record_files()[0]
    value = json.loads(path.read_bytes().splitlines()[0])
    path.write_bytes(
        json.dumps({**value, "image": "../outside.exr"}).encode()
        + b"\n"
        + path.read_bytes().split(b"\n", 1)[1]
    )
    status, said = command("verify", tmp_path / "data", "--repair")
    assert ", found ../outside.exr" in said and status == 0
    assert (tmp_path / "outside.exr").read_bytes() == b"mine"
    assert render(small_job, tmp_path / "data").made == 11
    assert command("verify", tmp_path / "data")[0] == 0


def test_missing_files_are_named_and_made_again_after_repair(command, render, small_job, tmp_path):
    render(small_job, tmp_path / "data")
    records = list(Store(tmp_path / "data").records())
    (tmp_path / "data" / records[0].image).unlink()
    status, said = command("verify", tmp_path / "data")
    assert (
        status == 1 and f"{records[0].image}: expected an OpenEXR file, found no such file" in said
    )
    status, said = command("preview", tmp_path / "data", "--out", tmp_path / "p", "--count", "12")
    assert status == 1 and records[0].id in said
    assert command("verify", tmp_path / "data", "--repair")[0] == 0
    assert render(small_job, tmp_path / "data").made == 1
    assert command("verify", tmp_path / "data")[0] == 0


def test_a_preview_that_would_fill_the_memory_is_refused(
    command, render, small_job, tmp_path, monkeypatch
):
    render(small_job, tmp_path / "data", limit=2)
    monkeypatch.setattr(preview, "LARGEST", 2 * 16**2)
    words = ("preview", tmp_path / "data", "--out", tmp_path / "p", "--count", "1000")
    status, said = command(*words, "--size", "17")
    assert status == 1 and "expected 512 pixels of pictures at most, found 578" in said
    assert not (tmp_path / "p" / "sheet.png").exists()
    assert command(*words, "--size", "16")[0] == 0


def test_a_preview_of_the_folder_one_is_in_lies_beside_it(
    command, render, small_job, tmp_path, monkeypatch
):
    render(small_job, tmp_path / "data", limit=1)
    monkeypatch.chdir(tmp_path / "data")
    assert command("preview", ".", "--size", "16")[0] == 0
    assert (tmp_path / "data-preview" / "index.html").exists()
    monkeypatch.chdir(tmp_path / "data" / "images")
    assert command("preview", "..", "--size", "16", "--overwrite")[0] == 0
    assert not (tmp_path / "data" / "images" / "..-preview").exists()


def test_memory_that_is_exhausted_is_one_line(command, monkeypatch):
    import torch

    from factory.commands import preview

    with pytest.raises(RuntimeError) as refused:
        torch.empty(1 << 60)  # a million TB
    cuda = torch.OutOfMemoryError("CUDA out of memory. Tried to allocate")
    for error in (MemoryError(), cuda, refused.value):

        def run(options, error=error):
            raise error

        monkeypatch.setattr(preview, "run", run)
        status, said = command("preview", "anywhere")
        assert status == 1 and "memory: expected" in said and one_line(said)


def test_a_preview_replaces_a_page_only_when_told(command, render, small_job, tmp_path):
    render(small_job, tmp_path / "data", limit=1)
    page, sheet = tmp_path / "site" / "index.html", tmp_path / "site" / "sheet.png"
    page.parent.mkdir()
    page.write_text("mine")
    words = ("preview", tmp_path / "data", "--out", page.parent, "--size", "16")
    status, said = command(*words)
    assert (
        status == 1
        and "index.html: expected no earlier result, found one (give another --out, or --overwrite"
        in said
        and one_line(said)
    )
    assert page.read_text() == "mine" and not sheet.exists()
    assert command(*words, "--overwrite")[0] == 0
    assert page.read_text() != "mine" and sheet.exists()
    assert command(*words)[0] == 1 and command(*words, "--overwrite")[0] == 0


def test_a_light_file_that_is_gone_is_named(command, a_job, catalogue, tmp_path, render, small_job):
    path, _ = a_job
    (tmp_path / "lamp.exr").unlink()
    status, said = command("render", path, "--catalogue", catalogue, "--out", tmp_path / "data")
    assert status == 1 and "lamp.exr" in said and one_line(said)
    render(small_job, tmp_path / "made", limit=1)
    next((tmp_path / "made" / "lights").iterdir()).unlink()
    status, said = command("verify", tmp_path / "made")
    assert status == 1 and "lights/lamp-" in said
    status, said = command("preview", tmp_path / "made")
    assert status == 1 and "lights/lamp-" in said and one_line(said)


def test_a_mesh_that_changed_since_the_plan_is_a_failure_with_its_reason(
    plan_of, small_job, tmp_path, monkeypatch
):
    from factory.execution.run import RunOptions, carry_out
    from tests.support.tetrahedron import FAKE, ROOT, TETRAHEDRON

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    mesh = tmp_path / "mesh.ply"
    mesh.write_bytes(TETRAHEDRON)
    plan = plan_of(
        msgspec.structs.replace(
            small_job, shapes=(str(mesh),), views=(0,), materials=("small/matte",)
        )
    )
    mesh.write_bytes(TETRAHEDRON.replace(b"0 0 2", b"0 0 3"))
    assert carry_out(plan, tmp_path / "data", RunOptions(studio=FAKE)).failed == 1
    assert (
        "the file has changed since the plan"
        in next(iter(Store(tmp_path / "data").failures())).reason
    )


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system whose size can be set: a function of a size such as "300k"."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=160k", "tmpfs", str(folder)],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.skip(f"needs the right to mount a small file system: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_stops_the_run_in_one_line_and_the_same_command_goes_on_when_there_is_room(
    render, small_job, tiny_disk
):
    job = msgspec.structs.replace(small_job, views=tuple(range(12)))
    data = tiny_disk / "data"
    with pytest.raises((InputError, OSError), match="No space left on device") as caught:
        render(job, data)
    assert "\n" not in str(caught.value)
    store = Store(data)
    made = {record.id: record for record in store.records()}
    assert 0 < len(made) < 72
    assert list(store.failures()) == []  # the disk was full, the shots were good
    subprocess.run(["mount", "-o", "remount,size=8m", str(tiny_disk)], check=True)
    outcome = render(job, data)
    assert (outcome.made, outcome.already_there) == (72 - len(made), len(made))
    assert [f.text for f in faults_of(store)] == []
    assert all(made[record.id] == record for record in store.records() if record.id in made)


def test_a_disk_that_is_full_from_the_start_is_told_in_one_line(render, small_job, tiny_disk):
    (tiny_disk / "filler").write_bytes(b"x" * 150_000)
    with pytest.raises((InputError, OSError), match="No space left on device"):
        render(small_job, tiny_disk / "data")


def test_an_export_that_is_refused_has_written_nothing(tmp_path, command, monkeypatch):
    store, written = Store(tmp_path / "data"), []
    store.write_json("dataset.json", Dataset())
    monkeypatch.setattr("manifests.export.to_parquet", lambda *_: written.append(1))
    (tmp_path / "tars").mkdir()
    (tmp_path / "tars" / "000000.tar").write_bytes(b"")
    status, said = command(
        "export", store.folder, "--parquet", tmp_path / "all.parquet", "--tars", tmp_path / "tars"
    )
    assert status == 1 and "a folder without tars" in said and not written
    said = export.EPILOG.replace("\n", " ")
    assert "a table of records is replaced, and tars need a folder without tars." in said
