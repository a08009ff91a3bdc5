"""Weights on disk: safetensors only, for nothing is ever unpickled.

weights.safetensors     what a user needs: the moving average in half precision; metadata: network,
                        size, step, and the run as JSON. With a data set's own materials also the
                        labels of the training materials
                        seen: hashes of what training and validation drew from (learn.data.seen)
checkpoint.safetensors  what a run needs to continue (learn.training.checkpoints)
"""

import contextlib
import hashlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch

from learn.data.seen import KEY, Seen, encode_seen, read_seen
from learn.data.settings import convert
from learn.networks import tensor_file
from learn.networks.coding import LARGEST_KAPPA, SMALLEST_LABEL, Ranges
from learn.networks.compact import Compact, CompactWrapped
from learn.networks.encoder_decoder import EncoderDecoder
from learn.networks.joint_encoders import JointEncoders, JointWide
from learn.networks.paper import Paper
from learn.networks.prediction import Coded, ThreeNetworks
from learn.networks.pretrained import CompactPretrained
from learn.networks.separate import Separate
from learn.networks.two_encoders import TwoEncoders
from manifests.errors import InputError
from manifests.reading import decode
from manifests.training_runs import NetworkName, Part, Size
from shaders.dsbrdf import SHAPE, SIZE

NETWORKS: dict[str, type[Coded]] = {
    network.name: network
    for network in (
        Compact,
        CompactWrapped,
        CompactPretrained,
        TwoEncoders,
        JointEncoders,
        JointWide,
        Paper,
        Separate,
        EncoderDecoder,
    )
}
PARTS: tuple[Part, ...] = ("normals", "material", "light")
FORMAT = "brdfactory weights 1"
HEADS = ("reflectance", "material", "illumination", "widen", "light")  # modules of Compact
TRAINING_LABELS = "training_labels"  # a tensor beside the network's
MOST_MATERIALS = 100_000
LARGEST_IN_RANGE = 17.0  # LARGEST_LABEL of manifests.materials and the margin that Ranges.of adds
DAMAGED = (
    "put a copy of it back, or move it away to begin again; weights.safetensors has the last"
    " validated step"
)
Natural = Annotated[int, msgspec.Meta(ge=0, le=10**15)]


class WeightsMetadata(msgspec.Struct, frozen=True):
    """Metadata of weights that are read from them.

    network  one of NETWORKS
    size     height and width of pictures
    step     number of steps that the run had made; None: not known
    """

    network: NetworkName
    size: Size
    step: Natural | None = None


class RunInWeights(msgspec.Struct, frozen=True):
    """The part of a run's settings that is read from weights; older runs had others besides."""

    name: str = ""
    parts: Annotated[tuple[Part, ...], msgspec.Meta(min_length=1)] = PARTS


class Progress(msgspec.Struct, frozen=True):
    """Metadata of a checkpoint, learn.data.seen's aside.

    used    processor time in s; passed: time by the clock in s
    digest  `digest_of` its tensors
    """

    step: Natural
    skipped: Natural
    run: str
    used: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    passed: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    digest: str | None = None


def save(
    path: str | Path, tensors: Mapping[str, torch.Tensor], metadata: Mapping[str, str]
) -> None:
    """Write tensors and text, whole or not at all. Raises as manifests.files.replacing."""
    tensor_file.write(path, tensors, metadata)


def save_weights(
    path: str | Path,
    network: Coded,
    state: Mapping[str, torch.Tensor],
    run_json: str,
    size: int,
    step: int | None = None,
    labels: np.ndarray | None = None,
    seen: Seen | None = None,
) -> None:
    """Write the weights that a user needs.

    state   {name: tensor} of the moving average
    size    height and width of pictures; step: the number of steps that the run had made
    labels  (M, 108) of the training materials, where these were a data set's own
    seen    what training and validation drew from; None: the file does not say
    """
    half = {
        name: t.half() if t.is_floating_point() and t.ndim > 1 else t for name, t in state.items()
    }
    if labels is not None:
        half[TRAINING_LABELS] = torch.from_numpy(np.asarray(labels, np.float32))
    metadata = {"format": FORMAT, "network": network.name, "size": str(size), "run": run_json}
    if seen is not None:
        metadata[KEY] = encode_seen(seen)
    save(path, half, metadata if step is None else metadata | {"step": str(step)})


