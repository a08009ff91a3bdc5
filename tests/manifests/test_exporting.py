"""Exports that other programs train from: read back by those programs, continued, and refused."""

import gc
import io
import json
import os
import re
import shutil

import msgspec
import numpy as np
import pytest

from manifests.errors import InputError
from manifests.exporting import FORMATS
from manifests.exporting.folders import export
from manifests.exporting.samples import Samples
from manifests.picture_files import read_geometry, read_picture
from manifests.schema import Accuracy, Camera
from manifests.store import Store

WITHOUT = {
    "webdataset": ("webdataset", "webdataset is not installed (extra export)"),
    "pyarrow": ("pyarrow.parquet", "pyarrow is not installed (extra export)"),
    "h5py": ("h5py", "could not import 'h5py' (extra export)"),
}
PACKAGE = {"parquet": "pyarrow", "huggingface": "pyarrow", "hdf5": "h5py"}


def package(name):
    """An optional package; a test that needs it is skipped where it is missing."""
    module, reason = WITHOUT[name]
    return pytest.importorskip(module, reason=reason)


@pytest.fixture(params=FORMATS)
def form(request):
    """Each format whose package is there."""
    if request.param in PACKAGE:
        package(PACKAGE[request.param])
    return request.param


def by_id(store):
    return {line.id: line for line in (*store.records(), *store.views())}


def files(folder):
    """{path: bytes} of an export's files but for its lock."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def same_arrays(store, line, arrays):
    """Whether the arrays of a sample are those of the data set's files."""
    geometry = read_geometry(store.folder / line.geometry)
    assert np.array_equal(arrays["normals"], geometry.normals)
    assert np.array_equal(arrays["depth"], geometry.depth)
    assert np.array_equal(arrays["segments"], geometry.segments)
    if "radiance" in arrays:
        assert np.array_equal(arrays["radiance"], read_picture(store.folder / line.image))


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # the package leaves its streams open
def test_webdataset_reads_each_sample_once(whole, tmp_path):
    webdataset = package("webdataset")
    store = Store(whole(segments=2))
    lines = by_id(store)
    assert export(store, tmp_path / "out", "webdataset", each=3).made == 3
    tars = sorted(str(path) for path in (tmp_path / "out").glob("*.tar"))
    seen = []
    for sample in webdataset.WebDataset(tars, shardshuffle=False).decode("rgb8"):
        line = lines[sample["__key__"]]
        seen.append(line.id)
        exposure = sample["json"].pop("exposure")
        assert msgspec.convert(sample["json"], type(line)) == line
        arrays = dict(sample["npz"])
        same_arrays(store, line, arrays)
        assert sample["png"].shape == (16, 16, 3) and sample["png"].dtype == np.uint8
        assert arrays["labels"].shape == (2, 108) and arrays["labels"][0, 0] < 0
        white = (arrays["radiance"].astype(float) * exposure >= 1.05).all(-1)
        assert (sample["png"][white] == 255).all()
    assert seen == sorted(lines) and len(seen) == 8
    del sample, arrays
    gc.collect()


def test_parquet_has_a_row_for_each_sample(whole, tmp_path):
    parquet = package("pyarrow")
    store = Store(whole())
    lines = by_id(store)
    export(store, tmp_path / "out", "parquet", each=5)
    rows = [
        row
        for path in sorted((tmp_path / "out").glob("*.parquet"))
        for row in parquet.read_table(path).to_pylist()
    ]
    assert [row["id"] for row in rows] == sorted(lines)
    for row in rows:
        line = lines[row["id"]]
        names = ("normals", "depth", "segments", "radiance")
        same_arrays(store, line, {name: np.load(io.BytesIO(row[name])) for name in names})
        assert row["picture"].startswith(b"\x89PNG")
        assert row["camera.size"] == [16, 16] and row["materials"] == list(line.materials)
        assert row["mean"] == line.statistics.mean and row["light"] == line.light


