"""Calls of the rendering layer with arguments of wrong or unusual type, dtype, shape, value or
place.

    python -m tests.fuzz.layer_calls --calls 2000 --seed 0

A call is right if it ends in one of two ways:

- ValueError, TypeError or (for derivatives that there are not) NotImplementedError whose message
  begins with the name of an argument that was changed, and is one line;
- a picture in the shape, dtype and place of n, black outside of the mask, and finite where the same
  scene in float64 is; where the method promises an error, within it of the exact sum in float64.
  Gradients that come with it are finite and have their arguments' shapes.

Each change also says whether the layer must refuse it, must take it, or may do either.
"""

import argparse
import math
import signal
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from learn import methods
from learn.layer import RenderLayer, render

TENSORS = ("n", "material", "light", "view")
ARGUMENTS = (*TENSORS, "segments", "mask", "method", "tolerance", "elevation")
REFUSALS = (ValueError, TypeError, NotImplementedError)
SECONDS = 60.0
REFUSE, TAKE, EITHER = "refuse", "take", "either"
WAYS = (
    "function",
    "function",
    "module",
    "no_grad",
    "inference_mode",
    "backward",
    "backward",
    "backward",
    "twice",
)
TRANSFORMS = ("vmap", "grad", "jacrev", "jvp", "vmap of grad", "batched gradients", "traced")


@dataclass
class Call:
    """One call: arguments, how it is made, what was changed and whether it must be refused."""

    arguments: dict
    way: str = "function"
    changed: list = field(default_factory=list)
    must: str = TAKE
    # the same in plain tensors, for the reference; None: as the arguments are
    plain: dict | None = None

    @property
    def label(self):
        """What was done, in a line."""
        return f"{self.way}, {self.arguments.get('method')!r:.40}: " + (
            "; ".join(what for _, what in self.changed) or "nothing changed"
        )


# ------------------------------------------------------------------------------------------------
# valid calls


def valid(rng):
    """Arguments of a small scene, all right."""
    dtype = (torch.float32, torch.float32, torch.float64)[rng.integers(3)]
    images, height, width = (
        int(rng.integers(1, 3)),
        int(rng.integers(1, 6)),
        int(rng.integers(1, 6)),
    )
    materials = int(rng.choice([0, 0, 1, 2, 3]))
    n = rng.normal(size=(images, height, width, 3))
    n[..., 2] = np.abs(n[..., 2]) + 0.3
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    curves = (images, max(materials, 1), 3, 3, 6)
    m = np.stack([rng.uniform(0.05, 1.5, curves), 10 ** rng.uniform(-1, 2, curves)], -2)
    m = m.reshape(images, -1, 108)
    arguments = {
        "n": torch.tensor(n, dtype=dtype),
        "material": torch.tensor(m if materials else m[:, 0], dtype=dtype),
        "light": torch.tensor(
            rng.random((images, int(rng.integers(1, 9)), int(rng.integers(1, 9)), 3)), dtype=dtype
        ),
    }
    if rng.random() < 0.3:
        view = rng.normal(size=n.shape) * 0.1 + [0.0, 0.0, 1.0]
        arguments["view"] = torch.tensor(
            view / np.linalg.norm(view, axis=-1, keepdims=True), dtype=dtype
        )
    if materials or rng.random() < 0.1:
        arguments["segments"] = torch.tensor(rng.integers(0, max(materials, 1) + 1, n.shape[:3]))
    if rng.random() < 0.3:
        arguments["mask"] = torch.tensor(rng.random(n.shape[:3]) < 0.8)
    names = [name for name in methods.NAMES if "view" not in arguments or name != "reflectance_map"]
    quick = [name for name in names if not name.startswith("monte_carlo") and name != "split_sum"]
    arguments["method"] = str(rng.choice(quick if rng.random() < 0.9 else names))
    if rng.random() < 0.5:
        arguments["tolerance"] = float(rng.choice([5e-2, 1e-2, 1e-3]))
    if rng.random() < 0.5:
        arguments["elevation"] = float(rng.uniform(-1.5, 1.5))
    return arguments


