"""verify finds every kind of damage, names the record, and repair leaves a clean folder behind."""

import msgspec
import pytest

from manifests.schema import Record
from manifests.store import Lines, geometry_path, image_path
from manifests.verification import faults_in_files, faults_in_records, repair, shared_between

ID = f"{1:024x}"


def faults(store, normals=()):
    found = list(faults_in_records(store))
    condemned = {f.record for f in found}
    return found + list(faults_in_files(store, store.records(lambda r: r.id not in condemned), lambda path, record: normals))


def texts(store, normals=()):
    return "\n".join(f.text for f in faults(store, normals))


def rewrite(store, **changes):
    path = store.record_files()[0]
    records = [msgspec.json.decode(line, type=Record) for line in path.read_bytes().splitlines()]
    records = [msgspec.structs.replace(r, **changes) if r.id == ID else r for r in records]
    path.write_bytes(b"".join(msgspec.json.encode(r) + b"\n" for r in records))


def test_a_good_folder_has_no_faults(a_dataset):
    assert faults(a_dataset) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": "../../etc/passwd"}, "a path inside the dataset's folder expected"),
        ({"geometry": "/etc/passwd"}, "a path inside the dataset's folder expected"),
        ({"image": "images/ab/other.exr"}, "image at images/00"),
        ({"image_hash": "1" * 64}, "the file was altered"),
        ({"shape": "cube"}, "shape 'cube' in dataset.json expected, found none"),
        ({"shape_hash": "6" * 64}, "shape 'sphere' with hash 555555555555 expected, found 666666666666"),
        ({"light_hash": "6" * 64}, "light 'lamp' with hash"),
        ({"materials": ("gold",)}, "material 'gold' in dataset.json expected, found none"),
        ({"materials": ("matte", "matte")}, "1 materials, one a segment, expected, found 2"),
        ({"split": "test"}, "split train expected, found test"),
    ],
)
def test_a_record_that_does_not_fit_is_named(a_dataset, changes, message):
    rewrite(a_dataset, **changes)
    assert message in texts(a_dataset)
    assert any(f.record == ID for f in faults(a_dataset))


def test_missing_altered_and_stray_files_are_found(a_dataset):
    (a_dataset.folder / image_path(ID)).unlink()
    (a_dataset.folder / image_path(f"{2:024x}")).write_bytes(b"other")
    (a_dataset.folder / "images" / "00" / "stray.exr").write_bytes(b"")
    (a_dataset.folder / "lights" / "lamp-777777777777.npz").write_bytes(b"")
    (a_dataset.folder / "partial" / "worker-00-x.exr").write_bytes(b"")
    found = texts(a_dataset)
    assert f"{image_path(ID)}: a file expected, found none" in found
    assert f"{image_path(f'{2:024x}')}: hash" in found
    assert "stray.exr: a record that names it expected" in found
    assert "lamp-777777777777.npz: hash" in found
    assert "half-written" in found


def test_a_bad_geometry_condemns_every_record_that_uses_it(a_dataset):
    (a_dataset.folder / geometry_path("9" * 24)).write_bytes(b"other")
    assert len({f.record for f in faults(a_dataset)}) == 3
    assert texts(a_dataset, normals=["unit normals expected"]).count("hash") == 3


def test_normals_are_judged_once_a_geometry(a_dataset):
    assert texts(a_dataset, normals=["unit normals expected"]).count("unit normals expected") == 3
    calls = []
    list(faults_in_files(a_dataset, a_dataset.records(), lambda path, record: calls.append(path) or []))
    assert len(calls) == 1


def test_duplicates_torn_and_foreign_lines_are_found(a_dataset, a_record):
    lines = Lines(a_dataset.folder / "records" / "worker-01.jsonl")
    lines.append(a_record(ID))
    lines.close()
    with open(a_dataset.folder / "records" / "worker-02.jsonl", "wb") as file:
        file.write(b'{"id": 3}\n{"id": "abc')
    found = texts_of_records(a_dataset)
    assert f"record {ID}: once expected, found again" in found
    assert "worker-02.jsonl:1: a record expected" in found
    assert "worker-02.jsonl:2: a whole line expected" in found


def texts_of_records(store):
    return "\n".join(f.text for f in faults_in_records(store))


def test_repair_takes_away_what_is_broken_and_nothing_else(a_dataset):
    (a_dataset.folder / image_path(ID)).unlink()
    (a_dataset.folder / "images" / "00" / "stray.exr").write_bytes(b"")
    assert repair(a_dataset, faults(a_dataset)) == (1, 1)
    assert faults(a_dataset) == []
    assert a_dataset.ids() == {f"{0:024x}", f"{2:024x}"}


def test_a_changed_label_is_found(a_dataset):
    path = a_dataset.folder / "materials.json"
    path.write_text(path.read_text().replace("3" * 64, "4" * 64))
    assert "materials.json: 'matte' with hash 333333333333 expected, found 444444444444" in texts(a_dataset)


def test_what_trains_here_and_tests_there_is_found(a_dataset):
    ours = a_dataset.dataset()
    other = {"ball": msgspec.structs.replace(ours.shapes["sphere"], side="test", role="test")}
    theirs = msgspec.structs.replace(ours, shapes=other, materials={})
    assert shared_between({"a": ours, "b": theirs}) == [("shape", "sphere", "a", "ball", "b")]
    assert shared_between({"a": ours, "b": ours}) == []
