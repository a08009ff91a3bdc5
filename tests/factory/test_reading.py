"""Shapes are read while the first ones are rendered, and a run remembers what it has read."""

import os
import subprocess
import sys
import time

import msgspec
import pytest

from factory.planning import assets, facts, job_shapes, reading
from factory.planning.facts import Facts, Memory, facts_of
from factory.planning.reading import Reading
from factory.planning.shape_names import Source
from factory.shapes import files
from manifests.errors import InputError
from manifests.schema import Job
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.tetrahedron import ROOT, TETRAHEDRON, lines, written


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


@pytest.fixture
def in_processes(monkeypatch):
    """Nothing is read in this process."""
    monkeypatch.setattr(reading, "HERE", 0.0)


@pytest.fixture
def old_files(monkeypatch):
    """Files that have just been written can be remembered."""
    monkeypatch.setattr(facts, "RECENT", 0.0)


@pytest.mark.parametrize("pictures", [False, True])
def test_the_records_are_those_of_a_job_that_is_read_whole(
    stream, render, job, tmp_path, in_processes, pictures
):
    written(tmp_path / "meshes")
    (tmp_path / "meshes" / "twice.ply").write_bytes(TETRAHEDRON)
    job = msgspec.structs.replace(job, pictures=pictures)
    notes = []
    outcome = stream(job, tmp_path / "streamed", lambda *event: notes.append(event), workers=2)
    assert outcome == render(job, tmp_path / "whole", workers=2)
    kind = "records" if pictures else "views"
    assert lines(tmp_path / "streamed", kind) == lines(tmp_path / "whole", kind)
    assert [value for event, value in notes if event == "note"] == [
        "shape 'twice' is 'mesh0' again, left out"
    ]
    streamed, whole = (Store(tmp_path / name).dataset() for name in ("streamed", "whole"))
    assert streamed.shapes == whole.shapes
    assert [order.shots for order in streamed.orders] == [order.shots for order in whole.orders]
    assert [fault.text for fault in faults_of(Store(tmp_path / "streamed"))] == []


def test_views_of_the_first_shapes_are_made_before_the_last_one_is_read(
    stream, job, tmp_path, in_processes
):
    *_, last = written(tmp_path / "meshes", 4)
    flag = tmp_path / "flag"
    job = msgspec.structs.replace(job, shapes=(*job.shapes, f"{last}"))
    made = []

    def watch(event, value):
        if event == "made":
            made.append(value)
            if len(made) == 6:
                flag.touch()

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{_waiting_reader(tmp_path, last, flag)}{os.pathsep}{ROOT}")
        outcome = stream(job, tmp_path / "data", watch, workers=2)
    assert (outcome.made, outcome.failed) == (8, 0)


def _waiting_reader(folder, path, flag):
    """Return a folder for PYTHONPATH with which Python waits for a flag before it reads a mesh."""
    (folder / "sitecustomize.py").write_text(
        "import sys, time, pathlib\n"
        "import factory.planning.shape_names as names\n"
        "load = names.load_mesh\n"
        "def load_mesh(source):\n"
        f"    while source.place == {str(path)!r} and not pathlib.Path({str(flag)!r}).exists():\n"
        "        time.sleep(0.01)\n"
        "    return load(source)\n"
        "names.load_mesh = load_mesh\n"
    )
    return folder


def test_a_resumed_run_reads_nothing_that_an_earlier_one_has_read(
    stream, job, tmp_path, in_processes, old_files, monkeypatch
):
    written(tmp_path / "meshes")
    assert stream(job, tmp_path / "data").made == 12
    read = []
    monkeypatch.setattr(reading, "HERE", 1e9)
    monkeypatch.setattr(reading, "facts_of", lambda source: read.append(source) or facts_of(source))
    job = msgspec.structs.replace(job, views=(0, 6, 12))
    assert stream(job, tmp_path / "data").made == 6
    assert read == []
    written(tmp_path / "meshes", 7)  # the six others are written again and have other times
    assert stream(job, tmp_path / "data").made == 3
    assert len(read) == 7


