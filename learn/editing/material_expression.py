"""Materials written as text: principled(base_color=#a03020, roughness=.35), lambert(…), ggx(…).

An expression is a name and, in parentheses, values with commas between them, each as key=value; one
value without a key is the first one. A colour is #rgb or #rrggbb in sRGB, or a number: a linear
grey. Nothing is evaluated: a text is names, numbers and colours, or it is refused.
"""

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import fields

import numpy as np

from manifests.errors import InputError, closest
from shaders import principled_fit
from shaders.principled import PrincipledMaterial, ggx, lambert
from shaders.principled_fit import LabelFit
from shaders.tone import linear_from_srgb

LONGEST = 240  # characters: every key with eight digits fits
NUMBER = re.compile(r"[+-]?(\d{1,30}\.?\d{0,30}|\.\d{1,30})([eE][+-]?\d{1,3})?", re.ASCII)
HEX = re.compile(r"#([0-9a-f]{3}|[0-9a-f]{6})", re.IGNORECASE | re.ASCII)
COLORS = ("base_color", "color", "f0")
Value = float | tuple[float, float, float]

KEYS: Mapping[str, tuple[str, ...]] = {
    "principled": tuple(field.name for field in fields(PrincipledMaterial)),
    "lambert": ("color",),
    "ggx": ("f0", "roughness"),
}
CONSTRUCTORS: Mapping[str, Callable[..., PrincipledMaterial]] = {
    "principled": PrincipledMaterial,
    "lambert": lambert,
    "ggx": ggx,
}
USAGE = {
    "principled": "principled(base_color=#a03020, roughness=.35, metallic=0)",
    "lambert": "lambert(#c0c0c0)",
    "ggx": "ggx(f0=.9, roughness=.2)",
}
CALL = re.compile(r"\s*([A-Za-z_]\w{0,40})\s*\(", re.ASCII)


def is_expression(text: str) -> bool:
    """Return whether a text is meant as an expression, right or wrong.

    It begins like a call of a known name, or looks like a call from end to end.
    """
    call = CALL.match(text)
    return call is not None and (call[1] in KEYS or text.rstrip().endswith(")"))


@functools.lru_cache(maxsize=64)
def fit_expression(text: str) -> LabelFit:
    """Return the label that is fitted to an expression, with its error. Raises InputError."""
    return principled_fit.fit(parse_expression(text))


def parse_expression(text: str) -> PrincipledMaterial:
    """Return the material that an expression describes. Raises InputError."""
    shown = text if len(text) <= 60 else text[:57] + "…"
    where = f"--material {shown}"
    call = CALL.match(text)
    if call is None or call[1] not in KEYS:
        name = call[1] if call else shown
        remedy = closest(name, KEYS)
        raise InputError(where, "principled(…), lambert(…) or ggx(…)", f"'{name}'", remedy)
    name, inner = call[1], text[call.end() :].rstrip()
    usage = f"as in: {USAGE[name]}"
    if len(text) > LONGEST:
        raise InputError(where, f"at most {LONGEST} characters", f"{len(text)}", usage)
    if not inner.endswith(")") or set(inner[:-1]) & set("()"):
        raise InputError(where, "one pair of parentheses, closed at the end", inner[-20:], usage)
    values = _parse_values(inner[:-1], name, where, usage)
    missing = [key for key in KEYS[name] if key not in values]
    if name != "principled" and missing:
        raise InputError(where, f"a value of {missing[0]}", "none", usage)
    try:
        return CONSTRUCTORS[name](**values)
    except ValueError as error:
        raise InputError(where, "values within their ranges", str(error), usage) from None


def _parse_values(inner: str, name: str, where: str, usage: str) -> dict[str, Value]:
    """Return {key: value} of the text between the parentheses. Raises InputError."""
    values: dict[str, Value] = {}
    for position, part in enumerate(inner.split(",") if inner.strip() else ()):
        key, equals, written = (word.strip() for word in part.partition("="))
        if not equals and position == 0:
            key, written = KEYS[name][0], key
        elif key not in KEYS[name]:
            shown = f"'{key}'" if equals else f"'{part.strip()}', which has no key"
            expected = "keys among " + ", ".join(KEYS[name])
            raise InputError(where, expected, shown, f"{closest(key, KEYS[name])}; {usage}")
        if key in values:
            raise InputError(where, "every key once", f"{key} twice", usage)
        values[key] = _parse_value(key, written, where, usage)
    return values


def _parse_value(key: str, written: str, where: str, usage: str) -> Value:
    """Return a number, or a colour as three linear numbers. Raises InputError."""
    if NUMBER.fullmatch(written):
        number = float(written)
        return (number, number, number) if key in COLORS else number
    if key in COLORS and HEX.fullmatch(written):
        digits = written[1:] if len(written) == 7 else "".join(2 * each for each in written[1:])
        encoded = np.array([int(digits[k : k + 2], 16) for k in (0, 2, 4)]) / 255
        red, green, blue = linear_from_srgb(encoded).tolist()
        return red, green, blue
    expected = f"{key} as #rrggbb or a number" if key in COLORS else f"{key} as a number"
    raise InputError(where, expected, f"'{written}'", usage)