# ------------------------------------------------------------------------------------------------
# changes A change takes a value and the generator of numbers, and gives (new value, what was done,
# what the layer must do).


def place(x, rng):
    """A random place in an array."""
    return tuple(int(rng.integers(size)) for size in x.shape)


def put(value):
    """A change: one element set to a value."""

    def change(x, rng):
        if not x.numel():
            return x, "nothing", EITHER
        y = x.clone()
        y[place(y, rng)] = value
        return y, f"one element {value:g}", EITHER

    return change


def reshaped(x, rng):
    """Dimensions added, dropped, swapped, cut or repeated."""
    kind, axis = rng.integers(6), int(rng.integers(x.ndim))
    made = (
        lambda: x[None],
        lambda: x[(slice(None),) * axis + (0,)] if x.shape[axis] else x[None],
        lambda: x.transpose(axis, (axis + 1) % x.ndim),
        lambda: x.narrow(axis, 0, x.shape[axis] // 2),
        lambda: x.repeat_interleave(2, axis),
        lambda: x.flatten(),
    )[kind]()
    return made, f"shape {tuple(made.shape)}", EITHER


def emptied(x, rng):
    """One dimension of size 0."""
    axis = int(rng.integers(x.ndim))
    return x.narrow(axis, 0, 0), f"dimension {axis} of size 0", EITHER


def enormous(x, rng):
    """One element spread over more places than there is memory for."""
    shape = list(x.shape)
    shape[0 if x.ndim < 4 else int(rng.integers(1, 3))] = 2**40
    return x.flatten()[:1].reshape([1] * x.ndim).expand(shape), f"shape {tuple(shape)}", REFUSE


def scattered(x, rng):
    """The same values, strided otherwise."""
    y = (
        torch.stack([torch.zeros_like(x), x, x + 1], -1)[..., 1]
        if x.dtype != torch.bool
        else x.clone().t_copy()
        if x.ndim == 2
        else x
    )
    return (
        y.transpose(0, -1).contiguous().transpose(0, -1) if rng.random() < 0.5 else y,
        "other strides",
        TAKE,
    )


def offset(x, rng):
    """The same values, behind others in one storage."""
    storage = torch.cat([x.new_zeros(7), x.flatten()])
    return storage[7:].reshape(x.shape), "offset in its storage", TAKE


def negated(x, rng):
    """The same values as a pending negation, as the imaginary part of a conjugate has it."""
    return torch.complex(torch.zeros_like(x), -x).conj().imag, "a pending negation", TAKE


def from_inference(x, rng):
    """The same values, made in inference mode."""
    with torch.inference_mode():
        return x.clone(), "made in inference mode", TAKE


class Own(torch.Tensor):
    """A subclass that changes nothing."""


def to(dtype):
    """A change of the dtype of one argument."""
    return lambda x, rng: (x.to(dtype), str(dtype), EITHER)


def sparse(x, rng):
    """A sparse layout."""
    return x.to_sparse(), "sparse", REFUSE


def nested(x, rng):
    """A nested tensor."""
    return (
        torch.nested.nested_tensor(list(x)) if len(x) else x,
        "nested",
        REFUSE if len(x) else TAKE,
    )


TYPES = {
    "None": lambda x: None,
    "a list": lambda x: x.tolist(),
    "a numpy array": lambda x: x.numpy(),
    "text": lambda x: "tensor",
    "an integer": lambda x: 3,
    "an object": lambda x: object(),
    "a tuple of itself": lambda x: (x,),
    "a complex number": lambda x: 1j,
    "a class": lambda x: torch.Tensor,
}


def retyped(x, rng):
    """Something else than a tensor."""
    name = list(TYPES)[rng.integers(len(TYPES))]
    return TYPES[name](x), name, EITHER if name == "None" else REFUSE


OF_ANY = [
    reshaped,
    reshaped,
    emptied,
    enormous,
    scattered,
    offset,
    retyped,
    retyped,
    sparse,
    nested,
    from_inference,
]
OF_ANY += [lambda x, rng: (x.to("meta"), "device meta", REFUSE)]
OF_FLOATS = [
    *OF_ANY,
    *(
        put(value)
        for value in (math.nan, math.inf, -math.inf, -1.0, 0.0, -0.0, 1e-40, 1e30, 1e38, -1e-30)
    ),
    *(
        to(dtype)
        for dtype in (
            torch.float16,
            torch.bfloat16,
            torch.float32,
            torch.float64,
            torch.int64,
            torch.bool,
            torch.complex64,
        )
    ),
    to(torch.float8_e4m3fn),
    negated,
    lambda x, rng: (x.as_subclass(Own), "a subclass", TAKE),
    lambda x, rng: (torch.nn.Parameter(x.clone()), "a parameter", TAKE),
    lambda x, rng: (x * 1.5, "times 1.5", EITHER),
    lambda x, rng: (x * 0, "times 0", EITHER),
    lambda x, rng: (x.log(), "its logarithm", EITHER),
    lambda x, rng: (x[:1].expand(x.shape), "the first image, expanded", TAKE),
    lambda x, rng: (
        torch.quantize_per_tensor(x.float(), 0.1, 0, torch.quint8),
        "quantized",
        REFUSE,
    ),
]
OF_MASKS = [
    *OF_ANY,
    *(to(dtype) for dtype in (torch.uint8, torch.int64, torch.float32, torch.complex64)),
    lambda x, rng: (x & False, "nothing inside", TAKE),
    lambda x, rng: (x[:1].expand(x.shape), "the first image, expanded", TAKE),
]
WHOLE = (
    torch.uint8,
    torch.int8,
    torch.int16,
    torch.int32,
    torch.uint16,
    torch.uint32,
    torch.uint64,
)
OF_SEGMENTS = [
    *OF_ANY,
    *((lambda x, rng, dtype=dtype: (x.to(dtype), str(dtype), TAKE)) for dtype in WHOLE),
    *(to(dtype) for dtype in (torch.float32, torch.bool, torch.complex64)),
    *(put(value) for value in (-1, 4, 255, 256, 2**31, 2**40, -(2**63), 2**63 - 1)),
    lambda x, rng: (x * 0, "all background", TAKE),
    lambda x, rng: (x.to(torch.uint64) - 1, "uint64, less 1", EITHER),
]
NUMBERS = [  # (value, what a tolerance and what an elevation must do)
    *(
        (value, REFUSE, REFUSE)
        for value in (
            None,
            "0.1",
            "",
            "nan",
            True,
            False,
            math.nan,
            math.inf,
            -math.inf,
            1j,
            [],
            [0.1],
        )
    ),
    *((value, REFUSE, REFUSE) for value in ({}, object())),
    *(
        (value, REFUSE, REFUSE)
        for value in (
            np.array(0.1),
            np.array([0.1]),
            np.bool_(True),
            np.nan,
            Decimal("0.1"),
            b"0.1",
            10**400,
        )
    ),
    *(
        (value, REFUSE, REFUSE)
        for value in (
            torch.tensor(0.1),
            torch.tensor(0.1, requires_grad=True),
            torch.tensor([0.1, 0.2]),
        )
    ),
    *((value, REFUSE, TAKE) for value in (0, 0.0, -0.0, -1e-3, -1)),
    *(
        (value, TAKE, TAKE)
        for value in (
            np.float32(0.1),
            np.float64(0.1),
            np.float16(0.1),
            Fraction(1, 10),
            1,
            np.int64(1),
        )
    ),
    *((value, TAKE, TAKE) for value in (5e-324, 1e-300, 1e-30, 1e-9, 1e-6)),
    *((value, TAKE, REFUSE) for value in (2.0, 90, 1e10, 1e300, 10**20, 1e38)),
]
NAMES = [
    None,
    "",
    "Auto",
    "auto ",
    b"auto",
    3,
    [],
    ["auto"],
    ("auto",),
    {},
    "exakt",
    "é",
    "x" * 10_000,
    "__init__",
    "directional",
]
NAMES.append(torch.tensor(1))


def change_number(name):
    """A change of the tolerance or the elevation."""

    def change(x, rng):
        value, of_tolerance, of_elevation = NUMBERS[rng.integers(len(NUMBERS))]
        return (
            value,
            f"{type(value).__name__} {str(value)[:30]}",
            of_tolerance if name == "tolerance" else of_elevation,
        )

    return change


def change_name(x, rng):
    """A name that is no method's."""
    value = NAMES[rng.integers(len(NAMES))]
    return value, f"{type(value).__name__} {str(value)[:20]}", REFUSE


CHANGES = {
    **dict.fromkeys(TENSORS, OF_FLOATS),
    "mask": OF_MASKS,
    "segments": OF_SEGMENTS,
    "method": [change_name],
    "tolerance": [change_number("tolerance")],
    "elevation": [change_number("elevation")],
}


def together(arguments, rng):
    """All of the floating tensors, or all tensors, changed alike."""
    floats = [name for name in TENSORS if isinstance(arguments.get(name), torch.Tensor)]
    kind = rng.integers(5)
    if kind < 3:
        dtype = (torch.float16, torch.bfloat16, torch.float64)[kind]
        return {name: arguments[name].to(dtype) for name in floats}, f"all of {dtype}", TAKE
    every = floats + [
        name for name in ("segments", "mask") if isinstance(arguments.get(name), torch.Tensor)
    ]
    if kind == 3:
        return {name: arguments[name].to("meta") for name in every}, "all on device meta", REFUSE
    axis = int(rng.integers(3))
    cut = {
        name: arguments[name].narrow(axis, 0, 0)
        for name in every
        if axis == 0 or name not in ("material", "light")
    }
    return cut, f"nothing along dimension {axis}", TAKE


def make(rng):
    """A `Call`."""
    with warnings.catch_warnings():
        # torch announces changes of quantized and nested tensors
        warnings.simplefilter("ignore", UserWarning)
        return _made(rng)


def _made(rng):
    call = Call(valid(rng))
    for _ in range(int(rng.choice([0, 1, 1, 1, 1, 2]))):
        if rng.random() < 0.12 and not call.changed:
            changed, what, must = together(call.arguments, rng)
            call.arguments |= changed
            call.changed.append((tuple(changed), what))
        else:
            name = str(rng.choice(ARGUMENTS))
            if any(name in names for names, _ in call.changed):
                continue
            value = call.arguments.get(name)
            if value is None and name in ("view", "segments", "mask"):
                value = fresh(name, call.arguments)
            if not isinstance(value, torch.Tensor) and name in (*TENSORS, "segments", "mask"):
                continue  # changed to something else before
            if isinstance(value, torch.Tensor) and not value.is_nested and value.numel() > 10**6:
                continue  # enormous
            options = CHANGES[name]
            try:
                call.arguments[name], what, must = options[rng.integers(len(options))](value, rng)
            except (RuntimeError, NotImplementedError, IndexError, TypeError):
                continue  # torch cannot make it of what was changed before
            call.changed.append(((name,), f"{name}: {what}"))
            if name == "view" and call.arguments["method"] == "reflectance_map":
                must = EITHER  # it has no view
        if must != TAKE:
            call.must = REFUSE if REFUSE in (must, call.must) else EITHER
    if len(call.changed) > 1 and call.must == TAKE:
        call.must = EITHER  # what is right alone may be wrong together, as two dtypes
    call.way = str(rng.choice(TRANSFORMS if rng.random() < 0.08 else WAYS))
    return call


def fresh(name, arguments):
    """A right value for an argument that was left out."""
    n = arguments["n"]
    if not isinstance(n, torch.Tensor) or n.ndim != 4 or n.numel() > 10**6 or n.is_nested:
        return None
    if name == "view":
        return (
            torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).to(n.dtype).expand(n.shape).clone()
        )
    return torch.ones(n.shape[:3], dtype=torch.bool if name == "mask" else torch.int64)


