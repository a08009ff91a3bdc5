"""Learning from relit geometry: what a batch is, what a step does, and that a killed run loses
nothing.
"""

import itertools
import json
import math
import time
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from learn.data import augmentation, lights, sources
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.light_copies import KnownLights
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Losses, Run, Schedule
from learn.layer import light_maps
from learn.metrics import radiometry
from learn.networks import weights as checkpoint
from learn.networks.coding import REACH, Ranges, unit_mean
from learn.networks.compact import CELLS, Compact, CompactWrapped, reflectance_map
from learn.networks.paper import Paper
from learn.networks.prediction import Prediction
from learn.training import clock, loop, losses, rerendering, validation
from learn.training.loop import Training
from manifests.errors import InputError
from shaders import envmap
from tests.support import synthetic
from tests.support.tiny_run import ALL_TERMS

SIZE = 32


@pytest.fixture(scope="module")
def geometry(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    synthetic.write_dataset(
        folder, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="sphere"
    )
    return Geometry(folder, progress=False)


@pytest.fixture(scope="module")
def data_splits(geometry):
    rng = np.random.default_rng(2)
    label = np.log(np.array(lambertian(0.5), np.float32))
    labels = {f"m{i}": (label + rng.normal(0, 0.3, 108)).astype(np.float32) for i in range(4)}
    maps = [lights.draw_computed(rng).astype(np.float32) for _ in range(2)]
    return {
        side: DataSplit(geometry, np.arange(len(geometry)), labels, maps, side)
        for side in ("train", "validation", "test")
    }


def lambertian(albedo):
    """m (108,) of f = albedo/π: γ so small that c^γ is 1, and two empty lobes."""
    m = np.full((3, 3, 2, 6), 1e-9)
    m[:, 0, 0] = math.log1p(albedo / math.pi)
    return m.reshape(-1)


def run(**changes):
    schedule = Schedule(steps=4, batch=4, warm_up=1)
    settings = {
        "name": "test",
        "size": SIZE,
        "data": Data(sharing=2),
        "losses": ALL_TERMS,
        "schedule": schedule,
        "seed": 3,
    }
    return Run(**settings | changes)


def trained(settings, data_splits, folder, workers=0, every=2):
    training = Training(
        settings, data_splits, folder, sheet_every=1000, checkpoint_every=every, workers=workers
    )
    training.train()
    return training


def test_packed_normals_are_the_stored_ones_to_a_sixteen_bit_step(geometry):
    n, mask = synthetic.sphere(synthetic.Camera(size=(SIZE, SIZE)))
    inner = mask & (n[..., 2] > 0.3)  # n_z = √(1 − n_x² − n_y²) magnifies a step by 1/n_z
    assert np.abs(geometry.normals(0) - n)[inner].max() < 2e-4
    assert (geometry.segments(0) == mask).all()


def test_a_stale_cache_of_geometry_is_made_again(geometry):
    path = geometry.folder / "packed" / "views.json"
    path.write_text("[]")
    Geometry(geometry.folder, progress=False)
    assert json.loads(path.read_text()) == [view.hash for view in geometry.views]


def test_training_labels_lie_within_the_reach_of_tanh(rng):
    labels = torch.from_numpy(rng.normal(0, 2, (20, 108))).float()
    ranges = Ranges.of(labels, margin=0.0)
    assert ranges.code(labels).abs().max() == pytest.approx(REACH, abs=1e-5)
    # float32
    torch.testing.assert_close(ranges.label(ranges.code(labels)), labels, rtol=1e-4, atol=1e-5)


def test_a_light_scaled_to_unit_mean_has_unit_mean_luminance(rng):
    L = torch.from_numpy(rng.random((2, 3, 64, 128))).float()
    scaled = unit_mean(L, torch.from_numpy(envmap.row_solid_angles(64, 128)).float())
    for light in scaled.movedim(1, -1).numpy():
        # float32 sums
        assert envmap.mean_radiance(light) @ envmap.LUMINANCE == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("network", [Compact, CompactWrapped, Paper])
def test_networks_predict_unit_normals_codes_in_reach_and_lights_of_unit_mean(network, rng):
    net = network(Ranges(torch.zeros(108), torch.ones(108))).eval()
    image, mask = torch.rand(2, 3, 64, 64), (torch.rand(2, 1, 64, 64) > 0.5).float()
    segments = torch.randint(1, 3, (2, 64, 64)) * mask[:, 0].long()
    with torch.no_grad():
        result = net(image, mask, segments)
    torch.testing.assert_close(result.n.norm(dim=1), torch.ones(2, 64, 64), rtol=0, atol=1e-5)
    assert (result.n[:, 2] > 0).all()
    assert result.code.shape == (2, 2, 108)
    assert result.code.abs().max() <= 1
    assert result.light.shape == (2, 3, 64, 128)
    assert result.light.min() >= 0
    for light in result.light.movedim(1, -1).numpy():
        assert envmap.mean_radiance(light) @ envmap.LUMINANCE == pytest.approx(1, abs=1e-4)


def test_the_papers_coarse_scale_sees_the_whole_picture():
    """A normal in one corner depends on a pixel in the opposite one."""
    torch.manual_seed(0)
    net = Paper(Ranges(torch.zeros(108), torch.ones(108))).eval()
    image, mask = torch.rand(1, 3, 256, 256, requires_grad=True), torch.ones(1, 1, 256, 256)
    net(image, mask, parts=("normals",)).n[0, 0, 0, 0].backward()
    assert image.grad[0, :, -8:, -8:].abs().max() > 0


def test_all_fully_connected_layers_of_the_papers_light_have_dropout():
    net = Paper(Ranges(torch.zeros(108), torch.ones(108)))
    kinds = [type(layer) for layer in net.illumination]
    linear = [i for i, kind in enumerate(kinds) if kind is torch.nn.Linear]
    assert len(linear) == 2
    assert all(kinds[i + 1 : i + 3] == [torch.nn.ReLU, torch.nn.Dropout] for i in linear)


def test_the_reflectance_map_holds_a_pictures_radiance_where_its_normals_point():
    n = torch.from_numpy(synthetic.sphere(synthetic.Camera(size=(128, 128)))[0]).movedim(-1, 0)[
        None
    ]
    mask = (n[:, 2:] > 0).float()
    image = (n[:, :1] > 0).float().expand(-1, 3, -1, -1)  # white where the surface faces right
    result = reflectance_map(image, mask, n)[0]
    right, left = result[0, CELLS // 2, 3 * CELLS // 4], result[0, CELLS // 2, CELLS // 4]
    # c(1) − ½ and c(0) − ½
    assert (right.item(), left.item()) == (pytest.approx(0.5), pytest.approx(-0.5))
    assert result[3, 0, 0] == 0  # outside the disk no normal points


def test_a_batch_depends_on_seed_and_number_alone_and_parts_make_the_whole(data_splits):
    data = Data(sharing=2)
    whole = RelitDataset(data_splits["train"], data, 4, SIZE, 5)[7]
    again = RelitDataset(data_splits["train"], data, 4, SIZE, 5)[7]
    assert torch.equal(whole.image, again.image)
    parts = [RelitDataset(data_splits["train"], data, 4, SIZE, 5, (i, 2))[7] for i in (0, 1)]
    assert torch.equal(torch.cat([p.image for p in parts]), whole.image)
    assert not torch.equal(
        RelitDataset(data_splits["train"], data, 4, SIZE, 6)[7].image, whole.image
    )


def test_a_relit_picture_is_the_layers_of_its_own_truth(data_splits):
    # held-out sides are not augmented
    batch = RelitDataset(data_splits["test"], Data(sharing=2), 4, SIZE, 5)[0]
    seen = validation.render_batch(batch.n, batch.label, batch.light, batch)
    mine = batch.image.movedim(1, -1).numpy()
    assert np.abs(seen - mine).mean() / mine.mean() < 0.03  # two methods at 1e-2 and 2e-2


def test_the_true_prediction_has_no_loss(data_splits):
    batch = RelitDataset(data_splits["test"], Data(sharing=2), 4, SIZE, 5)[0]
    ranges = Ranges.of(torch.from_numpy(np.stack(list(data_splits["train"].labels.values()))))
    truth = Prediction(
        batch.n, ranges.code(batch.label), batch.label, torch.log1p(batch.light), batch.light
    )
    result = losses.terms(truth, batch, run().losses, torch.Generator().manual_seed(0), ranges)
    assert set(result) == {
        "normals",
        "material",
        "albedo",
        "light_log",
        "light_rendered",
        "image",
        "target",
    }
    assert max(value.item() for value in result.values()) < 1e-8
    wrong = truth._replace(light=batch.light.flip(-1))
    assert (
        losses.terms(wrong, batch, run().losses, torch.Generator().manual_seed(0), ranges)[
            "light_rendered"
        ]
        > 1e-3
    )


@pytest.mark.parametrize("camera_model", [0.0, 1.0])
def test_an_object_that_is_too_thin_for_the_runs_size_stops_no_training(
    data_splits, monkeypatch, camera_model
):
    """A pole of a pixel's width: of geometry twice as large, every second column is left."""
    n, segments = np.zeros((64, 64, 3), np.float32), np.zeros((64, 64), np.int64)
    n[:, 20, 2] = segments[:, 20] = 1
    split = data_splits["train"]
    monkeypatch.setattr(split.geometry, "size", (64, 64))
    monkeypatch.setattr(split.geometry, "normals", lambda view: n)
    monkeypatch.setattr(split.geometry, "segments", lambda view: segments)
    data = Data(sharing=2, camera_model=camera_model, patterns=1.0, deformations=1.0)
    batch = RelitDataset(split, data, 4, SIZE, 5)[0]
    assert not batch.segments.any() and not batch.mask.any() and batch.image.isfinite().all()
    ranges = Ranges.of(torch.from_numpy(np.stack(list(split.labels.values()))))
    network = Compact(ranges)
    prediction = network(batch.image, batch.mask)
    for rendered in ("sampled", "all"):
        terms = msgspec.structs.replace(ALL_TERMS, rendered=rendered)
        values = losses.terms(prediction, batch, terms, torch.Generator().manual_seed(0), ranges)
        assert not any(values[name].item() for name in ("normals", "image", "target"))
        losses.total(values, terms).backward(retain_graph=True)
    found = [each.grad for each in network.parameters() if each.grad is not None]
    assert found and all(gradient.isfinite().all() for gradient in found)


def test_a_highlight_that_the_camera_clipped_is_compared_with_its_true_brightness(data_splits):
    """Both ways: what is brighter than the truth costs there, though the camera shows white."""
    data = Data(sharing=2, camera_model=1.0)
    batch = RelitDataset(data_splits["train"], data, 4, SIZE, 5)[0]
    ranges = Ranges.of(torch.from_numpy(np.stack(list(data_splits["train"].labels.values()))))
    only = Losses(image=1.0, pixels=SIZE**2, layer_light=(64, 128))

    def cost(brighter, of_batch):
        label = batch.label.clone()
        label.unflatten(-1, (3, 3, 2, 6))[..., 0, :] += brighter  # log κ, about that of radiance
        prediction = Prediction(batch.n, ranges.code(label), label, None, batch.light)
        rng = torch.Generator().manual_seed(0)
        return losses.terms(prediction, of_batch, only, rng, ranges)["image"].item()

    white = replace(batch, clipped=torch.ones_like(batch.image))
    for each in (batch, white):
        assert cost(0.0, each) == pytest.approx(0, abs=1e-9)
        assert cost(0.3, each) == pytest.approx(cost(0.3, batch)) and cost(0.3, each) > 1e-4
        assert cost(-0.3, each) > 1e-4


@pytest.mark.parametrize("term", ["light_log", "light_rendered"])
def test_no_light_loss_wants_a_colour_where_the_truth_has_none(data_splits, term):
    batch = RelitDataset(data_splits["test"], Data(sharing=2), 4, SIZE, 5)[0]
    solid_angle = torch.as_tensor(
        np.asarray(envmap.row_solid_angles(64, 128)).reshape(-1), dtype=torch.float32
    )
    grey = unit_mean(batch.light.mean(1, keepdim=True).expand(-1, 3, -1, -1) ** 2, solid_angle)
    shift = torch.zeros(3, requires_grad=True)
    blurred = unit_mean(torch.ones_like(grey) * shift.exp()[:, None, None], solid_angle)
    only = Losses(**{term: 1.0})
    terms = losses.light_terms(
        Prediction(None, None, None, None, blurred), replace(batch, light=grey), only
    )
    (slope,) = torch.autograd.grad(terms[term], shift)
    assert terms[term] > 1e-3
    np.testing.assert_allclose(slope, 0, atol=1e-5)  # float32; at unit luminance 0.05 to 0.9


@pytest.mark.parametrize("albedo", [0.05, 0.8])
def test_the_log_albedo_of_a_lambertian_is_its_own(albedo):
    label = torch.from_numpy(np.log(lambertian(albedo))).float()
    # 48 nodes
    assert radiometry.log_albedo(label)[0].item() == pytest.approx(
        math.log(albedo + 1e-3), abs=2e-3
    )


def test_albedos_error_is_the_logarithm_of_their_ratio_for_each_region_that_is_shown(data_splits):
    batch = RelitDataset(data_splits["test"], Data(sharing=2, regions=2), 4, SIZE, 5)[0]
    label = np.log(np.stack([lambertian(0.2), lambertian(0.4)])).astype(np.float32)
    segments = batch.segments.clone()
    segments[0][segments[0] == 1] = 2  # the first picture does not show region 1
    segments[1:, : SIZE // 2][segments[1:, : SIZE // 2] > 0] = 2
    known = replace(batch, segments=segments, label=torch.from_numpy(label).expand(4, 2, 108))
    mine = torch.from_numpy(label[::-1].copy()).expand(4, 2, 108)
    result = validation.albedo_errors(mine, known, torch.full((3,), math.log(0.2)))
    double = pytest.approx(math.log(2), abs=0.01)  # of albedo + 1e-3
    assert math.isnan(result["albedo_1"][0])
    assert list(result["albedo_1"][1:]) == [double] * 3
    assert list(result["albedo_2"]) == [double] * 4
    assert list(result["constant_albedo_1"][1:]) == [pytest.approx(0, abs=0.01)] * 3
    assert list(result["constant_albedo_2"]) == [double] * 4
    assert set(validation.albedo_errors(mine[:, :1], known)) == {"albedo"}
    assert validation._mean(result["albedo_1"]) == double


def test_a_light_reduced_keeps_its_energy(rng):
    L = torch.from_numpy(rng.random((1, 3, 64, 128)))
    small = light_maps.reduce_maps(L, (8, 16))
    torch.testing.assert_close(
        (small * light_maps.solid_angles(small)).sum((2, 3)),
        (L * light_maps.solid_angles(L)).sum((2, 3)),
    )


def test_no_pixel_pulls_harder_than_its_bound():
    x = torch.ones(2, 5, 3, requires_grad=True)
    y = x * 1.0
    y.register_hook(rerendering.bound_gradient(torch.tensor(1e-3)))
    (y**2).sum().backward()
    assert x.grad.norm(dim=-1).max().item() == pytest.approx(1e-3, rel=1e-5)


def test_a_killed_run_ends_with_bitwise_the_same_weights(data_splits, tmp_path):
    undisturbed = trained(run(), data_splits, tmp_path / "whole")
    killed = Training(
        run(), data_splits, tmp_path / "killed", sheet_every=1000, checkpoint_every=2, workers=0
    )
    save = killed._save_checkpoint

    def die_after_saving():
        save()
        raise KeyboardInterrupt

    killed._save_checkpoint = die_after_saving
    with pytest.raises(KeyboardInterrupt):
        killed.train()
    resumed = trained(run(), data_splits, tmp_path / "killed")
    for name, tensor in undisturbed.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name]), name
    for name, tensor in undisturbed.average.items():
        assert torch.equal(tensor, resumed.average[name]), name


def test_training_lowers_its_loss(data_splits, tmp_path):
    schedule = Schedule(steps=30, batch=4, learning_rate=2e-3, warm_up=1)
    trained(
        run(schedule=schedule, losses=Losses(normals=1, material=0), parts=("normals",)),
        data_splits,
        tmp_path,
        every=100,
    )
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert np.mean([r["normals"] for r in lines[-5:]]) < 0.5 * np.mean(
        [r["normals"] for r in lines[:3]]
    )


def test_a_run_ends_by_the_clock_with_its_learning_rate_at_its_end(
    data_splits, tmp_path, monkeypatch
):
    """By a clock that is one second later whenever it is read. Time between two parts of a run does
    not count.
    """
    ticks = itertools.count()
    ticking = SimpleNamespace(monotonic=lambda: float(next(ticks)), process_time=time.process_time)
    for module in (loop, clock):
        monkeypatch.setattr(module, "time", ticking)
    schedule = Schedule(steps=1000, batch=4, warm_up=1, clock_seconds=20.0)
    own = run(schedule=schedule, parts=("normals",))
    first = Training(own, data_splits, tmp_path, sheet_every=0, checkpoint_every=1, workers=0)
    first._is_done = lambda: first.step >= 3
    first.train()
    assert first.step == 3 and 3 <= first.clock.passed < 15
    second = Training(own, data_splits, tmp_path, sheet_every=0, checkpoint_every=1, workers=0)
    assert second.clock.passed == first.clock.passed
    second.train()
    assert 20 <= second.clock.passed < 25 and 3 < second.step <= 20
    last = second.optimiser.param_groups[0]["lr"]
    assert last < 0.3 * own.schedule.learning_rate


def test_a_step_that_is_not_finite_changes_nothing_and_too_many_end_the_run(
    data_splits, tmp_path, monkeypatch
):
    monkeypatch.setattr(losses, "total", lambda result, weights: result["normals"] * math.nan)
    training = Training(run(skipped_steps=1), data_splits, tmp_path, workers=0)
    before = {name: t.clone() for name, t in training.network.named_parameters()}
    with pytest.raises(InputError, match="finite loss"):
        training.train()
    assert all(torch.equal(before[name], t) for name, t in training.network.named_parameters())
    assert len(list(tmp_path.glob("skipped-*.safetensors"))) == 2


def test_a_checkpoint_of_other_settings_is_refused(data_splits, tmp_path):
    trained(run(), data_splits, tmp_path)
    with pytest.raises(InputError, match="other settings"):
        Training(run(seed=4), data_splits, tmp_path)


def test_weights_that_are_pickled_or_of_another_size_are_refused(tmp_path):
    pickled = tmp_path / "weights.safetensors"
    pickled.write_bytes(b"\x80\x04\x95" + bytes(64))
    with pytest.raises(InputError, match="never read"):
        checkpoint.load_network(pickled)
    other = tmp_path / "other.safetensors"
    checkpoint.save(
        other,
        {"label_centre": torch.zeros(7)},
        {"format": "brdfactory weights 1", "network": "compact", "size": "128"},
    )
    with pytest.raises(InputError, match=r"label_centre.*shape"):
        checkpoint.load_network(other)


def test_weights_come_back_to_half_precision(tmp_path):
    network = Compact(Ranges(torch.full((108,), 0.25), torch.ones(108)))
    checkpoint.save_weights(
        tmp_path / "w.safetensors",
        network,
        network.state_dict(),
        msgspec.json.encode(run()).decode(),
        128,
    )
    loaded, metadata = checkpoint.load_network(tmp_path / "w.safetensors")
    assert metadata["run"]["name"] == "test"
    for (name, a), b in zip(
        network.state_dict().items(), loaded.state_dict().values(), strict=True
    ):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-4, msg=name)  # half precision


