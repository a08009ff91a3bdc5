"""What other programs get: every record once, its files beside it, the same bytes each time."""

import os
import tarfile

import msgspec
import pytest

from manifests import export
from manifests.errors import InputError
from manifests.export import to_parquet, to_tars
from manifests.line_files import Lines
from manifests.schema import Accuracy, Camera, Record
from manifests.store_paths import image_path


def test_tars_hold_each_record_with_its_files_and_labels_beside(a_dataset, tmp_path):
    assert to_tars(a_dataset, tmp_path / "out", each=2) == 2
    names, records = [], []
    for path in sorted((tmp_path / "out").glob("*.tar")):
        with tarfile.open(path) as tar:
            for info in tar:
                names.append(info.name)
                if info.name.endswith(".json"):
                    records.append(msgspec.json.decode(tar.extractfile(info).read(), type=Record))
                if info.name.endswith("image.exr"):
                    assert (
                        tar.extractfile(info).read()
                        == (a_dataset.folder / records[-1].image).read_bytes()
                    )
    assert records == sorted(a_dataset.records(), key=lambda r: r.id)
    assert len(names) == 9 and len(set(names)) == 9
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "000000.tar",
        "000001.tar",
        "dataset.json",
        "materials.json",
        "lights",
    }


def test_the_same_dataset_gives_the_same_tar(a_dataset, tmp_path):
    for name in ("a", "b"):
        to_tars(a_dataset, tmp_path / name)
    assert (tmp_path / "a" / "000000.tar").read_bytes() == (
        tmp_path / "b" / "000000.tar"
    ).read_bytes()


def write_record_twice(dataset):
    path = dataset.record_files()[0]
    path.write_bytes(path.read_bytes() + path.read_bytes().splitlines(keepends=True)[0])


def test_a_record_that_is_there_twice_is_in_no_tar(a_dataset, tmp_path):
    write_record_twice(a_dataset)
    with pytest.raises(InputError, match=r"each of the records once, found \w{24} twice"):
        to_tars(a_dataset, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_record_that_is_there_twice_is_in_no_table(a_dataset, tmp_path):
    pytest.importorskip(
        "pyarrow.parquet", reason="pyarrow is not installed: the Parquet export is optional"
    )
    write_record_twice(a_dataset)
    with pytest.raises(InputError, match=r"each of the records once, found \w{24} twice"):
        to_parquet(a_dataset, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": "../secret"}, "another name"),
        ({"image": "dataset.json"}, "another name"),
        ({"geometry": "../secret"}, "another name"),
        ({"geometry": "geometry/../../x/../secret.exr"}, "another name"),
        ({"id": "../../../../tmp/x"}, "id: expected str matching"),
        ({"id": "0/../../../../etc/passwd1"}, "id: expected str"),
        ({"id": "f" * 24 + "/../x"}, "id: expected str"),
        ({"id": "f" * 23 + "\0"}, "id: expected str matching"),
    ],
)
def test_a_record_that_points_outside_is_not_exported(
    a_dataset, a_record, tmp_path, changes, message
):
    (tmp_path / "secret").write_bytes(b"x")
    a_dataset.place(image_path("f" * 24), b"picture", "t")
    path = a_dataset.record_files()[0]
    value = msgspec.to_builtins(a_record("f" * 24)) | changes
    path.write_bytes(path.read_bytes() + msgspec.json.encode(value) + b"\n")
    with pytest.raises(InputError, match=message) as caught:
        to_tars(a_dataset, tmp_path / "out")
    assert str(caught.value).isprintable()
    assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]


@pytest.mark.parametrize(
    "file", ["dataset.json", "000000.tar", "../x.npz", "lights/../../x.npz", "lights/a\0.npz"]
)
def test_a_light_that_lies_elsewhere_is_not_exported(a_dataset, tmp_path, file):
    dataset = a_dataset.dataset()
    lights = {"lamp": msgspec.structs.replace(dataset.lights["lamp"], file=file)}
    a_dataset.write_json("dataset.json", msgspec.structs.replace(dataset, lights=lights))
    with pytest.raises(InputError, match="another name"):
        to_tars(a_dataset, tmp_path / "out")