# ------------------------------------------------------------------------------------------------
# calls


@dataclass
class Answer:
    """What a call gave: a picture, and gradients {name: …} or None."""

    picture: Any
    gradients: dict | None = None


def perform(call):
    """The call's `Answer`, or whatever it raises."""
    arguments = call.arguments
    if call.way in TRANSFORMS:
        return transformed(call)
    if call.way == "module":
        layer = RenderLayer(
            **{
                name: arguments[name]
                for name in ("method", "tolerance", "elevation")
                if name in arguments
            }
        )
        repr(layer)
        return Answer(
            layer(
                **{
                    name: value
                    for name, value in arguments.items()
                    if name in (*TENSORS, "segments", "mask")
                }
            )
        )
    if call.way in ("no_grad", "inference_mode"):
        with getattr(torch, call.way)():
            return Answer(render(**arguments))
    if call.way == "function":
        return Answer(render(**arguments))
    leaves = leaves_of(arguments)
    picture = render(**arguments | leaves)
    total = (
        picture.double().sum()
        if call.way == "backward"
        else (picture.double() + render(**arguments | leaves).double()).sum()
    )
    by = (
        torch.autograd.grad(total, list(leaves.values()), allow_unused=True)
        if leaves and total.requires_grad
        else ()
    )
    return Answer(picture, dict(zip(leaves, by, strict=True)) if by else None)


