"""From one measured material to its label and its mixture, and their errors.

The steps: samples over the view stops; a label fitted to the data; closures chosen for that label;
label and mixture fitted to each other, first by weighted squares, then reweighted towards least L1;
the fewest closures that keep the tolerance; last, between the last fitted view and the horizon, the
closures' weights alone are fitted to the label. Errors are measured on view angles that were not
fitted.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from factory.materials import joint_fit, label_fit, nnls, node_model
from factory.materials.sphere import Sphere
from shaders import errors, label_model
from shaders.mixture import Mixture
from shaders.samples import Measured, Samples, held_out_samples, view_stops
from shaders.spline import basis

# times the tolerance after the first metric: reweighting gains a sixth, so more closures are tried
# at once
HOPELESS = 1.6
CHECK_DEG = (7.5, 22.0, 37.0, 53.0, 67.5, 79.0)
DIGITS = 5  # significant digits of a mixture in the catalogue; the label has one more
VIEWS_DEG = (
    0,
    5,
    9,
    13,
    17,
    21,
    25,
    28,
    32,
    36,
    40,
    43,
    47,
    51,
    54,
    57,
    61.5,
    64,
    67,
    70,
    73,
    76,
    78,
    80,
    82,
    84,
    86,
)
# beyond them nodes are fitted to the label alone, not to the measurement
GRAZING_DEG = (87.3, 88.4, 89.3)
GRAZING_ROUNDS = 4  # of fitting the weights there, reweighted towards least L1


@dataclass(frozen=True)
class Recipe:
    """The tolerances of a fit, on view angles that are neither fitted nor reported (CHECK_DEG).

    closures        counts to try, fewest first; the first that keeps the tolerance is used
    l1, worst       nodes against label: relative L1 of the views' mean, and of the worst view
    drift           nodes against the measurement, L1 of the mean
    pulls           weights μ of the measurement to try: a fit whose label and nodes agree well may
                    follow the measurement more closely
    hard_*          for a material that keeps no tolerance with the most closures: μ falls until
                    hard_l1 and hard_worst are kept; or, where the drift is above hard_drift, it
                    rises (hard_pulls), if that brings the drift below within bought_l1; otherwise
                    it stays
    """

    closures: tuple[int, ...] = (4, 6, 8)
    l1: float = 0.013
    worst: float = 0.04
    drift: float = 0.065
    pulls: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4, 0.8)
    hard_l1: float = 0.034
    hard_worst: float = 0.055
    hard_drift: float = 0.172
    bought_l1: float = 0.041
    hard_pulls: tuple[float, ...] = (0.12, 0.14, 0.16, 0.18)
    views_deg: tuple[float, ...] = VIEWS_DEG
    joint: joint_fit.Settings = field(default_factory=joint_fit.Settings)


@dataclass(frozen=True)
class Fit:
    """A label and a mixture with their errors.

    label          (3, 3, 2, 6) logarithms in canonical order
    …_vs_…         (6,) relative L1 per held-out view
    """

    label: np.ndarray
    mixture: Mixture
    nodes_vs_label: np.ndarray
    nodes_vs_source: np.ndarray
    label_vs_source: np.ndarray


class Check(NamedTuple):
    """Relative L1 at the check angles."""

    agreement: float  # nodes against label, mean of the views
    worst: float  # the same at the worst view
    drift: float  # nodes against measurement, mean of the views


def fit(source: Measured, recipe: Recipe) -> Fit:
    """Return the Fit of a source with the fewest closures that keep the tolerance, or the most.

    source  callable (cos_h, cos_d) → f (…, 3)
    """
    problem = FittingProblem(source, recipe)
    for count in recipe.closures:
        state, kept = problem.search(count, last=count == recipe.closures[-1])
        if kept:
            break
    label, mixture = problem.parts(state)
    return measure(label, with_grazing_views(label, mixture), source)


def with_grazing_views(label: np.ndarray, mixture: Mixture) -> Mixture:
    """Return a mixture that follows a label up to the horizon; other views stay as they are.

    It has stops at GRAZING_DEG beside its own. Widths are those of its last stop, and so are tilts,
    but tilts away from the viewer shrink with n·v, so that no closure turns away from the viewer.

    label  (3, 3, 2, 6) logarithms
    """
    stops = view_stops(GRAZING_DEG)
    stops = stops[stops > mixture.stops[-1]]
    if not len(stops):
        return mixture
    samples = Samples(np.arccos(1 - stops), 120, 20)
    truth = errors.label_values(label, samples)
    shrunk = (1 - stops) / (1 - mixture.stops[-1])
    log_alpha = np.repeat(mixture.log_alpha[-1:], len(stops), 0)
    tilt = mixture.tilt[-1] * np.where(mixture.tilt[-1] < 0, shrunk[:, None], 1.0)
    columns = node_model.columns(mixture.kinds, log_alpha, tilt, samples)
    weight = errors.metric(truth, samples)
    for _ in range(GRAZING_ROUNDS):
        weights = _fit_weights(columns, truth, weight)
        weight = errors.reweight(truth, columns @ weights, samples)
    return replace(
        mixture,
        stops=np.concatenate([mixture.stops, stops]),
        log_alpha=np.concatenate([mixture.log_alpha, log_alpha]),
        tilt=np.concatenate([mixture.tilt, tilt]),
        weights=np.concatenate([mixture.weights, weights]),
    )


def _fit_weights(columns: np.ndarray, truth: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the weights (V, K, 3) ≥ 0 of columns (V, P, K) nearest to a truth (V, P, 3).

    weight  (V, P, 3) of squared differences
    """
    V, _, K = columns.shape
    G, b = nnls.normal_equations(columns, np.moveaxis(weight, -1, 1), np.moveaxis(truth, -1, 1))
    x, _ = nnls.solve(G.reshape(-1, K, K), b.reshape(-1, K))
    return np.swapaxes(x.reshape(V, 3, K), 1, 2)


