"""Rendering into object stores, with a studio without Blender: in memory, in a folder by its URL,
and on an S3 server whose connection is disturbed.
"""

import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import msgspec
import pytest

from factory.__main__ import COMMANDS
from factory.commands.status import count_data_set
from factory.execution import leases, uploads
from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning import facts
from factory.planning.assets import resolve_unread
from manifests import cli, object_store
from manifests.cached_store import open_store
from manifests.errors import InputError
from manifests.store import Store
from manifests.verification import faults_of
from tests.endurance.kill_and_resume import compared, disturbed
from tests.support import s3_server
from tests.support.network_faults import KINDS, Proxy
from tests.support.store_content import content
from tests.support.tetrahedron import FAKE, ROOT

pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")


@pytest.fixture
def url(request, monkeypatch, tmp_path):
    """A URL in memory, of which nothing is left; scratch folders and copies lie in tmp_path."""
    import fsspec

    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    monkeypatch.setenv(object_store.VARIABLE, "0")
    monkeypatch.setattr(leases, "EXPIRED", 0.3)
    monkeypatch.setattr(leases, "RENEWED", 0.05)
    monkeypatch.setattr(leases, "PAUSE", 0.02)
    result = f"memory://{request.node.originalname}"
    yield result
    files = fsspec.filesystem("memory")
    if files.exists(result):
        files.rm(result, recursive=True)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_store_holds_what_a_folder_would(url, render, small_job, tmp_path, workers):
    folder = tmp_path / "folder"
    expected = render(small_job, folder)
    assert render(small_job, url, workers=workers) == expected
    theirs = open_store(url, fresh=True)
    assert content(theirs) == content(Store(folder)) and faults_of(theirs) == []
    report = count_data_set(url)
    assert report["records"] == report["planned"] == expected.made and not report["failed"]
    assert os.listdir(tmp_path / "scratch") == [Path(theirs.folder).name]  # the copy just read


def test_a_file_url_is_a_data_set_that_any_reader_knows(url, render, small_job, tmp_path):
    render(small_job, f"file://{tmp_path}/there", limit=5)
    render(small_job, f"file:{tmp_path}/there")
    assert faults_of(Store(tmp_path / "there")) == []
    assert len(content(Store(tmp_path / "there"))) == 12


def test_a_second_run_continues_and_keeps_each_geometry_file(url, render, small_job):
    assert render(small_job, url, limit=5).made == 5
    before = open_store(url, fresh=True)
    files = {name: before.remote.read(name) for name in before.remote.names("geometry", deep=True)}
    outcome = render(small_job, url)
    assert (outcome.made, outcome.already_there) == (7, 5)
    after = open_store(url, fresh=True)
    assert len(content(after)) == 12 and faults_of(after) == []
    assert {name: after.remote.read(name) for name in files} == files
    assert render(small_job, url).already_there == 12
    assert len(after.remote.names("records")) == 2  # a part of each run that made something


def test_a_geometry_file_of_another_writer_stays_and_is_named(url, render, small_job):
    render(small_job, url)
    remote = open_store(url).remote
    for name in remote.names("records"):
        remote._files.rm(f"{remote._base}/{name}")
    # as another machine wrote it: the same pixels in another file
    names = remote.names("geometry", deep=True)
    for name in names:
        remote.write(name, remote.read(name) + b"\0")
    render(small_job, url)
    assert all(remote.read(name).endswith(b"\0") for name in names)
    assert [fault.text for fault in faults_of(open_store(url, fresh=True))] == []


def test_parts_of_a_job_array_write_side_by_side(url, render, small_job, tmp_path):
    render(small_job, tmp_path / "folder")
    for part in (1, 2):
        render(small_job, url, shard=(part, 2))
    theirs = open_store(url, fresh=True)
    assert content(theirs) == content(Store(tmp_path / "folder")) and faults_of(theirs) == []


def test_parts_that_overlap_in_a_store_know_all_shapes_of_the_job(url, stream, small_job):
    """Each writes a dataset.json of its own over the other's, and they cannot take turns."""
    made = []

    def watch(event, value):
        if event == "made" and not made:
            made.append(value)
            assert stream(small_job, url, shard=(2, 2)).made == 6

    assert stream(small_job, url, watch, shard=(1, 2)).made == 6
    theirs = open_store(url, fresh=True)
    assert set(theirs.dataset().shapes) == {"cube", "disc"} and faults_of(theirs) == []
    assert len(content(theirs)) == count_data_set(url)["planned"] == 12


