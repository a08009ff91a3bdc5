"""Weights on disk: safetensors only, nothing is ever unpickled; written by learn.networks.tensor_file.

checkpoint.safetensors  all a run needs to go on: network, moving average, optimiser; metadata: step, skipped steps, the run
weights.safetensors     what a user needs: the moving average in half precision; metadata: network, size, step, and the run as JSON
"""

import json
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open

from learn.baselines.encoder_decoder import EncoderDecoder
from learn.baselines.separate import Separate
from learn.networks import tensor_file
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.paper import Paper
from learn.networks.prediction import ThreeNetworks
from manifests.problems import Problem

NETWORKS = {network.name: network for network in (Compact, Paper, Separate, EncoderDecoder)}
PARTS = ("normals", "material", "light")
LARGEST_FILE = 4 << 30


def save(path, tensors, metadata):
    """Write tensors and text, whole or not at all. Raises as manifests.files.replacing."""
    tensor_file.write(path, tensors, metadata)


def load(path):
    """({name: tensor}, metadata) of a safetensors file. Raises Problem."""
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise Problem(
                path, f"at most {LARGEST_FILE >> 30} GiB", f"{path.stat().st_size >> 30} GiB", "check that this is the right file"
            )
        with safe_open(path, "pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118 -- not a dict
    except FileNotFoundError:
        raise Problem(path, "weights in a .safetensors file", "nothing", "train some: python -m learn train RUN.json") from None
    except (OSError, SafetensorError) as error:
        raise Problem(path, "weights in a .safetensors file", str(error), "weights in other formats are never read; convert them") from None


def save_weights(path, network, state, run_json, size, step=None):
    """The weights a user needs. state: the moving average's tensors by name; step: how many the run had made."""
    half = {name: t.half() if t.is_floating_point() and t.ndim > 1 else t for name, t in state.items()}
    told = {} if step is None else {"step": str(step)}
    save(path, half, {"format": "brdfactory weights 1", "network": network.name, "size": str(size), "run": run_json} | told)


def load_network(path):
    """(network ready to predict, metadata) of a weights file. Raises Problem."""
    tensors, metadata = load(path)
    if metadata.get("format") != "brdfactory weights 1" or metadata.get("network") not in NETWORKS:
        raise Problem(
            path, f"weights of {' or '.join(NETWORKS)}", metadata.get("network", "others"), "use weights that `learn train` wrote"
        )
    network = NETWORKS[metadata["network"]](Ranges(torch.zeros(108), torch.ones(108)))
    fill(network, tensors, path)
    return network.eval(), metadata | {"run": json.loads(metadata.get("run", "{}")), "ranges": network.ranges}


def load_parts(path):
    """As `load_network`, of one that tells normals, material and light apart. Raises Problem for another."""
    network, metadata = load_network(path)
    missing = set(PARTS) - set(metadata["run"].get("parts", PARTS))
    if not isinstance(network, (Compact, ThreeNetworks)) or missing:
        found = f"'{network.name}' without {' and '.join(sorted(missing))}" if missing else f"'{network.name}'"
        raise Problem(path, "a network that predicts normals, material and light", found, "leave --weights out, or give others")
    return network, metadata


def fill(network, tensors, where):
    """Give a network its tensors; Problem if a name is missing or a size another."""
    wanted = network.state_dict()
    for name, mine in wanted.items():
        if name not in tensors or tensors[name].shape != mine.shape:
            found = f"{tuple(tensors[name].shape)}" if name in tensors else "none"
            raise Problem(
                f"{where}: {name}", f"a tensor of shape {tuple(mine.shape)}", found, f"these weights are not of this {network.name} network"
            )
    network.load_state_dict({name: tensors[name].to(mine.dtype) for name, mine in wanted.items()})