def test_a_memory_holds_what_was_noted_and_forgets_a_file_that_has_changed(tmp_path, old_files):
    mesh, *_ = written(tmp_path / "meshes", 1)
    sources = [Source(str(mesh), name="a"), Source("cube"), Source(f"{mesh}?up=y")]
    memory = Memory(tmp_path)
    known = [facts_of(source) for source in sources]
    for source, one in zip(sources, known, strict=True):
        memory.note(memory.key(source), source, one)
    memory.close()
    memory = Memory(tmp_path, "other")
    assert [memory.recall(memory.key(source)) for source in sources] == known
    assert memory.recall(memory.key(Source(str(mesh), name="b"))) is None
    mesh.write_bytes(mesh.read_bytes() + b"\n")
    assert [memory.recall(memory.key(source)) for source in sources] == [None, known[1], None]


def test_a_file_that_changed_just_now_or_while_it_was_read_is_not_remembered(tmp_path, monkeypatch):
    mesh, *_ = written(tmp_path / "meshes", 1)
    source = Source(str(mesh))
    assert Memory(tmp_path).key(source) is None  # it was written less than two seconds ago
    monkeypatch.setattr(facts, "RECENT", 0.0)
    memory = Memory(tmp_path)
    key, known = memory.key(source), facts_of(source)
    mesh.write_bytes(b"other")
    memory.note(key, source, known)
    assert not (tmp_path / facts.FOLDER).exists()


def test_a_file_from_the_future_is_remembered(tmp_path, monkeypatch):
    mesh, *_ = written(tmp_path / "meshes", 1)
    real = facts.time.time
    monkeypatch.setattr(facts.time, "time", lambda: real() - 3600.0)  # the clock was set back
    memory, source = Memory(tmp_path), Source(str(mesh))
    memory.note(memory.key(source), source, facts_of(source))
    memory.close()
    assert Memory(tmp_path).recall(Memory(tmp_path).key(source)) == facts_of(source)


def test_other_code_reads_again(tmp_path, monkeypatch):
    memory, source = Memory(tmp_path), Source("cube")
    memory.note(memory.key(source), source, facts_of(source))
    memory.close()
    assert Memory(tmp_path).recall(Memory(tmp_path).key(source)) is not None
    monkeypatch.setattr(facts, "code_version", lambda: "another")
    assert Memory(tmp_path).recall(Memory(tmp_path).key(source)) is None


def test_a_damaged_memory_is_passed_over(tmp_path):
    memory, source = Memory(tmp_path), Source("cube")
    memory.note(memory.key(source), source, facts_of(source))
    memory.close()
    (path,) = (tmp_path / facts.FOLDER).iterdir()
    whole = path.read_bytes()
    path.write_bytes(b"{}\n\xff\n" + whole + whole[:40])
    (path.parent / "pipe.jsonl").mkdir()
    assert Memory(tmp_path).recall(Memory(tmp_path).key(source)) == facts_of(source)
    path.write_bytes(b"nothing\n")
    assert Memory(tmp_path).recall(Memory(tmp_path).key(source)) is None


@pytest.mark.parametrize("processes", [0, 2])
def test_a_bad_mesh_gives_its_own_line_and_the_first_in_order_is_named(
    tmp_path, in_processes, processes
):
    paths = written(tmp_path / "meshes", 6, damaged=(2, 4))
    reader = Reading([Source(str(path)) for path in paths], processes)
    read = []
    with pytest.raises(InputError, match=r"mesh2\.ply: expected") as there:
        read.extend(facts.name for _, facts in reader.each())
    reader.close()
    with pytest.raises(InputError) as here:
        facts_of(Source(str(paths[2])))
    assert str(there.value) == str(here.value)


def test_a_bad_mesh_ends_the_run_and_a_run_without_it_continues(
    stream, job, tmp_path, in_processes, old_files
):
    written(tmp_path / "meshes", 6, damaged=(5,))
    with pytest.raises(InputError, match=r"mesh5\.ply: expected"):
        stream(job, tmp_path / "data")
    (tmp_path / "meshes" / "mesh5.ply").unlink()
    stream(job, tmp_path / "data")
    assert len(lines(tmp_path / "data")) == 10
    assert [fault.text for fault in faults_of(Store(tmp_path / "data"))] == []


