"""Stages of a run, its log and TensorBoard's events, dead units, and old runs that must stay
readable.
"""

import json
import sys

import msgspec
import pytest
import torch

from learn.data.settings import Data, Losses, Run, Schedule, Stage, read_run
from learn.training import schedule, validation
from learn.training.journal import Journal
from manifests.errors import InputError

STAGED = Run(
    name="staged",
    stages=(Stage(("normals",), 10, Losses(normals=2)), Stage(("material",), 5)),
    schedule=Schedule(steps=20, warm_up=2, learning_rate=1.0),
)


def test_stages_come_first_and_the_runs_own_parts_last():
    assert schedule.total_steps(STAGED) == 35
    parts = [schedule.phase_at(STAGED, step).parts for step in (0, 9, 10, 14, 15, 34)]
    assert (
        parts == [("normals",)] * 2 + [("material",)] * 2 + [("normals", "material", "light")] * 2
    )
    assert schedule.phase_at(STAGED, 3).losses.normals == 2


def test_each_stage_warms_up_anew_and_ends_slow():
    def rate(step):
        phase = schedule.phase_at(STAGED, step)
        return schedule.learning_rate(STAGED, phase, step, (step - phase.first) / phase.steps)[0]

    assert rate(1) > rate(0)
    assert rate(9) < 0.05 < rate(10) < rate(11)
    assert rate(16) > 0.9
    assert rate(34) < 0.05


def test_the_papers_rates_fall_by_thirds_and_its_momentum_with_them():
    run = Run(name="paper", schedule=Schedule(steps=30, learning_rate=1e-4, style="paper"))
    phase = schedule.phase_at(run, 0)
    result = [schedule.learning_rate(run, phase, step, step / 30) for step in (0, 9, 10, 20, 29)]
    assert result == [
        (1e-4, 0.9),
        (1e-4, 0.9),
        (pytest.approx(1e-6), 0.5),
        (pytest.approx(1e-8), 0.5),
        (pytest.approx(1e-8), 0.5),
    ]


def test_a_run_from_before_sources_and_stages_means_what_it_meant(tmp_path):
    old = {
        "version": 1,
        "name": "joint-compact",
        "data": {
            "sharing": 4,
            "tolerance": 0.01,
            "regions": 1,
            "real_lights": 0.5,
            "photograph": True,
            "test_lights": ["city"],
        },
        "losses": {
            "normals": 3.0,
            "image": 3.0,
            "pixels": 64,
            "pull": 0.5,
            "layer_light": [32, 64],
        },
        "schedule": {
            "steps": 2400,
            "batch": 16,
            "rate": 0.002,
            "style": "compact",
            "clip": 1.0,
            "average": 0.999,
        },
        "start": None,
        "seed": 1,
    }
    (tmp_path / "run.json").write_text(json.dumps(old))
    run = read_run(tmp_path / "run.json")
    assert (run.data.source, run.data.gloss_curriculum, run.stages, run.schedule.seconds) == (
        "relit",
        0,
        (),
        None,
    )
    assert (run.losses.rendered, run.losses.image_features, run.losses.target_features) == (
        "sampled",
        0.0,
        0.0,
    )
    assert schedule.total_steps(run) == 2400


def test_a_resumed_log_drops_steps_that_are_made_again_and_a_torn_line(tmp_path):
    lines = [json.dumps({"step": k, "loss": 1.0}) + "\n" for k in range(5)]
    (tmp_path / "log.jsonl").write_text("".join(lines) + '{"step": 5, "lo')
    journal = Journal(tmp_path, 3)
    journal.write({"step": 3, "loss": 2.0})
    result = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(r["step"], r["loss"]) for r in result] == [(0, 1.0), (1, 1.0), (2, 1.0), (3, 2.0)]


def test_tensorboard_that_is_not_installed_is_told_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(InputError, match="pip install tensorboard") as error:
        Journal(tmp_path, 0, tensorboard=True)
    assert "\n" not in str(error.value)


@pytest.mark.filterwarnings("ignore")  # of TensorBoard's own imports
def test_tensorboard_gets_every_figure_of_a_step(tmp_path):
    pytest.importorskip("tensorboard")
    journal = Journal(tmp_path, 0, tensorboard=True)
    journal.write({"step": 7, "loss": 0.25, "validation": {"cosine": 0.5}})
    journal.close()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert set(events.Tags()["scalars"]) == {"train/loss", "validation/cosine"}
    (loss,) = events.Scalars("train/loss")
    assert (loss.step, loss.value) == (7, 0.25)


def test_dead_units_are_the_channels_that_never_light_up():
    layer = torch.nn.Conv2d(1, 4, 1)
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias.copy_(torch.tensor([1.0, -1.0, -1.0, 0.5]))
    network = torch.nn.Sequential(layer, torch.nn.ReLU())
    with validation.DeadUnits(network) as dead:
        assert dead.figures() == {}
        network(torch.zeros(2, 1, 3, 3))
        assert dead.figures() == {"dead_units": 0.5}
        with torch.no_grad():
            layer.bias.fill_(1.0)
        network(torch.zeros(2, 1, 3, 3))  # alive once is alive
        assert dead.figures() == {"dead_units": 0.0}
        with torch.no_grad():
            layer.bias.fill_(-1.0)
        network(torch.zeros(2, 1, 3, 3))
        assert dead.figures() == {"dead_units": 0.0}
    assert not network[1]._forward_hooks


def test_a_mix_of_sources_is_a_runs_own_setting():
    run = Run(name="mixed", data=Data(source="mix", pictures_share=0.5))
    assert msgspec.json.decode(msgspec.json.encode(run), type=Run) == run
    with pytest.raises(msgspec.ValidationError, match="source"):
        msgspec.json.decode(b'{"name": "x", "data": {"source": "blender"}}', type=Run)
