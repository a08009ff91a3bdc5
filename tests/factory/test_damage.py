"""Files of a data set that were damaged since they were written: the next run replaces them, or
says what to do.
"""

import os
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning.assets import resolve
from manifests import exr
from manifests.errors import InputError
from manifests.light_files import read_light, read_scale
from manifests.materials import read_catalogue
from manifests.picture_files import encode_geometry, read_geometry
from manifests.schema import Camera, Job
from manifests.store import Store
from manifests.store_paths import file_hash
from manifests.verification import Verification, faults_of, repair
from tests.support.tetrahedron import FAKE, ROOT


def faults(folder):
    return faults_of(Store(folder))


def bytes_of(folder, kind):
    """{path: bytes} of all files of a kind."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in sorted((folder / kind).rglob("*.*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def template(catalogue, light_file, tmp_path_factory):
    """As `begun`: rendered once, copied for each test."""
    views = tuple(range(len(DAMAGES) + 1))
    camera = Camera(size=(16, 16))
    job = Job(
        shapes=("cube",),
        materials=("small",),
        lights=(str(light_file),),
        views=views,
        samples=1,
        camera=camera,
    )
    folder = tmp_path_factory.mktemp("template")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        first = msgspec.structs.replace(job, materials=("small/matte", "small/metal"))
        carry_out(
            make_plan(first, resolve(first, catalogues=[catalogue])),
            folder,
            RunOptions(studio=FAKE),
        )
    return folder, job


@pytest.fixture
def begun(template, tmp_path):
    """A data set of which one picture is still owed of each geometry file, and its job with all
    pictures.
    """
    folder, job = template
    shutil.copytree(folder, tmp_path / "data")
    return tmp_path / "data", job


def truncated(path):
    path.write_bytes(path.read_bytes()[:-10])


def emptied(path):
    path.write_bytes(b"")


def of_another_size(path):
    geometry = read_geometry(path)
    path.write_bytes(
        encode_geometry(
            geometry._replace(
                **{
                    name: getattr(geometry, name)[:8, :8]
                    for name in ("normals", "depth", "segments")
                }
            )
        )
    )


def turned(path):
    """Readable, of the right size, unit normals: but not what was rendered."""
    geometry = read_geometry(path)
    path.write_bytes(
        encode_geometry(
            geometry._replace(
                normals=geometry.normals[:, ::-1], segments=geometry.segments[:, ::-1]
            )
        )
    )


def not_unit(path):
    geometry = read_geometry(path)
    path.write_bytes(encode_geometry(geometry._replace(normals=geometry.normals * 0.5)))


def not_finite(path):
    geometry = read_geometry(path)
    path.write_bytes(encode_geometry(geometry._replace(depth=np.full_like(geometry.depth, np.nan))))


def a_picture(path):
    exr.write(path, {name: np.ones((16, 16), np.float16) for name in "RGB"})


def a_pipe(path):
    path.unlink()
    os.mkfifo(path)


def a_broken_link(path):
    path.unlink()
    path.symlink_to("nowhere")


DAMAGES = (
    truncated,
    emptied,
    of_another_size,
    turned,
    not_unit,
    not_finite,
    a_picture,
    a_broken_link,
)


def test_damaged_geometry_files_are_rendered_again_by_the_run_that_needs_them(render, begun):
    folder, job = begun
    whole = bytes_of(folder, "geometry")
    paths = sorted(whole)
    for damage, path in zip(DAMAGES, paths, strict=False):
        damage(folder / path)
    notes = []
    outcome = render(
        job, folder, lambda event, value: notes.append(value) if event == "note" else None
    )
    assert (outcome.made, outcome.failed, outcome.already_there) == (len(paths), 0, 2 * len(paths))
    left = bytes_of(folder, "geometry")
    assert [
        damage.__name__
        for damage, path in zip(DAMAGES, paths, strict=False)
        if left.get(path) != whole[path]
    ] == []
    assert faults(folder) == []
    assert sorted(note.split(" ")[0] for note in notes) == [
        str(path) for path in paths[: len(DAMAGES)]
    ]
    assert all("was damaged" in note and "rendered again" in note for note in notes)


def test_a_pipe_in_the_place_of_geometry_fails_its_shots_in_a_line_and_holds_nothing_up(
    render, begun
):
    """Nothing that this program makes is a pipe, so none is taken away."""
    folder, job = begun
    a_pipe(folder / sorted(bytes_of(folder, "geometry"))[1])
    outcome = render(job, folder)
    assert (outcome.made, outcome.failed) == (len(DAMAGES), 1)
    assert "a pipe" in next(Store(folder).failures()).reason


def test_damaged_geometry_whose_records_are_all_there_is_found_and_healed_by_verify_and_render(
    render, begun
):
    folder, job = begun
    render(job, folder)
    emptied(folder / sorted(bytes_of(folder, "geometry"))[1])
    result = faults(folder)
    assert len(result) == 3 and all("geometry" in fault.text for fault in result)
    assert repair(Store(folder), result) == (3, 4)  # with their pictures and the geometry
    assert render(job, folder).made == 3
    assert faults(folder) == []


def test_records_that_name_geometry_which_no_render_gives_again_are_told_and_healed(render, begun):
    """As after a change of machine between the two runs: the earlier records' hash cannot be had
    any more.
    """
    folder, job = begun
    (lines,) = Store(folder).record_files()
    records = list(Store(folder).records())
    altered = records[0].geometry
    changed = [
        msgspec.structs.replace(r, geometry_hash="0" * 64) if r.geometry == altered else r
        for r in records
    ]
    lines.write_bytes(b"".join(msgspec.json.encode(record) + b"\n" for record in changed))
    truncated(folder / altered)
    notes = []
    render(job, folder, lambda event, value: notes.append(value) if event == "note" else None)
    assert len(notes) == 2 and "verify --repair" in notes[1]
    result = faults(folder)
    assert {fault.record for fault in result} == {r.id for r in changed if r.geometry == altered}
    repair(Store(folder), result)
    assert render(job, folder).made == len(result)
    assert faults(folder) == []


def test_two_workers_that_meet_one_damaged_file_agree_on_what_lies_there(
    render, begun, monkeypatch
):
    folder, job = begun
    for path in bytes_of(folder, "geometry"):
        not_unit(folder / path)
    monkeypatch.setattr("factory.execution.pool.CHUNK", 1)
    monkeypatch.setenv("FAKE_STUDIO", "slow")
    assert render(job, folder, workers=2).failed == 0
    assert faults(folder) == []


def test_views_of_geometry_alone_replace_a_damaged_file_too(render, small_job, tmp_path):
    job = msgspec.structs.replace(small_job, pictures=False)
    render(job, tmp_path, limit=2)
    whole = bytes_of(tmp_path, "geometry")
    (lines,) = Store(tmp_path).record_files("views")
    # the second one's record is gone, its file is there
    lines.write_bytes(lines.read_bytes().splitlines(keepends=True)[0])
    for path in whole:
        emptied(tmp_path / path)
    assert render(job, tmp_path).made == 3
    left = bytes_of(tmp_path, "geometry")
    # not read by this check
    assert [path for path in whole if left[path] != whole[path]] == [
        Path(next(Store(tmp_path).views()).geometry)
    ]


@pytest.mark.parametrize("damage", [emptied, "another"])
def test_a_damaged_light_map_is_written_again_by_the_next_run(render, begun, damage):
    folder, job = begun
    (path,) = (folder / "lights").iterdir()
    whole, known = path.read_bytes(), Store(folder).dataset().lights
    if damage == "another":
        np.savez_compressed(path, L=np.roll(read_light(path), 1, axis=1), scale=1.0)
    else:
        damage(path)
    render(job, folder)
    assert path.read_bytes() == whole and Store(folder).dataset().lights == known
    assert faults(folder) == []


def test_a_damaged_light_map_is_not_taken_for_the_right_one_where_no_dataset_says_otherwise(
    render, begun
):
    """dataset.json is written after the maps: a run that was killed between the two left maps that
    nothing vouches for.
    """
    folder, job = begun
    (path,) = (folder / "lights").iterdir()
    whole = path.read_bytes()
    np.savez_compressed(path, L=read_light(path) * 2, scale=1.0)
    (folder / "dataset.json").unlink()
    render(job, folder)
    assert path.read_bytes() == whole
    assert Store(folder).dataset().lights["lamp"].file_hash == file_hash(path)


def test_a_map_that_another_machine_rounded_otherwise_stays(render, begun):
    folder, job = begun
    (path,) = (folder / "lights").iterdir()
    np.savez_compressed(
        path, L=np.nextafter(read_light(path), np.float32(np.inf)), scale=read_scale(path)
    )
    rounded = path.read_bytes()
    (folder / "dataset.json").unlink()
    render(job, folder)
    assert path.read_bytes() == rounded
    assert faults(folder) == []


@pytest.mark.parametrize("damage", [truncated, "label"])
def test_damaged_materials_that_the_job_knows_are_written_again(render, begun, damage):
    folder, job = begun
    job, path = (
        msgspec.structs.replace(job, materials=("small/matte", "small/metal")),
        folder / "materials.json",
    )
    whole = path.read_bytes()
    if damage == "label":
        entry = read_catalogue(path).materials[0]
        path.write_bytes(whole.replace(str(entry.label[0]).encode(), b"0.125", 1))
    else:
        damage(path)
    assert render(job, folder).made == 0
    assert path.read_bytes() == whole
    assert faults(folder) == []


def test_damaged_materials_of_another_job_say_what_to_do_and_so_it_works(render, begun):
    folder, job = begun
    path, first = (
        folder / "materials.json",
        msgspec.structs.replace(job, materials=("small/matte",)),
    )
    damaged = path.read_bytes()[:-10]
    path.write_bytes(damaged)
    with pytest.raises(
        InputError, match=r"delete it and render each of the folder's jobs again: they know .*metal"
    ):
        render(first, folder)
    assert path.read_bytes() == damaged
    path.unlink()
    render(first, folder)
    render(job, folder)
    assert faults(folder) == []


def test_a_lost_dataset_comes_back_with_its_jobs_and_no_picture_is_made_twice(render, begun):
    folder, job = begun
    (folder / "dataset.json").unlink()
    assert render(job, folder).already_there == 2 * len(job.views)
    assert faults(folder) == []


def test_a_damaged_record_in_the_middle_is_healed_as_its_message_says(render, begun):
    folder, job = begun
    (path,) = Store(folder).record_files()
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:2], b"damaged\n", *lines[3:]]))
    with pytest.raises(InputError, match=r"worker-00\.jsonl:3.*verify .*--repair"):
        render(job, folder)
    repair(Store(folder), list(Verification(Store(folder)).in_records()))
    repair(Store(folder), faults(folder))
    assert render(job, folder).made == len(DAMAGES) + 2
    assert faults(folder) == []
