"""The label of a principled material, in tens of milliseconds, and how far the two are apart.

Weighted least squares by Levenberg–Marquardt, reweighted towards least L1. The samples follow the
material's own width; channels of different colour are fitted at once, so that numpy's calls are
few, and equal ones only once.

C  channels that differ, P  samples of all fitted views, q (C, 36) their numbers
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from shaders import errors, label_model
from shaders.principled import PrincipledMaterial
from shaders.samples import Samples, held_out_samples

VIEWS_DEG = (3.0, 21.0, 38.0, 53.0, 67.0, 79.0)  # none is a view at which errors are measured
N_THETA, N_PHI = 24, 4
TRIES, ITERATIONS = 4, 24  # for every initial label; then for the best one
REWEIGHT_AT = (8, 14)
PRIOR, SMOOTH = 1e-6, 1e-5  # towards the initial label, and against second differences
LARGEST_STEP = 2.0
# peaks of smooth metals at grazing angles are higher than MERL's
HIGHEST_LOG_KAPPA = 2.7
HIGH = np.stack([np.full(6, HIGHEST_LOG_KAPPA), label_model.HIGH[1]])
_ROUGH = np.kron(np.eye(6), SMOOTH * label_model.ROUGHNESS)  # (36, 36)


@dataclass(frozen=True)
class LabelFit:
    """A label and how far it is from its material.

    label  (3, 3, 2, 6) logarithms in canonical order
    views  (6,) relative L1 of f · cos at the held-out view angles
    """

    label: np.ndarray
    views: np.ndarray

    @property
    def error(self) -> float:
        """Mean relative L1 of the held-out views."""
        return float(self.views.mean())


def fit(material: PrincipledMaterial, iterations: int = ITERATIONS) -> LabelFit:
    """Return the label of a material with its error."""
    label = label_of(material, iterations)
    samples, basis, log_cos_h = _held_out()
    f = label_model.values(label, basis, log_cos_h)
    return LabelFit(label, errors.relative_l1(f, material.evaluate(*samples.cosines), samples))


def label_of(material: PrincipledMaterial, iterations: int = ITERATIONS) -> np.ndarray:
    """Return the label (3, 3, 2, 6) of a material, in canonical order."""
    colors = np.array(material.base_color)
    _, first, same = np.unique(colors, return_index=True, return_inverse=True)
    narrowest = max(material.narrowest / 2, 1e-3)
    samples = Samples(np.radians(VIEWS_DEG), N_THETA, N_PHI, narrowest)
    problem = _Problem(samples, material.evaluate(*samples.cosines)[..., first])
    state = problem.best([initial[first] for initial in initial_labels(material)])
    for iteration in range(iterations):
        if iteration in REWEIGHT_AT:
            state = problem.reweighted(state)
        state = problem.improved(state)
    label = state.q.reshape(-1, 3, 2, 6)[same.reshape(-1)]
    return label_model.in_canonical_order(label)


def initial_labels(material: PrincipledMaterial) -> np.ndarray:
    """Return initial labels (S, 3, 3, 2, 6), estimated where light and view are equally steep."""

    def symmetric(cos_h: np.ndarray, cos_d: np.ndarray) -> np.ndarray:
        cos_h, cos_d = np.broadcast_arrays(cos_h, cos_d)
        cosine = np.maximum(cos_h * cos_d, 1e-3)
        return material.evaluate(cosine, cosine, cos_h, cos_d)

    return label_model.initial_labels(symmetric)


@functools.lru_cache(maxsize=1)
def _held_out() -> tuple[Samples, np.ndarray, np.ndarray]:
    samples = held_out_samples()
    return samples, *samples.spline()


@dataclass(frozen=True)
class _State:
    """q, initial (C, 36); f (C, P); slope (C, P, 36); cost, damping (C,)."""

    q: np.ndarray
    initial: np.ndarray
    f: np.ndarray
    slope: np.ndarray
    cost: np.ndarray
    damping: np.ndarray


class _Problem:
    """Lit samples of a material: target and square root of the weights (C, P)."""

    def __init__(self, samples: Samples, target: np.ndarray) -> None:
        basis, log_cos_h = samples.spline()
        lit = samples.solid_angle > 0
        self.basis, self.log_cos_h = basis[lit], log_cos_h[lit]
        self.target = target[lit].T
        albedo = (samples.measure[..., None] * target).sum(1, keepdims=True)
        self.albedo = np.broadcast_to(albedo, target.shape)[lit].T
        self.measure = samples.measure[lit] / np.maximum(self.albedo, 1e-5)
        self._weigh(errors.metric(target, samples)[lit].T)

    def _weigh(self, weight: np.ndarray) -> None:
        scale = (weight * self.target**2).sum(-1, keepdims=True)
        self.root = np.sqrt(weight / np.maximum(scale, 1e-12))

    def _state(self, q: np.ndarray, initial: np.ndarray, damping: np.ndarray) -> _State:
        f, slope = label_model.slopes(q.reshape(-1, 3, 2, 6), self.basis, self.log_cos_h)
        return _State(q, initial, f, slope, self._cost(q, initial, f), damping)

    def _cost(self, q: np.ndarray, initial: np.ndarray, f: np.ndarray) -> np.ndarray:
        difference = ((self.root * (f - self.target)) ** 2).sum(-1)
        return difference + PRIOR * ((q - initial) ** 2).sum(-1) + (q * (q @ _ROUGH)).sum(-1)

    def best(self, initial: list[np.ndarray]) -> _State:
        """Return each channel's state of least cost after TRIES iterations from each label."""
        states = []
        for label in initial:
            q = _bounded(label.reshape(-1, 36))
            state = self._state(q, q, np.full(len(q), 1e-2))
            for _ in range(TRIES):
                state = self.improved(state)
            states.append(state)
        chosen = states[0]
        for state in states[1:]:
            chosen = _where(state.cost < chosen.cost, state, chosen)
        return chosen

    def reweighted(self, state: _State) -> _State:
        """Return the state under weights by which least squares approach least L1.

        The formula is that of errors.reweight, for lit samples alone.
        """
        off = np.abs(state.f - self.target) + 0.05 * self.target + 0.005 * self.albedo / np.pi
        self._weigh(self.measure / (off + 1e-5))
        return replace(state, cost=self._cost(state.q, state.initial, state.f))

    def improved(self, state: _State) -> _State:
        """Return the state after one damped step; channels that it does not improve stay."""
        slope = state.slope * self.root[..., None]
        across = slope.transpose(0, 2, 1)
        off = self.root * (state.f - self.target)
        gradient = (across @ off[..., None])[..., 0]
        gradient += PRIOR * (state.q - state.initial) + state.q @ _ROUGH
        H = across @ slope + _ROUGH + PRIOR * np.eye(36)
        diagonal = np.einsum("cii->ci", H)
        H = H + (state.damping[:, None] * diagonal + 1e-10)[..., None] * np.eye(36)
        step = np.linalg.solve(H, -gradient[..., None])[..., 0]
        q = _bounded(state.q + np.clip(step, -LARGEST_STEP, LARGEST_STEP))
        trial = self._state(q, state.initial, np.maximum(state.damping / 5, 1e-7))
        stay = replace(state, damping=4 * state.damping)
        return _where(trial.cost < state.cost, trial, stay)


def _bounded(q: np.ndarray) -> np.ndarray:
    return np.clip(q.reshape(-1, 3, 2, 6), label_model.LOW, HIGH).reshape(q.shape)


def _where(condition: np.ndarray, a: _State, b: _State) -> _State:
    """Return a's channels where the condition (C,) holds, else b's."""
    parts = []
    for name in ("q", "initial", "f", "slope", "cost", "damping"):
        x, y = getattr(a, name), getattr(b, name)
        parts.append(np.where(condition.reshape(-1, *[1] * (x.ndim - 1)), x, y))
    return _State(*parts)