def leaves_of(arguments):
    """Leaves with gradients in place of those tensors that can have them; strides and storage
    stay.
    """
    given = {name: arguments.get(name) for name in TENSORS}
    return {
        name: x.detach().requires_grad_()
        for name, x in given.items()
        if isinstance(x, torch.Tensor)
        and (x.is_floating_point() or x.is_complex())
        and not x.is_inference()
        and not x.is_quantized
    }


def transformed(call):
    """The call under torch.func, over the material."""
    arguments = {name: value for name, value in call.arguments.items() if name != "material"}
    m = call.arguments["material"]

    def picture(m):
        return render(material=m, **arguments)

    def total(m):
        return picture(m).sum()

    # torch itself refuses these two ways where a tensor can have no derivative, before the layer is
    # called
    underivable = (
        call.way in ("batched gradients", "jvp")
        and isinstance(m, torch.Tensor)
        and not m.is_floating_point()
    )
    if not isinstance(m, torch.Tensor) or m.is_quantized or underivable:
        return Answer(picture(m))
    if call.way == "vmap":
        return Answer(torch.func.vmap(picture)(torch.stack([m, m]))[1])
    if call.way == "grad":
        return Answer(picture(m), {"material": torch.func.grad(total)(m)})
    if call.way == "jacrev":
        return Answer(picture(m), {"material": torch.func.jacrev(total)(m)})
    if call.way == "vmap of grad":
        return Answer(picture(m), {"material": torch.func.vmap(torch.func.grad(total))(m[None])[0]})
    if call.way == "jvp":
        return Answer(torch.func.jvp(picture, (m,), (torch.ones_like(m),))[0])
    if call.way == "traced":
        return Answer(torch.jit.trace(picture, m)(m))
    m = m.detach().requires_grad_()
    seen = picture(m)
    torch.autograd.grad(seen, m, torch.stack([torch.ones_like(seen)] * 2), is_grads_batched=True)
    return Answer(seen)


