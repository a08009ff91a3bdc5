"""Rendered pictures as a source: sides, partners, order and mixtures.

Bad data are reported, or left out on request.
"""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch

from learn.data import preflight, sources
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.records import Records
from learn.data.relit import RelitDataset
from learn.data.rendered import MixedDataset, RenderedDataset, RenderedSplit, fits
from learn.data.settings import Data, Losses, Run
from learn.layer import render
from learn.training import losses, validation
from manifests import materials
from manifests.errors import InputError
from manifests.store import Store
from manifests.training_runs import LAYER_METHODS
from shaders import envmap
from tests.support import synthetic
from tests.support.two_materials import SIZE, album_of, damage, first, written


@pytest.fixture
def store(tmp_path):
    """Two materials under one light at two rotations, a picture each."""
    return written(tmp_path)


@pytest.fixture(scope="module")
def rendered_split(tmp_path_factory):
    return album_of(written(tmp_path_factory.mktemp("pictures")).folder)


def data_split(rendered_split, side="train"):
    labels = {name: rendered_split.records.label(name) for name in ("dark", "light")}
    return DataSplit(
        rendered_split.geometry,
        np.arange(1),
        labels,
        [rendered_split.records.light("sky")],
        side,
        rendered_split,
    )


def test_a_pictures_target_is_the_record_of_the_other_material_under_the_same_light(rendered_split):
    batch = RenderedDataset(data_split(rendered_split, "test"), Data(), 4, SIZE, 5)[0]
    for i, name in enumerate(batch.names):
        record = next(r for r in rendered_split.records.records if r.id in name)
        other = next(
            r
            for r in rendered_split.records.records
            if r.rotation_texels == record.rotation_texels and r.materials != record.materials
        )
        mask = batch.mask[i, 0].numpy()[..., None]
        assert np.array_equal(
            batch.image[i].movedim(0, -1).numpy(), rendered_split.records.image(record) * mask
        )
        assert np.array_equal(
            batch.target[i].movedim(0, -1).numpy(), rendered_split.records.image(other) * mask
        )
        assert np.array_equal(
            batch.target_label[i, 0].numpy(), rendered_split.records.label(other.materials[0])
        )
        rolled = envmap.roll(rendered_split.records.light("sky"), record.rotation_texels)
        assert np.array_equal(batch.light[i].movedim(0, -1).numpy(), rolled)


def test_without_a_partner_the_layer_renders_the_target(rendered_split):
    lonely = RenderedSplit(
        rendered_split.records, rendered_split.geometry, rendered_split.records.records[:1]
    )
    batch = RenderedDataset(data_split(lonely, "test"), Data(), 1, SIZE, 5)[0]
    mine = validation.render_batch(batch.n, batch.target_label, batch.light, batch)
    truth = batch.target.movedim(1, -1).numpy()
    assert np.abs(mine - truth).mean() / truth.mean() < 0.03  # two methods at 1e-2 and 2e-2


@pytest.mark.parametrize("method", LAYER_METHODS)
def test_such_a_target_is_rendered_by_the_method_that_the_run_names(rendered_split, method):
    lonely = RenderedSplit(
        rendered_split.records, rendered_split.geometry, rendered_split.records.records[:1]
    )
    label = np.array(synthetic.glossy(gamma=4e3).label, np.float32).reshape(-1)
    split = replace(data_split(lonely, "test"), labels={"glossy": label})
    batch = RenderedDataset(split, Data(layer_method=method), 1, SIZE, 5)[0]
    n, light = (each.movedim(1, -1).contiguous() for each in (batch.n, batch.light))
    errors = {}
    for each in LAYER_METHODS:
        picture = render(
            n, torch.from_numpy(label).exp()[None], light, method=each, elevation=batch.elevation
        )
        errors[each] = float((picture - batch.target.movedim(1, -1)).abs().mean() / picture.mean())
    assert errors.pop(method) < 1e-3 < 0.05 < errors.popitem()[1]


def test_an_epoch_shows_each_picture_once_and_parts_make_the_whole(rendered_split):
    source = RenderedDataset(data_split(rendered_split), Data(), 2, SIZE, 5)
    for epoch in (0, 1):
        assert sorted(
            name.split(" ")[3] for k in (0, 1) for name in source[2 * epoch + k].names
        ) == sorted(r.id for r in rendered_split.chosen)
    parts = [
        RenderedDataset(data_split(rendered_split), Data(), 2, SIZE, 5, (i, 2))[3] for i in (0, 1)
    ]
    assert torch.equal(torch.cat([part.image for part in parts]), source[3].image)


