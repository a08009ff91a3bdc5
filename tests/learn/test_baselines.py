"""The methods that Section 4.5 compares with: they train, come back from their files, and keep the
tables' protocol.
"""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch

from learn import baselines
from learn.baselines import material_swap, posterior, priors
from learn.data import lights
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Losses, Run, Schedule
from learn.evaluation import baseline_methods as methods
from learn.evaluation.methods import render_by_layer
from learn.layer import render
from learn.networks import weights as checkpoint
from learn.networks.coding import Ranges, compress
from learn.networks.encoder_decoder import EncoderDecoder, radiance
from learn.networks.separate import Separate
from learn.training.loop import Training
from manifests.errors import InputError
from shaders import envmap
from tests.support import synthetic

SIZE = 32


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A search of fewer evaluations, pixels and lights."""
    monkeypatch.setattr(posterior, "STAGES", (((8, 16), 20), ((16, 32), 15)))
    monkeypatch.setattr(posterior, "PIXELS", 48)


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    synthetic.write_dataset(
        folder, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="sphere"
    )
    geometry, rng = Geometry(folder, progress=False), np.random.default_rng(2)
    labels = {f"m{i}": painted(albedo) for i, albedo in enumerate(np.linspace(0.05, 0.9, 12))}
    maps = [lights.draw_computed(rng).astype(np.float32) for _ in range(6)]
    return {
        side: DataSplit(geometry, np.arange(len(geometry)), labels, maps, side)
        for side in ("train", "validation", "test")
    }


def painted(albedo):
    """label (108,) of a matte material, one albedo in each channel: γ so small that c^γ is 1, two
    lobes next to nothing.
    """
    m = np.full((3, 3, 2, 6), 1e-3, np.float32)
    m[:, 0, 0] = np.log1p(albedo * np.array([1.0, 0.8, 0.6]) / np.pi)[:, None]
    return np.log(m).reshape(-1)


def run(network, **losses):
    parts = ("material",) if network == "encoder-decoder" else ("normals", "material", "light")
    schedule = Schedule(steps=2, batch=4, warm_up=1)
    return Run(
        name="test",
        network=network,
        size=SIZE,
        parts=parts,
        data=Data(sharing=2),
        losses=Losses(**losses),
        schedule=schedule,
    )


@pytest.fixture(scope="module")
def known(data_splits):
    return priors.fit(list(data_splits["train"].labels.values()), data_splits["train"].maps)


@pytest.fixture(scope="module")
def folder(data_splits, known, tmp_path_factory):
    """Weights of two steps, and priors: all that `found` looks for."""
    out = tmp_path_factory.mktemp("baselines")
    for name, kind, settings in (
        (
            "baseline-1",
            material_swap.SwapTraining,
            run("encoder-decoder", normals=0, material=1, target=20),
        ),
        ("baseline-2", Training, run("separate", normals=1, material=1, light_log=1)),
    ):
        kind(settings, data_splits, out / name, sheet_every=2, workers=0).train()
        (out / name / "weights.safetensors").rename(out / f"{name}.safetensors")
    priors.save(out / "lombardi.safetensors", known, {})
    return out


@pytest.fixture
def batch(data_splits):
    """One picture of the test side."""
    return RelitDataset(data_splits["test"], Data(sharing=1), 1, SIZE, 5)[0]


def test_all_three_are_found_in_a_folder_and_keep_the_protocol(folder, batch):
    present, missing = methods.present_and_missing(folder)
    assert [method.name for method in present] == [
        "Lombardi-like, true normals",
        "Baseline 1",
        "Baseline 2",
    ]
    assert not missing
    mask = batch.mask[0, 0].numpy() > 0
    for method in present:
        picture = method.edit(batch, batch.target_label[0])
        assert picture.shape == (SIZE, SIZE, 3)
        assert np.isfinite(picture).all()
        assert not picture[~mask].any()
        assert picture[mask].max() > 0
        result = method.parts(batch)
        assert result.label.shape == batch.label.shape
        assert (result.n is None) == (method.name == "Baseline 1")


def test_what_is_missing_is_named_with_its_remedy(tmp_path):
    present, missing = methods.present_and_missing(tmp_path)
    assert not present
    assert set(missing) == set(baselines.FILES)
    assert all("python -m learn train-baselines" in reason for reason in missing.values())


def test_weights_of_another_network_are_refused(folder, tmp_path):
    (tmp_path / "baseline-2.safetensors").write_bytes(
        (folder / "baseline-1.safetensors").read_bytes()
    )
    with pytest.raises(InputError, match="'separate'"):
        methods.present_and_missing(tmp_path)


def test_the_three_networks_share_nothing():
    network = Separate(Ranges(torch.zeros(108), torch.ones(108)))
    image, mask = torch.rand(2, 3, SIZE, SIZE), torch.ones(2, 1, SIZE, SIZE)
    moved = {}
    for part, output in (("normals", "n"), ("material", "code"), ("light", "light")):
        network.zero_grad(set_to_none=True)
        (getattr(network(image, mask), output) ** 3).sum().backward()
        moved[part] = {
            name for name, parameter in network.named_parameters() if parameter.grad is not None
        }
    assert not (
        moved["normals"] & moved["material"]
        or moved["normals"] & moved["light"]
        or moved["material"] & moved["light"]
    )
    assert set().union(*moved.values()) == {name for name, _ in network.named_parameters()}


def test_the_true_target_is_the_layers_picture_in_the_target_material(data_splits):
    pair = material_swap.PairedDataset(data_splits["test"], Data(sharing=2), 4, SIZE, 5)[0]
    for i in range(4):
        expected = render_by_layer(
            pair.n[i : i + 1],
            pair.target_label[i],
            pair.light[i : i + 1],
            replace(pair, segments=pair.segments[i : i + 1]),
        )
        mine = pair.target[i].movedim(0, -1).numpy()
        assert np.abs(mine - expected).mean() / expected.mean() < 0.03  # two methods, each at 1e-2


def test_a_true_edit_has_no_loss(data_splits):
    pair = material_swap.PairedDataset(data_splits["test"], Data(sharing=2), 4, SIZE, 5)[0]
    network = EncoderDecoder(Ranges(torch.zeros(108), torch.ones(108)))
    edited = network(pair.image, pair.mask, pair.target_label)
    code, embedded = network.ranges.code(pair.label), network.ranges.code(pair.target_label)
    truth = edited._replace(code=code, embedded=embedded, picture=compress(pair.target))
    weights = Losses(material=1, target=20)
    assert (
        max(
            value.item()
            for value in material_swap.terms(truth, pair, weights, network.ranges).values()
        )
        < 1e-10
    )
    # float32 through logarithm and back
    assert material_swap.figures(truth, pair, network.ranges)["target_l2"] < 1e-3
    assert material_swap.terms(edited, pair, weights, network.ranges)["target"] > 1e-3


def test_radiance_inverts_the_compressed_picture():
    image = torch.tensor([0.0, 1e-3, 0.2, 1.0, 50.0])
    torch.testing.assert_close(radiance(compress(image)), image, rtol=1e-5, atol=1e-6)  # float32


def test_the_wanted_material_changes_the_edit(data_splits, batch):
    network = EncoderDecoder(
        Ranges.of(torch.from_numpy(np.stack(list(data_splits["train"].labels.values()))))
    ).eval()
    with torch.no_grad():
        one, other = (
            network(batch.image, batch.mask, torch.from_numpy(painted(a))[None, None]).picture
            for a in (0.1, 0.8)
        )
    assert (one - other).abs().max() > 1e-3


def test_an_estimate_ends_below_its_start_and_nearer_to_the_pictures_brightness(batch, known):
    label = torch.from_numpy(painted(0.08))[None, None]
    shone = {
        "n": batch.n.movedim(1, -1),
        "material": label[:, 0].exp(),
        "light": batch.light.movedim(1, -1),
    }
    picture = render(**shone, elevation=batch.elevation).movedim(-1, 1)
    dark = replace(batch, image=picture, label=label)
    result = posterior.estimate(dark, known)
    assert result.after < 0.2 * result.before
    again = render_by_layer(dark.n, result.label[0], result.light, dark)
    start = posterior.Posterior(dark, known).start()
    first = render_by_layer(
        dark.n, known.label(start[0]).float(), known.light(start[1], 64, 128).float(), dark
    )
    seen, inside = picture[0].movedim(0, -1).numpy(), dark.mask[0, 0].numpy() > 0
    off = [abs(np.log(p[inside].mean() / seen[inside].mean())) for p in (again, first)]
    assert off[0] < 0.5 * off[1]
    assert off[0] < 0.1


def test_an_estimate_that_went_astray_is_not_taken(batch, known, monkeypatch):
    far = lambda posterior, point, *_: tuple(part + 30 for part in point)  # noqa: E731
    monkeypatch.setattr(posterior, "descend_from", far)
    result = posterior.estimate(batch, known)
    assert result.after == result.before


def test_priors_hold_the_training_materials_and_maps(data_splits, known, tmp_path):
    labels = np.stack(list(data_splits["train"].labels.values()))
    z = (labels - known.mean.numpy()) @ np.linalg.pinv(known.directions.numpy())
    # 1 % of the variance is left out
    assert np.abs(known.label(torch.from_numpy(z)).numpy() - labels).max() < 0.5
    assert 0.5 < np.sqrt((z**2).mean()) < 2  # standard normal, but for channel orders
    spread = torch.randn(
        known.light_mean.shape, generator=torch.Generator().manual_seed(0)
    ).double()
    light = known.light(spread, 64, 128)[0].movedim(0, -1).numpy()
    assert envmap.mean_radiance(light) @ envmap.LUMINANCE == pytest.approx(1, abs=1e-5)
    priors.save(tmp_path / "p.safetensors", known, {})
    assert torch.equal(priors.load(tmp_path / "p.safetensors").directions, known.directions)


def test_files_that_are_no_priors_are_refused(folder):
    with pytest.raises(InputError, match="priors"):
        priors.load(folder / "baseline-1.safetensors")


def test_a_picture_of_another_size_is_seen_at_the_networks_own(folder, data_splits):
    (method,) = (m for m in methods.present_and_missing(folder)[0] if m.name == "Baseline 2")
    net, _ = checkpoint.load_network(folder / "baseline-2.safetensors")
    batch = RelitDataset(data_splits["test"], Data(sharing=1), 1, SIZE, 5)[0]
    double = {
        name: getattr(batch, name).repeat_interleave(2, -1).repeat_interleave(2, -2)
        for name in ("image", "mask", "n", "segments")
    }
    result = methods.make_predictor_at_size(net, SIZE)(replace(batch, **double))
    torch.testing.assert_close(result.light, method.parts(batch).light)
    assert result.n.shape == (1, 3, 2 * SIZE, 2 * SIZE)
    torch.testing.assert_close(result.n.norm(dim=1), torch.ones(1, 2 * SIZE, 2 * SIZE))


def test_presets_of_the_baselines_name_their_networks(root):
    for path in (root / "manifests" / "runs").glob("baseline-*.json"):
        settings = msgspec.json.decode(path.read_bytes(), type=Run)
        assert settings.network == (
            "separate" if path.stem.startswith("baseline-2") else "encoder-decoder"
        )