def test_a_reader_that_dies_is_replaced_once_and_then_named(tmp_path, in_processes, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(
        "import os, pathlib\n"
        "import factory.planning.shape_names as names\n"
        "load = names.load_mesh\n"
        "def load_mesh(source):\n"
        "    mark = pathlib.Path(os.environ['MARK'])\n"
        "    if source.place == 'disc' or (source.place == 'cube' and not mark.exists()):\n"
        "        mark.touch()\n"
        "        os.kill(os.getpid(), 9)\n"
        "    return load(source)\n"
        "names.load_mesh = load_mesh\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    monkeypatch.setenv("MARK", str(tmp_path / "mark"))
    reader = Reading([Source("cube"), Source("torus"), Source("disc")], 1)
    read = reader.each()
    assert [next(read)[1].name, next(read)[1].name] == ["cube", "torus"]
    with pytest.raises(InputError, match=r"disc: expected a mesh that can be read.*signal 9"):
        next(read)
    reader.close()


def test_processes_end_when_the_reading_is_given_up(tmp_path, in_processes):
    reader = Reading([Source(f"vessel:{k}") for k in range(40)], 2)
    assert list(reader.ready()) == []
    reader.close()
    assert all(process.returncode is not None for process in reader._readers._all)


def test_parts_of_a_job_array_make_every_shot_once(stream, job, tmp_path, in_processes):
    written(tmp_path / "meshes", 5)
    made = [stream(job, tmp_path / "data", shard=(i, 3)).made for i in (1, 2, 3)]
    assert sum(made) == 10
    assert max(made) - min(made) <= 1
    assert len({line["id"] for line in lines(tmp_path / "data")}) == 10


def test_a_duplicate_with_another_role_is_refused():
    arrivals = job_shapes.Arrivals(
        Job(shapes=("dish:0",), materials=("a",), lights=("b",), split="general")
    )
    known = Facts(name="dish:0", category="dish", hash="f" * 64, segments=1, report="")
    assert arrivals.take(Source("dish:0"), known).role == "test"
    other = msgspec.structs.replace(known, name="toy:1", category="toy")
    with pytest.raises(InputError, match="'toy:1': expected role test, as 'dish:0'"):
        arrivals.take(Source("toy:1"), other)


def test_a_killed_run_continues_and_ends_as_an_undisturbed_one(
    stream, job, tmp_path, catalogue, light_file
):
    written(tmp_path / "meshes", 12)
    job = msgspec.structs.replace(
        job, lights=("lamp.exr",), shapes=("meshes/",), views=tuple(range(12))
    )
    (tmp_path / "job.json").write_bytes(msgspec.json.encode(job))
    (tmp_path / "lamp.exr").write_bytes(light_file.read_bytes())
    command = [sys.executable, "-m", "tests.support.fake_stream", "job.json", "killed", catalogue]
    for _ in range(3):
        process = subprocess.Popen(
            list(map(str, command)), cwd=tmp_path, start_new_session=True, stderr=subprocess.DEVNULL
        )
        before = len(lines(tmp_path / "killed"))
        while process.poll() is None and len(lines(tmp_path / "killed")) < before + 20:
            time.sleep(0.01)
        process.kill()
        process.wait()
    subprocess.run(list(map(str, command)), cwd=tmp_path, check=True)
    job = msgspec.structs.replace(
        job, lights=(str(tmp_path / "lamp.exr"),), shapes=(f"{tmp_path}/meshes/",)
    )
    stream(job, tmp_path / "whole")
    assert lines(tmp_path / "killed") == lines(tmp_path / "whole")
    assert [fault.text for fault in faults_of(Store(tmp_path / "killed"))] == []


def test_similar_names_are_looked_for_only_where_a_file_is_missing(
    job, catalogue, tmp_path, monkeypatch
):
    """For each of thousands of files it took as long as there are files."""
    paths = written(tmp_path / "meshes")
    listed = []
    monkeypatch.setattr(files, "closest", lambda name, _: listed.append(name) or "none is near")
    for folder_or_files in (job.shapes, tuple(map(str, paths))):
        named = msgspec.structs.replace(job, shapes=folder_or_files)
        assert len(assets.resolve_unread(named, catalogues=[catalogue]).unread) == 6
    assert not listed
    lost = msgspec.structs.replace(job, shapes=(f"{tmp_path}/meshes/mesh9.ply",))
    with pytest.raises(InputError, match=r"no such file .none is near"):
        assets.resolve_unread(lost, catalogues=[catalogue])
    assert listed == ["mesh9.ply"]
