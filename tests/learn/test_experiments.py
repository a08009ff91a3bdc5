"""Ablations, step times and the network's card, run small; their statistics on known figures."""

import json

import msgspec
import numpy as np
import pytest
import torch

from learn.data import lights
from learn.data.data_split import DataSplit, gloss
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Run, Schedule
from learn.evaluation import model_card
from learn.experiments.training import (
    layer_ablation,
    normals_ablation,
    step_profile,
    step_timing,
    variants,
)
from learn.networks import weights as checkpoint
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from manifests.errors import InputError
from tests.support.tiny_run import ALL_TERMS
from tests.support.two_materials import album_of, written

SIZE = 32


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    """Three sides of the one shape there is: what is measured here is not worth knowing, only that
    it is measured.
    """
    rendered_split = album_of(written(tmp_path_factory.mktemp("experiments")).folder)
    labels = {name: rendered_split.records.label(name) for name in ("dark", "light")}
    maps = [lights.draw_computed(np.random.default_rng(2)).astype(np.float32)]
    return {
        side: DataSplit(rendered_split.geometry, np.arange(1), labels, maps, side, rendered_split)
        for side in ("train", "validation", "test")
    }


def result(l2, seed=0):
    """A result of `variants.train_and_measure` on 6 shapes × 4 materials."""
    rng = np.random.default_rng(seed)
    groups = [{"shape": f"s{i}", "material": f"m{j}"} for i in range(6) for j in range(4)]
    rows = [
        each
        | {
            "l2": l2 * rng.uniform(0.5, 1.5),
            "l2_frame": 1.0,
            "ssim": 0.5,
            "angle_deg": 20.0,
            "cosine": 0.9,
        }
        for each in groups
    ]
    return {"rows": rows, "steps": 1}


def test_the_ratio_of_a_variant_twice_as_good_is_a_half_and_of_an_equal_one_about_one():
    a = [result(100.0, seed) for seed in (1, 2)]
    half = [{"rows": [row | {"l2": row["l2"] / 2} for row in each["rows"]]} for each in a]
    assert variants.ratio(a, half) == pytest.approx([0.5, 0.5, 0.5])
    mean, low, high = variants.ratio(a, [result(100.0, seed) for seed in (3, 4)])
    assert low < 1 < high
    assert low < mean < high
    assert variants.figures(a)["ssim"] == pytest.approx([0.5, 0.5, 0.5])


def test_pictures_like_the_truth_have_no_l2_and_the_frame_dilutes_the_rest():
    truth = np.zeros((16, 16, 3))
    truth[4:12, 4:12] = 0.5
    mask = truth[..., 0] > 0
    assert variants._compare(truth, truth, mask) == pytest.approx(
        {"l2": 0, "l2_frame": 0, "ssim": 1}
    )
    results = variants._compare(truth * 0.9, truth, mask)
    assert results["l2"] > 0
    assert results["l2_frame"] == pytest.approx(results["l2"] / 4)


def test_a_variant_ends_by_its_clock_and_is_not_trained_again(data_splits, tmp_path):
    run = layer_ablation.settings("normals", "combined", Data(sharing=2), SIZE, 0.4, seed=1)
    tests = variants.held_out_batches(data_splits, run.data, SIZE, 1)
    results = variants.train_and_measure(run, data_splits, tests, tmp_path, workers=0)
    assert results["seconds"] >= 0.4
    assert 1 <= results["steps"] < 100  # of a million that it may make
    assert {"l2", "l2_frame", "ssim", "angle_deg", "cosine"} <= set(results["rows"][0])
    assert len(results["rows"]) == variants.BATCH
    assert not (tmp_path / "checkpoint.safetensors").exists()
    assert variants.train_and_measure(run, None, None, tmp_path) == results


