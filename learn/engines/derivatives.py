"""Steps for autograd that refuse, by name and when they are requested, derivatives they lack.

torch.autograd.function.once_differentiable lets a second derivative come out as None or 0 wherever
the gradient that is passed down does not depend on the inputs (a sum, a fixed weighting), for the
results of the backward pass then have no graph at all. Here they always depend on everything they
were computed from, through a step whose own backward pass raises. Asking for the graph
(create_graph=True) without using it raises nothing.
"""

import functools
from collections.abc import Callable
from typing import Any, Protocol

import torch
from torch.autograd import forward_ad

FORWARD_MODE = (
    "derivatives: expected reverse mode (backward, torch.autograd.grad), found forward mode"
    " (torch.autograd.forward_ad, jvp) (torch.autograd.functional.jvp gives the same product by two"
    " reverse passes)"
)

BATCHED = (
    "derivatives: expected one gradient at a time, found a batch of them (vectorize=True or"
    " is_grads_batched=True) (torch.func.jacrev and torch.func.vmap take batches)"
)
THIRD = "derivatives: expected at most a derivative of a derivative, found a third one"


Results = tuple[torch.Tensor | None, ...]
Backward = Callable[..., Results]


class Context(Protocol):
    """The object that torch passes to a step, which may set further attributes on it."""

    saved_tensors: tuple[Any, ...]  # tensors, or None where None was saved
    needs_input_grad: tuple[bool, ...]

    def save_for_backward(self, *tensors: torch.Tensor | None) -> None: ...
    def set_materialize_grads(self, value: bool) -> None: ...
    def __getattr__(self, name: str) -> Any: ...
    def __setattr__(self, name: str, value: Any) -> None: ...


class Step(torch.autograd.Function):
    """A step of the layer with a backward pass of its own; forward mode is refused."""

    @staticmethod
    def jvp(ctx: Context, *tangents: torch.Tensor | None) -> None:
        raise NotImplementedError(FORWARD_MODE)


class Refusal(Step):
    """The results of a backward pass unchanged; differentiating them raises.

    message, count, `count` results (or None), and the tensors that they depend on → the results
    """

    @staticmethod
    def forward(ctx: Context, message: str, count: int, *tensors: torch.Tensor | None) -> Results:
        ctx.message = message
        return tensors[:count]

    @staticmethod
    def backward(ctx: Context, *g: torch.Tensor) -> None:
        raise NotImplementedError(ctx.message)


class Gate(Step):
    """message, tensors → the same tensors; differentiating twice through them raises."""

    @staticmethod
    def forward(ctx: Context, message: str, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.message = message
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*tensors)
        return tensors

    @staticmethod
    def backward(ctx: Context, *g: torch.Tensor | None) -> Results:
        if torch.is_grad_enabled():
            g = Refusal.apply(ctx.message, len(g), *g, *ctx.saved_tensors)
        return None, *g


def last(backward: Backward) -> Backward:
    """Decorate a `Step`'s backward pass: no graph is kept; differentiating its results raises.

    The step's forward pass keeps the message as ctx.refusal and its tensors by save_for_backward.
    """

    @functools.wraps(backward)
    def without_graph(ctx: Context, *g: torch.Tensor | None) -> Results:
        require_one_gradient(*g)
        with torch.no_grad():
            result = backward(ctx, *g)
        if not torch.is_grad_enabled():
            return result
        return Refusal.apply(ctx.refusal, len(result), *result, *g, *ctx.saved_tensors)

    return without_graph


def forbid_second_derivatives(message: str, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Return the tensors unchanged, but allow only one differentiation through them."""
    gated = [i for i, x in enumerate(tensors) if x.requires_grad]
    if not gated or not torch.is_grad_enabled():
        return tensors
    result = list(tensors)
    for i, x in zip(gated, Gate.apply(message, *(tensors[i] for i in gated)), strict=True):
        result[i] = x
    return tuple(result)


def require_one_gradient(*g: torch.Tensor | None) -> None:
    """Refuse gradients (or None) that torch passes to a backward pass several at a time."""
    # torch has no public name for it, and its own error names an operator that the caller never saw
    kinds = torch._C._functorch
    for x in g:
        if x is not None and (kinds.is_legacy_batchedtensor(x) or kinds.is_batchedtensor(x)):
            raise NotImplementedError(BATCHED)


def require_reverse_mode(*tensors: torch.Tensor | None) -> None:
    """Refuse tensors (or None) that carry a forward-mode tangent, which an operator would drop."""
    for x in tensors:
        if x is not None and forward_ad.unpack_dual(x).tangent is not None:
            raise NotImplementedError(FORWARD_MODE)