# ------------------------------------------------------------------------------------------------
# verdict


def refusal_fault(call, error):
    """What is wrong with a refusal, or None."""
    message = str(error)
    if "\n" in message or len(message) > 600:
        return f"message of {len(message)} characters: {message[:200]!r}"
    named = {name for names, _ in call.changed for name in names}
    if isinstance(error, NotImplementedError):
        report = message.startswith("derivatives:") and call.way in ("jvp", "batched gradients")
        return (
            None
            if report or (call.way == "traced" and "torch.jit.trace" in message)
            else f"NotImplementedError: {message[:200]}"
        )
    # where two arguments must be alike, the message names the one that is not as n is
    alike = {*TENSORS, "segments", "mask"} if "n" in named or len(call.changed) > 1 else named
    alike = alike | ({"view", "segments", "mask"} if "material" in named else set())
    alike = alike | ({"method"} if "view" in named else set())
    if message.split(":")[0] not in named | alike:
        return f"names another argument than those changed: {message[:200]}"
    return None if call.must != TAKE else f"refused: {message[:200]}"


def answer_fault(call, answer):
    """What is wrong with a picture and its gradients, or None."""
    if call.must == REFUSE:
        return "taken, where a refusal was due"
    if call.way in ("jvp", "batched gradients", "traced"):
        return "taken, where a refusal was due"
    given, picture = call.arguments, answer.picture
    n = given["n"]
    if (
        not isinstance(picture, torch.Tensor)
        or picture.shape != n.shape
        or picture.dtype != n.dtype
        or picture.device != n.device
    ):
        return (
            f"{getattr(picture, 'shape', type(picture))} {getattr(picture, 'dtype', '')} for n"
            f" {tuple(n.shape)} {n.dtype}"
        )
    for name, by in (answer.gradients or {}).items():
        if by is None or by.shape != given[name].shape:
            return f"gradient by {name}: {None if by is None else tuple(by.shape)}"
    if not picture.numel():
        return None
    right = truth(given)
    largest = torch.finfo(n.dtype).max if n.dtype != torch.bfloat16 else 1e38
    if right.max() > 1e-3 * min(largest, 1e30):  # beyond what the dtype or float32 can add up
        return None
    if not picture.isfinite().all():
        return "a picture that is not finite"
    for name, by in (answer.gradients or {}).items():
        if not by.isfinite().all() and moderate(given):
            return f"gradient by {name} is not finite"
    return error_fault(given, picture.detach().double(), right)


