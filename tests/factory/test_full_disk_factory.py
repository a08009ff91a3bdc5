"""Every command of `factory` that writes, where the disk is full: one line, no draft, nothing lost,
and the same command succeeds later.

RLIMIT_FSIZE stands for the full disk: it needs no root. tests/endurance/full_disk.py does the same
on real small file systems.
"""

import os
import shutil
import subprocess
import sys

import msgspec
import pytest
from PIL import Image

from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning.assets import resolve
from manifests.errors import InputError
from manifests.schema import Camera, Job
from manifests.store import Store
from tests.support.full_disk_case import (
    bad_records,
    check,
    check_read_only,
    contents,
    done,
    drafts,
    mesh,
    pictures,
)
from tests.support.tetrahedron import FAKE, ROOT

QUICK = (
    "preview",
    "export, tars",
    "export, records",
    "lights preview",
    "lights add",
    "lights add, of npz",
    "materials preview",
    "materials report",
    "shapes preview",
    "shapes add",
)


@pytest.fixture(scope="module")
def room(tmp_path_factory, catalogue, light_file):
    """What the commands read; the data set's pictures are made by the fake studio."""
    room = tmp_path_factory.mktemp("room")
    pictures(room)
    mesh(room)
    job = Job(
        shapes=("cube",),
        materials=("small",),
        lights=(str(light_file),),
        views=(0, 6),
        samples=1,
        camera=Camera(size=(16, 16)),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        carry_out(
            make_plan(job, resolve(job, catalogues=[catalogue])),
            room / "data",
            RunOptions(studio=FAKE),
        )
    return room


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Nothing here looks at the balls of a contact sheet: it is what is written."""
    monkeypatch.setattr(
        "factory.materials.preview.contact_sheet", lambda *_: Image.new("RGB", (32, 32))
    )


@pytest.mark.parametrize("name", QUICK)
def test_a_full_disk_costs_a_line_and_nothing_else(room, tmp_path, small_files, name):
    if name == "export, records":
        pytest.importorskip("pyarrow", reason="needs pyarrow, which is optional")
    check(name, room, tmp_path, small_files, seed=QUICK.index(name))


@pytest.mark.parametrize("name", QUICK)
def test_a_read_only_disk_can_be_read_and_costs_a_line_where_it_was_to_be_written(
    room, tmp_path, read_only, name
):
    if name == "export, records":
        pytest.importorskip("pyarrow", reason="needs pyarrow, which is optional")
    check_read_only(name, room, tmp_path, read_only)


def sizes(folder):
    """Sizes of the files of a folder."""
    return sorted({path.stat().st_size for path in folder.rglob("*") if path.is_file()} - {0})


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_a_render_on_a_full_disk_names_no_file_that_is_not_whole_and_goes_on_later(
    render, small_job, room, tmp_path, small_files, share
):
    job = msgspec.structs.replace(small_job, shapes=("cube",))
    several = sizes(room / "data")
    count = several[int(share * len(several))] - 1
    with small_files(count), pytest.raises((OSError, InputError), match="File too large"):
        render(job, tmp_path)
    assert bad_records(tmp_path) == 0 and drafts(tmp_path) == []
    assert render(job, tmp_path).failed == 0
    assert bad_records(tmp_path) == 0
    made, whole = contents(tmp_path), contents(room / "data")
    assert {k: v for k, v in made.items() if k.startswith(("images/", "geometry/"))} == {
        k: v for k, v in whole.items() if k.startswith(("images/", "geometry/"))
    }


def test_a_repair_on_a_full_disk_keeps_every_record(render, small_job, tmp_path, small_files):
    render(small_job, tmp_path, limit=3)
    path = next(iter((tmp_path / "images").rglob("*.exr")))
    path.write_bytes(b"")
    before = contents(tmp_path)
    repair = ["factory", "verify", str(tmp_path), "--repair"]
    with small_files(100):
        status, said, _ = done(repair)
    assert status == 1 and len(said) == 1 and "File too large" in said[0]
    assert contents(tmp_path) == before and drafts(tmp_path) == []
    assert done(repair)[0] == 0
    assert len(list(Store(tmp_path).records())) == 2


@pytest.mark.parametrize("command", ["verify", "status"])
def test_a_data_set_that_may_only_be_read_is_verified_and_counted(room, read_only, command):
    read_only(room)
    assert done(["factory", command, str(room / "data")])[0] == 0


def test_nothing_is_rendered_or_repaired_into_a_data_set_that_may_only_be_read(
    render, small_job, tmp_path, read_only
):
    render(small_job, tmp_path, limit=2)
    next(iter((tmp_path / "images").rglob("*.exr"))).unlink()
    read_only(tmp_path)
    with pytest.raises((OSError, InputError), match="Read-only file system"):
        render(small_job, tmp_path)
    status, said, _ = done(["factory", "verify", str(tmp_path), "--repair"])
    assert status == 1 and len(said) == 1 and "Read-only file system" in said[0]


DYING = """
import os, signal
call, count = os.{call}, 0
def dying(*arguments):
    global count
    count += 1
    if count == {number} and not os.path.exists("{mark}"):
        os.close(os.open("{mark}", os.O_CREAT))
        os.kill(os.getpid(), signal.SIGKILL)
    return call(*arguments)
os.{call} = dying
"""


@pytest.mark.parametrize(
    ("call", "number"),
    [("write", 2), ("fsync", 1), ("fsync", 5), ("replace", 3), ("replace", 4), ("link", 2)],
)
def test_a_kill_in_the_midst_of_writing_loses_nothing_and_leaves_no_draft(
    small_job, tmp_path, catalogue, light_file, call, number
):
    """By its number the call is one of the run's own, on the lights or the data set's description,
    or one of its worker's.
    """
    (tmp_path / "job.json").write_bytes(
        msgspec.json.encode(msgspec.structs.replace(small_job, lights=(light_file.name,)))
    )
    shutil.copy(light_file, tmp_path)
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(
        DYING.format(call=call, number=number, mark=tmp_path / "mark")
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (tmp_path / "site", ROOT)))}
    folder = tmp_path / "data"
    command = [
        sys.executable,
        "-m",
        "tests.support.fake_render",
        str(tmp_path / "job.json"),
        str(folder),
        str(catalogue),
    ]
    statuses = [
        subprocess.run(command, env=environment, capture_output=True).returncode for _ in range(2)
    ]
    assert (tmp_path / "mark").exists() and statuses[1] == 0
    assert bad_records(folder) == 0 and drafts(folder) == []
    assert len(Store(folder).ids()) == sum(1 for _ in Store(folder).records()) == 12
    assert done(["factory", "verify", str(folder)])[0] == 0
