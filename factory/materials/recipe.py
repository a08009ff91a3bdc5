"""From one measured material to its label and its mixture, and how far they stand apart.

The steps: samples over the view stops; a label fitted to the data; closures chosen for that label;
label and mixture fitted to each other, first by weighted squares, then reweighted towards least L1;
the fewest closures that keep the tolerance. Errors are measured on view angles that were not
fitted.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from factory.materials import errors, joint_fit, label_fit, label_model, node_model
from factory.materials.samples import Samples, held_out, view_stops
from shaders.mixture import Mixture
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


@dataclass(frozen=True)
class Recipe:
    """What to aim at, on view angles between the stops that are neither fitted nor reported
    (CHECK_DEG).

    closures        the counts to try, fewest first; the first that keeps the tolerance wins
    l1, worst       nodes against label: relative L1 of the views' mean, and of the worst view
    drift           nodes against the measurement, L1 of the mean
    pulls           μ to go through: a fit that agrees well may follow the measurement more closely
    hard_*          for what keeps no tolerance with the most closures: less pull until hard_l1 and
    hard_worst are kept; or, where the
                    drift is above hard_drift, more (hard_pulls), if that brings it below within
                    bought_l1; else it stays as it is
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
    """label (3, 3, 2, 6) logarithms in canonical order; the three L1 are (6,), one a held-out
    view.
    """

    label: np.ndarray
    mixture: Mixture
    nodes_vs_label: np.ndarray
    nodes_vs_source: np.ndarray
    label_vs_source: np.ndarray


def fit(source, recipe):
    """The Fit of a source (callable (cos_h, cos_d) → f (…, 3)) with the fewest closures that keep
    the tolerance, else with the most.
    """
    problem = FittingProblem(source, recipe)
    for count in recipe.closures:
        state, kept = problem.search(count, last=count == recipe.closures[-1])
        if kept:
            break
    return measure(*problem.parts(state), source)


class FittingProblem:
    """One material: its samples, its start label, the closures chosen for each count, and fits with
    different pulls.
    """

    def __init__(self, source, recipe):
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

    def parts(self, state):
        """Label in canonical order and mixture."""
        return label_model.in_canonical_order(state.label), Mixture(
            state.kinds, self.stops, state.log_alpha, state.tilt, state.weights
        )

    def start(self, count):
        """The chosen closures, their widths fitted to the start label, upright."""
        atoms = self.sizes[count - 1]
        log_alpha = np.log(np.tile([alpha for _, alpha in atoms], (len(self.stops), 1)))
        state = joint_fit.State(
            self.label, tuple(kind for kind, _ in atoms), log_alpha, np.zeros_like(log_alpha)
        )
        return self.joint(self.recipe.joint).run(state, frozen=("label", "tilt"), iterations=6)

    def joint(self, settings, weight=None):
        """The joint fit under these settings; weight: of squared differences, the first metric if
        None.
        """
        return joint_fit.JointFit(
            self.samples,
            self.measured,
            self.weight if weight is None else weight,
            settings,
            self.label,
        )

    def with_prior_weight(self, state, mu, iterations, rounds=1):
        """The joint fit from a state with pull μ, reweighted each round, and its check.

        The check is three L1: nodes against label, the same at the worst view, nodes against
        measurement.
        """
        for _ in range(rounds):
            columns = node_model.columns(state.kinds, state.log_alpha, state.tilt, self.samples)
            weight = errors.reweighted(self.measured, columns @ state.weights, self.samples)
            state = self.joint(replace(self.recipe.joint, mu=mu, mu_label=mu), weight).run(
                state, iterations=iterations
            )
        return state, self.checked(state)

    def checked(self, state):
        """The three L1 of `with_pull`, at the check angles."""
        label, mixture = self.parts(state)
        L, N = errors.label_values(label, self.check), mixture.evaluate(*self.check.cosines)
        agreement = errors.relative_l1(N, L, self.check)
        return (
            agreement.mean(),
            agreement.max(),
            errors.relative_l1(N, self.check_measured, self.check).mean(),
        )

    def search(self, count, last):
        """The fit with `count` closures under the strongest pull that keeps the tolerance, and
        whether it is kept.

        last  no more closures will be tried: what keeps none gives up agreement for drift, or the
        other way round
        """
        r = self.recipe
        middle = r.joint.mu
        state = self.joint(r.joint).run(self.start(count), iterations=15)
        if not last and self.checked(state)[0] > HOPELESS * r.l1:
            return state, False
        state, figures = self.with_prior_weight(state, middle, iterations=15, rounds=2)

        def keeps(f):
            return f[0] <= r.l1 and f[1] <= r.worst

        if keeps(figures):
            stronger = [mu for mu in r.pulls if mu > middle]
            state, figures = self._follow(state, figures, stronger, keeps)
            return state, figures[2] <= r.drift
        if not last:
            return state, False
        if figures[0] > r.hard_l1 or figures[1] > r.hard_worst:
            return self._loosened(state, figures), False
        if figures[2] > r.hard_drift:
            return self._bought(state), False
        return state, False

    def _follow(self, state, figures, pulls, allowed):
        """Goes through the pulls as long as what is figures is allowed."""
        for mu in pulls:
            trial, result = self.with_prior_weight(state, mu, iterations=12)
            if not allowed(result):
                break
            state, figures = trial, result
        return state, figures

    def _loosened(self, state, figures):
        """Less and less pull until label and nodes agree well enough."""
        r = self.recipe
        for mu in sorted((mu for mu in r.pulls if mu < r.joint.mu), reverse=True):
            if figures[0] <= r.hard_l1 and figures[1] <= r.hard_worst:
                break
            state, figures = self.with_prior_weight(state, mu, iterations=15)
        return state

    def _bought(self, state):
        """More pull until the drift is bearable; the state as it was if that costs too much
        agreement.
        """
        r, trial = self.recipe, state
        for mu in r.hard_pulls:
            trial, figures = self.with_prior_weight(trial, mu, iterations=12)
            if figures[0] > r.bought_l1:
                break
            if figures[2] <= r.hard_drift:
                return trial
        return state


def measure(label, mixture, source):
    """The Fit of a label and mixture, their errors taken at the held-out views."""
    samples = held_out()
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


def display(fit_, source, sphere):
    """Display L2 on the sphere, one a light map: nodes against label, nodes against source, label
    against source.
    """
    nodes = sphere.nodes()
    L, N = (
        sphere.picture(label_on(fit_.label, nodes)),
        sphere.picture(fit_.mixture.evaluate(*nodes)),
    )
    M = sphere.picture(source(nodes[2], nodes[3]))
    return sphere.display_l2(N, L), sphere.display_l2(N, M), sphere.display_l2(L, M)


def label_on(label, cosines):
    """BRDF values of a label at (cos_i, cos_o, cos_h, cos_d)."""
    return label_model.values(
        label, basis(np.arccos(np.clip(cosines[3], 0, 1))), np.log(cosines[2])
    )


def rounded(fit_, source):
    """The Fit with its numbers as the catalogue will hold them, and errors of those numbers."""
    label = np.array([float(f"{x:.{DIGITS + 1}g}") for x in fit_.label.ravel()]).reshape(
        fit_.label.shape
    )
    return measure(label, Mixture.from_json(fit_.mixture.to_json(DIGITS)), source)
