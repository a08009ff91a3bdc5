"""The ablation of predicted lights' repairs: each variant undoes one, and figures show it."""

import argparse
import json

import msgspec
import numpy as np
import pytest
import torch

from learn.data import lights
from learn.data.data_split import DataSplit
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Losses, Run, Schedule, read_run
from learn.experiments.training import light_figures, light_repairs, objective_training, variants
from learn.experiments.training.kept_batches import KeptBatches
from learn.experiments.training.light_repairs import REFERENCE, VARIANTS
from learn.training import losses
from manifests.errors import InputError
from tests.support.two_materials import album_of, written

SIZE = 32
RUN = Run(
    name="lights",
    network="compact-wrapped",
    size=SIZE,
    data=Data(sharing=2),
    losses=Losses(normals=1, image=3, light_log=0.3, light_rendered=1),
    schedule=Schedule(steps=99, batch=2, learning_rate=3e-3, warm_up=50),
)


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    """Three sides of the one shape there is."""
    rendered_split = album_of(written(tmp_path_factory.mktemp("lights")).folder)
    labels = {name: rendered_split.records.label(name) for name in ("dark", "light")}
    maps = [lights.draw_computed(np.random.default_rng(2)).astype(np.float32)]
    return {
        side: DataSplit(rendered_split.geometry, np.arange(1), labels, maps, side)
        for side in ("train", "validation", "test")
    }


def options(**changes):
    return argparse.Namespace(**{"steps": 2, "size": SIZE, "seed": 0, "pictures": None} | changes)


def test_every_variant_trains_the_light_alone_and_undoes_one_repair(data_splits, tmp_path):
    source = RelitDataset(data_splits["train"], RUN.data, 2, SIZE, 0)
    kept = KeptBatches(source, tmp_path / "batches")
    tested = objective_training.tests(data_splits, RUN, SIZE, 1)
    logged = {}
    for name, variant in VARIANTS.items():
        run = light_repairs.settings(name, RUN, options())
        make = objective_training.maker(kept, True, variant.of_luminance)
        result = variants.train_and_measure(
            run, data_splits, tested, tmp_path / name, 0, make, light_repairs.rows
        )
        lines = (tmp_path / name / "log.jsonl").read_text().splitlines()
        logged[name] = [json.loads(line) for line in lines]
        assert len(logged[name]) == result["steps"] == 2
        terms = {"light_log", "light_rendered", "normals", "material", "image", "target"}
        assert terms & logged[name][0].keys() == {"light_log", "light_rendered"}
        row = result["rows"][0]
        assert {*light_repairs.ERRORS, *light_repairs.SIGNED} < row.keys()
        assert result["run"]["network"] == (variant.network or "compact-wrapped")
    # the first step's prediction is the same, and what it is compared with is scaled otherwise
    first = {name: lines[0]["light_log"] for name, lines in logged.items()}
    assert first["at unit luminance"] != first[REFERENCE]
    again, reference = (
        light_repairs.settings(name, RUN, options()) for name in ("as in use again", REFERENCE)
    )
    assert again.seed != reference.seed
    same = msgspec.structs.replace(again, seed=reference.seed, name=reference.name)
    assert same == reference
    assert first["zeros beyond the edges"] != first[REFERENCE]


def test_a_dark_frame_and_a_green_cast_are_seen_in_stops():
    true = torch.rand(2, 3, 16, 32) + 0.5
    framed = true.clone()
    framed[0, :, 1:-1, 1:-1] *= 4
    framed[0] /= 4
    framed[1, 1] *= 2
    figures = light_figures.light_figures(framed, true)
    # of random texels, and a little less for what is faint
    assert figures["frame"].tolist() == pytest.approx([-2, 0], abs=0.15)
    assert figures["green"][1].item() == pytest.approx(1, abs=1e-4)
    assert figures["edge_error"][0] > figures["light_log"][0] > 0
    smooth = torch.ones(1, 3, 16, 32)
    stepped = smooth.clone()
    stepped[..., 0] *= 8
    assert light_figures.light_figures(stepped, smooth)["seam"].item() == pytest.approx(3, abs=0.1)
    same = light_figures.light_figures(true, true)
    assert all(value.abs().max() == 0 for value in same.values())


def test_maps_may_be_compared_as_they_are(data_splits):
    """A light of unit luminance that is twice as bright costs nothing once both have unit mean."""
    batch = RelitDataset(data_splits["test"], RUN.data, 2, SIZE, 5)[0]
    prediction = losses.Prediction(None, None, None, None, 2 * batch.light)
    scaled = losses.light_terms(prediction, batch, RUN.losses)
    plain = losses.light_terms(prediction, batch, RUN.losses, scaled=lambda light: light)
    assert all(value.item() == pytest.approx(0, abs=1e-9) for value in scaled.values())
    assert all(value > 0.01 for value in plain.values())


def test_a_run_without_the_repairs_is_refused():
    light_repairs.require_lights(read_run("general-compact"), "general-compact")
    with pytest.raises(InputError, match="compact-wrapped"):
        light_repairs.require_lights(read_run("joint-compact"), "joint-compact")
    without = msgspec.structs.replace(RUN.losses, light_log=0, light_rendered=0)
    with pytest.raises(InputError, match="light_log"):
        light_repairs.require_lights(msgspec.structs.replace(RUN, losses=without), "run.json")
