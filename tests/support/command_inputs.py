"""What commands of `learn` read: a data set of all sides, settings of a run, untrained weights."""

import json

import numpy as np
import torch

from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.weights import save_weights
from tests.support.full_disk_case import RUN, SIZE, pictures
from tests.support.synthetic import add_sides, matte, write_dataset


def write(room, weights):
    """Write pictures, `run.json` and `data` into a folder, and weights to a path."""
    pictures(room)
    (room / "run.json").write_text(json.dumps(RUN | {"network": "compact"}))
    both = [matte("dark", 0.2), matte("light", 0.8)]
    rng = np.random.default_rng(3)
    store = write_dataset(room / "data", both, rng, SIZE, 1, 0.0, (0,), category="sphere")
    add_sides(store)
    torch.manual_seed(0)
    network = Compact(Ranges.of(torch.tensor([each.label for each in both])))
    weights.parent.mkdir(exist_ok=True)
    save_weights(weights, network, network.state_dict(), json.dumps(RUN), SIZE)
