"""From one measured material to its label and its mixture, and how far they stand apart.

The steps: samples over the view stops; a label fitted to the data; closures chosen for that label; label and mixture fitted to each
other; the fewest closures that keep the tolerance. Errors are measured on view angles that were not fitted.
"""

from dataclasses import dataclass, field

import numpy as np

from factory.materials import errors, joint_fit, label_fit, label_model, node_model
from factory.materials.samples import Samples, held_out, view_stops
from shaders.mixture import Mixture
from shaders.spline import basis

DIGITS = 5  # significant digits of a mixture in the catalogue; the label has one more
VIEWS_DEG = (0, 5, 9, 13, 17, 21, 25, 28, 32, 36, 40, 43, 47, 51, 54, 57, 61.5, 64, 67, 70, 73, 76, 78, 80, 82, 84, 86)


@dataclass(frozen=True)
class Recipe:
    """closures: the counts to try, fewest first; l1, worst: nodes against label, mean and worst view, that end the search."""

    closures: tuple[int, ...] = (6,)
    l1: float = 0.015
    worst: float = 0.05
    views_deg: tuple[float, ...] = VIEWS_DEG
    joint: joint_fit.Settings = field(default_factory=joint_fit.Settings)


@dataclass(frozen=True)
class Fit:
    """label (3, 3, 2, 6) logarithms in canonical order; the three L1 are (6,), one a held-out view."""

    label: np.ndarray
    mixture: Mixture
    nodes_vs_label: np.ndarray
    nodes_vs_source: np.ndarray
    label_vs_source: np.ndarray

    def score(self, recipe):
        """At most 1 if the tolerance is kept."""
        return max(self.nodes_vs_label.mean() / recipe.l1, self.nodes_vs_label.max() / recipe.worst)


def fit(source, recipe, sphere=None):
    """The Fit of a source (callable (cos_h, cos_d) → f (…, 3)) with the fewest closures that keep the tolerance, else the best."""
    stops = view_stops(recipe.views_deg)
    samples = Samples(np.arccos(1 - stops))
    measured = source(samples.cos_h, samples.cos_d)
    weight = errors.metric(measured, samples)
    half = samples.thinned(2)
    label = label_fit.fit(measured[::2], weight[::2], half, label_model.starts(source))
    sizes = node_model.choose(errors.label_values(label, half), weight[::2], half, max(recipe.closures))
    problem = joint_fit.JointFit(samples, measured, weight, recipe.joint, label)
    best = None
    for count in recipe.closures:
        result = measure(*_together(problem, label, sizes[count - 1], stops), source)
        if best is None or result.score(recipe) < best.score(recipe):
            best = result
        if best.score(recipe) <= 1:
            break
    return best


def _together(problem, label, atoms, stops):
    """Label and mixture after the joint fit from these closures."""
    kinds = tuple(kind for kind, _ in atoms)
    log_alpha = np.log(np.tile([alpha for _, alpha in atoms], (len(stops), 1)))
    state = joint_fit.State(label, kinds, log_alpha, np.zeros_like(log_alpha))
    state = problem.run(problem.run(state, frozen=("label", "tilt"), iterations=8))
    return label_model.in_canonical_order(state.label), Mixture(kinds, stops, state.log_alpha, state.tilt, state.weights)


def measure(label, mixture, source):
    """The Fit of a label and mixture, their errors taken at the held-out views."""
    samples = held_out()
    L, N, M = errors.label_values(label, samples), mixture.evaluate(*samples.cosines), source(samples.cos_h, samples.cos_d)
    return Fit(
        label,
        mixture,
        nodes_vs_label=errors.relative_l1(N, L, samples),
        nodes_vs_source=errors.relative_l1(N, M, samples),
        label_vs_source=errors.relative_l1(L, M, samples),
    )


def display(fit_, source, sphere):
    """Display L2 on the sphere, one a light map: nodes against label, nodes against source, label against source."""
    nodes = sphere.nodes()
    L, N = sphere.picture(label_on(fit_.label, nodes)), sphere.picture(fit_.mixture.evaluate(*nodes))
    M = sphere.picture(source(nodes[2], nodes[3]))
    return sphere.display_l2(N, L), sphere.display_l2(N, M), sphere.display_l2(L, M)


def label_on(label, cosines):
    """BRDF values of a label at (cos_i, cos_o, cos_h, cos_d)."""
    return label_model.values(label, basis(np.arccos(np.clip(cosines[3], 0, 1))), np.log(cosines[2]))


def rounded(fit_, source):
    """The Fit with its numbers as the catalogue will hold them, and errors of those numbers."""
    label = np.array([float(f"{x:.{DIGITS + 1}g}") for x in fit_.label.ravel()]).reshape(fit_.label.shape)
    return measure(label, Mixture.from_json(fit_.mixture.to_json(DIGITS)), source)
