"""Parts of a job array read their own shapes alone, and make the whole job's shots once."""

import os
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack

import msgspec
import pytest

from factory.commands.status import count_data_set
from factory.execution import parts
from factory.execution.reservations import FILE, Reservations
from factory.planning import facts, reading
from factory.planning.assets import resolve_unread
from factory.planning.facts import facts_of
from factory.planning.shape_names import Source
from manifests import lock
from manifests.errors import InputError
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.tetrahedron import ROOT, TETRAHEDRON, lines, written


@pytest.fixture
def read(monkeypatch):
    """The names of the files that this process reads, which are few enough to be read here.

    Nothing is remembered between runs: files always count as changed a moment ago.
    """
    names = []

    def noted(source):
        names.append(source.place.rpartition("/")[2])
        return facts_of(source)

    monkeypatch.setattr(reading, "HERE", 1e9)
    monkeypatch.setattr(facts, "RECENT", 1e9)
    monkeypatch.setattr(reading, "facts_of", noted)
    return names


def require_whole(folder, expected, kind="views"):
    """Assert that a data set has the shots of another one, each once, and each mesh once."""
    made = lines(folder, kind)
    assert Counter(line["id"] for line in made) == Counter(
        line["id"] for line in lines(expected, kind)
    )
    dataset, whole = Store(folder).dataset(), Store(expected).dataset()
    hashes = [entry.hash for entry in dataset.shapes.values()]
    assert sorted(hashes) == sorted(entry.hash for entry in whole.shapes.values())
    assert [order.shots for order in dataset.orders] == [order.shots for order in whole.orders]
    assert [fault.text for fault in faults_of(Store(folder))] == []