def test_what_fails_is_listed_there(url, render, small_job, monkeypatch):
    monkeypatch.setenv("FAKE_STUDIO", "nan:cube")
    outcome = render(small_job, url)
    assert (outcome.made, outcome.failed) == (6, 6)
    assert count_data_set(url)["failed"] == 6
    monkeypatch.delenv("FAKE_STUDIO")
    assert render(small_job, url).made == 6
    assert count_data_set(url)["failed"] == 0 and faults_of(open_store(url, fresh=True)) == []


def test_views_without_pictures_are_written_too(url, render, small_job, tmp_path):
    job = msgspec.structs.replace(small_job, pictures=False)
    assert render(job, url) == render(job, tmp_path / "folder")
    theirs = open_store(url, fresh=True)
    assert {v.id for v in theirs.views()} == {v.id for v in Store(tmp_path / "folder").views()}
    assert faults_of(theirs) == []


def test_what_was_read_of_shapes_is_known_to_the_next_run(
    url, render, small_job, catalogue, monkeypatch
):
    plan = make_plan(small_job, resolve_unread(small_job, catalogues=[catalogue]))
    run_options = RunOptions(studio=FAKE)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert carry_out(plan, url, run_options).made == 12
    parts = open_store(url).remote.names(facts.FOLDER)
    monkeypatch.setattr("factory.planning.reading.facts_of", lambda _: pytest.fail("it reads"))
    assert carry_out(plan, url, run_options).already_there == 12
    assert open_store(url).remote.names(facts.FOLDER) == parts != {}


def test_pictures_leave_the_scratch_folder_once_they_are_sent(
    url, render, small_job, tmp_path, monkeypatch
):
    monkeypatch.setattr(uploads, "SECONDS", 0.01)
    monkeypatch.setattr(uploads, "MOST_WAITING", 1)
    held = []

    def watch(event, value):
        if event == "made":
            held.append(len(list((tmp_path / "scratch").glob("*/images/*/*.exr"))))

    job = msgspec.structs.replace(small_job, views=tuple(range(24)))
    monkeypatch.setenv("FAKE_STUDIO", "slow")
    render(job, url, watch)
    assert len(held) == 144 and max(held) < 72
    assert len(content(open_store(url, fresh=True))) == 144


def test_a_run_waits_for_a_store_that_is_slower(url, render, small_job, monkeypatch):
    monkeypatch.setattr(uploads, "SECONDS", 0.01)
    monkeypatch.setattr(uploads, "MOST_WAITING", 3)
    written, opened_again, made = object_store.ObjectFolder.write, threading.Event(), []

    def held(self, relative, data):
        if relative.startswith("records/"):
            opened_again.wait()
        written(self, relative, data)

    monkeypatch.setattr(object_store.ObjectFolder, "write", held)
    timer = threading.Timer(1.0, lambda: made.append(len(made)) or opened_again.set())
    timer.start()
    outcome = render(small_job, url, lambda event, _: made.append(0) if event == "made" else None)
    timer.join()
    # the first part may have been begun with some of these shots, none of which it has sent
    assert max(made) <= 4 and outcome.made == 12


def test_a_store_that_is_lost_ends_the_run_in_a_line_and_the_next_one_completes_it(
    url, render, small_job, monkeypatch
):
    monkeypatch.setattr(uploads, "SECONDS", 0.01)
    monkeypatch.setenv("FAKE_STUDIO", "slow")
    written = object_store.ObjectFolder.write
    left = 3  # of records: how often leases are written depends on the machine's speed

    def lost(self, relative, data):
        nonlocal left
        left -= relative.startswith("records/")
        if left < 0:
            raise object_store.Unreachable(self.url, "a store that answers", "none", "wait")
        written(self, relative, data)

    job = msgspec.structs.replace(small_job, views=tuple(range(12)))
    with monkeypatch.context() as patch:
        patch.setattr(object_store.ObjectFolder, "write", lost)
        with pytest.raises(InputError, match="a store that answers, found none"):
            render(job, url)
    before = content(open_store(url, fresh=True))
    assert 0 < len(before) < 72
    assert render(job, url).already_there == len(before)
    after = open_store(url, fresh=True)
    assert len(content(after)) == 72 and faults_of(after) == []