def load_network(
    path: str | Path, device: torch.device | str = "cpu"
) -> tuple[Coded, dict[str, Any]]:
    """Return (network ready to predict, metadata) of a weights file.

    device    where the network is to compute
    metadata  size: of pictures, a whole number; run: a dict, at least {}; ranges: of the network,
              on the CPU; and the file's own texts
    Raises    InputError: no weights, other metadata or tensors than `learn train` writes, numbers
              that are not finite
    """
    with tensor_file.open_tensor_file(path) as stored:
        metadata = stored.metadata
        for key, known in (("format", (FORMAT,)), ("network", tuple(NETWORKS))):
            if metadata.get(key) not in known:
                rule = f"weights of {key} {' or '.join(known)}"
                raise InputError(
                    path,
                    rule,
                    str(metadata.get(key, "none"))[:60],
                    "use weights that `learn train` wrote",
                )
        about = convert(metadata, WeightsMetadata, f"{path}: metadata", strict=False)
        run = read_run_settings(metadata, path)
        network = NETWORKS[about.network](Ranges(torch.zeros(108), torch.ones(108)))
        require_network(stored, network)
        fill(network, stored)
        network.training_labels = _training_labels(stored)
    ranges = network.ranges
    _require_ranges(ranges, path)
    return network.to(device).eval(), metadata | {"size": about.size, "run": run, "ranges": ranges}


def load_full_network(
    path: str | Path, device: torch.device | str = "cpu"
) -> tuple[Coded, dict[str, Any]]:
    """Return as `load_network`, for a network that predicts normals, material and light.

    Raises InputError for any other network.
    """
    network, metadata = load_network(path, device)
    missing = set(PARTS) - set(metadata["run"].get("parts", PARTS))
    if not isinstance(network, (Compact, ThreeNetworks)) or missing:
        result = (
            f"'{network.name}' without {' and '.join(sorted(missing))}"
            if missing
            else f"'{network.name}'"
        )
        raise InputError(
            path,
            "a network that predicts normals, material and light",
            result,
            "leave --weights out, or give others",
        )
    return network, metadata


def read_run_settings(metadata: Mapping[str, str], path: str | Path) -> dict[str, Any]:
    """Return the run's settings as a dict; {} where the metadata have none.

    Only its name and parts are checked. Raises InputError.
    """
    text = metadata.get("run", "{}").encode()
    where = f"{path}: run in the metadata"
    decode(text, RunInWeights, where)
    return decode(text, dict, where)


def seen_by(path: str | Path) -> Seen | None:
    """Return what a file of weights or priors says it saw, None where it does not say.

    Raises InputError for lists other than those that were written.
    """
    with tensor_file.open_tensor_file(path) as stored:
        return read_seen(stored.metadata, path)