def test_augmentation_moves_picture_truth_and_target_together(rendered_split):
    batch = RenderedDataset(data_split(rendered_split), Data(), 4, SIZE, 7)[0]
    inside = (batch.segments > 0)[:, None]
    assert ((batch.n.norm(dim=1, keepdim=True) > 0.5) == inside).all()
    assert (batch.picture * ~inside).abs().max() == 0
    # channels of picture, label and light permuted alike
    mine = validation.render_batch(batch.n, batch.label, batch.light, batch)
    truth = batch.picture.movedim(1, -1).numpy()
    assert np.abs(mine - truth).mean() / truth.mean() < 0.03


def test_the_loss_compares_with_the_rendered_picture(rendered_split):
    batch = RenderedDataset(data_split(rendered_split, "test"), Data(), 2, SIZE, 5)[0]
    from learn.networks.prediction import Prediction

    expected = Losses(normals=0, material=0, image=1, target=1, pixels=64, layer_light=(64, 128))
    nothing = Prediction(None, None, None, None, None)
    result = losses.terms(nothing, batch, expected, torch.Generator().manual_seed(0), None)
    # the parts are true, and the pictures are the layer's own in half precision
    assert max(result.values()) < 1e-6
    brighter = losses.terms(
        nothing,
        replace(batch, picture=batch.picture * 2),
        expected,
        torch.Generator().manual_seed(0),
        None,
    )
    assert brighter["image"] > 1e-3


def test_a_mix_takes_its_share_evenly_and_leaves_out_no_batch_of_either():
    class Numbered:
        def __init__(self, name):
            self.name = name

        def __getitem__(self, k):
            return self.name, k

    mix = MixedDataset(Numbered("relit"), Numbered("cycles"), 0.25)
    seen = [mix[k] for k in range(40)]
    assert [k for name, k in seen if name == "cycles"] == list(range(10))
    assert [k for name, k in seen if name == "relit"] == list(range(30))
    assert all(sum(name == "cycles" for name, _ in seen[k : k + 4]) == 1 for k in range(0, 40, 4))


def test_records_of_more_materials_than_regions_do_not_fit(rendered_split):
    record = rendered_split.records.records[0]
    of = lambda *names: msgspec.structs.replace(record, materials=names)  # noqa: E731 -- three uses
    assert fits(of("a", "a"), 1)
    assert not fits(of("a", "b"), 1)
    assert fits(of("a", "b", "a"), 2)


def test_the_source_is_what_the_run_says(rendered_split):
    def of(**data):
        run = Run(name="t", size=SIZE, data=Data(sharing=2, **data))
        return sources.make_batch_source(data_split(rendered_split), run, 4, 1)

    assert isinstance(of(), RelitDataset)
    assert isinstance(of(source="pictures"), RenderedDataset)
    assert isinstance(of(source="mix"), MixedDataset)


def test_no_picture_of_a_held_out_material_trains(store):
    test = next(m for m in materials.load_catalogue().values() if m.split == "test")
    dark = materials.read_catalogue(store.folder / "materials.json").materials[0]
    synthetic.exchange(store, msgspec.structs.replace(dark, name=test.name), "dark")
    assert of_training(store, Data(source="pictures", materials="built-in")) == {("light",)}
    sky = Records(store.folder).light("sky")
    with pytest.raises(InputError, match="pictures for training"):
        of_training(store, Data(source="pictures"), {"other name": ("test", envmap.roll(sky, 17))})


def test_no_picture_of_a_material_that_the_data_set_holds_out_trains(store):
    dark = materials.read_catalogue(store.folder / "materials.json").materials[0]
    assert of_training(store, Data(source="pictures")) == {("dark",), ("light",)}
    synthetic.exchange(store, msgspec.structs.replace(dark, split="test"))
    assert of_training(store, Data(source="pictures")) == {("light",)}


def test_pictures_of_every_material_train_where_nothing_but_shapes_is_held_out(store):
    dark = materials.read_catalogue(store.folder / "materials.json").materials[0]
    synthetic.exchange(store, msgspec.structs.replace(dark, split="test"))
    every = Data(source="pictures", all_materials_and_lights=True)
    assert of_training(store, every) == {("dark",), ("light",)}


def of_training(store, data, maps=None):
    """The materials of the pictures that would train."""
    records = Records(store.folder)
    maps = maps or {"sky": ("train", records.light("sky"))}
    drawn, _ = sources.split_materials(data, records)
    rendered_splits = sources._rendered_splits(
        data, store.folder, Geometry(store.folder, progress=False), maps, drawn, False, False
    )
    return {record.materials for record in rendered_splits["train"].chosen}


