"""The exact sum as a torch operator with its own backward pass, for CPU and CUDA kernels.

    exact_sum(n, view, m, light, rotation, counts, light_of) → radiance (P, 3)        arguments as
    in learn.engines.cpu

float32 only. torch.compile and opcheck see an opaque operator with known shapes; autograd calls
`exact_sum_backward`, which computes the pass again from the same inputs; where the graph of that
pass is recorded, `Second` differentiates it. The number of threads is torch's own
(torch.set_num_threads): a DataLoader worker has one.

Defined by torch.library.define rather than the custom_op decorator: the same operator, but the
decorator's first call imports the whole of torch._dynamo, one second.
"""

import importlib.util
from collections.abc import Sequence

import numpy as np
import torch

from learn.engines import cpu, machine_code
from learn.engines.derivatives import (
    THIRD,
    Context,
    Step,
    require_one_gradient,
    require_reverse_mode,
)
from learn.methods import Batch
from shaders.dsbrdf import MAX_EXPONENT

NAME = "brdfactory::exact_sum"


def serves(batch: Batch) -> bool:
    """Whether an engine computes this batch; the reference (learn.methods.exact) takes the others.

    Engines keep exponents below MAX_EXPONENT by requiring it of κ: c^γ ≤ 1.
    """
    if (
        batch.n.dtype != torch.float32
        or batch.m.numel() == 0
        or batch.m.detach()[..., 0, :].amax() > MAX_EXPONENT
    ):
        return False
    if batch.n.device.type == "cuda":
        return importlib.util.find_spec("triton") is not None
    return batch.n.device.type == "cpu" and machine_code.is_available()