def test_sides_share_no_material_and_twin_maps_are_known(rng):
    materials, _ = sources.split_materials(Data(materials="built-in"), None)
    names = [{m.name for m in materials[side]} for side in ("train", "validation", "test")]
    assert not (names[0] & names[1] or names[0] & names[2] or names[1] & names[2])
    assert all(names)
    maps = rng.random((40, 64, 128, 3))
    known = KnownLights(dict(zip(map(str, range(40)), maps, strict=True)))
    assert known.copy_of(rng.random((64, 128, 3))) is None
    # mirrored maps have other correlations; those of another contrast, other amplitudes
    assert known.copy_of(envmap.roll(maps[17], 9)[:, ::-1] * 1.001) == "17"
    assert known.copy_of(envmap.roll(maps[38], 100) * 3) == "38"


def test_a_photographed_picture_keeps_its_radiance_but_for_exposure_and_noise(rng):
    image, mask = np.full((32, 32, 3), 0.3, np.float32), np.ones((32, 32), bool)
    draws = 1000
    ratios = np.log(
        [augmentation.vary_exposure_and_noise(rng, image, mask).mean() / 0.3 for _ in range(draws)]
    )
    sigma = augmentation.EXPOSURE / np.sqrt(draws)
    # four standard deviations: 9 %
    assert np.std(ratios) == pytest.approx(augmentation.EXPOSURE, abs=4 * sigma / np.sqrt(2))
    assert abs(np.mean(ratios)) < 4 * sigma


def test_an_eroded_mask_loses_its_rim_at_most(rng):
    mask = np.zeros((16, 16), bool)
    mask[4:12, 4:12] = True
    for _ in range(8):
        eroded = augmentation.erode_mask(rng, mask)
        assert (eroded <= mask).all()
        assert eroded[5:11, 5:11].all()


def test_what_stays_in_register_moves_with_the_picture():
    mask = np.zeros((64, 64), bool)
    mask[20:40, 10:50] = True
    moved = 0
    for seed in range(20):
        truth = torch.from_numpy(mask.astype(np.float32))[..., None]
        _, seen_mask, (seen_truth,) = augmentation.prepare_picture(
            np.random.default_rng(seed), np.ones((64, 64, 3)), mask, [truth], True
        )
        inside = seen_truth[..., 0].numpy() > 0
        assert not (seen_mask & ~inside).any()
        moved += not np.array_equal(inside, mask)
    assert moved > 10  # of 20; a shift of at most two pixels stays where it is in one case of 25