@pytest.mark.parametrize("count", [1, 2, 7, 12, 50])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 12])
def test_shares_of_all_parts_cover_each_shot_once_and_read_few_sources(count, n):
    sources = [Source(f"cube:{k}") for k in range(count)]
    for shots in (1, 2, 8):
        made = Counter()
        for i in range(1, n + 1):
            own = parts.split_sources(sources, (i, n))
            assert len({share.source for share in own}) == len(own) <= -(-count // n) + 1
            part = [(s.source, shot) for s in own for shot in range(*s.bounds(shots))]
            assert abs(len(part) - count * shots / n) < 1
            made.update(part)
        assert made == Counter({(source, shot): 1 for source in sources for shot in range(shots)})


def test_a_part_holds_a_bit_of_every_family():
    """The sources of a part come from all places of the job's list."""
    families = [f"{family}:{k}" for family in ("chair", "car", "stone") for k in range(40)]
    for i in range(1, 21):
        own = parts.split_sources([Source(name) for name in families], (i, 20))
        counts = Counter(share.source.place.partition(":")[0] for share in own)
        assert set(counts.values()) <= {1, 2, 3} and len(counts) == 3


def test_a_part_reads_its_own_shapes_alone(stream, render, job, tmp_path, read):
    written(tmp_path / "meshes", 9)
    numbers = []
    for i in (1, 2, 3):
        assert stream(job, tmp_path / "data", shard=(i, 3)).made == 6
        numbers.append(sorted(int(name[4:-4]) for name in read))
        read.clear()
    assert numbers == [[0, 3, 6], [1, 4, 7], [2, 5, 8]]
    render(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_a_source_at_a_cut_is_read_by_both_parts_that_share_its_shots(
    stream, render, job, tmp_path, read
):
    written(tmp_path / "meshes", 7)
    job = msgspec.structs.replace(job, pictures=True)  # six each
    outcomes = []
    for i in (1, 2, 3):
        outcomes.append(stream(job, tmp_path / "data", shard=(i, 3)))
        assert len(read) == 3
        read.clear()
    assert [outcome.made for outcome in outcomes] == [14, 14, 14]
    assert [outcome.already_there for outcome in outcomes] == [0, 0, 0]
    render(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole", "records")


def test_a_job_with_fewer_shapes_than_parts_is_divided_by_shots(stream, job, tmp_path, read):
    written(tmp_path / "meshes", 3)
    made = [stream(job, tmp_path / "data", shard=(i, 4)).made for i in (1, 2, 3, 4)]
    assert made == [1, 2, 1, 2]
    assert len(read) == 12


def test_the_first_views_are_made_before_the_parts_last_shape_is_read(
    stream, job, tmp_path, monkeypatch
):
    """And without a look at the shapes of the others, which would end the run."""
    paths = written(tmp_path / "meshes", 8)
    (tmp_path / "sitecustomize.py").write_text(
        "import time, pathlib\n"
        "import factory.planning.shape_names as names\n"
        "load = names.load_mesh\n"
        "def load_mesh(source):\n"
        f"    if source.place in {[str(path) for path in paths[1::2]]!r}:\n"
        "        raise RuntimeError('another part reads it')\n"
        "    end = time.monotonic() + 60\n"
        f"    while source.place == {str(paths[6])!r} and time.monotonic() < end:\n"
        f"        if pathlib.Path({str(tmp_path / 'flag')!r}).exists():\n"
        "            break\n"
        "        time.sleep(0.01)\n"
        "    return load(source)\n"
        "names.load_mesh = load_mesh\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    monkeypatch.setattr(reading, "HERE", 0.0)
    made, unread, unread_then = [], [], []

    def watch(event, value):
        if event == "unread":
            unread.append(value)
        if event == "made":
            made.append(value)
            if len(made) == 2:
                unread_then.append(unread[-1])
                (tmp_path / "flag").touch()

    assert stream(job, tmp_path / "data", watch, shard=(1, 2)).made == 8
    assert unread_then[0] > 0 and max(unread) <= 4 and unread[-1] == 0


def with_copies(job, folder):
    """Write six meshes, of which some lie in other files, too; return the job with all ten files.

    mesh5's copy has its name as well.
    """
    written(folder / "meshes", 6)
    for name, k in (("meshes/copy0", 0), ("meshes/copy3", 3), ("meshes/again0", 0), ("mesh5", 5)):
        (folder / f"{name}.ply").write_bytes((folder / "meshes" / f"mesh{k}.ply").read_bytes())
    return msgspec.structs.replace(job, shapes=(*job.shapes, f"{folder}/mesh5.ply"))


@pytest.mark.parametrize(
    ("order", "pictures"), [((1, 2, 3), False), ((3, 2, 1), False), ((2, 3, 1), True)]
)
def test_a_mesh_that_several_parts_read_is_made_once(
    stream, render, job, tmp_path, order, pictures
):
    job = msgspec.structs.replace(with_copies(job, tmp_path), pictures=pictures)
    notes = []
    made = [
        stream(job, tmp_path / "data", lambda *event: notes.append(event), shard=(i, 3)).made
        for i in order
    ]
    assert sum(made) == 6 * (6 if pictures else 2)
    said = [value for event, value in notes if event == "note"]
    # a source at a cut is left out by both parts that read it, and says so twice; mesh5 again says
    # nothing, because the name is the same
    assert len(set(said)) == 3 and all(note.endswith("again, left out") for note in said)
    render(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole", "records" if pictures else "views")


def test_parts_at_the_same_time_register_and_make_each_mesh_once(
    stream, job, tmp_path, catalogue, light_file
):
    job = with_copies(job, tmp_path)
    for k in range(6, 20):
        text = TETRAHEDRON.replace(b"0 0 2\n", f"0 0 {2 + k}\n".encode())
        for name in (f"mesh{k}", f"twin{k}"):
            (tmp_path / "meshes" / f"{name}.ply").write_bytes(text)
    run = _command(job, tmp_path, catalogue, light_file)
    processes = [run(f"{i}/4") for i in (1, 2, 3, 4)]
    assert [process.wait(timeout=300) for process in processes] == [0, 0, 0, 0]
    stream(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_a_part_waits_for_its_turn_and_sees_what_another_has_reserved_meanwhile(
    stream, job, tmp_path, catalogue
):
    written(tmp_path / "meshes", 3)
    same = tmp_path / "meshes" / "copy0.ply"  # first in the list, and of the first part
    same.write_bytes((tmp_path / "meshes" / "mesh0.ply").read_bytes())
    sources = resolve_unread(job, catalogues=[catalogue]).unread
    other = next(source for source in sources if source.place.endswith("mesh0.ply"))
    threads = []

    def reserve(turn):
        time.sleep(0.5)  # as long as another part may take
        reservations = Reservations(tmp_path / "data", job, sources, shared=True)
        assert reservations.reserve(facts_of(other).hash, other, 2)
        reservations.write()
        turn.close()

    def watch(event, value):
        if event == "unread" and not threads:
            turn = ExitStack()
            turn.enter_context(lock.changing(tmp_path / "data"))
            threads.append(threading.Thread(target=reserve, args=(turn,)))
            threads[0].start()

    assert stream(job, tmp_path / "data", watch, shard=(1, 2)).made == 2
    threads[0].join()
    assert {line["shape"] for line in lines(tmp_path / "data")} == {"mesh1"}


def test_a_pipe_in_the_place_of_what_is_reserved_ends_the_part_in_a_line(stream, job, tmp_path):
    written(tmp_path / "meshes", 2)
    (tmp_path / "data").mkdir()
    os.mkfifo(tmp_path / "data" / FILE)
    with pytest.raises(InputError, match=rf"{FILE}: expected a file of lines"):
        stream(job, tmp_path / "data", shard=(1, 2))


def test_all_shapes_are_read_where_their_roles_depend_on_each_other(stream, job, tmp_path, read):
    written(tmp_path / "meshes", 4)
    job = msgspec.structs.replace(job, split="paper")
    assert [stream(job, tmp_path / "data", shard=(i, 2)).made for i in (1, 2)] == [4, 4]
    assert len(read) == 8


def _command(job, folder, catalogue, light_file):
    """Return a function that starts the job, or its part "I/N"; both write to folder/data."""
    places = tuple(shape.removeprefix(f"{folder}/") for shape in job.shapes)
    job = msgspec.structs.replace(job, lights=("lamp.exr",), shapes=places)
    (folder / "job.json").write_bytes(msgspec.json.encode(job))
    (folder / "lamp.exr").write_bytes(light_file.read_bytes())

    def run(*part):
        words = ["-m", "tests.support.fake_stream", "job.json", "data", str(catalogue), *part]
        return subprocess.Popen(
            [sys.executable, *words],
            cwd=folder,
            start_new_session=True,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )

    return run


def test_parts_that_are_killed_continue_and_lose_and_double_nothing(
    stream, job, tmp_path, catalogue, light_file
):
    job = msgspec.structs.replace(with_copies(job, tmp_path), views=tuple(range(24)))
    run = _command(job, tmp_path, catalogue, light_file)
    for _ in range(3):
        processes = [run(f"{i}/2") for i in (1, 2)]
        before = len(lines(tmp_path / "data"))
        while len(lines(tmp_path / "data")) < before + 8 and any(
            process.poll() is None for process in processes
        ):
            time.sleep(0.01)
        for process in processes:
            process.kill()
            process.wait()
    with lock.writing(tmp_path / "data"):  # waits until the last workers have noticed
        assert 0 < len(lines(tmp_path / "data")) < 144
    processes = [run(f"{i}/3") for i in (1, 2, 3)]
    assert [process.wait(timeout=300) for process in processes] == [0, 0, 0]
    made = lines(tmp_path / "data")
    assert run().wait(timeout=300) == 0  # it removes the drafts of killed parts
    assert lines(tmp_path / "data") == made
    stream(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_a_folder_continues_with_another_number_of_parts(stream, job, tmp_path):
    job = msgspec.structs.replace(with_copies(job, tmp_path), views=(0, 6, 12))
    made = stream(job, tmp_path / "data", shard=(2, 2), limit=4).made
    made += stream(job, tmp_path / "data", shard=(1, 2), limit=2).made
    made += sum(stream(job, tmp_path / "data", shard=(i, 3), limit=2).made for i in (3, 1, 2))
    assert 6 < made <= 12
    made += sum(stream(job, tmp_path / "data", shard=(i, 4)).made for i in (4, 2, 1, 3))
    assert made == 18 and stream(job, tmp_path / "data").made == 0
    stream(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_a_run_of_the_whole_job_completes_what_parts_have_begun(stream, job, tmp_path):
    job = with_copies(job, tmp_path)
    assert stream(job, tmp_path / "data", shard=(2, 2), limit=5).made == 5
    outcome = stream(job, tmp_path / "data")
    assert (outcome.made, outcome.already_there) == (7, 5)
    stream(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_a_folder_that_was_divided_by_shots_continues_by_shapes(stream, render, job, tmp_path):
    job = with_copies(job, tmp_path)
    assert render(job, tmp_path / "data", shard=(1, 2)).made == 6  # all shapes are read
    made = [stream(job, tmp_path / "data", shard=(i, 2)).made for i in (1, 2)]
    assert sum(made) == 6
    render(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_what_is_reserved_may_be_lost_or_damaged_between_runs(stream, job, tmp_path):
    job = with_copies(job, tmp_path)
    assert stream(job, tmp_path / "data", shard=(2, 2), limit=5).made == 5
    path = tmp_path / "data" / FILE
    path.write_bytes(b"{}\n\xff\n" + path.read_bytes()[:40])
    made = sum(stream(job, tmp_path / "data", shard=(i, 2)).made for i in (1, 2))
    assert made == 7
    assert len({line["id"] for line in lines(tmp_path / "data")}) == 12
    assert [fault.text for fault in faults_of(Store(tmp_path / "data"))] == []


def test_a_mesh_that_a_source_of_another_job_has_reserved_is_free(stream, job, tmp_path):
    """Of jobs with the same settings, which differ in their shapes alone, and of the same job after
    the file was removed.
    """
    job = with_copies(job, tmp_path)
    first = msgspec.structs.replace(job, shapes=(f"{tmp_path}/meshes/copy0.ply",))
    assert stream(first, tmp_path / "data", shard=(1, 1)).made == 2
    assert sum(stream(job, tmp_path / "data", shard=(i, 2)).made for i in (1, 2)) == 10
    stream(job, tmp_path / "removed", shard=(1, 2))
    source = Source(f"{tmp_path}/meshes/copy0.ply")
    gone = Reservations(tmp_path / "gone", job, [source], shared=True)
    (tmp_path / "gone").mkdir()
    assert gone.reserve("f" * 64, source, 2)
    gone.write()
    other = Source(f"{tmp_path}/meshes/mesh0.ply")
    for sources, is_free in (([other], True), ([other, source], False)):
        reservations = Reservations(tmp_path / "gone", job, sources, shared=True)
        reservations.refresh()
        assert reservations.reserve("f" * 64, other, 2) is is_free


def test_a_bad_mesh_ends_the_parts_that_read_it_and_no_other(stream, job, tmp_path):
    written(tmp_path / "meshes", 6, damaged=(3,))
    assert stream(job, tmp_path / "data", shard=(1, 2)).made == 6
    with pytest.raises(InputError, match=r"mesh3\.ply: expected"):
        stream(job, tmp_path / "data", shard=(2, 2))
    written(tmp_path / "meshes", 6)
    assert stream(job, tmp_path / "data", shard=(2, 2)).made == 6
    stream(job, tmp_path / "whole")
    require_whole(tmp_path / "data", tmp_path / "whole")


def test_two_meshes_of_one_name_in_different_parts_are_refused(stream, job, tmp_path):
    written(tmp_path / "meshes", 4)
    (tmp_path / "mesh0.ply").write_bytes(TETRAHEDRON.replace(b"0 0 2\n", b"0 0 9\n"))
    job = msgspec.structs.replace(job, shapes=(*job.shapes, f"{tmp_path}/mesh0.ply"))
    outcomes = [stream(job, tmp_path / "data", shard=(i, 5)).made for i in (1, 2, 3, 4)]
    assert outcomes == [2, 2, 2, 2]
    with pytest.raises(InputError, match="shape 'mesh0': expected the one already there"):
        stream(job, tmp_path / "data", shard=(5, 5))
    assert len(Store(tmp_path / "data").dataset().shapes) == 4


def test_status_counts_what_all_parts_have_read_so_far(stream, job, tmp_path):
    written(tmp_path / "meshes", 6)
    seen = []

    def watch(event, value):
        if event == "unread" and not seen:
            seen.append(count_data_set(f"{tmp_path}/data")["planned"])

    for i, planned, read_before in ((2, 4, 0), (1, 8, 4), (3, 12, 8)):
        seen.clear()
        stream(job, tmp_path / "data", watch, shard=(i, 3))
        report = count_data_set(f"{tmp_path}/data")
        assert (seen, report["planned"], report["views"]) == ([read_before], planned, planned)
        # again: what was read before is not counted twice
        assert stream(job, tmp_path / "data", shard=(i, 3)).already_there == 4
        assert count_data_set(f"{tmp_path}/data")["planned"] == planned


def test_a_part_without_a_shape_of_the_jobs_roles_says_so_and_ends_well(stream, job, tmp_path):
    paths = written(tmp_path / "meshes", 8)
    stream(job, tmp_path / "whole")
    shapes = Store(tmp_path / "whole").dataset().shapes
    sides = {path: shapes[path.stem].side for path in paths}
    assert set(sides.values()) == {"test", "train"}
    chosen = [next(path for path in paths if sides[path] == side) for side in ("train", "test")]
    job = msgspec.structs.replace(job, shapes=tuple(map(str, chosen)), roles=("test",))
    notes, made = [], []
    for i in (1, 2):
        outcome = stream(job, tmp_path / "data", lambda *e: notes.append(e), shard=(i, 2))
        made.append(outcome.made)
    assert made == [0, 2]
    said = [value for event, value in notes if event == "note"]
    assert said == ["part 1 of 2 has no shapes with a role among test"]


@pytest.mark.parametrize("by", ["shapes", "shots"])
def test_a_job_without_a_shot_ends_with_one_line(stream, render, job, tmp_path, by):
    paths = written(tmp_path / "meshes", 8)
    stream(job, tmp_path / "whole")
    shapes = Store(tmp_path / "whole").dataset().shapes
    chosen = tuple(str(path) for path in paths if shapes[path.stem].side == "train")
    job = msgspec.structs.replace(
        job, shapes=chosen, materials=("small/test",), pictures=True, mixed=False
    )
    with pytest.raises(InputError) as caught:
        (stream if by == "shapes" else render)(job, tmp_path / "data")
    assert str(caught.value) == (
        "job: mixed: expected shapes and materials of one split, because it is false, found shapes"
        " of train alone, and no material of it (name other shapes or materials, or leave mixed"
        " out)"
    )


def test_the_total_of_a_part_is_its_own(stream, job, tmp_path):
    written(tmp_path / "meshes", 7)
    totals = []
    stream(
        job,
        tmp_path / "data",
        lambda event, value: totals.append(value) if event == "total" else None,
        shard=(2, 3),
    )
    assert totals[-1] == len(lines(tmp_path / "data")) == 5
