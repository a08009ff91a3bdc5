"""What `learn predict` writes: parts that can be read back, of a picture or a record of a dataset,
and nothing over earlier ones.
"""

import json

import msgspec
import numpy as np
import pytest
import torch
from PIL import Image

from learn.__main__ import COMMANDS
from learn.data import framing
from learn.data.settings import Run
from learn.editing import material_file, photograph, predict
from learn.editing.exposure import render_prediction
from learn.networks import weights as checkpoint
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from manifests import exr
from manifests.cli import main
from manifests.errors import InputError
from manifests.materials import load_catalogue
from shaders import envmap
from tests.support import synthetic
from tests.support.two_materials import written

SIZE = 32


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    torch.manual_seed(0)
    labels = torch.from_numpy(
        np.stack([m.label.reshape(-1) for m in load_catalogue().values()])
    ).float()
    network = Compact(Ranges.of(labels))
    run = Run(name="tiny", size=SIZE)
    checkpoint.save_weights(
        path, network, network.state_dict(), msgspec.json.encode(run).decode(), SIZE
    )
    return path


@pytest.fixture(scope="module")
def predicted(weights, tmp_path_factory):
    """The folder of a prediction of a record, and the dataset it is of."""
    store, out = written(tmp_path_factory.mktemp("data")), tmp_path_factory.mktemp("out")
    predict.run(store.folder, None, weights, out)
    return out, store


def shown(path):
    with Image.open(path) as picture:
        return np.asarray(picture)


def test_normals_are_unit_inside_the_mask_and_nothing_outside(predicted):
    channels = exr.read(predicted[0] / "normals.exr")
    lengths = np.linalg.norm(
        np.stack([channels[axis].astype(np.float32) for axis in "XYZ"], -1), axis=-1
    )
    mask = shown(predicted[0] / "mask.png") > 127
    assert mask.any()
    assert np.abs(lengths[mask] - 1).max() < 2e-3  # half floats
    assert lengths[~mask].max() == 0


def test_the_light_is_a_whole_map_of_unit_mean(predicted):
    channels = exr.read(predicted[0] / "light.exr")
    L = np.stack([channels[c].astype(np.float32) for c in "RGB"], -1)
    assert L.shape == (64, 128, 3)
    assert envmap.mean_radiance(L) @ envmap.LUMINANCE == pytest.approx(1, rel=2e-3)  # half floats


def test_the_material_is_a_label_with_the_catalogues_nearest(predicted):
    report = json.loads((predicted[0] / "material.json").read_text())
    assert len(report["label"]) == 108
    assert np.isfinite(report["label"]).all()
    catalogue = load_catalogue()
    assert len(report["nearest"]) == material_file.NEAREST
    assert set(report["nearest"]) <= set(catalogue)
    assert report["run"] == "tiny"


def test_every_part_has_its_picture_and_the_sheet_all_of_them(predicted):
    names = ("picture", "normals", "light", "material", "rendering")
    assert {shown(predicted[0] / f"{name}.png").shape[:2] for name in names} == {(SIZE, SIZE)}
    height, width = shown(predicted[0] / "sheet.png").shape[:2]
    # a row, and its captions
    assert width // predict.TILE == len(names) and predict.TILE < height < 2 * predict.TILE


def test_an_earlier_prediction_stays_unless_it_may_go(predicted, weights):
    out, store = predicted
    with pytest.raises(InputError, match="--overwrite"):
        predict.run(store.folder, None, weights, out)
    before = json.loads((out / "material.json").read_text())
    predict.run(store.folder, None, weights, out, overwrite=True)
    after = json.loads((out / "material.json").read_text())
    # the same picture; float32 sums in another order
    np.testing.assert_allclose(after["label"], before["label"], atol=1e-4)
    assert after["nearest"] == before["nearest"]