def test_a_record_that_is_there_twice_is_refused(whole, form, tmp_path):
    shutil.copytree(whole(), tmp_path / "data")
    store = Store(tmp_path / "data")
    path = store.record_files()[0]
    first = path.read_bytes().splitlines(keepends=True)[0]
    path.with_name("worker-99.jsonl").write_bytes(first)  # as of a folder that was copied into it
    message = f"{msgspec.json.decode(first)['id']} twice .*--repair"
    with pytest.raises(InputError, match=message):
        export(store, tmp_path / "out", form)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("form", ["parquet", "huggingface"])
def test_the_tables_say_how_exact_a_picture_is_where_its_record_does(whole, form, tmp_path):
    parquet = package("pyarrow")
    store = Store(shutil.copytree(whole(), tmp_path / "data"))
    accuracy = {
        "requested": 5.0,
        "estimator": "denoised",
        "predicted": 4.0,
        "estimated": 3.0,
        "standard_error": 0.5,
        "seconds": 0.2,
        "traced": "direct",
    }
    path = store.record_files()[0]
    first, *others = path.read_bytes().splitlines(keepends=True)
    line = msgspec.json.decode(first) | {"accuracy": accuracy}
    path.write_bytes(msgspec.json.encode(line) + b"\n" + b"".join(others))
    export(store, tmp_path / "out", form)
    rows = {
        row["id"]: {key: value for key, value in row.items() if key.startswith("accuracy.")}
        for path in (tmp_path / "out").rglob("*.parquet")
        for row in parquet.read_table(path).to_pylist()
    }
    # a key that the schema gains gets a column
    assert set(accuracy) == set(Accuracy.__struct_fields__)
    assert rows.pop(line["id"]) == {f"accuracy.{key}": value for key, value in accuracy.items()}
    assert list(rows.values()) == [{f"accuracy.{key}": None for key in accuracy}] * 7


LIMITED = (
    {"requested": 5.0, "estimator": "denoised", "estimated": 3.0},
    {"requested": 5.0, "estimator": "path-tracing", "estimated": 6.0},
    {"requested": 5.0, "estimator": "denoised", "estimated": 4.5},
    {"requested": 20.0, "estimator": "closed-form", "estimated": 7.25},
)
UNLIMITED = "Noise of path tracing is in the pictures: the records give the samples of each pixel."


def with_limits(folder, accuracies):
    """A data set's folder after its first records have been given accuracies."""
    path = Store(folder).record_files()[0]
    lines = path.read_bytes().splitlines(keepends=True)
    for k, accuracy in enumerate(accuracies):
        rest = {"predicted": 4.0, "standard_error": 0.5, "seconds": 0.2}
        line = msgspec.json.decode(lines[k]) | {"accuracy": accuracy | rest}
        lines[k] = msgspec.json.encode(line) + b"\n"
    path.write_bytes(b"".join(lines))
    return folder


def test_the_card_says_which_errors_were_allowed_and_what_is_known_of_bias(whole, tmp_path):
    folder = with_limits(shutil.copytree(whole(), tmp_path / "data"), LIMITED)
    export(Store(folder), tmp_path / "out", "webdataset")
    card = (tmp_path / "out" / "README.md").read_text("utf-8")
    part = card.partition("\n## Error of the pictures\n")[2].partition("\n## ")[0]
    assert "| 5 | 3 | 4.5 | 6 | 1 |" in part and "| 20 | 1 | 7.25 | 7.25 | 0 |" in part
    assert "| none | 4 |" in part
    for name, count in (("path-tracing", 1), ("denoised", 2), ("closed-form", 1)):
        assert f"| {name} | {count} |" in part
    assert "| ratio |" not in part and "at most a third of the\nlimit" in part
    assert (
        UNLIMITED not in card
        and "in the 4 pictures without a limit on their error: the" in " ".join(card.split())
    )


