"""docs/dataset.md says what the contract says: its arrays, its keys and its examples, and its code
reads a data set.
"""

import json
import re

import msgspec
import numpy as np
import pytest

from manifests import arrays, exr, light_files, materials, picture_files, publish, schema
from manifests.store import Store
from shaders import envmap
from tests.support import whole_dataset

STRUCTS = {
    each.__name__: each
    for each in (
        *(
            schema.Record,
            schema.Accuracy,
            schema.Camera,
            schema.Statistics,
            schema.View,
            schema.Failure,
            schema.Job,
        ),
        schema.CameraRanges,
        *(schema.Dataset, schema.Order, schema.ShapeEntry, schema.MaterialEntry, schema.LightEntry),
        *(
            materials.Catalogue,
            materials.Entry,
            materials.Errors,
            materials.Distance,
            materials.Neighbour,
            materials.MixtureData,
        ),
    )
}
WITHOUT_EXAMPLE = ("Entry", "Errors")  # pages of numbers; the page names a file that holds them


@pytest.fixture(scope="module")
def page(root):
    return (root / "docs" / "dataset.md").read_text(encoding="utf-8")


def sections(page):
    """{type's name: the text under its heading}."""
    parts = re.split(r"^### `(\w+)`.*$|^## .*$", page, flags=re.M)
    return {name: text for name, text in zip(parts[1::2], parts[2::2], strict=True) if name}


def test_the_pages_table_of_arrays_is_the_one_in_the_code(page):
    assert arrays.table() in page


def test_every_type_of_the_contract_has_a_section(page):
    assert set(sections(page)) == set(STRUCTS)
    published = {
        name
        for kind, type_ in publish.TYPES.items()
        if kind != "run"  # a training run is no part of a data set: docs/learning.md
        for name in msgspec.json.schema(type_)["$defs"]
    }
    assert published - {"Draw"} == set(
        STRUCTS
    )  # `{"random": 5}` is described with the keys that take it


@pytest.mark.parametrize("name", STRUCTS)
def test_a_section_has_every_key_of_its_type_and_no_other(page, name):
    keys = re.findall(r"^\| `(\w+)` \|", sections(page)[name], flags=re.M)
    assert keys == list(STRUCTS[name].__struct_encode_fields__)


@pytest.mark.parametrize("name", [name for name in STRUCTS if name not in WITHOUT_EXAMPLE])
def test_an_example_is_of_its_type(page, name):
    (example,) = re.findall(r"^```json\n(.*?)^```", sections(page)[name], flags=re.M | re.S)
    assert msgspec.json.decode(example, type=STRUCTS[name])
    if name != "Job":  # a person may leave out what has a default; the program writes all
        assert set(json.loads(example)) == set(STRUCTS[name].__struct_encode_fields__)


@pytest.mark.parametrize(
    "camera",
    [
        schema.Camera(size=(16, 16)),
        schema.Camera(size=(16, 24), fov_deg=40.0, pixel="centre"),
        schema.Camera(size=(16, 16), roll_deg=-7.25),
    ],
)
def test_the_pages_code_reads_what_our_own_readers_read(page, camera, tmp_path, monkeypatch):
    """Its assertions recompute ids and hashes with hashlib alone."""
    job = msgspec.structs.replace(whole_dataset.JOB, camera=camera)
    store = whole_dataset.write_dataset(tmp_path / "data", job, segments=2)
    monkeypatch.chdir(tmp_path)
    read = {}
    blocks = re.findall(r"^```python\n(.*?)^```", page, flags=re.M | re.S)
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "docs/dataset.md", "exec"), read)
    record = min(Store(store.folder).records(), key=lambda record: record.id)
    assert read["record"]["id"] == record.id
    np.testing.assert_array_equal(
        read["picture"], picture_files.read_picture(store.folder / record.image)
    )
    geometry = picture_files.read_geometry(store.folder / record.geometry)
    for name in ("normals", "depth", "segments", "mask"):
        np.testing.assert_array_equal(read[name], getattr(geometry, name), err_msg=name)
    entry = store.dataset().lights[record.light]
    L = envmap.roll(light_files.read_light(store.folder / entry.file), record.rotation_texels)
    np.testing.assert_array_equal(read["light"], L)
    assert read["label"].shape == (2, 108)


@pytest.mark.parametrize("name", list(arrays.FILES))
def test_files_hold_the_arrays_that_the_table_says(name, tmp_path):
    store = whole_dataset.write_dataset(tmp_path)
    path = next(
        path
        for path in sorted(store.folder.rglob("*"))
        if path.is_file() and path.match(pattern_of(name))
    )
    if path.suffix == ".npz":
        with np.load(path) as stored:
            result = {key: (stored[key].dtype, stored[key].shape) for key in stored.files}
        assert result == {
            a.name: (a.type, arrays.LIGHT_MEMBERS[a.name][0]) for a in arrays.FILES[name]
        }
    else:
        assert {key: v.dtype for key, v in exr.read(path).items()} == {
            # facets are in files of points alone (tests/manifests/test_stored_arrays.py)
            a.name: a.type
            for a in arrays.FILES[name]
            if a not in arrays.FACETS
        }


def pattern_of(name):
    return name.replace("ab", "??").replace("NAME-HASH", "*").replace("ID", "*")