def test_a_report_has_every_variant_with_its_interval():
    results = {
        part: {
            v: [result(100.0 * (i + 1), seed) for seed in (1, 2, 3)] for i, v in enumerate(of_part)
        }
        for part, of_part in layer_ablation.VARIANTS.items()
    }
    report = layer_ablation.summary(results, {"seconds": 1.0, "size": SIZE, "seeds": 3})
    pairs = {
        "combined / standalone",
        "control / standalone",
        "both / standalone",
        "combined / control",
        "both / control",
    }
    assert set(report["material"]["ratios"]) == pairs
    page = layer_ablation.tables(report)
    for part, of_part in layer_ablation.VARIANTS.items():
        assert all(f"| {part} | {variant} |" in page for variant in of_part)


def test_normals_have_a_table_and_a_chart():
    about = {"pretraining": 1.0, "seconds": 1.0, "size": SIZE, "seeds": 1, "shapes": 250}
    report = normals_ablation.summary({"L2": [result(100.0)], "pixels": [result(90.0)]}, about)
    assert report["rows"]["pixels"]["ratio"] == pytest.approx([0.9] * 3)
    assert "| 0.900 [0.900, 0.900] | 20.00" in normals_ablation.tables(report)
    assert len(normals_ablation.figure(report).axes) == 2


def test_fewer_shapes_than_a_variant_asks_for_are_told(data_splits):
    with pytest.raises(InputError, match="expected 60 training shapes, found 1"):
        normals_ablation._limit_shapes(data_splits, 60)


def test_every_variant_is_a_run_that_can_be_read_back():
    for name, weights in normals_ablation.VARIANTS.items():
        own = normals_ablation.Pretrained("weights.safetensors", weights, 5)
        run = normals_ablation.settings(name, Data(), 64, 1.0, 0, 1e-3, own)
        assert msgspec.json.decode(msgspec.json.encode(run), type=Run) == run


def test_matte_first_draws_the_mattest_third_at_first_and_all_in_the_end(data_splits):
    rng = np.random.default_rng(0)
    labels = {f"m{i}": rng.normal(0, 1, 108).astype(np.float32) for i in range(9)}
    order = sorted(labels, key=lambda name: gloss(labels[name]))
    data_split = DataSplit(
        data_splits["train"].geometry, np.arange(1), labels, data_splits["train"].maps, "train"
    )
    source = RelitDataset(data_split, Data(sharing=1, gloss_curriculum=10), 1, SIZE, 1)
    assert source.names[: source._admitted_count(0)] == order[:3]
    assert (source._admitted_count(10), source._admitted_count(1000)) == (9, 9)


def test_gloss_is_the_narrowest_lobes():
    m = np.full((3, 3, 2, 6), 1.0)
    m[:, 1, 1] = 400.0  # γ of the second lobe
    m[:, 1, 0] = 3.0  # κ: κ c^γ falls twice as fast in its logarithm as c^γ does
    assert gloss(np.log(m).reshape(108).astype(np.float32)) == pytest.approx(1200, rel=1e-4)


def test_a_card_measures_relit_and_rendered_pictures_apart(data_splits, tmp_path):
    network = Compact(Ranges(torch.zeros(108), torch.ones(108)))
    run = Run(name="tiny", size=SIZE, data=Data(sharing=2))
    checkpoint.save_weights(
        tmp_path / "w.safetensors",
        network,
        network.state_dict(),
        msgspec.json.encode(run).decode(),
        SIZE,
        7,
    )
    results = model_card.write_card(
        tmp_path / "w.safetensors",
        data_splits,
        tmp_path,
        batches=1,
        note="a note to readers",
        printed=True,
    )
    printed = results["printed"]
    assert printed["plain_angle_deg"] == pytest.approx(results["figures"]["angle_deg"])
    means = [printed[f"{kind}_angle_deg"][0] for kind in ("plain", "printed")]
    assert means[0] != means[1]
    assert printed["ratio"][0] == pytest.approx(means[1] / means[0])
    assert {"angle_deg", "irradiance", "image_l2", "target_l2", "control_l2"} <= set(
        results["figures"]
    )
    assert set(results["cycles"]) == set(results["figures"])
    report = json.loads((tmp_path / "card.json").read_text())
    assert (report["pictures"], report["cycles_pictures"]) == (16, 4)
    text = (tmp_path / "card.md").read_text()
    assert "a note to readers" in text
    assert f"7 of {run.schedule.steps} steps" in text
    assert "4 pictures that Cycles rendered" in text
    assert (tmp_path / "sheet.jpg").exists()
    assert (tmp_path / "sheet-cycles.jpg").exists()