def moderate(given):
    """Whether material and light are within what the methods' derivatives promise to be finite
    for.
    """
    m = given["material"].detach().double().reshape(-1, 2, 6)
    return bool(
        m[:, 0].max() <= 30
        and m[:, 1].max() <= 1e5
        and m[:, 1].min() >= 1e-3
        and given["light"].max() <= 1e6
    )


def error_fault(given, picture, right):
    """Whether a picture is off by more than its method promises."""
    method, tolerance = given.get("method", "auto"), given.get("tolerance", 1e-2)
    if (picture[outside(given)] != 0).any():
        return "light outside of the mask"
    # what 16 bits take off the picture; what float32 does of the whole
    digits = (
        {torch.float16: 1e-3, torch.bfloat16: 8e-3}.get(given["n"].dtype, 0.0) * right.mean().item()
        + 3e-5 * right.max().item()
        + 1e-7
    )
    if method not in ("auto", "culled", "exact") or not moderate(given):
        return None
    error = (picture - right).abs().mean().item()
    allowed = 0.0 if method == "exact" else min(float(tolerance), 1e30) * largest_mean(given, right)
    return (
        None
        if error <= allowed + digits
        else f"error {error:.3g}, mean {right.mean():.3g}, tolerance {float(tolerance):g}"
    )


def outside(given):
    """(B, H, W) bool: pixels of the background."""
    n, mask, segments = (given.get(name) for name in ("n", "mask", "segments"))
    inside = (n.detach() != 0).any(-1) if mask is None else mask
    return ~inside if segments is None else ~inside | (segments.to(torch.int64) == 0)


