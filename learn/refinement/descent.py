"""The descent of Eq. 6: from coarse to fine, keeping only steps that lower the whole energy.

Each round moves the material, then the light, then the normals by L-BFGS (scipy's, whose line
search keeps the strong Wolfe conditions). The material is first: when normals were free first, they
moved from 9° to 50° off. After the rounds a level may go on in all three properties at once. A step
that does not lower the energy is undone.

A further outer iteration is held to the result of the one before it (a proximal step). The
prediction holds the first one; in the end the picture decides. An outer iteration counts only if
the energy about the prediction itself stays below the start's.
"""

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.networks.prediction import Prediction
from learn.refinement.coordinates import (
    LightCoordinates,
    MaterialCoordinates,
    NormalCoordinates,
    principal_directions,
)
from learn.refinement.energy import Energy, State
from learn.refinement.settings import Level, RefinementSettings

FIELDS = {"material": "label", "light": "light", "normals": "n"}
MOST_EVALUATIONS = 2  # per iteration: a line search that needs more is stopped
NOWHERE = 1e30  # energy of what is not finite or cannot be rendered: a line search turns back

# {property: the map from its vector to its value}
Coordinates = dict[str, MaterialCoordinates | LightCoordinates | NormalCoordinates]
Vectors = dict[str, np.ndarray]  # {property: (Z,) float64}
Watch = Callable[[int, int], None]  # (evaluations so far, about how many there will be)


class Step(NamedTuple):
    """One descent at a level.

    round       number of its round; that in all properties at once comes after the rounds
    properties  that move
    iterations  of L-BFGS, at most
    """

    round: int
    properties: tuple[str, ...]
    iterations: int


@dataclass(frozen=True)
class RefinementResult:
    """A refined prediction and how its energy fell.

    prediction  refined
    before, after   {term: float} of learn.refinement.energy with "total", at the finest level
    history     [{"pass", "level", "round", "property", "total", "accepted"}, …] of the steps that
                count; "pass" is the number of the outer iteration, total is about its start
    """

    prediction: Prediction
    before: dict[str, float]
    after: dict[str, float]
    history: list[dict[str, Any]]
    seconds: float


def refine(
    batch: ExampleBatch,
    prediction: Prediction,
    settings: RefinementSettings = RefinementSettings(),  # noqa: B008 -- frozen
    labels: np.ndarray | None = None,
    watch: Watch | None = None,
) -> RefinementResult:
    """Return the prediction moved to where it explains its picture better.

    Its energy never ends above the start's.

    batch       of one picture: image, mask, segments and elevation are used, the truth is not
    prediction  of one picture, with n, label and light
    labels      (M, 108) of the materials that the prediction's weights were trained on; None: the
                built-in ones (learn.refinement.coordinates.principal_directions)
    watch       called before each evaluation of the energy; what it raises ends the refinement
    Raises      ValueError for more than one picture, or a prediction that lacks a property or is
                not finite
    """
    began = time.perf_counter()
    if len(batch.image) != 1 or (
        prediction.n is None or prediction.label is None or prediction.light is None
    ):
        raise ValueError(
            "refine: expected one picture with normals, material and light, found others (predict"
            " all three, and refine one by one)"
        )
    inside = (batch.segments > 0) & (batch.mask[:, 0] > 0)
    directions = principal_directions(labels)
    predicted = State(prediction.label, prediction.light, prediction.n, {})
    coordinates = make_coordinates(predicted, inside, settings, directions)
    current = starting_state(coordinates)
    if not current.is_renderable:
        raise ValueError(
            "refine: expected finite normals and light, and a label whose exp is finite and above"
            " 0, found others (check the network's weights)"
        )
    energy = Energy(batch, current, settings)
    before = after = energy.terms_of_all_pixels(current)
    history: list[dict[str, Any]] = []
    counted = None if watch is None else _make_counter(watch, settings)
    for number in range(settings.outer_iterations):
        if number:  # about the result of the one before
            coordinates = make_coordinates(current, inside, settings, directions)
            own = Energy(batch, starting_state(coordinates), settings)
            state, _, steps = run_outer_iteration(own, coordinates, None, counted)
            state = replace(state, z={"material": current.z["material"] + state.z["material"]})
            terms = energy.terms_of_all_pixels(state)
        else:
            state, terms, steps = run_outer_iteration(energy, coordinates, before, counted)
        if not terms["total"] < before["total"]:
            break
        current, after = state, terms
        history += [{"pass": number} | step for step in steps]
    n = torch.where(inside[:, None], current.n, prediction.n)
    label = current.label.to(prediction.label.dtype)
    refined = Prediction(n, None, label, torch.log1p(current.light), current.light)
    return RefinementResult(refined, before, after, history, time.perf_counter() - began)


def _make_counter(watch: Watch, settings: RefinementSettings) -> Callable[[], None]:
    """Return a function to call before each evaluation; L-BFGS makes about one per iteration."""
    steps = [step for level in settings.levels for step in steps_of(level, settings.order)]
    expected = settings.outer_iterations * sum(step.iterations for step in steps)
    numbers = itertools.count()
    return lambda: watch(next(numbers), expected)