class FittingProblem:
    """One material: its samples, its initial label, and the closures chosen for each count."""

    def __init__(self, source: Measured, recipe: Recipe) -> None:
        self.recipe = recipe
        self.stops = view_stops(recipe.views_deg)
        self.samples = Samples(np.arccos(1 - self.stops))
        self.measured = source(self.samples.cos_h, self.samples.cos_d)
        self.weight = errors.metric(self.measured, self.samples)
        half = self.samples.thinned(2)
        self.label = label_fit.fit(
            self.measured[::2], self.weight[::2], half, label_model.initial_labels(source)
        )
        self.sizes = node_model.choose(
            errors.label_values(self.label, half), self.weight[::2], half, max(recipe.closures)
        )
        self.check = Samples(np.radians(CHECK_DEG), 80, 16)
        self.check_measured = source(self.check.cos_h, self.check.cos_d)

    def parts(self, state: joint_fit.State) -> tuple[np.ndarray, Mixture]:
        """Return label in canonical order and mixture."""
        return label_model.in_canonical_order(state.label), Mixture(
            state.kinds, self.stops, state.log_alpha, state.tilt, state.weights
        )

    def start(self, count: int) -> joint_fit.State:
        """Return the state of `count` chosen closures, untilted, with fitted widths.

        The widths are fitted to the initial label."""
        atoms = self.sizes[count - 1]
        log_alpha = np.log(np.tile([alpha for _, alpha in atoms], (len(self.stops), 1)))
        state = joint_fit.State(
            self.label, tuple(kind for kind, _ in atoms), log_alpha, np.zeros_like(log_alpha)
        )
        return self.joint(self.recipe.joint).run(state, frozen=("label", "tilt"), iterations=6)

    def joint(
        self, settings: joint_fit.Settings, weight: np.ndarray | None = None
    ) -> joint_fit.JointFit:
        """Return the joint fit under these settings.

        weight  of squared differences; None: the first metric
        """
        return joint_fit.JointFit(
            self.samples,
            self.measured,
            self.weight if weight is None else weight,
            settings,
            self.label,
        )

    def with_measurement_weight(
        self, state: joint_fit.State, mu: float, iterations: int, rounds: int = 1
    ) -> tuple[joint_fit.State, Check]:
        """Return the joint fit from a state with weight μ, reweighted each round, and its check."""
        for _ in range(rounds):
            columns = node_model.columns(state.kinds, state.log_alpha, state.tilt, self.samples)
            weight = errors.reweight(self.measured, columns @ state.weights, self.samples)
            state = self.joint(replace(self.recipe.joint, mu=mu, mu_label=mu), weight).run(
                state, iterations=iterations
            )
        return state, self.checked(state)

    def checked(self, state: joint_fit.State) -> Check:
        """Return the L1 errors of a state at the check angles."""
        label, mixture = self.parts(state)
        L, N = errors.label_values(label, self.check), mixture.evaluate(*self.check.cosines)
        agreement = errors.relative_l1(N, L, self.check)
        drift = errors.relative_l1(N, self.check_measured, self.check)
        return Check(agreement.mean(), agreement.max(), drift.mean())

    def search(self, count: int, last: bool) -> tuple[joint_fit.State, bool]:
        """Return the fit with `count` closures, and whether it keeps the tolerance.

        It has the highest weight of the measurement that keeps the tolerance.

        last  no more closures will be tried: a fit that keeps no tolerance trades agreement for
              drift, or drift for agreement
        """
        r = self.recipe
        middle = r.joint.mu
        state = self.joint(r.joint).run(self.start(count), iterations=15)
        if not last and self.checked(state).agreement > HOPELESS * r.l1:
            return state, False
        state, check = self.with_measurement_weight(state, middle, iterations=15, rounds=2)

        def keeps(check: Check) -> bool:
            return check.agreement <= r.l1 and check.worst <= r.worst

        if keeps(check):
            higher = [mu for mu in r.pulls if mu > middle]
            state, check = self._raise_weights(state, check, higher, keeps)
            return state, check.drift <= r.drift
        if not last:
            return state, False
        if check.agreement > r.hard_l1 or check.worst > r.hard_worst:
            return self._lower_weights(state, check), False
        if check.drift > r.hard_drift:
            return self._trade_weights(state), False
        return state, False

    def _raise_weights(self, state, check, weights, allowed):
        """Return the last state, with rising weights, whose errors are allowed."""
        for mu in weights:
            trial, result = self.with_measurement_weight(state, mu, iterations=12)
            if not allowed(result):
                break
            state, check = trial, result
        return state, check

    def _lower_weights(self, state, check):
        """Return the first state, with falling weights, whose label and nodes agree well enough."""
        r = self.recipe
        for mu in sorted((mu for mu in r.pulls if mu < r.joint.mu), reverse=True):
            if check.agreement <= r.hard_l1 and check.worst <= r.hard_worst:
                break
            state, check = self.with_measurement_weight(state, mu, iterations=15)
        return state

    def _trade_weights(self, state):
        """Return the state whose higher weight brings the drift below its limit.

        The state is the given one if that costs too much agreement.
        """
        r, trial = self.recipe, state
        for mu in r.hard_pulls:
            trial, check = self.with_measurement_weight(trial, mu, iterations=12)
            if check.agreement > r.bought_l1:
                break
            if check.drift <= r.hard_drift:
                return trial
        return state