def largest_mean(given, right):
    """The mean radiance by which a tolerance counts: of the brightest image, for each has its
    own.
    """
    return right.flatten(1).mean(1).max().item() * max(
        1, right[0, ..., 0].numel() / max(1, int((right.sum(-1) > 0).sum()))
    )


def truth(given):
    """The exact sum in float64, of plain copies of the arguments."""
    present = [name for name in TENSORS if given.get(name) is not None]
    plain = {
        name: given[name].detach().double().resolve_neg().clone().as_subclass(torch.Tensor)
        for name in present
    }
    plain["segments"] = (
        None if given.get("segments") is None else given["segments"].to(torch.int64).clone()
    )
    plain["mask"] = None if given.get("mask") is None else given["mask"].clone()
    with torch.no_grad():
        return render(
            **plain,
            method="exact",
            **{name: float(given[name]) for name in ("elevation",) if name in given},
        )


class Hang(BaseException):
    """A call took longer than SECONDS; no `Exception`, so that nothing in between takes it for a
    refusal.
    """


def _alarm(signum, frame):
    raise Hang


def judged(call) -> str | None:
    """What is wrong with how a call ends, in one line, or None."""
    signal.signal(signal.SIGALRM, _alarm)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            # of torch's own parts, which no user sees
            warnings.simplefilter("ignore", DeprecationWarning)
            answer = perform(call)
    except REFUSALS as error:
        return refusal_fault(call, error)
    except Hang:
        return f"more than {SECONDS:g} s"
    except Exception as error:  # whatever else: that is what is looked for
        return f"{type(error).__name__}: {str(error).splitlines()[0][:200] if str(error) else ''}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return (
        f"warning: {warned[0].message}".splitlines()[0][:200]
        if warned
        else answer_fault(call, answer)
    )


# ------------------------------------------------------------------------------------------------
# running


def numbered(seed, number):
    """The call of a seed and a number, which does not depend on others."""
    return make(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,))))


def run(
    seed: int,
    count: int,
    first: int = 0,
    each: Callable[[int, Call, str | None], None] | None = None,
) -> list[str]:
    """Faults of calls first … first + count − 1 of a seed, one line each; each(number, call, fault)
    is reported for all.
    """
    faults = []
    for number in range(first, first + count):
        call = numbered(seed, number)
        fault = judged(call)
        if fault:
            faults.append(f"call {number} ({call.label}): {fault}")
        if each:
            each(number, call, fault)
    return faults


def case(index, rng, room):
    """The driver's `Case` of this package (tests/fuzz/__init__.py)."""
    from . import Case

    call = make(rng)
    return Case(label=call.label, run=lambda: judged(call), check=lambda result: result.value)


def main(arguments=None):
    """Exit status 1 if any call ended in a way that is wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.layer_calls",
        description="Calls of the layer with unusual arguments.",
    )
    parser.add_argument(
        "--calls", type=int, default=2000, metavar="N", help="how many (default 2,000)"
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="I", help="number of the first (default 0)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="of everything left to chance (default 0)"
    )
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    ends, begun = Counter(), time.monotonic()
    with tqdm(total=options.calls, desc="calls", mininterval=10.0) as bar:

        def count(number, call, fault):
            ends[
                (
                    "faults"
                    if fault
                    else f"{call.must}, {'changed' if call.changed else 'not changed'}"
                )
            ] += 1
            bar.update()
            if fault:
                tqdm.write(f"call {number} ({call.label}): {fault}", file=sys.stdout)

        faults = run(options.seed, options.calls, options.first, count)
    print(", ".join(f"{end} {number}" for end, number in sorted(ends.items())))
    print(
        f"{options.calls} calls, seed {options.seed}, {time.monotonic() - begun:.0f} s:"
        f" {len(faults)} faults"
    )
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
