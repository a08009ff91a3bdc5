"""Weights on disk: safetensors only, nothing is ever unpickled; written by
learn.networks.tensor_file.

checkpoint.safetensors  all a run needs to go on: network, moving average, optimiser; metadata:
step, skipped steps, the run
weights.safetensors     what a user needs: the moving average in half precision; metadata: network,
size, step, and the run as JSON
"""

import contextlib
import hashlib
from typing import Annotated, Literal

import msgspec
import torch

from learn.data.settings import converted
from learn.networks import tensor_file
from learn.networks.coding import LARGEST_KAPPA, SMALLEST_LABEL, Ranges
from learn.networks.compact import Compact
from learn.networks.encoder_decoder import EncoderDecoder
from learn.networks.paper import Paper
from learn.networks.prediction import ThreeNetworks
from learn.networks.separate import Separate
from manifests.errors import InputError
from manifests.reading import decode
from manifests.training_runs import Part, Size
from shaders.dsbrdf import SHAPE

NETWORKS = {network.name: network for network in (Compact, Paper, Separate, EncoderDecoder)}
PARTS = ("normals", "material", "light")
FORMAT = "brdfactory weights 1"
LARGEST_IN_RANGE = 17.0  # LARGEST_LABEL of manifests.materials and the margin that Ranges.of adds
DAMAGED = (
    "put a copy of it back, or move it away to begin again; weights.safetensors has the last"
    " validated step"
)
Natural = Annotated[int, msgspec.Meta(ge=0, le=10**15)]


class About(msgspec.Struct, frozen=True):
    """Metadata of weights, read from its texts. size: of pictures; step: how many the run had
    made.
    """

    network: Literal["compact", "paper", "separate", "encoder-decoder"]
    size: Size
    step: Natural | None = None


class RunInWeights(msgspec.Struct, frozen=True):
    """What is read of the run that weights are of; older runs had other settings besides."""

    name: str = ""
    parts: Annotated[tuple[Part, ...], msgspec.Meta(min_length=1)] = PARTS


class Progress(msgspec.Struct, frozen=True):
    """Metadata of a checkpoint, read from its texts. used: seconds of processor time; digest:
    `digest_of` its tensors.
    """

    step: Natural
    skipped: Natural
    run: str
    used: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    digest: str | None = None


def save(path, tensors, metadata):
    """Write tensors and text, whole or not at all. Raises as manifests.files.replacing."""
    tensor_file.write(path, tensors, metadata)


def save_weights(path, network, state, run_json, size, step=None):
    """The weights a user needs. state: the moving average's tensors by name; step: how many the run
    had made.
    """
    half = {
        name: t.half() if t.is_floating_point() and t.ndim > 1 else t for name, t in state.items()
    }
    report = {} if step is None else {"step": str(step)}
    save(
        path,
        half,
        {"format": FORMAT, "network": network.name, "size": str(size), "run": run_json} | report,
    )


def load_network(path, device="cpu"):
    """(network ready to predict, metadata) of a weights file.

    device    where the network is to compute
    metadata  size: of pictures, a whole number; run: a dict, at least {}; ranges: of the network,
    on the CPU; and the file's own texts
    Raises    InputError: no weights, other metadata or tensors than `learn train` writes, numbers
    that are not finite
    """
    with tensor_file.opened(path) as stored:
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
        about = converted(metadata, About, f"{path}: metadata", strict=False)
        run = run_of(metadata, path)
        network = NETWORKS[about.network](Ranges(torch.zeros(108), torch.ones(108)))
        stored.require(shapes(network), f"this {network.name} network")
        fill(network, stored)
    ranges = network.ranges
    _require_ranges(ranges, path)
    return network.to(device).eval(), metadata | {"size": about.size, "run": run, "ranges": ranges}


def load_parts(path, device="cpu"):
    """As `load_network`, of one that tells normals, material and light apart. Raises InputError for
    another.
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


def run_of(metadata, path):
    """The run's settings as a dict, whose name and parts are checked; {} where the metadata have
    none. Raises InputError.
    """
    text = metadata.get("run", "{}").encode()
    where = f"{path}: run in the metadata"
    decode(text, RunInWeights, where)
    return decode(text, dict, where)


def shapes(network, prefix=""):
    """{prefix + name: shape} of a network's tensors."""
    return {prefix + name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


def fill(network, stored, prefix=""):
    """Give a network the tensors of a learn.networks.tensor_file.Stored that are named as its own
    after a prefix.

    They must have been required before. Raises InputError for numbers that are not finite
    """
    state = network.state_dict()
    network.load_state_dict(
        {name: stored.tensor(prefix + name).to(mine.dtype) for name, mine in state.items()}
    )


@contextlib.contextmanager
def remedy(text):
    """Every InputError of the block ends with this remedy: a file's reader does not know what the
    file is for.
    """
    try:
        yield
    except InputError as problem:
        raise InputError(problem.where, problem.expected, problem.found, text) from None


def progress_of(stored):
    """The Progress in the metadata of a checkpoint. Raises InputError."""
    return converted(stored.metadata, Progress, f"{stored.path}: metadata", strict=False)


def digest_of(named):
    """sha256 (hex) of {name: tensor}: names, types, shapes and bytes."""
    result = hashlib.sha256()
    for name, tensor in sorted(named.items()):
        flat = tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8)
        result.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        result.update(memoryview(flat.numpy()))
    return result.hexdigest()


def _require_ranges(ranges, path):
    """Raises InputError for ranges of labels that a material cannot have."""
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
