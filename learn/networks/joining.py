"""Join the weights of two networks: normals of both, material and light of one."""

import json
from pathlib import Path

import torch

from learn.data.seen import KEY, Seen, encode_seen, read_seen
from learn.networks import tensor_file, weights
from learn.networks.coding import Ranges
from learn.networks.compact import CompactWrapped
from learn.networks.pretrained import CompactPretrained
from learn.networks.two_encoders import OF_NORMALS, TwoEncoders
from manifests.errors import InputError

RUN_OF_NORMALS = "run of normals"  # in the metadata, beside the run of material and light


def join(normals: Path, others: Path, out: Path) -> None:
    """Write the weights of a network whose normals are the mean of both files'.

    normals  weights of a compact-pretrained network, of which nothing but normals is kept
    others   weights of a compact-wrapped network, for pictures of the same size; material and light
             are its own. What the new file says it saw is what either saw
    Raises   InputError: other networks, other tensors, numbers that are not finite
    """
    network = TwoEncoders(Ranges(torch.zeros(108), torch.ones(108)))
    with (
        tensor_file.open_tensor_file(normals) as first,
        tensor_file.open_tensor_file(others) as second,
    ):
        _require(first, CompactPretrained.name)
        _require(second, CompactWrapped.name)
        size = first.metadata.get("size")
        if second.metadata.get("size") != size:
            rule = f"weights for pictures of {size}², as {normals} has"
            raise InputError(others, rule, f"{second.metadata.get('size')}²", "give others")
        state = {}
        for name, mine in network.state_dict().items():
            own = name.removeprefix(f"{OF_NORMALS}.")
            stored = second if own == name else first
            stored.require({own: tuple(mine.shape)}, f"a {network.name} network", alone=False)
            state[name] = stored.tensor(own)
        if weights.TRAINING_LABELS in second.shapes:
            state[weights.TRAINING_LABELS] = second.tensor(weights.TRAINING_LABELS)
        run = weights.read_run_settings(second.metadata, others) | {"network": network.name}
        seen = read_seen(first.metadata, normals), read_seen(second.metadata, others)
        metadata = second.metadata | {
            "network": network.name,
            "run": json.dumps(run),
            RUN_OF_NORMALS: first.metadata.get("run", "{}"),
            KEY: encode_seen((seen[1] or Seen(complete=False)).join(seen[0])),
        }
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    weights.save(out, state, metadata)


def _require(stored: tensor_file.Stored, name: str) -> None:
    own = stored.metadata.get("network", "none")
    if stored.metadata.get("format") != weights.FORMAT or own != name:
        rule = f"weights of the network {name}"
        remedy = "use weights that `learn train` wrote"
        raise InputError(stored.path, rule, f"'{own}'"[:60], remedy)
