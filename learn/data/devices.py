"""The device on which networks and the layer compute, and the one way from there to numpy.

A device is a torch.device: "cpu", or "cuda" where torch sees one. Sources of batches, files and
figures stay on the CPU.
"""

import os

import numpy as np
import torch

from manifests.errors import InputError

CHOICES = ("auto", "cpu", "cuda")


def choose(name: str = "auto") -> torch.device:
    """Return the device of a name in CHOICES; auto: CUDA if torch sees it, else the CPU.

    If torchrun started several processes, each takes the CUDA device of its own number, LOCAL_RANK.
    Raises InputError if CUDA is requested and torch does not see it.
    """
    if name not in CHOICES:
        raise ValueError(f"device: expected one of {', '.join(CHOICES)}, found {name!r}")
    if name == "cpu":
        return torch.device("cpu")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    number = int(os.environ.get("LOCAL_RANK", 0))
    if number < count:
        return torch.device("cuda", number)
    if name == "auto" and not count:
        return torch.device("cpu")
    if count:
        raise InputError(
            "--device",
            f"CUDA device {number}",
            f"{count} of them",
            f"start at most {count} processes on this machine",
        )
    result = (
        "a build of torch without CUDA" if torch.version.cuda is None else "none that torch sees"
    )
    remedy = "give --device cpu, or install the build of torch for your CUDA driver"
    raise InputError("--device", "a CUDA device", result, remedy)


def device_of(module: torch.nn.Module) -> torch.device:
    """Return the device of a module's first parameter or buffer; the CPU if it has neither."""
    tensors = (*module.parameters(), *module.buffers())
    return tensors[0].device if tensors else torch.device("cpu")


def to_numpy(tensor: torch.Tensor) -> np.ndarray:
    """Return a tensor's values as a numpy array, which shares memory with a tensor on the CPU."""
    return tensor.detach().cpu().numpy()


def reduced_type(device: torch.device) -> torch.dtype:
    """Return the type in which networks on this device learn fastest.

    bfloat16, except on CPUs for which torch has no fast kernels in it, x86 without AVX-512 for
    example: there convolutions take ten times as long as in float32 (docs/log.md).
    """
    if device.type != "cpu" or _has_bfloat16_kernels():
        return torch.bfloat16
    return torch.float32


def _has_bfloat16_kernels() -> bool:
    # builds without oneDNN, as for macOS, do not have the operator either
    return torch.backends.mkldnn.is_available() and torch.ops.mkldnn._is_mkldnn_bf16_supported()


def mixed_precision(device: torch.device, enabled: bool) -> torch.autocast:
    """Return a context in which networks on this device compute in their `reduced_type`.

    enabled  False: they compute in float32
    """
    enabled = enabled and reduced_type(device) == torch.bfloat16
    return torch.autocast(device.type, torch.bfloat16, enabled=enabled)


def process_group_backend(device: torch.device) -> str:
    """Return the name of torch.distributed's backend for tensors on this device."""
    return "nccl" if device.type == "cuda" else "gloo"
