"""A device that no machine needs to have: tensors that say they lie on cuda:0, while the CPU holds
and computes their values.

What CUDA would refuse is refused: reading such a tensor through numpy, and operations on tensors of
both devices. Operators run on the values that are held, so results are those of the CPU; what is
shown is where each tensor lies, and nothing about a GPU's numbers.

    with fake_device.present():
        x = torch.zeros(3).to(fake_device.DEVICE)
"""

import contextlib

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("cuda", 0)
# operators that move values between devices
ACROSS = {"aten::copy_", "aten::_to_copy", "aten::_foreach_copy_"}
INDEXING = {
    "aten::index.Tensor",
    "aten::index_put_",
    "aten::index_put",
    "aten::_index_put_impl_",
}  # indices of a tensor on DEVICE may lie on the CPU
# operators that take not even a single number of another device
WHOLE = {"aten::cat", "aten::stack"}
FACTORIES = {
    getattr(torch, name)
    for name in (
        "tensor",
        "as_tensor",
        "zeros",
        "ones",
        "empty",
        "full",
        "arange",
        "linspace",
        "rand",
        "randn",
        "eye",
        "from_numpy",
    )
}
LIKE = {torch.zeros_like, torch.ones_like, torch.empty_like, torch.rand_like, torch.full_like}
NEW = {
    getattr(torch.Tensor, f"new_{name}") for name in ("tensor", "zeros", "ones", "empty", "full")
}


class OnDevice(torch.Tensor):
    """A tensor on DEVICE. held: its values, on the CPU."""

    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, held):
        layout = {
            "strides": held.stride(),
            "storage_offset": held.storage_offset(),
            "dtype": held.dtype,
            "device": "cpu",
        }
        return torch.Tensor._make_wrapper_subclass(cls, held.shape, **layout)

    def __init__(self, held):
        self.held = held

    def __repr__(self, **_):
        return f"OnDevice({self.held})"

    device = property(lambda self: DEVICE)
    is_cuda = property(lambda self: True)
    is_cpu = property(lambda self: False)

    def numpy(self, **_):
        raise TypeError(
            f"can't convert {DEVICE} device type tensor to numpy. Use Tensor.cpu() first."
        )

    __array__ = numpy

    def tolist(self):
        return self.held.tolist()

    def cpu(self, *_, **__):
        return Leave.apply(self)

    def to(self, *args, **options):
        return moved(self, *args, **options)

    def new_tensor(self, data, **options):
        return moved(torch.tensor(data, **{"dtype": self.dtype} | options), DEVICE)

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        name = (
            function._schema.name
            if function._schema.name != "aten::index"
            else "aten::index.Tensor"
        )
        require_one_device(name, args, kwargs)
        options = {key: value for key, value in kwargs.items() if key != "device"}
        result = function(*tree_map(held_of, args), **tree_map(held_of, options))
        # an operator in place, or one with out=: the tensor that was written to
        if function._schema.is_mutable:
            return kwargs.get("out", args[0]) if function._schema.returns else None
        return tree_map(
            lambda value: OnDevice(value) if isinstance(value, torch.Tensor) else value, result
        )


def held_of(value):
    """The values of a tensor on DEVICE; anything else as it is."""
    return value.held if isinstance(value, OnDevice) else value


def require_one_device(name, args, kwargs):
    """Raises RuntimeError, as CUDA does, for an operator on tensors of both devices."""
    # autograd makes zeros of its own, which look like ours
    if name in ACROSS or torch._C._current_graph_task_id() != -1:
        return
    checked = (args[0], *args[2:]) if name in INDEXING and isinstance(args[0], OnDevice) else args
    given = [leaf for leaf in tree_leaves((checked, kwargs)) if isinstance(leaf, torch.Tensor)]
    other = [
        leaf for leaf in given if not isinstance(leaf, OnDevice) and (leaf.ndim or name in WHOLE)
    ]
    if other and len(other) < len(given):
        raise RuntimeError(
            f"{name}: Expected all tensors to be on the same device, found at least two, {DEVICE}"
            " and cpu!"
        )


class Enter(torch.autograd.Function):
    @staticmethod
    def forward(ctx, tensor):
        return OnDevice(tensor.detach().clone(memory_format=torch.preserve_format))

    @staticmethod
    def backward(ctx, g):
        return held_of(g)


class Leave(torch.autograd.Function):
    @staticmethod
    def forward(ctx, tensor):
        return tensor.held.detach().clone()

    @staticmethod
    def backward(ctx, g):
        return g if isinstance(g, OnDevice) else OnDevice(g)


def moved(tensor, *args, **options):
    """tensor.to(*args, **options), which may name DEVICE, the CPU, or a tensor on either."""
    options.pop("non_blocking", None)
    device = options.pop("device", None)
    rest = []
    for value in args:
        if isinstance(value, torch.Tensor):
            device, options["dtype"] = value.device, value.dtype
        elif isinstance(value, torch.device | str):
            device = torch.device(value)
        elif isinstance(value, torch.dtype):
            options["dtype"] = value
        elif value is not None and not isinstance(value, bool):  # a bool: non_blocking
            rest.append(value)
    device = tensor.device if device is None else torch.device(device)
    options = {key: value for key, value in options.items() if value is not None}
    inside = isinstance(tensor, OnDevice)
    if device.type == DEVICE.type and not inside:
        tensor = Enter.apply(tensor)
    elif device.type == "cpu" and inside:
        tensor = Leave.apply(tensor)
    return torch.Tensor.to(tensor, *rest, **options) if options or rest else tensor


class Present(TorchFunctionMode):
    """While entered, tensors can be made on DEVICE and moved there."""

    def __torch_function__(self, function, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if function is torch.Tensor.to:
            return moved(*args, **kwargs)
        if function in FACTORIES or function in NEW or function in LIKE:
            device = kwargs.pop("device", None)
            result = function(*args, **kwargs)
            if device is None or not isinstance(result, torch.Tensor):
                return result
            needs_gradient = result.requires_grad
            result = moved(result.detach() if needs_gradient else result, device)
            return result.requires_grad_() if needs_gradient else result
        return function(*args, **kwargs)


@contextlib.contextmanager
def present():
    """A context in which DEVICE can be used."""
    before = torch.__future__.get_overwrite_module_params_on_conversion()
    # a module's parameters take the type of what they are moved to
    torch.__future__.set_overwrite_module_params_on_conversion(True)
    try:
        with Present():
            yield
    finally:
        torch.__future__.set_overwrite_module_params_on_conversion(before)