def run_outer_iteration(
    energy: Energy,
    coordinates: Coordinates,
    before: dict[str, float] | None = None,
    before_evaluation: Callable[[], None] | None = None,
) -> tuple[State, dict[str, float], list[dict[str, Any]]]:
    """Return the State after all levels, its terms over all pixels, and a line for each step.

    energy  about the start of `coordinates`
    before  its terms over all pixels at the start; None: not known
    """
    settings = energy.settings
    z = {name: to_numpy(m.predicted).flatten() for name, m in coordinates.items()}
    best = energy.terms_of_all_pixels(starting_state(coordinates)) if before is None else before
    history = []
    for number, level in enumerate(settings.levels):
        where = energy.pixels(level.pixels)
        for step in steps_of(level, settings.order):
            moved = z | minimise_step(energy, coordinates, z, step, level, where, before_evaluation)
            terms = energy.terms_of_all_pixels(state_of(coordinates, moved))
            accepted = math.isfinite(terms["total"]) and terms["total"] < best["total"]
            if accepted:
                z, best = moved, terms
            line = {
                "level": number,
                "round": step.round,
                "property": "+".join(step.properties),
                "accepted": accepted,
                "total": terms["total"],
            }
            history.append(line)
    return state_of(coordinates, z), best, history


def make_coordinates(
    start: State,
    inside: torch.Tensor,
    settings: RefinementSettings,
    directions: np.ndarray | None = None,
) -> Coordinates:
    """Return the coordinates about a State, of which z is not read.

    inside      (1, H, W) bool: the pixels of the object
    directions  as of MaterialCoordinates
    """
    return {
        "material": MaterialCoordinates(start.label, directions),
        "light": LightCoordinates(start.light, settings.degree),
        "normals": NormalCoordinates(start.n, inside, settings.trust_region),
    }


def steps_of(level: Level, order: Sequence[str]) -> list[Step]:
    """Return the steps of a level, in turn."""
    steps = [
        Step(number, (name,), level.iterations) for number in range(level.rounds) for name in order
    ]
    joint = Step(level.rounds, tuple(order), level.joint_iterations)
    return [*steps, joint] if level.joint_iterations and order else [*steps]


def starting_state(coordinates: Coordinates) -> State:
    """Return the State of the coordinates' start."""
    return state_of(coordinates, {name: m.predicted for name, m in coordinates.items()})


def state_of(
    coordinates: Coordinates,
    z: dict[str, np.ndarray] | dict[str, torch.Tensor],
    known: State | None = None,
) -> State:
    """Return the State of vectors {property: (Z,)}.

    known  a State from which properties that `z` does not name are taken
    """
    moved = {
        name: torch.as_tensor(z[name]).to(m.predicted.device).reshape(m.shape)
        for name, m in coordinates.items()
        if name in z
    }
    fields: dict[str, Any] = {
        FIELDS[name]: coordinates[name](value) for name, value in moved.items()
    }
    fields["z"] = ({} if known is None else known.z) | moved
    return State(**fields) if known is None else replace(known, **fields)


def minimise_step(
    energy: Energy,
    coordinates: Coordinates,
    z: Vectors,
    step: Step,
    level: Level,
    where: torch.Tensor,
    before_evaluation: Callable[[], None] | None = None,
) -> Vectors:
    """Return {property: vector} of the properties that a step moves, after its L-BFGS.

    Where it meets no finite energy the vectors stay as they are. If a line search takes more than
    `most_trials` of the settings, the step ends with the lowest energy that was met.

    level  whose light map and method the energy is rendered by
    where  indices of pixels, as of Energy.pixels
    """
    names, iterations = step.properties, step.iterations
    sizes = [len(z[name]) for name in names]
    unmoved = state_of(coordinates, z)
    device = unmoved.n.device

    def split(x: np.ndarray) -> Vectors:
        return dict(zip(names, np.split(x, np.cumsum(sizes)[:-1]), strict=True))

    def value_and_gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
        if before_evaluation is not None:
            before_evaluation()
        moved = {
            name: torch.from_numpy(v.copy()).to(device).requires_grad_()
            for name, v in split(x).items()
        }
        state = state_of(coordinates, moved, unmoved)
        if not state.is_renderable:
            return NOWHERE, np.zeros_like(x)
        value = energy.total(energy.terms(state, where, level.light, level.method, level.tolerance))
        gradients = torch.autograd.grad(value, list(moved.values()))
        gradient = np.concatenate([to_numpy(part) for part in gradients])
        if not (math.isfinite(value.item()) and np.isfinite(gradient).all()):
            return NOWHERE, np.zeros_like(x)
        return value.item(), gradient.astype(np.float64)

    x = np.concatenate([z[name] for name in names])
    return split(run_lbfgs(value_and_gradient, x, iterations, energy.settings.most_trials))


class _StuckError(Exception):
    """A line search took too many trials."""


def run_lbfgs(
    value_and_gradient: Callable[[np.ndarray], tuple[float, np.ndarray]],
    x: np.ndarray,
    iterations: int,
    most_trials: int | None = None,
) -> np.ndarray:
    """Return the vector (Z,) at which scipy's L-BFGS ends.

    x            where it starts
    most_trials  of one line search. One that needs more ends the descent with the lowest value that
                 was met. None: scipy decides. It gives up after 20, and tries again from the
                 gradient.
    """
    trials = -1  # the value at x is none
    lowest, best = math.inf, x

    def limited(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal trials, lowest, best
        trials += 1
        if most_trials is not None and trials > most_trials:
            raise _StuckError
        value, gradient = value_and_gradient(x)
        if value < lowest:
            lowest, best = value, x.copy()
        return value, gradient

    def begin_line_search(_: np.ndarray) -> None:
        nonlocal trials
        trials = 0

    options = {"maxiter": iterations, "maxfun": MOST_EVALUATIONS * iterations, "maxcor": 10}
    try:
        return minimize(
            limited, x, jac=True, method="L-BFGS-B", callback=begin_line_search, options=options
        ).x
    except _StuckError:
        return best