def test_a_card_says_nothing_of_path_tracing_alone_where_every_picture_has_a_limit(whole, tmp_path):
    folder = with_limits(shutil.copytree(whole(), tmp_path / "data"), 2 * LIMITED)
    export(Store(folder), tmp_path / "out", "webdataset")
    card = (tmp_path / "out" / "README.md").read_text("utf-8")
    assert "Noise of path tracing" not in card and "| none |" not in card


def test_a_card_of_pictures_without_limits_says_that_noise_is_in_them(whole, tmp_path):
    export(Store(whole()), tmp_path / "out", "webdataset")
    card = (tmp_path / "out" / "README.md").read_text("utf-8")
    assert UNLIMITED in card and "Error of the pictures" not in card


def test_the_hugging_face_layout_names_its_splits_and_features(whole, tmp_path):
    parquet = package("pyarrow")
    store = Store(whole())
    export(store, tmp_path / "out", "huggingface", each=3, author="A. Name")
    card = (tmp_path / "out" / "README.md").read_text("utf-8")
    front = card.split("---")[1]
    counts = {}
    for line in by_id(store).values():
        counts[line.split] = counts.get(line.split, 0) + 1
    for split, count in counts.items():
        assert f"  - split: {split}\n    path: data/{split}-*.parquet" in front
        paths = sorted((tmp_path / "out" / "data").glob(f"{split}-*.parquet"))
        assert sum(parquet.read_metadata(path).num_rows for path in paths) == count
    schema = parquet.read_schema(paths[0])
    features = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    assert list(features) == schema.names
    assert features["picture"] == {"_type": "Image"}
    assert features["camera.size"] == {
        "feature": {"dtype": "int32", "_type": "Value"},
        "_type": "List",
    }
    for words in ("A. Name, with:", "| lights | CC0 | 1 |", "| samples | 8 |", "Known limits"):
        assert words in card


