"""A run killed by SIGKILL, at whatever point of a step, goes on to bitwise the weights of one that
was left alone.
"""

import json
import os
import subprocess
import sys

import pytest

from tests.support.two_materials import written

PROGRAM = """
import hashlib, json, os, signal, sys
from pathlib import Path
import numpy as np, torch
torch.set_num_threads(1)
from learn.data.geometry import Geometry
from learn.networks import weights as checkpoint
from learn.training import loop
from learn.data.relit import DataSplit
from learn.data.settings import Data, Losses, Run, Schedule

folder = Path(sys.argv[1])
geometry = Geometry(folder / "data", progress=False)
labels = {name: np.log(np.full(108, value, np.float32)) for name, value in (("a", 0.3), ("b", 0.5))}
data_splits = {
    side: DataSplit(geometry, np.arange(1), labels, [], side)
    for side in ("train", "validation", "test")
}
terms = Losses(normals=1, material=1, image=1, pixels=8, layer_light=(8, 16))
schedule = Schedule(steps=4, batch=2, warm_up=1)
run = Run(name="kill", size=32, data=Data(sharing=1), losses=terms, schedule=schedule, seed=3)


def trained(out, kill=None):
    training = loop.Training(run, data_splits, out, sheet_every=0, checkpoint_every=2, workers=0)
    if kill:
        place, step = kill
        def die(*_, **__):
            if training.step >= step:
                os.kill(os.getpid(), signal.SIGKILL)
        if place == "step":  # in the middle of a step: gradients are there, weights half changed
            half = training.optimiser.step
            training.optimiser.step = lambda: (half(), die())
        elif place == "write":  # the checkpoint is written, and not yet renamed
            rename = os.replace
            os.replace = lambda draft, target: (die(), rename(draft, target))[1]
        else:  # the log has a step that no checkpoint has
            write = training.journal.write
            training.journal.write = lambda record: (write(record), die())
    training.train()
    return training


whole = trained(folder / "whole")
for kill in (("step", 1), ("write", 2), ("log", 3)):
    child = os.fork()
    if not child:
        trained(folder / "killed", kill)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL, (kill, status)
resumed = trained(folder / "killed")
ends = resumed.network.state_dict()
different = [n for n, t in whole.network.state_dict().items() if not torch.equal(t, ends[n])]
different += [n for n, t in whole.average.items() if not torch.equal(t, resumed.average[n])]
texts = [(folder / name / "log.jsonl").read_text() for name in ("whole", "killed")]
logs = [[json.loads(line) for line in text.splitlines()] for text in texts]
steps, losses = ([[r[key] for r in log] for log in logs] for key in ("step", "loss"))
print(json.dumps({"different": different, "steps": steps, "losses": losses}))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_sigkill_in_a_step_in_a_save_and_after_a_log_line_changes_no_bit(tmp_path, root):
    written(tmp_path / "data")
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=root,
        timeout=900,
    )
    assert ran.returncode == 0, ran.stderr[-2000:]
    result = json.loads(ran.stdout.splitlines()[-1])
    assert result["different"] == []
    assert result["steps"] == [[0, 1, 2, 3]] * 2  # each step is logged once
    assert result["losses"][0] == result["losses"][1]
