"""Records become tensors in the layer's conventions, and damaged datasets are named in one line."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from learn.data.geometry import Geometry
from learn.data.records import Records
from learn.editing import photograph
from learn.evaluation import ladder, run
from learn.layer import render
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.store import Store
from manifests.store_paths import file_hash
from tests.support import synthetic


@pytest.fixture
def folder(tmp_path, rng):
    synthetic.write_dataset(tmp_path, [synthetic.matte()], rng, noise=0.0)
    return tmp_path


def test_a_record_rendered_by_the_layer_is_its_own_picture(folder):
    records = Records(folder)
    assert len(records) == 4
    for sample in records:
        seen = render(**sample.for_layer(), method="exact")[0]
        # the file holds halves: 2^-11 of each value
        torch.testing.assert_close(sample.image, seen, rtol=6e-4, atol=0)


def test_records_and_geometry_are_read_by_a_url_as_from_the_folder(folder, tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")
    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    here = Records(folder)
    for url in (f"file://{folder}", Path(f"file://{folder}")):  # options make paths of arguments
        there = Records(url)
        assert there.folder.is_relative_to(tmp_path / "copies")
        for ours, theirs in zip(here, there, strict=True):
            assert ours.record == theirs.record
            torch.testing.assert_close(ours.for_layer(), theirs.for_layer(), rtol=0, atol=0)
    geometry = Geometry(f"file://{folder}", progress=False)
    assert geometry.views == Geometry(folder, progress=False).views
    assert (there.folder / "packed").is_dir()


@pytest.mark.parametrize("module", [run, ladder])
def test_the_settings_of_an_evaluation_are_those_of_the_folder(
    folder, tmp_path, monkeypatch, module
):
    pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")
    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    here = module.Options(data=folder, weights=folder / "materials.json", out=tmp_path)
    there = replace(here, data=Path(f"file://{folder}"))
    assert module.settings(there) == module.settings(here)


def test_a_copy_of_what_was_rendered_again_on_a_store_is_replaced(folder, tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")
    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    url = f"file://{folder}"
    assert len(list(Records(url))) == 4  # all files are copied
    store = Store(folder)
    records, (path,) = list(store.records()), store.record_files()
    for name in {name for record in records for name in (record.image, record.geometry)}:
        # the same pixels in another file, as another machine may write them
        (folder / name).write_bytes((folder / name).read_bytes() + b"\0")
    path.unlink()
    lines = Lines(folder / "records" / "worker-09.jsonl")
    for record in records:
        hashes = {
            "image_hash": file_hash(folder / record.image),
            "geometry_hash": file_hash(folder / record.geometry),
        }
        lines.append(msgspec.structs.replace(record, **hashes))
    lines.close()
    there = Records(url)
    for ours, theirs in zip(Records(folder), there, strict=True):
        torch.testing.assert_close(ours.for_layer(), theirs.for_layer(), rtol=0, atol=0)
    # what is altered on the store itself is refused as before
    (folder / records[0].image).write_bytes((folder / records[0].image).read_bytes() + b"\0")
    (there.folder / records[0].image).unlink()
    with pytest.raises(InputError, match="the file was altered"):
        there.image(there.records[[r.id for r in there.records].index(records[0].id)])


def test_the_light_is_rolled_by_the_records_rotation(folder):
    straight, turned = (
        Records(folder, lambda r: r.rotation_texels == 0)[0],
        Records(folder, lambda r: r.rotation_texels == 5)[0],
    )
    torch.testing.assert_close(turned.light[:, 5], straight.light[:, 0], rtol=0, atol=0)


def test_a_perspective_record_has_view_vectors(tmp_path, rng):
    synthetic.write_dataset(tmp_path, [synthetic.matte()], rng, fov_deg=40.0, noise=0.0)
    sample = Records(tmp_path)[0]
    np.testing.assert_allclose(sample.view.norm(dim=-1), 1, atol=1e-6)
    assert sample.view[12, 0, 0] > 0.1  # left of the axis the viewer lies to the right
    torch.testing.assert_close(
        sample.image, render(**sample.for_layer(), method="exact")[0], rtol=6e-4, atol=0
    )


def test_a_rolled_record_is_rendered_upright_and_refused_where_elevation_alone_counts(
    tmp_path, rng
):
    synthetic.write_dataset(tmp_path, [synthetic.matte()], rng, roll_deg=30.0, noise=0.0)
    sample = Records(tmp_path)[0]
    # what the picture shows to the right, turned clockwise by 30°, is to the lower right
    right = torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(sample.upright(right), torch.tensor([0.75**0.5, -0.5, 0.0]))
    seen = render(**sample.for_layer(), method="exact")[0]
    torch.testing.assert_close(sample.image, seen, rtol=6e-4, atol=0)
    for look in (lambda: sample.elevation, lambda: photograph.open_photograph(tmp_path)):
        with pytest.raises(InputError, match="an upright camera"):
            look()


def test_records_come_in_the_same_order_whatever_wrote_them(folder):
    lines = folder / "records" / "worker-00.jsonl"
    before = [record.id for record in Records(folder).records]
    lines.write_text("".join(reversed(lines.read_text().splitlines(keepends=True))))
    assert [record.id for record in Records(folder).records] == before


def damage(folder, what):
    if what == "truncated picture":
        path = next(folder.glob("images/*/*.exr"))
        path.write_bytes(path.read_bytes()[:300])
    elif what == "missing geometry":
        next(folder.glob("geometry/*/*.exr")).unlink()
    elif what == "truncated light":
        path = next(folder.glob("lights/*.npz"))
        path.write_bytes(path.read_bytes()[:300])
    elif what == "no materials":
        (folder / "materials.json").write_text(
            '{"title": "none", "credit": "none", "materials": []}'
        )
    elif what == "no dataset":
        (folder / "dataset.json").unlink()


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("truncated picture", "expected a whole OpenEXR file"),
        ("missing geometry", "expected an OpenEXR file, found no such file"),
        ("truncated light", "expected a stored light map"),
        ("no materials", "expected an entry for 'matte', which a record names, found none"),
        ("no dataset", r"expected a data set \(dataset.json\), found none"),
    ],
)
def test_a_damaged_dataset_is_named_in_one_line(folder, what, message):
    damage(folder, what)
    with pytest.raises(InputError, match=message) as caught:
        [Records(folder)[i] for i in range(4)]
    assert "\n" not in str(caught.value)