@pytest.mark.parametrize("name", predict.WRITTEN)
def test_no_file_that_is_there_is_replaced_unless_asked(predicted, weights, tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        predict.run(predicted[1].folder, None, weights, tmp_path)
    assert (tmp_path / name).read_text() == "mine"


def test_what_is_claimed_is_what_is_written(predicted):
    assert {path.name for path in predicted[0].iterdir()} == set(predict.WRITTEN)


def test_a_material_of_the_catalogue_is_its_own_nearest(weights):
    _, metadata = checkpoint.load_network(weights)
    catalogue = load_catalogue()
    for name in ("brass", "red-fabric", "blue-rubber"):
        for label in (catalogue[name].label, catalogue[name].calibrated_label):
            flat = label.reshape(108).astype(np.float32)
            assert material_file.nearest(flat, metadata["ranges"])[0] == name


def test_the_material_file_tells_where_the_object_was_and_at_what_exposure(weights, tmp_path):
    values = np.full((60, 90, 3), 120, np.uint8)
    mask = np.zeros((60, 90), np.uint8)
    mask[10:50, 30:60] = 255
    Image.fromarray(values).save(tmp_path / "p.png")
    Image.fromarray(mask).save(tmp_path / "m.png")
    predict.run(tmp_path / "p.png", tmp_path / "m.png", weights, tmp_path / "out", exposure=0.7)
    report = json.loads((tmp_path / "out" / "material.json").read_text())
    top, left, side = report["box"]
    assert report["exposure"] == 0.7
    # about the object's middle
    assert side >= 40 and (2 * top + side, 2 * left + side) == pytest.approx((60, 90), abs=1)


def test_a_record_is_rendered_again_by_its_own_camera(weights, tmp_path, rng, monkeypatch):
    seen = []
    monkeypatch.setattr(
        predict,
        "render_prediction",
        lambda batch, predicted: (
            seen.append(batch.elevation) or render_prediction(batch, predicted)
        ),
    )
    synthetic.write_dataset(
        tmp_path,
        [synthetic.matte()],
        rng,
        size=SIZE,
        seeds=1,
        rotations=(0,),
        method="quadrature",
        elevation_deg=50.0,
    )
    predict.predict_picture(tmp_path, None, weights, None, "cpu")
    assert np.degrees(seen) == pytest.approx([50.0])


@pytest.mark.parametrize(
    ("camera", "words"),
    [({"fov_deg": 40.0}, "an orthographic camera"), ({"roll_deg": 30.0}, "an upright camera")],
)
def test_a_record_by_another_camera_is_refused(weights, tmp_path, rng, camera, words):
    synthetic.write_dataset(
        tmp_path / "data", [synthetic.matte()], rng, size=SIZE, seeds=1, rotations=(0,), **camera
    )
    with pytest.raises(InputError, match=words):
        predict.run(tmp_path / "data", None, weights, tmp_path / "out")


def test_a_dataset_without_records_is_told(weights, tmp_path):
    store = written(tmp_path / "data")
    for path in store.record_files():
        path.write_bytes(b"")
    with pytest.raises(InputError, match="expected records, found none"):
        predict.run(store.folder, None, weights, tmp_path / "out")


def test_the_example_is_predicted_as_a_whole_by_the_masks_that_edit_has(weights, tmp_path):
    words = ["predict", "example:espresso-cup", "--weights", str(weights), "--device", "cpu"]
    assert main("learn", "", COMMANDS, [*words, "--out", str(tmp_path)]) == 0
    seen = photograph.open_photograph("example:espresso-cup", fit_mask=None)
    assert seen.count == 2
    framed = framing.frame_object(seen.radiance, seen.mask, SIZE)
    assert (shown(tmp_path / "mask.png") > 127).tolist() == framed.mask.tolist()
    report = json.loads((tmp_path / "material.json").read_text())
    assert report["box"] == list(framed.box) and len(report["label"]) == 108


def test_alpha_in_place_of_a_mask_is_the_pictures_transparency(weights, tmp_path, capsys):
    y, x = np.mgrid[-1:1:60j, -1:1:60j]
    inside = x * x + y * y < 0.5
    values = np.dstack([np.full((60, 60, 3), 120), 255 * inside]).astype(np.uint8)
    Image.fromarray(values).save(tmp_path / "cut-out.png")
    Image.fromarray(values[..., :3]).save(tmp_path / "opaque.png")
    words = ["--mask", "alpha", "--weights", str(weights), "--device", "cpu", "--out"]
    for name, status in (("cut-out", 0), ("opaque", 1)):
        given = ["predict", str(tmp_path / f"{name}.png"), *words, str(tmp_path / name)]
        assert main("learn", "", COMMANDS, given) == status
    assert "expected a mask, or transparency around the object" in capsys.readouterr().err
    predict.run(tmp_path / "cut-out.png", None, weights, tmp_path / "without")
    files = [tmp_path / name / "material.json" for name in ("cut-out", "without")]
    assert files[0].read_bytes() == files[1].read_bytes()