def test_a_part_that_was_written_before_an_error_is_written_once(
    url, render, small_job, monkeypatch
):
    """The store has done what it was asked for and the answer is lost."""
    monkeypatch.setattr(object_store, "FIRST_PAUSE", 0.0)
    monkeypatch.setenv(object_store.VARIABLE, "60")
    made = object_store._file_system

    class Deaf:
        def __init__(self, files):
            self._files, self._seen = files, set()

        def __getattr__(self, name):
            return getattr(self._files, name)

        def pipe_file(self, path, data):
            self._files.pipe_file(path, data)
            if path not in self._seen:
                self._seen.add(path)
                raise OSError("reset by peer")

    def deaf(*words):
        files, base = made(*words)
        return Deaf(files), base

    monkeypatch.setattr(object_store, "_file_system", deaf)
    render(small_job, url)
    theirs = open_store(url, fresh=True)
    assert len(content(theirs)) == 12 and faults_of(theirs) == []


@pytest.mark.long
def test_runs_into_a_store_that_are_killed_lose_and_double_nothing(
    url, render, small_job, tmp_path, catalogue
):
    job = msgspec.structs.replace(small_job, views=tuple(range(24)), rotations=(0, 1))
    (tmp_path / "job.json").write_bytes(
        msgspec.json.encode(msgspec.structs.replace(job, lights=("lamp.exr",)))
    )
    shutil.copy(small_job.lights[0], tmp_path / "lamp.exr")
    command = [sys.executable, "-m", "tests.support.fake_render", str(tmp_path / "job.json")]
    command += [f"file://{tmp_path}/killed", str(catalogue), "0.1"]
    environment = {"PYTHONPATH": str(ROOT), "FAKE_STUDIO": "slow", "TMPDIR": str(tmp_path)}
    kills = disturbed(
        command,
        tmp_path / "killed",
        kills=4,
        window=(0.0, 0.3),
        seed=0,
        environment=environment,
        working=True,
    )
    assert kills == 4
    render(msgspec.structs.replace(job, lights=(str(tmp_path / "lamp.exr"),)), tmp_path / "whole")
    assert compared(tmp_path / "whole", tmp_path / "killed") == []
    said = [fault.text for fault in faults_of(Store(tmp_path / "killed"))]
    # drafts of killed writes, as a folder has them
    assert [text for text in said if not text.startswith("partial/")] == []


def test_ray_and_repair_need_a_folder(url, render, small_job):
    def main(words):
        return cli.main("factory", "", COMMANDS, words)

    with pytest.raises(InputError, match="a folder, not a URL"):
        render(small_job, url, ray="auto")
    render(small_job, url)
    assert main(["verify", url]) == 0
    assert main(["status", url]) == 0
    assert main(["verify", url, "--repair"]) == 1


@pytest.mark.long
def test_nothing_is_lost_or_doubled_on_an_s3_server_whose_connection_is_disturbed(
    render, small_job, monkeypatch, tmp_path
):
    """One fault of each kind; tests/endurance/cut_off_store.py makes twenty."""
    pytest.importorskip("obstore", reason="obstore is not installed (extra stores)")
    if s3_server.program() is None:
        pytest.skip(s3_server.REASON)
    monkeypatch.setattr(uploads, "SECONDS", 0.05)
    monkeypatch.setattr(object_store, "TIMEOUT", 5)
    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    monkeypatch.setenv("FAKE_STUDIO", "slow")
    job = msgspec.structs.replace(small_job, views=tuple(range(24)))
    render(job, tmp_path / "folder")
    url = f"s3://{s3_server.BUCKET}/mine"
    with s3_server.started() as port, Proxy(port) as proxy:
        for name, value in s3_server.variables(proxy.port).items():
            monkeypatch.setenv(name, value)
        kinds, made = list(KINDS), 0

        def watch(event, value):
            nonlocal made
            made += event == "made"
            if event == "made" and made % 30 == 0 and kinds:
                with proxy.fault(kinds.pop()):
                    while not proxy.disturbed:
                        pass

        outcome = render(job, url, watch, workers=2)
        assert (outcome.made, outcome.failed, kinds) == (144, 0, [])
        theirs = open_store(url, fresh=True)
        assert content(theirs) == content(Store(tmp_path / "folder"))
        assert faults_of(theirs) == []
        assert object_store.ObjectFolder(url).names(leases.FOLDER) == {}