def test_a_figure_that_no_picture_shows_is_left_out_of_a_card():
    names = ("car:0 view 0 red", "chair:0 view 0 blue")
    first, second = (
        ({"albedo_1": np.array([0.1, value]), "albedo_2": np.full(2, np.nan)}, names)
        for value in (0.2, 0.4)
    )
    part = model_card._summarise("", [first, second])
    assert part["figures"].keys() == part["figures_seeds"].keys() == {"albedo_1"}
    assert part["figures_seeds"]["albedo_1"]["each"] == pytest.approx([0.15, 0.25])


def test_a_card_of_several_seeds_has_all_of_them_on_the_same_pictures(data_splits, tmp_path):
    paths = [tmp_path / f"w{seed}.safetensors" for seed in (1, 2, 3)]
    runs = [Run(name="tiny", size=SIZE, data=Data(sharing=2), seed=seed) for seed in (1, 2, 2)]
    for path, run in zip(paths, runs, strict=True):
        torch.manual_seed(run.seed)
        network = Compact(Ranges(torch.zeros(108), torch.ones(108)))
        checkpoint.save_weights(
            path, network, network.state_dict(), msgspec.json.encode(run).decode(), SIZE, 7
        )
    results = model_card.write_card(
        paths[0], data_splits, tmp_path, batches=1, other_seeds=paths[1:2]
    )
    report = json.loads((tmp_path / "card.json").read_text())
    assert report["seeds"] == [[1, "7"], [2, "7"]]
    for name, of in report["figures_seeds"].items():
        assert len(of["each"]) == 2
        assert of["each"][0] == pytest.approx(results["figures"][name][0])
        assert of["mean"][0] == pytest.approx(np.mean(of["each"]))
    assert (
        report["figures_seeds"]["angle_deg"]["each"][0]
        != report["figures_seeds"]["angle_deg"]["each"][1]
    )
    assert (
        report["figures_seeds"]["constant_irradiance"]["each"][0]
        == report["figures_seeds"]["constant_irradiance"]["each"][1]
    )
    assert "seed 2, 7 steps" in (tmp_path / "card.md").read_text()
    with pytest.raises(InputError, match="seed 2 twice"):
        model_card.write_card(paths[0], data_splits, tmp_path, batches=1, other_seeds=paths[1:])
    other = msgspec.structs.replace(runs[1], schedule=Schedule(steps=3))
    checkpoint.save_weights(
        paths[2], network, network.state_dict(), msgspec.json.encode(other).decode(), SIZE, 7
    )
    with pytest.raises(InputError, match="other settings"):
        model_card.write_card(paths[0], data_splits, tmp_path, batches=1, other_seeds=paths[2:])


def test_step_times_cover_every_part_and_add_up(data_splits, tmp_path):
    run = Run(
        name="tiny",
        size=SIZE,
        data=Data(sharing=2),
        losses=ALL_TERMS,
        schedule=Schedule(steps=4, batch=2),
    )
    result = step_timing.profile(run, data_splits, tmp_path / "scratch", 1, 4)
    parts = {"data", "network", "normals and material terms", "light terms", "layer", "optimiser"}
    assert set(result["step"]) == parts | {"total"}
    assert result["step"]["total"] == pytest.approx(sum(result["step"][part] for part in parts))
    assert result["relit"]["images"] == 4
    assert "| layer |" in step_profile.tables(result)