def measure(label: np.ndarray, mixture: Mixture, source: Measured) -> Fit:
    """Return the Fit of a label and mixture, with errors at the held-out views."""
    samples = held_out_samples()
    L, N, M = (
        errors.label_values(label, samples),
        mixture.evaluate(*samples.cosines),
        source(samples.cos_h, samples.cos_d),
    )
    return Fit(
        label,
        mixture,
        nodes_vs_label=errors.relative_l1(N, L, samples),
        nodes_vs_source=errors.relative_l1(N, M, samples),
        label_vs_source=errors.relative_l1(L, M, samples),
    )


def display(
    fit_: Fit, source: Measured, sphere: Sphere
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return display L2 on the sphere per light map.

    The three are nodes against label, nodes against source, label against source.
    """
    nodes = sphere.nodes()
    L, N = (
        sphere.picture(label_on(fit_.label, nodes)),
        sphere.picture(fit_.mixture.evaluate(*nodes)),
    )
    M = sphere.picture(source(nodes[2], nodes[3]))
    return sphere.display_l2(N, L), sphere.display_l2(N, M), sphere.display_l2(L, M)


def label_on(label: np.ndarray, cosines: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return BRDF values of a label at (cos_i, cos_o, cos_h, cos_d)."""
    return label_model.values(
        label, basis(np.arccos(np.clip(cosines[3], 0, 1))), np.log(cosines[2])
    )


def round_fit(fit_: Fit, source: Measured) -> Fit:
    """Return the Fit of the numbers as rounded for the catalogue, with errors of those."""
    label = np.array([float(f"{x:.{DIGITS + 1}g}") for x in fit_.label.ravel()]).reshape(
        fit_.label.shape
    )
    return measure(label, Mixture.from_json(fit_.mixture.to_json(DIGITS)), source)