def test_two_runs_at_once_do_not_meet_in_a_store(url, render, small_job):
    remote, notes = object_store.ObjectFolder(url), []
    first = leases.Lease(remote, None, notes.append)
    try:
        with pytest.raises(InputError, match=r"no other run writes to, found one in use"):
            render(small_job, url)
        assert len(remote.names(leases.FOLDER)) == 1 and notes == []
    finally:
        first.release()
    assert render(small_job, url).made == 12
    assert remote.names(leases.FOLDER) == {}


def test_the_claim_of_a_killed_run_expires(url, render, small_job):
    remote, notes = object_store.ObjectFolder(url), []
    remote.write(f"{leases.FOLDER}/killed.json", b'{"part":1,"parts":1,"written":7}')
    remote.write(f"{leases.FOLDER}/torn.json", b'{"pa')
    start = time.monotonic()
    leases.Lease(remote, None, notes.append).release()
    assert time.monotonic() - start >= leases.EXPIRED
    assert len(notes) == 1 and "waiting up to" in notes[0]
    assert remote.names(leases.FOLDER) == {}
    assert render(small_job, url).made == 12


@pytest.mark.parametrize(
    ("one", "other", "meet"),
    [
        ((1, 2), (2, 2), False),
        ((1, 2), (1, 2), True),
        ((1, 2), (2, 3), True),
        (None, (2, 3), True),
        ((1, 2), None, True),
    ],
)
def test_leases_of_parts_meet_where_their_shots_do(url, one, other, meet):
    remote = object_store.ObjectFolder(url)
    first = leases.Lease(remote, one, str)
    try:
        if meet:
            with pytest.raises(InputError, match="one in use"):
                leases.Lease(remote, other, str)
        else:
            leases.Lease(remote, other, str).release()
    finally:
        first.release()
    assert remote.names(leases.FOLDER) == {}


def test_a_part_of_another_job_waits_for_its_turn(url, stream, small_job):
    """Each would write a dataset.json and a materials.json over the other's."""
    other = msgspec.structs.replace(small_job, materials=("pink-felt",))
    refused = []

    def watch(event, value):
        if event == "made" and not refused:
            with pytest.raises(InputError, match="one in use") as problem:
                stream(other, url, shard=(2, 2))
            refused.append(problem)

    stream(small_job, url, watch, shard=(1, 2))
    stream(other, url, shard=(2, 2))
    theirs = open_store(url, fresh=True)
    assert refused and faults_of(theirs) == []
    materials = theirs.dataset().materials
    assert "pink-felt" in materials and len(materials) == 4


def test_a_store_with_the_files_of_something_else_is_refused(url, render, small_job):
    """As a folder is: nothing is overwritten."""
    remote = object_store.ObjectFolder(url)
    for name in ("materials.json", "records/own.jsonl"):
        remote.write(name, b'{"a": 1}\n')
        with pytest.raises(InputError, match=f"{name} of something else") as problem:
            render(small_job, url)
        assert problem.value.where == url and remote.read(name) == b'{"a": 1}\n'
        remote.remove(name)


def test_a_run_is_told_before_it_waits_for_a_claim(url, render, small_job):
    object_store.ObjectFolder(url).write(f"{leases.FOLDER}/killed.json", b"{}")
    seen = []
    render(small_job, url, watch=lambda event, value: seen.append((event, value)))
    assert seen[0][0] == "note" and "another run was killed" in seen[0][1]


def test_a_folder_of_a_killed_run_is_continued_where_it_was_copied_to(
    url, render, small_job, tmp_path
):
    """Its last line may be cut short, and workers here have the same files as those there had."""
    render(small_job, tmp_path / "folder", limit=5)
    for path in sorted(tmp_path.glob("folder/*/*.jsonl")):
        path.write_bytes(path.read_bytes() + b'{"id":"0123')
    remote = object_store.ObjectFolder(url)
    for path in sorted(tmp_path.glob("folder/**/*.*")):
        if path.is_file() and path.stat().st_size:
            remote.write(path.relative_to(tmp_path / "folder").as_posix(), path.read_bytes())
    outcome = render(small_job, url)
    assert (outcome.made, outcome.already_there) == (7, 5)
    theirs = open_store(url, fresh=True)
    assert len(content(theirs)) == 12 and faults_of(theirs) == []
