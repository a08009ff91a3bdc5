"""The checkpoint of a run: network, moving average of the weights, optimiser and progress.

A killed run continues from it to bitwise the same weights. Tensors are named "network.NAME",
"average.NAME" and "optimiser.I.NAME", with I the number of the network's parameter.
"""

from pathlib import Path

import msgspec
import torch

from learn.data.seen import KEY, Seen, encode_seen, read_seen
from learn.data.settings import Run, decode_run
from learn.networks import tensor_file, weights
from learn.networks.prediction import Coded
from learn.training import schedule
from manifests.errors import InputError

Tensors = dict[str, torch.Tensor]
MOMENTS = ("exp_avg", "exp_avg_sq")


def write(
    path: Path,
    run: Run,
    network: Coded,
    average: Tensors,
    optimiser: torch.optim.Optimizer,
    progress: dict[str, float],
    seen: Seen,
) -> None:
    """Write a checkpoint.

    progress  {"step", "skipped", "used"} as of learn.networks.weights
    seen      what training and validation drew from
    """
    tensors = {f"network.{name}": t for name, t in network.state_dict().items()}
    tensors |= {f"average.{name}": t for name, t in average.items()}
    for i, parameter in enumerate(network.parameters()):
        for name, value in optimiser.state.get(parameter, {}).items():
            tensors[f"optimiser.{i}.{name}"] = value
    metadata = {name: str(value) for name, value in progress.items()} | {
        "run": msgspec.json.encode(run).decode(),
        "digest": weights.digest_of(tensors),
        KEY: encode_seen(seen),
    }
    weights.save(path, tensors, metadata)


def restore(
    path: Path,
    run: Run,
    network: Coded,
    average: Tensors,
    optimiser: torch.optim.Optimizer,
) -> tuple[weights.Progress, Seen | None]:
    """Fill network, average and optimiser from a checkpoint.

    Returns how far the run was, and what it saw until then; None where the file does not say.

    Raises InputError for a checkpoint of other settings, and for a damaged one, which stays as it
    is.
    """
    with (
        weights.with_remedy(weights.DAMAGED),
        tensor_file.open_tensor_file(path, "a checkpoint") as stored,
    ):
        progress = weights.progress_of(stored)
        seen = read_seen(stored.metadata, path)
        is_ours = decode_run(progress.run.encode(), path) == run
        if is_ours:
            of_optimiser = _optimiser_shapes(network, stored)
            expected = _all_shapes(network, of_optimiser)
            stored.require(expected, "this run")
            tensors = {name: stored.tensor(name) for name in expected}
    if not is_ours:
        hint = "give another --out, or the settings in run.json there"
        raise InputError(path, "a checkpoint of this run", "one of other settings", hint)
    total = schedule.total_steps(run)
    if progress.step > total:
        rule = f"a checkpoint of at most {total} steps"
        raise InputError(path, rule, f"one of {progress.step}", weights.DAMAGED)
    if progress.digest not in (None, weights.digest_of(tensors)):
        raise InputError(path, "the numbers that were saved", "others", weights.DAMAGED)
    for state, prefix in ((network.state_dict(), "network."), (average, "average.")):
        for name, tensor in state.items():
            tensor.copy_(tensors[prefix + name])
    for i, parameter in enumerate(network.parameters()):
        if i in of_optimiser:
            # torch counts "step" on the CPU, but where one launch updates all weights
            fused = optimiser.param_groups[0].get("fused")
            optimiser.state[parameter] = {
                name: tensor.to(parameter.device) if fused or name in MOMENTS else tensor
                for name in of_optimiser[i]
                for tensor in [tensors[f"optimiser.{i}.{name}"]]
            }
    return progress, seen


def _optimiser_shapes(network: Coded, stored: tensor_file.Stored) -> dict[int, dict[str, tuple]]:
    """Return {number of a parameter: {name: shape} of what the optimiser stores of it}.

    Parameters that no stage has trained so far have no state.
    """
    return {
        i: {"step": ()} | dict.fromkeys(MOMENTS, tuple(parameter.shape))
        for i, parameter in enumerate(network.parameters())
        if any(name.startswith(f"optimiser.{i}.") for name in stored.shapes)
    }


def _all_shapes(network: Coded, of_optimiser: dict[int, dict[str, tuple]]) -> dict[str, tuple]:
    """Return {name: shape} of all tensors of a checkpoint."""
    result = weights.shapes(network, "network.") | weights.shapes(network, "average.")
    for i, of_one in of_optimiser.items():
        result |= {f"optimiser.{i}.{name}": shape for name, shape in of_one.items()}
    return result