def test_datasets_loads_the_hugging_face_layout(whole, tmp_path):
    datasets = pytest.importorskip("datasets", reason="the package datasets is not installed")
    export(Store(whole()), tmp_path / "out", "huggingface", each=3)
    loaded = datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))
    assert sum(split.num_rows for split in loaded.values()) == 8
    row = next(iter(loaded.values()))[0]
    assert row["picture"].size == (16, 16) and row["camera.size"] == [16, 16]
    assert np.load(io.BytesIO(row["normals"])).shape == (16, 16, 3)


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # webdataset leaves its streams open
def test_the_code_of_the_page_runs(root, whole, tmp_path, monkeypatch):
    package("webdataset"), package("h5py"), package("pyarrow")
    store = Store(whole())
    export(store, tmp_path / "demo-shards", "webdataset", each=2)
    export(store, tmp_path / "demo-parquet", "parquet", each=3)
    export(store, tmp_path / "frames", "hdf5")
    (tmp_path / "frames" / "000000").rename(tmp_path / "output")
    monkeypatch.chdir(tmp_path)
    text = (root / "docs" / "exporting.md").read_text("utf-8")
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```", text, flags=re.M | re.S):
        exec(compile(block, "exporting.md", "exec"), names)
    assert names["sample"]["npz"]["radiance"].dtype == np.float16
    assert names["frame"].geometry.mask.any()
    assert names["table"].num_rows == 8 and names["row"]["id"] in by_id(store)
    names.clear()
    gc.collect()


@pytest.mark.parametrize("fov", [None, 40.0])
def test_hdf5_has_the_keys_of_blenderproc_and_is_read_back(whole, tmp_path, fov):
    h5py = package("h5py")
    from manifests.exporting.blenderproc import FAR, read_frame
    from shaders.frames import camera_distance

    camera = Camera(size=(16, 16), fov_deg=fov)
    store = Store(whole(segments=2, camera=camera))
    lines = sorted(by_id(store).values(), key=lambda line: line.id)
    export(store, tmp_path / "out", "hdf5", each=5)
    for number, line in enumerate(lines):
        path = tmp_path / "out" / f"{number // 5:06d}" / f"{number}.hdf5"
        with h5py.File(path) as file:
            stored = {key: np.array(file[key]) for key in file}
        geometry = read_geometry(store.folder / line.geometry)
        mask = geometry.mask
        assert stored["colors"].dtype == np.uint8 and stored["colors"].shape == (16, 16, 3)
        assert np.allclose(stored["normals"][mask] * 2 - 1, geometry.normals[mask], atol=1e-6)
        assert (stored["normals"][~mask] == 0.5).all() and (stored["depth"][~mask] == FAR).all()
        assert np.array_equal(stored["instance_segmaps"], geometry.segments)
        instances = json.loads(stored["instance_attribute_maps"].tobytes())
        assert [each["idx"] for each in instances] == [0, 1, 2]
        assert instances[1]["name"] == line.materials[0]
        frame = read_frame(path)
        assert np.array_equal(frame.colors, stored["colors"])
        assert np.array_equal(frame.geometry.segments, geometry.segments)
        # the reader makes normals unit again, which their rounding to steps of 2^-15 had altered
        assert np.allclose(frame.geometry.normals, geometry.normals, rtol=0, atol=2**-15)
        away = camera_distance(line.camera.half_extent, line.camera.fov_deg)
        assert np.allclose(frame.geometry.depth[mask] - away, geometry.depth[mask], atol=1e-5)


def test_a_file_of_blenderproc_itself_is_read(tmp_path):
    """Keys, types and background of a frame as `blenderproc.writer.write_hdf5` writes them."""
    h5py = package("h5py")
    from manifests.exporting.blenderproc import read_frame

    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        normals = np.full((4, 6, 3), 0.5, np.float32)
        normals[1, 2] = (0.5, 0.5, 1.0)
        depth = np.full((4, 6), 1e10, np.float32)
        depth[1, 2] = 3.5
        segments = np.zeros((4, 6), np.uint16)
        segments[1, 2] = 7
        file.create_dataset("colors", data=np.zeros((4, 6, 3), np.uint8), compression="gzip")
        file.create_dataset("normals", data=normals, compression="gzip")
        file.create_dataset("depth", data=depth, compression="gzip")
        file.create_dataset("instance_segmaps", data=segments, compression="gzip")
        file.create_dataset("blender_proc_version", data=np.bytes_("2.7.0"))
    geometry = read_frame(tmp_path / "0.hdf5").geometry
    assert geometry.mask.sum() == 1 and geometry.segments[1, 2] == 1
    assert geometry.normals[1, 2].tolist() == [0, 0, 1] and geometry.depth[1, 2] == 3.5


def test_links_and_sizes_of_hdf5_files_are_checked_before_they_are_read(tmp_path):
    h5py = package("h5py")
    from manifests.exporting.blenderproc import read_frame

    with h5py.File(tmp_path / "secret.hdf5", "w") as file:
        file["depth"] = np.zeros((4, 4), np.float32)
    (tmp_path / "raw").write_bytes(bytes(64))

    def link(file):
        file["depth"] = h5py.ExternalLink("secret.hdf5", "/depth")

    def external(file):
        file.create_dataset("depth", (4, 4), np.float32, external=[("raw", 0, 64)])

    def virtual(file):
        layout = h5py.VirtualLayout((4, 4), np.float32)
        layout[:] = h5py.VirtualSource("secret.hdf5", "depth", (4, 4))
        file.create_virtual_dataset("depth", layout)

    def huge(file):
        file.create_dataset("depth", (1 << 20, 1 << 20), np.float32, chunks=(64, 64))

    def text(file):
        file["depth"] = np.full((4, 4), b"abc")

    def folder(file):
        file.create_group("depth")

    def unequal(file):
        file["depth"] = np.zeros((4, 4), np.float32)
        file["normals"] = np.zeros((5, 4, 3), np.float32)

    for number, make in enumerate((link, external, virtual, huge, text, folder, unequal)):
        path = tmp_path / f"{number}.hdf5"
        with h5py.File(path, "w") as file:
            make(file)
        with pytest.raises(InputError, match=", found"):
            read_frame(path)
    (tmp_path / "no.hdf5").write_bytes(b"no HDF5")
    for path in (tmp_path / "no.hdf5", tmp_path / "none.hdf5", tmp_path):
        with pytest.raises(InputError):
            read_frame(path)


def test_views_without_pictures_are_exported(whole, form, tmp_path):
    store = Store(whole(pictures=False))
    result = export(store, tmp_path / "out", form, each=3)
    assert result.samples == len(by_id(store)) == 4
    names = set(files(tmp_path / "out"))
    assert not any(name.endswith("png") for name in names)
    assert "README.md" in names
    if form in ("parquet", "huggingface"):
        parquet = package("pyarrow")
        path = next((tmp_path / "out").rglob("*.parquet"))
        row = parquet.read_table(path).to_pylist()[0]
        assert "picture" not in row and row["segment_count"] == 1 and row["coverage"] > 0


def test_views_beside_pictures_are_left_out_and_counted(whole, tmp_path, capsys):
    from brdfactory.command_line import run

    data = shutil.copytree(whole(), tmp_path / "data")
    words = ["export", str(data), "--to", "webdataset", "--out"]
    assert run([*words, str(tmp_path / "before")]) == 0
    assert "left out" not in capsys.readouterr().err
    shutil.copytree(whole(pictures=False) / "views", data / "views")
    assert run([*words, str(tmp_path / "after")]) == 0
    said = capsys.readouterr()
    assert "8 samples" in said.out
    assert "left out 4 views without pictures, because there are pictures" in said.err


def test_a_half_made_export_continues_to_the_same_bytes(whole, form, tmp_path, monkeypatch):
    store = Store(whole())
    export(store, tmp_path / "whole", form, each=2)
    read, count = Samples.read, 0

    def interrupted(self, line):
        nonlocal count
        count += 1
        if count > 5:
            raise KeyboardInterrupt
        return read(self, line)

    monkeypatch.setattr(Samples, "read", interrupted)
    with pytest.raises(KeyboardInterrupt):
        export(store, tmp_path / "out", form, each=2)
    assert "README.md" not in files(tmp_path / "out")
    again = []
    monkeypatch.setattr(Samples, "read", lambda self, line: again.append(line) or read(self, line))
    result = export(store, tmp_path / "out", form, each=2)
    assert result.already_there >= 2 and result.made >= 1
    assert len(again) < 8  # what is there is not read again
    assert files(tmp_path / "out") == files(tmp_path / "whole")
    assert export(store, tmp_path / "out", form, each=2).made == 0


def test_other_settings_another_state_and_other_folders_are_refused(whole, form, tmp_path):
    shutil.copytree(whole(), tmp_path / "data")
    store = Store(tmp_path / "data")
    export(store, tmp_path / "out", form, each=2)
    before = files(tmp_path / "out")
    with pytest.raises(InputError, match="other each"):
        export(store, tmp_path / "out", form, each=3)
    path = store.record_files()[0]
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[1:]))
    with pytest.raises(InputError, match="other samples, digest"):
        export(store, tmp_path / "out", form, each=2)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("x")
    with pytest.raises(InputError, match=r"an empty folder.*found thesis\.txt"):
        export(store, tmp_path / "mine", form)
    with pytest.raises(InputError, match="a folder, or a name for a new one"):
        export(store, tmp_path / "mine" / "thesis.txt", form)
    assert files(tmp_path / "out") == before


@pytest.mark.parametrize("form", ["parquet", "huggingface"])
def test_tables_begun_without_the_columns_of_accuracy_are_not_continued(whole, form, tmp_path):
    package("pyarrow")
    store = Store(whole())
    export(store, tmp_path / "out", form)
    settings = json.loads((tmp_path / "out" / "export.json").read_text("utf-8"))
    (tmp_path / "out" / "export.json").write_text(json.dumps(settings | {"layout": 1}), "utf-8")
    with pytest.raises(InputError, match="other layout"):
        export(store, tmp_path / "out", form)


def test_files_that_were_altered_or_lie_elsewhere_are_refused(whole, form, tmp_path):
    shutil.copytree(whole(), tmp_path / "data")
    store = Store(tmp_path / "data")
    record = min(store.records(), key=lambda line: line.id)
    (tmp_path / "secret").write_bytes((store.folder / record.image).read_bytes())
    path = store.record_files()[0]
    text = path.read_text("utf-8")
    path.write_text(text.replace(record.image, "../secret"), "utf-8")
    with pytest.raises(InputError, match="inside the data set's folder"):
        export(store, tmp_path / "a", form)
    path.write_text(text, "utf-8")
    other = max(store.records(), key=lambda line: line.id)
    shutil.copy(store.folder / other.image, store.folder / record.image)
    with pytest.raises(InputError, match="the file was altered"):
        export(store, tmp_path / "b", form)
    os.unlink(store.folder / record.image)
    os.mkfifo(store.folder / record.image)
    with pytest.raises(InputError, match="found a pipe"):
        export(store, tmp_path / "c", form)


def test_words_of_the_data_set_do_not_become_markup(whole, tmp_path):
    shutil.copytree(whole(), tmp_path / "data")
    store = Store(tmp_path / "data")
    dataset = store.dataset()
    evil = "CC0 | <script>x</script>\n---\nlicense: mit\n# [a](b)"
    lights = {
        name: msgspec.structs.replace(entry, licence=evil) for name, entry in dataset.lights.items()
    }
    store.write_json("dataset.json", msgspec.structs.replace(dataset, lights=lights))
    export(store, tmp_path / "out", "webdataset", author="<b>\n---")
    card = (tmp_path / "out" / "README.md").read_text("utf-8")
    assert card.startswith("---\n") and card.count("\n---\n") == 1
    assert "<" not in card.partition("\n---\n")[2] and "\nlicense: mit" not in card


def test_an_empty_choice_is_refused(whole, tmp_path):
    with pytest.raises(InputError, match="records to export, found none"):
        export(Store(whole()), tmp_path / "out", "webdataset", split="mixed")
    assert not (tmp_path / "out").exists()


def test_the_command_needs_both_of_its_options_and_says_what_it_did(whole, tmp_path, capsys):
    from brdfactory.command_line import run

    data = str(whole())
    for words in (["--to", "webdataset"], ["--out", str(tmp_path / "a")], []):
        assert run(["export", data, *words]) == 1
        assert "expected --to" in capsys.readouterr().err
    words = ["export", data, "--to", "webdataset", "--out", str(tmp_path / "a"), "--each", "5"]
    assert run(words) == 0
    assert "8 samples, 2 files written" in capsys.readouterr().out
    assert run(words) == 0
    assert "0 files written, 2 were there" in capsys.readouterr().out
    # the data set's own files by the same option; an earlier name does the same and says so
    folders = [tmp_path / name for name in ("tars", "earlier")]
    assert run(["export", data, "--to", "tars", "--out", str(folders[0])]) == 0
    assert "deprecated" not in capsys.readouterr().err
    assert run(["export", data, "--tars", str(folders[1])]) == 0
    assert f"write --to tars --out {folders[1]}" in capsys.readouterr().err
    contents = [{p.name: p.read_bytes() for p in f.iterdir() if p.is_file()} for f in folders]
    assert contents[0] and contents[0] == contents[1]
    words = ["export", data, "--to", "tars", "--out", "x", "--parquet", "y"]
    assert run(words) == 1 and "expected one of --to" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("form", "option", "value"), [("tars", "--by", "A. Name"), ("records", "--each", "5")]
)
def test_an_option_that_a_format_does_not_use_is_refused(
    whole, tmp_path, capsys, form, option, value
):
    from brdfactory.command_line import run

    words = ["export", str(whole()), "--to", form, "--out", str(tmp_path / "out")]
    assert run([*words, option, value]) == 1
    assert f"{option}: expected" in (message := capsys.readouterr().err) and form in message
    assert not (tmp_path / "out").exists()
