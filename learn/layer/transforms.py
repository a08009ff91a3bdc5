"""The rendering layer under torch.func: vmap, grad, vjp and jacrev, for first derivatives.

They may be nested. torch.func passes a function tensors that represent batches (vmap) or that are
recorded (grad). The layer reads its arguments' values and sums with kernels, which such tensors do
not allow; so it is one step for torch.func, which passes plain tensors to that step. A batch by
vmap becomes a longer batch of pictures. Forward mode and derivatives of derivatives are refused.
"""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import torch

from learn import layer
from learn.engines import derivatives
from learn.engines.derivatives import Context
from learn.layer.inputs import require_dense

FORWARD_MODE = (
    "derivatives: expected reverse mode (torch.func.grad, vjp, jacrev), found forward mode (jvp,"
    " jacfwd, hessian), which the layer has not"
)
SECOND = (
    "derivatives: expected first ones under torch.func, found second ones (torch.autograd gives"
    ' them with method="exact")'
)
TRACED = (
    "the layer cannot be recorded by {}, because its kernels read the tensors' values;"
    " torch.compile leaves it as one call, and torch.func.vmap, grad, vjp and jacrev work"
)
NAMES = ("n", "material", "light", "view", "segments", "mask")
Settings = tuple[str, float, float]  # method, tolerance and elevation
KINDS = torch._C._TorchDispatchModeKey


def are_active() -> bool:
    """Return whether the caller is inside a transform of torch.func.

    Raises  NotImplementedError inside a tracer, which records calls instead
    """
    if torch.jit.is_tracing():
        raise NotImplementedError(TRACED.format("torch.jit.trace"))
    if any(torch._C._get_dispatch_mode(kind) is not None for kind in (KINDS.FAKE, KINDS.PROXY)):
        raise NotImplementedError(
            TRACED.format("a tracer (make_fx, torch.func.linearize, FakeTensorMode)")
        )
    return torch._C._are_functorch_transforms_active()


def render(tensors: Sequence[object], settings: Settings) -> torch.Tensor:
    """`learn.layer.render` as one step of torch.func.

    tensors   n, material, light, view, segments and mask
    """
    for name, x in zip(NAMES, tensors, strict=True):
        if isinstance(x, torch.Tensor):
            if torch._is_functional_tensor(x):
                raise NotImplementedError(TRACED.format("torch.func.functionalize"))
            require_dense(name, x)  # torch.func itself fails at others, in words of its own
    return Picture.apply(*tensors, settings)


@contextlib.contextmanager
def allow_hooks() -> Iterator[None]:
    """Allow hooks on saved tensors, which torch.func forbids within grad.

    A step's own inner graph does not concern torch.func.
    """
    message = torch._C._autograd._saved_tensors_hooks_get_disabled_error_message()
    torch._C._autograd._saved_tensors_hooks_enable()
    try:
        yield
    finally:
        if message is not None:
            torch._C._autograd._saved_tensors_hooks_disable(message)


def refuse_batch(g: torch.Tensor) -> None:
    """Refuse, as a hook on the picture's gradient, a batch of gradients in one tensor."""
    derivatives.require_one_gradient(g)


def make_leaf(x: torch.Tensor) -> torch.Tensor:
    """Return the tensor without its graph; a copy if it is from inference mode.

    Such a tensor cannot join a graph.
    """
    return x.detach().clone() if x.is_inference() else x.detach()


def fold_batch(
    count: int, dimensions: Sequence[int | None], tensors: Sequence[object]
) -> list[object]:
    """Return the tensors with their dimension of size `count` merged into the first, the batch.

    dimensions  of each tensor; None: it has none and is expanded
    """

    def fold(dimension, x):
        if (
            not isinstance(x, torch.Tensor)
            or x.ndim == 0
            or x.is_nested
            or x.layout != torch.strided
        ):
            return x  # refused by the layer, with the argument's name
        stacked = x.expand(count, *x.shape) if dimension is None else x.movedim(dimension, 0)
        return stacked.flatten(0, 1) if stacked.ndim > 1 else stacked

    return [fold(dimension, x) for dimension, x in zip(dimensions, tensors, strict=True)]


def unfold_batch(count: int, x: torch.Tensor) -> torch.Tensor:
    """Return a tensor (count · B, …) as (count, B, …): undoes `fold_batch`."""
    return x.unflatten(0, (count, x.shape[0] // count if count else 0))


class Picture(torch.autograd.Function):
    """n, material, light, view, segments, mask (the last three or None), settings → the picture."""

    @staticmethod
    def forward(*inputs: Any) -> torch.Tensor:
        *tensors, settings = inputs
        with allow_hooks():
            return layer.render(*tensors, *settings)

    @staticmethod
    def setup_context(ctx: Context, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        *tensors, ctx.settings = inputs
        ctx.save_for_backward(*tensors)

    @staticmethod
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        requested = tuple(ctx.needs_input_grad[:4])
        result = iter(Gradients.apply(g, *ctx.saved_tensors, ctx.settings, requested))
        return *(next(result) if each else None for each in requested), None, None, None

    @staticmethod
    def vmap(
        info: Any, dimensions: tuple[int | None, ...], *inputs: Any
    ) -> tuple[torch.Tensor, int]:
        *tensors, settings = inputs
        return (
            unfold_batch(
                info.batch_size,
                Picture.apply(*fold_batch(info.batch_size, dimensions[:6], tensors), settings),
            ),
            0,
        )

    @staticmethod
    def jvp(ctx: Context, *tangents: torch.Tensor) -> None:
        raise NotImplementedError(FORWARD_MODE)


class Gradients(torch.autograd.Function):
    """The backward pass of `Picture`.

    g, the six tensors, settings, which derivatives by the first four are requested → derivatives of
    Σ g·picture by those
    """

    @staticmethod
    def forward(g: torch.Tensor, *inputs: Any) -> tuple[torch.Tensor, ...]:
        *tensors, settings, requested = inputs
        with allow_hooks(), torch.enable_grad():
            leaves: list[torch.Tensor | None] = [
                None if x is None else make_leaf(x).requires_grad_(each)
                for x, each in zip(tensors[:4], requested, strict=True)
            ]
            arguments: list[Any] = [*leaves, *tensors[4:], *settings]
            picture = layer.render(*arguments)
            pairs = zip(leaves, requested, strict=True)
            by = [x for x, each in pairs if each and x is not None]
            return torch.autograd.grad(picture, by, g)

    @staticmethod
    def setup_context(ctx: Context, inputs: tuple[Any, ...], output: object) -> None:
        pass

    @staticmethod
    def backward(ctx: Context, *g: torch.Tensor) -> None:
        raise NotImplementedError(SECOND)

    @staticmethod
    def vmap(
        info: Any, dimensions: tuple[int | None, ...], *inputs: Any
    ) -> tuple[tuple[torch.Tensor, ...], tuple[int, ...]]:
        *tensors, settings, requested = inputs
        result = Gradients.apply(
            *fold_batch(info.batch_size, dimensions[:7], tensors), settings, requested
        )
        return tuple(unfold_batch(info.batch_size, x) for x in result), (0,) * len(result)

    @staticmethod
    def jvp(ctx: Context, *tangents: torch.Tensor) -> None:
        raise NotImplementedError(FORWARD_MODE)
