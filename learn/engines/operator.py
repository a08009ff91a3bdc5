"""The exact sum as a torch operator: one for the CPU kernels and the CUDA kernels, with a backward of its own.

    exact_sum(n, view, m, light, rotation, counts, light_of) → radiance (P, 3)        arguments as in learn.engines.cpu

float32 only. torch.compile and opcheck see an opaque operator with known shapes; autograd calls `exact_sum_backward`, which
computes the pass again from the same inputs. The number of threads is torch's own (torch.set_num_threads): a DataLoader worker
has one.
"""

import torch
from torch import Tensor

from learn.engines import cpu, machine_code
from shaders.dsbrdf import MAX_EXPONENT

NAME = "brdfactory::exact_sum"


def serves(batch):
    """Whether an engine computes this `learn.methods.Batch`; the reference (learn.methods.exact) takes the others.

    Engines hold exponents below MAX_EXPONENT by requiring it of κ: c^γ ≤ 1.
    """
    if batch.n.dtype != torch.float32 or batch.m.numel() == 0 or batch.m.detach()[..., 0, :].amax() > MAX_EXPONENT:
        return False
    return batch.n.device.type == "cpu" and machine_code.is_available()


def radiance(batch):
    """(P, 3) outgoing radiance of a `learn.methods.Batch` that `serves` accepts."""
    rotation = batch.camera_from_light.double().flatten().tolist()
    return exact_sum(batch.n, batch.view, batch.m, batch.light, rotation, list(batch.counts), list(batch.light_of))


def _numpy(tensor):
    return None if tensor is None else tensor.detach().contiguous().numpy()


@torch.library.custom_op(NAME, mutates_args=(), device_types="cpu")
def exact_sum(
    n: Tensor, view: Tensor | None, m: Tensor, light: Tensor, rotation: list[float], counts: list[int], light_of: list[int]
) -> Tensor:
    arrays = (_numpy(a) for a in (n, view, m, light))
    return torch.from_numpy(cpu.radiance(*arrays, tuple(rotation), counts, light_of, torch.get_num_threads()))


@torch.library.custom_op(f"{NAME}_backward", mutates_args=(), device_types="cpu")
def exact_sum_backward(
    g: Tensor,
    n: Tensor,
    view: Tensor | None,
    m: Tensor,
    light: Tensor,
    rotation: list[float],
    counts: list[int],
    light_of: list[int],
    with_view: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Derivatives by n, view (empty unless with_view), m, light."""
    arrays = (_numpy(a) for a in (g, n, view, m, light))
    found = cpu.gradients(*arrays, tuple(rotation), counts, light_of, torch.get_num_threads(), with_view)
    return tuple(n.new_empty(0) if a is None else torch.from_numpy(a) for a in found)


def _plain(tensor):
    return torch.empty_like(tensor, memory_format=torch.contiguous_format)


@exact_sum.register_fake
def _(n, view, m, light, rotation, counts, light_of):
    return _plain(n)


@exact_sum_backward.register_fake
def _(g, n, view, m, light, rotation, counts, light_of, with_view):
    return _plain(n), _plain(view) if with_view else n.new_empty(0), _plain(m), _plain(light)


def _remember(ctx, inputs, output):
    n, view, m, light, *ctx.constants = inputs
    ctx.save_for_backward(n, view, m, light)


def _backward(ctx, g):
    with_view = ctx.needs_input_grad[1]
    by_n, by_view, by_m, by_light = exact_sum_backward(g, *ctx.saved_tensors, *ctx.constants, with_view)
    return by_n, by_view if with_view else None, by_m, by_light, None, None, None


exact_sum.register_autograd(_backward, setup_context=_remember)