@pytest.mark.parametrize("put", [os.mkfifo, lambda path: path.symlink_to(path.name), os.mkdir])
@pytest.mark.parametrize("kind", ["image", "geometry", "light", "materials"])
def test_what_is_no_file_is_not_waited_for(a_dataset, tmp_path, put, kind):
    record = next(a_dataset.records())
    name = {
        "image": record.image,
        "geometry": record.geometry,
        "light": a_dataset.dataset().lights["lamp"].file,
    }
    path = a_dataset.folder / name.get(kind, "materials.json")
    path.unlink()
    put(path)
    with pytest.raises(InputError, match=", found"):
        to_tars(a_dataset, tmp_path / "out")


def test_an_earlier_export_s_tars_do_not_stay_among_the_new_ones(a_dataset, tmp_path):
    to_tars(a_dataset, tmp_path / "out", each=1)
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").glob("*.tar")}
    with pytest.raises(
        InputError,
        match=r"out: expected a folder without tars, found 000000\.tar \(name another folder",
    ):
        to_tars(a_dataset, tmp_path / "out")
    assert {
        path.name: path.read_bytes() for path in (tmp_path / "out").glob("*.tar")
    } == before and len(before) == 3


def test_an_empty_choice_is_refused(a_dataset, tmp_path):
    with pytest.raises(InputError, match="expected records to export, found none"):
        to_tars(a_dataset, tmp_path / "out", split="test")


def test_the_table_has_a_row_a_record(a_dataset, tmp_path):
    parquet = pytest.importorskip(
        "pyarrow.parquet", reason="pyarrow is not installed: the Parquet export is optional"
    )
    assert to_parquet(a_dataset, tmp_path / "records.parquet") == 3
    rows = parquet.read_table(tmp_path / "records.parquet").to_pylist()
    assert [row["id"] for row in rows] == sorted(a_dataset.ids())
    assert rows[0]["camera.size"] == [8, 8] and rows[0]["statistics.coverage"] == 0.5


@pytest.mark.parametrize("rows", [1, 50_000])
def test_the_table_s_columns_do_not_depend_on_the_first_record(
    a_dataset, a_record, tmp_path, monkeypatch, rows
):
    parquet = pytest.importorskip(
        "pyarrow.parquet", reason="pyarrow is not installed: the Parquet export is optional"
    )
    monkeypatch.setattr(export, "ROWS", rows)
    accuracy = Accuracy(
        requested=5.0,
        estimator="denoised",
        predicted=4.0,
        estimated=3.0,
        standard_error=0.5,
        seconds=0.2,
    )
    lines = Lines(a_dataset.folder / "records" / "worker-01.jsonl")
    lines.append(
        a_record("f" * 24, accuracy=accuracy, camera=Camera(size=(8, 8), fov_deg=30.0))
    )  # the last by its id
    lines.close()
    # a folder that is missing is made, as for other results
    assert to_parquet(a_dataset, tmp_path / "a" / "b" / "records.parquet") == 4
    table = parquet.read_table(tmp_path / "a" / "b" / "records.parquet")
    rows = table.to_pylist()
    assert [row["accuracy.requested"] for row in rows] == [None, None, None, 5.0]
    assert [row["accuracy.estimator"] for row in rows] == [None, None, None, "denoised"]
    assert [row["camera.fov_deg"] for row in rows] == [None, None, None, 30.0]
    whole = msgspec.to_builtins(a_record("f" * 24, accuracy=accuracy))
    flat = {
        (f"{key}.{inner}" if inner else key)
        for key, value in whole.items()
        for inner in (value if isinstance(value, dict) else ("",))
    }
    assert set(table.column_names) == flat  # a key that the schema gains gets a column