def shapes(network: torch.nn.Module, prefix: str = "") -> dict[str, tuple[int, ...]]:
    """Return {prefix + name: shape} of a network's tensors."""
    return {prefix + name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


def require_network(stored: tensor_file.Stored, network: Coded) -> None:
    """Raise InputError unless a weights file holds this network's tensors, and no others.

    The labels of training materials may lie beside them.
    """
    expected = shapes(network)
    if TRAINING_LABELS in stored.shapes:
        count = next(iter(stored.shapes[TRAINING_LABELS]), 0)
        expected[TRAINING_LABELS] = (min(max(count, 1), MOST_MATERIALS), SIZE)
    stored.require(expected, f"this {network.name} network")


def _training_labels(stored: tensor_file.Stored) -> np.ndarray | None:
    """Return the labels (M, 108) of a weights file; None where it has none. Raises InputError."""
    if TRAINING_LABELS not in stored.shapes:
        return None
    labels = stored.tensor(TRAINING_LABELS).float()
    low, high = labels.min().item(), labels.max().item()
    if low < SMALLEST_LABEL or high > LARGEST_IN_RANGE:
        raise InputError(
            f"{stored.path}: {TRAINING_LABELS}",
            f"labels within {SMALLEST_LABEL:g} … {LARGEST_IN_RANGE:g}",
            f"{low:g} … {high:g}",
            "use weights that `learn train` wrote",
        )
    return labels.numpy()


def fill(network: torch.nn.Module, stored: tensor_file.Stored) -> None:
    """Give a network the tensors of a file that have the names of its own.

    They must have been required before. Raises InputError for numbers that are not finite.
    """
    state = network.state_dict()
    network.load_state_dict(
        {name: stored.tensor(name).to(mine.dtype) for name, mine in state.items()}
    )


def fill_joint(network: JointEncoders, stored: tensor_file.Stored) -> None:
    """Give a joint network what weights of `two-encoders` or `compact-pretrained` have of it.

    Of the former it takes all but the heads of material and light, which read more than those of
    the file; of the latter what predicts normals.
    Raises InputError: tensors are missing or have other shapes; numbers that are not finite
    """
    if stored.metadata.get("network") == CompactPretrained.name:
        fill_known(network.of_normals, stored, f"a {CompactPretrained.name} network")
        return
    begins_new = {name for name in network.state_dict() if name.split(".")[0] in network.begins_new}
    fill_known(network, stored, f"a {TwoEncoders.name} network", begins_new)


def fill_known(
    network: torch.nn.Module,
    stored: tensor_file.Stored,
    what: str,
    left_out: Collection[str] = (),
) -> None:
    """Give a network the tensors of its own names that a file has, which may have others as well.

    what      the file is, for an error
    left_out  names of tensors that keep their values
    Raises InputError: tensors are missing or have other shapes; numbers that are not finite
    """
    state = {n: mine for n, mine in network.state_dict().items() if n not in left_out}
    stored.require({name: tuple(mine.shape) for name, mine in state.items()}, what, False)
    chosen = {name: stored.tensor(name).to(mine.dtype) for name, mine in state.items()}
    network.load_state_dict(network.state_dict() | chosen)


def fill_heads(network: Coded, stored: tensor_file.Stored) -> None:
    """Give a compact network the heads of material and light of another compact network's file.

    The ranges of labels come with them, for the heads' codes are relative to these.
    Raises InputError where either has no such heads, and as `fill`.
    """
    if not isinstance(network, Compact):
        rule = "a run of a compact network, which has such heads"
        raise InputError("heads", rule, f"'{network.name}'", "leave heads out of the run")
    others = {
        name
        for name in network.state_dict()
        if name.split(".")[0] not in HEADS and not name.startswith("label_")
    }
    fill_known(network, stored, "these heads", others)


@contextlib.contextmanager
def with_remedy(text: str) -> Iterator[None]:
    """Give every InputError of the block this remedy, for a reader cannot know a file's purpose."""
    try:
        yield
    except InputError as problem:
        raise InputError(problem.where, problem.expected, problem.found, text) from None


def progress_of(stored: tensor_file.Stored) -> Progress:
    """Return the Progress in the metadata of a checkpoint. Raises InputError."""
    return convert(stored.metadata, Progress, f"{stored.path}: metadata", strict=False)


def digest_of(named: Mapping[str, torch.Tensor]) -> str:
    """Return the sha256 (hex) of {name: tensor}: names, types, shapes and bytes."""
    result = hashlib.sha256()
    for name, tensor in sorted(named.items()):
        flat = tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8)
        result.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        result.update(flat.numpy().data)
    return result.hexdigest()


def _require_ranges(ranges: Ranges, path: str | Path) -> None:
    """Raise InputError for ranges of labels that a material cannot have."""
    ends = torch.stack([ranges.label(torch.full((108,), code)) for code in (-1.0, 1.0)])
    largest = torch.full(SHAPE, LARGEST_IN_RANGE)
    largest[..., 0, :] = LARGEST_KAPPA
    if (
        not (ranges.half > 0).all()
        or (ends < SMALLEST_LABEL).any()
        or (ends > largest.reshape(-1)).any()
    ):
        rule = (
            f"ranges of labels within {SMALLEST_LABEL:g} … {LARGEST_IN_RANGE:g}, of κ up to"
            f" {LARGEST_KAPPA:g}"
        )
        result = f"{ends.min():g} … {ends.max():g}"
        raise InputError(
            f"{path}: label_centre, label_half",
            rule,
            result,
            "use weights that `learn train` wrote",
        )