# Bad data


@pytest.mark.parametrize("kind", ["missing", "truncated", "not finite"])
def test_a_bad_picture_stops_before_training_or_is_left_out_and_counted(store, kind):
    path = damage(store, kind)
    records, geometry = Records(store.folder), Geometry(store.folder, progress=False)
    with pytest.raises(InputError, match=path.name) as error:
        preflight.check_records(records, records.records, geometry, progress=False)
    assert "\n" not in str(error.value)
    good, skipped = preflight.check_records(
        records, records.records, geometry, skip_bad=True, progress=False
    )
    assert set(skipped) == {first(store).id}
    assert {r.id for r in good} == {r.id for r in records.records} - set(skipped)


@pytest.mark.parametrize("kind", ["light", "label"])
def test_a_light_or_a_label_out_of_range_stops_before_training_or_its_pictures_are_left_out(
    store, kind
):
    if kind == "light":
        path = store.folder / store.dataset().lights["sky"].file
        with np.load(path) as arrays:
            L, scale = arrays["L"], arrays["scale"]
        L[3, 3, 1] = np.nan
        np.savez(path, L=L, scale=scale)
        report, bad = (
            rf"{path.name}: expected finite radiance ≥ 0, found 1 value that is not",
            {r.id for r in store.records()},
        )
    else:
        dark = materials.read_catalogue(store.folder / "materials.json").materials[0]
        label = (*dark.label[:5], 1e30, *dark.label[6:])
        hash_ = materials.material_hash(label, dark.mixture)
        synthetic.exchange(store, msgspec.structs.replace(dark, label=label, hash=hash_))
        report, bad = (
            "'dark': expected natural logarithms up to 14",
            {r.id for r in store.records() if r.materials == ("dark",)},
        )
    records, geometry = Records(store.folder), Geometry(store.folder, progress=False)
    with pytest.raises(InputError, match=report):
        preflight.check_records(records, records.records, geometry, progress=False)
    good, skipped = preflight.check_records(
        records, records.records, geometry, skip_bad=True, progress=False
    )
    assert set(skipped) == bad
    assert {r.id for r in good} == {r.id for r in records.records} - bad


def test_a_picture_that_was_good_is_checked_again_once_it_changed(store):
    records, geometry = Records(store.folder), Geometry(store.folder, progress=False)
    preflight.check_records(records, records.records, geometry, progress=False)
    damage(store, "truncated")
    with pytest.raises(InputError, match="whole OpenEXR"):
        preflight.check_records(records, records.records, geometry, progress=False)


@pytest.mark.parametrize("kind", ["empty", "not finite", "truncated"])
def test_bad_geometry_is_told_or_left_out_and_counted(store, kind):
    record = first(store)
    path = store.folder / record.geometry
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[:-700])
    else:
        normals, _, segments = Records(store.folder).geometry(record)
        if kind == "not finite":
            normals[SIZE // 2, SIZE // 2] = np.inf
        segments = segments * (kind != "empty")
        channels = {f"normal.{axis}": normals[..., k] for k, axis in enumerate("XYZ")}
        synthetic.write_exr(
            path, channels | {"depth.Z": normals[..., 2], "segment": segments.astype(np.uint32)}
        )
    with pytest.raises(InputError, match=path.name) as error:
        Geometry(store.folder, progress=False)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="geometry that can be used"):  # nothing else is there
        Geometry(store.folder, progress=False, skip_bad=True)


def test_views_that_are_left_out_leave_the_others_as_they_are(store):
    known = first(store)
    other = synthetic.add_shape(store, "ball", "train")[0]
    gone = store.folder / other.geometry
    gone.unlink()
    result = Geometry(store.folder, progress=False, skip_bad=True)
    assert set(result.skipped) == {other.geometry_hash}
    assert [view.hash for view in result.views] == [known.geometry_hash]
    again = Geometry(store.folder, progress=False, skip_bad=True)  # from what is packed
    assert np.array_equal(again.normals(0), result.normals(0))
    assert again.skipped == result.skipped
    with pytest.raises(InputError, match=gone.name):
        Geometry(store.folder, progress=False)
    good, skipped = preflight.check_records(
        Records(store.folder), [other], result, skip_bad=True, progress=False
    )
    assert not good
    assert len(skipped) == 1


def test_a_dataset_of_another_schema_version_is_refused_in_one_line(store):
    path = store.folder / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 99}))
    with pytest.raises(InputError, match=r"expected schema version 1, found 99") as error:
        sources.load_data_splits(Data(), Store(store.folder).folder, progress=False)
    assert "\n" not in str(error.value)
