"""The way down: coarse to fine, and only what lowers the whole energy is kept.

Each round moves the material, then the light, then the normals by L-BFGS (scipy's, whose line
search keeps the strong Wolfe conditions). Material first: normals that were freed first moved from
9° to 50° off. Once each fits the others a level may go on in all three at once. A step that does
not lower the energy is taken back.

A further pass is held to what the one before it reached (a proximal step): the prediction holds the
first, the picture wins in the end. It counts only if the energy about the prediction itself is
still below the start's.
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import minimize

from learn.data.devices import array
from learn.networks.prediction import Prediction
from learn.refinement.coordinates import Light, Material, Normals
from learn.refinement.energy import Energy, State
from learn.refinement.settings import Settings

FIELDS = {"material": "label", "light": "light", "normals": "n"}
MOST_EVALUATIONS = 2  # for each iteration: a line search that needs more is stopped
NOWHERE = 1e30  # energy of what is not finite or cannot be drawn: a line search turns back


@dataclass(frozen=True)
class Refined:
    """prediction  Prediction, refined; before, after: {term: float} of learn.refinement.energy with
    "total", at the finest level
    history        [{"pass", "level", "round", "property", "total", "accepted"}, …]; total: about
    the start of its pass
    """

    prediction: Prediction
    before: dict
    after: dict
    history: list
    seconds: float


def refine(batch, prediction, settings=Settings()):  # noqa: B008 -- frozen
    """The prediction moved to where it explains its picture better. Its energy never ends above the
    start's.

    batch       learn.data.batch.Batch of one: image, mask, segments and elevation are used, the
    truth is not
    prediction  Prediction of one: n, label and light
    Raises      ValueError for a batch of more than one, or a prediction that lacks a property or is
    not finite
    """
    began = time.perf_counter()
    if len(batch.image) != 1 or any(
        part is None for part in (prediction.n, prediction.label, prediction.light)
    ):
        raise ValueError(
            "refine: expected one picture with normals, material and light, found others (predict"
            " all three, and refine one by one)"
        )
    inside = (batch.segments > 0) & (batch.mask[:, 0] > 0)
    reached = at_rest(coordinates(prediction, inside, settings))
    if not reached.drawable:
        raise ValueError(
            "refine: expected finite normals and light, and a label whose exp is finite and above"
            " 0, found others (check the network's weights)"
        )
    energy = Energy(batch, reached, settings)
    before = after = energy.finest(reached)
    history = []
    for number in range(settings.passes):
        state, report = passed(batch, reached if number else prediction, inside, settings)
        state = replace(state, z={"material": reached.z["material"] + state.z["material"]})
        terms = energy.finest(state)
        if not terms["total"] < before["total"]:
            break
        reached, after = state, terms
        history += [{"pass": number} | line for line in report]
    n = torch.where(inside[:, None], reached.n, prediction.n)
    refined = Prediction(
        n, None, reached.label.to(prediction.label.dtype), torch.log1p(reached.light), reached.light
    )
    return Refined(refined, before, after, history, time.perf_counter() - began)


def passed(batch, start, inside, settings):
    """(State, history) after all levels, held to `start`, a Prediction or a State: whatever lowers
    the energy about it.
    """
    maps = coordinates(start, inside, settings)
    z = {name: array(m.predicted).flatten() for name, m in maps.items()}
    energy = Energy(batch, at_rest(maps), settings)
    best, history = energy.finest(at_rest(maps)), []
    for number, level in enumerate(settings.levels):
        where = energy.pixels(level.pixels)
        for turn, names, iterations in steps(level, settings.order):
            tried = z | descended(energy, maps, z, names, level, where, iterations)
            result = energy.finest(state_of(maps, tried))
            accepted = math.isfinite(result["total"]) and result["total"] < best["total"]
            if accepted:
                z, best = tried, result
            report = {
                "level": number,
                "round": turn,
                "property": "+".join(names),
                "accepted": accepted,
            }
            history.append(report | {"total": result["total"]})
    return state_of(maps, z), history


def coordinates(prediction, inside, settings):
    """{property: map from z} of a Prediction or a State."""
    return {
        "material": Material(prediction.label),
        "light": Light(prediction.light, settings.degree),
        "normals": Normals(prediction.n, inside, settings.reach),
    }


def steps(level, order):
    """(round, properties, iterations) of a level, in turn."""
    results = [(turn, (name,), level.iterations) for turn in range(level.rounds) for name in order]
    return results + (
        [(level.rounds, tuple(order), level.together)] if level.together and order else []
    )


def at_rest(maps):
    """State of the coordinates' start."""
    return state_of(maps, {name: m.predicted for name, m in maps.items()})


def state_of(maps, z, known=None):
    """State of vectors {name: (Z,) numpy or tensor}; what `z` does not name is taken from the State
    `known`.
    """
    moved = {
        name: torch.as_tensor(z[name]).to(m.predicted.device).reshape(m.shape)
        for name, m in maps.items()
        if name in z
    }
    fields = {FIELDS[name]: maps[name](value) for name, value in moved.items()}
    fields["z"] = ({} if known is None else known.z) | moved
    return State(**fields) if known is None else replace(known, **fields)


def descended(energy, maps, z, names, level, where, iterations):
    """{name: vector} of the named properties after L-BFGS at one level; where it meets no finite
    energy it stays.
    """
    sizes = [len(z[name]) for name in names]
    still = state_of(maps, z)
    device = still.n.device

    def parts(x):
        return dict(zip(names, np.split(x, np.cumsum(sizes)[:-1]), strict=True))

    def value_and_slope(x):
        moved = {
            name: torch.from_numpy(v.copy()).to(device).requires_grad_()
            for name, v in parts(x).items()
        }
        state = state_of(maps, moved, still)
        if not state.drawable:
            return NOWHERE, np.zeros_like(x)
        value = energy.total(energy.terms(state, where, level.light, level.method, level.tolerance))
        slopes = torch.autograd.grad(value, list(moved.values()))
        slope = np.concatenate([array(s) for s in slopes])
        if not (math.isfinite(value.item()) and np.isfinite(slope).all()):
            return NOWHERE, np.zeros_like(x)
        return value.item(), slope.astype(np.float64)

    x = np.concatenate([z[name] for name in names])
    options = {"maxiter": iterations, "maxfun": MOST_EVALUATIONS * iterations, "maxcor": 10}
    return parts(minimize(value_and_slope, x, jac=True, method="L-BFGS-B", options=options).x)