def radiance(batch: Batch) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch that `serves` accepts."""
    if not torch.compiler.is_compiling():
        # torch drops a tangent that an operator knows nothing of
        require_reverse_mode(batch.n, batch.view, batch.m, batch.light)
    rotation = batch.camera_from_light.double().flatten().tolist()
    return torch.ops.brdfactory.exact_sum(
        batch.n,
        batch.view,
        batch.m,
        batch.light,
        rotation,
        list(batch.counts),
        list(batch.light_of),
    )


CONSTANTS = "float[] rotation, int[] counts, int[] light_of"
torch.library.define(
    NAME, f"(Tensor n, Tensor? view, Tensor m, Tensor light, {CONSTANTS}) -> Tensor"
)
torch.library.define(
    f"{NAME}_backward",
    f"(Tensor g, Tensor n, Tensor? view, Tensor m, Tensor light, {CONSTANTS}, bool with_view) ->"
    " (Tensor, Tensor, Tensor, Tensor)",
)


def _numpy(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _optional(tensor: torch.Tensor | None) -> np.ndarray | None:
    return None if tensor is None else _numpy(tensor)


@torch.library.impl(NAME, "CPU")
def _sum_on_cpu(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
) -> torch.Tensor:
    workers = torch.get_num_threads()
    arrays = _numpy(n), _optional(view), _numpy(m), _numpy(light)
    return torch.from_numpy(cpu.radiance(*arrays, tuple(rotation), counts, light_of, workers))


@torch.library.impl(f"{NAME}_backward", "CPU")
def _backward_on_cpu(
    g: torch.Tensor,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
    with_view: bool,
) -> tuple[torch.Tensor, ...]:
    """Return derivatives by n, view (empty unless with_view), m, light."""
    arrays = _numpy(g), _numpy(n), _optional(view), _numpy(m), _numpy(light)
    workers = torch.get_num_threads()
    result = cpu.gradients(*arrays, tuple(rotation), counts, light_of, workers, with_view)
    return tuple(n.new_empty(0) if a is None else torch.from_numpy(a) for a in result)


@torch.library.impl(NAME, "CUDA")
def _sum_on_cuda(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
) -> torch.Tensor:
    from learn.engines import cuda

    n, m, light = (a.contiguous() for a in (n, m, light))
    view = None if view is None else view.contiguous()
    return cuda.radiance(n, view, m, light, tuple(rotation), tuple(counts), tuple(light_of))


@torch.library.impl(f"{NAME}_backward", "CUDA")
def _backward_on_cuda(
    g: torch.Tensor,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
    with_view: bool,
) -> tuple[torch.Tensor, ...]:
    from learn.engines import cuda

    g, n, m, light = (a.contiguous() for a in (g, n, m, light))
    view = None if view is None else view.contiguous()
    by_n, by_view, by_m, by_light = cuda.gradients(
        g, n, view, m, light, tuple(rotation), tuple(counts), tuple(light_of)
    )
    return by_n, n.new_empty(0) if by_view is None or not with_view else by_view, by_m, by_light


def _plain(tensor: torch.Tensor) -> torch.Tensor:
    return torch.empty_like(tensor, memory_format=torch.contiguous_format)


@torch.library.register_fake(NAME)
def _sum_shape(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
) -> torch.Tensor:
    return _plain(n)


@torch.library.register_fake(f"{NAME}_backward")
def _backward_shapes(
    g: torch.Tensor,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Sequence[float],
    counts: Sequence[int],
    light_of: Sequence[int],
    with_view: bool,
) -> tuple[torch.Tensor, ...]:
    by_view = n.new_empty(0) if view is None or not with_view else _plain(view)
    return _plain(n), by_view, _plain(m), _plain(light)


def _remember(ctx: Context, inputs: tuple, output: torch.Tensor) -> None:
    n, view, m, light, *ctx.constants = inputs
    ctx.save_for_backward(n, view, m, light)


def _backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
    require_one_gradient(g)
    arguments = g, *ctx.saved_tensors, *ctx.constants, ctx.needs_input_grad[1]
    if torch.is_grad_enabled():  # one more step, which would slow small pictures down
        by_n, by_view, by_m, by_light = Gradients.apply(*arguments)
    else:
        by_n, by_view, by_m, by_light = torch.ops.brdfactory.exact_sum_backward(*arguments)
    return by_n, by_view if ctx.needs_input_grad[1] else None, by_m, by_light, None, None, None


class Gradients(Step):
    """The operator `exact_sum_backward`, with a derivative."""

    @staticmethod
    def forward(
        ctx: Context,
        g: torch.Tensor,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        light: torch.Tensor,
        *constants: object,
    ) -> tuple[torch.Tensor, ...]:
        ctx.save_for_backward(g, n, view, m, light)
        *ctx.constants, ctx.with_view = constants
        return torch.ops.brdfactory.exact_sum_backward(g, n, view, m, light, *constants)

    @staticmethod
    def backward(
        ctx: Context,
        by_n: torch.Tensor,
        by_view: torch.Tensor | None,
        by_m: torch.Tensor,
        by_light: torch.Tensor,
    ) -> tuple[torch.Tensor | None, ...]:
        require_one_gradient(by_n, by_view, by_m, by_light)
        view = ctx.saved_tensors[2]
        if not ctx.with_view:
            by_view = None if view is None else torch.zeros_like(view)
        return (
            *Second.apply(by_n, by_view, by_m, by_light, *ctx.saved_tensors, *ctx.constants),
            None,
        )


class Second(Step):
    """Differentiate the operator's backward pass.

    Derivatives of a loss by that pass's results, and its arguments → derivatives by g, n, view, m
    and light.

    No operator: torch.compile takes no second derivatives, and within an operator
    learn.methods.exact_second could not use autograd.
    """

    @staticmethod
    def forward(
        ctx: Context,
        by_n: torch.Tensor,
        by_view: torch.Tensor | None,
        by_m: torch.Tensor,
        by_light: torch.Tensor,
        g: torch.Tensor,
        n: torch.Tensor,
        view: torch.Tensor | None,
        m: torch.Tensor,
        light: torch.Tensor,
        rotation: Sequence[float],
        counts: Sequence[int],
        light_of: Sequence[int],
    ) -> tuple[torch.Tensor | None, ...]:
        if n.device.type == "cpu":
            from learn.engines import second

            arrays = second.gradients(
                [_optional(x) for x in (by_n, by_view, by_m, by_light)],
                *(_numpy(g), _numpy(n), _optional(view), _numpy(m), _numpy(light)),
                *(tuple(rotation), counts, light_of, torch.get_num_threads()),
            )
            results = [None if x is None else torch.from_numpy(x) for x in arrays]
        else:
            from learn.methods.exact_second import of_groups

            direction = by_n, by_view, by_m, by_light
            tensors = g, n, view, m, light
            results = [*of_groups(direction, *tensors, rotation, counts, light_of)]
        return *results, None, None, None

    @staticmethod
    def backward(ctx: Context, *g: torch.Tensor) -> None:
        raise NotImplementedError(THIRD)


torch.library.register_autograd(NAME, _backward, setup_context=_remember)
