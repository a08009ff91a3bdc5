"""The joint fit of a label and a mixture to a measured material and to each other.

M  measured, L label, N mixture (nodes); λ, μ small. It minimises
|L − N|² + λ |L − M|² + μ |N − M|² + ties,
where |·|² is a weighted sum over samples, views and channels. For given L and closures the weights
X ≥ 0 of N solve a small least-squares problem per view and channel (variable projection), because
|L − N|² + μ|N − M|² = (1 + μ)|N − T|² + μ/(1 + μ) |L − M|², T = (L + μM)/(1 + μ). The other
variables, the label's 108 numbers and log α and tilt per view and closure, move by
Levenberg–Marquardt. Ties keep neighbouring views' log α and tilt together, so that nothing jumps
between the stops of a colour ramp.
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from factory.materials import nnls, node_model
from shaders import label_model
from shaders.samples import Samples

# columns, weights, active sides, normal matrices, residuals N − T, and L − M
Projection: TypeAlias = tuple[
    np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray
]
LABEL = 108


@dataclass(frozen=True)
class Settings:
    """Weights of the cost's terms, and when to stop.

    mu, mu_label          weights of nodes and label against the measurement
    tie_alpha, tie_tilt   between neighbouring views, and upright: of tilts towards 0, all three
                          relative to the measurement's weighted square
    prior, smooth         of the label, towards `prior_label` and against second differences
    iterations            at most
    tolerance             relative gain below which three iterations in a row end the fit
    """

    mu: float = 0.1
    mu_label: float = 0.1
    tie_alpha: float = 2e-3
    tie_tilt: float = 2e-2
    upright: float = 1e-4
    prior: float = 1e-7
    smooth: float = 1e-6
    iterations: int = 40
    tolerance: float = 1e-3


@dataclass(frozen=True)
class State:
    """Variables of the fit and their cost.

    label (3, 3, 2, 6), kinds (K,), log_alpha and tilt (V, K), weights (V, K, 3)
    """

    label: np.ndarray
    kinds: tuple[str, ...]
    log_alpha: np.ndarray
    tilt: np.ndarray
    weights: np.ndarray = field(default_factory=lambda: np.zeros(0))  # set when a fit is done
    cost: float = np.inf


class JointFit:
    """The problem: samples, measured values, weights of squared differences, and settings."""

    def __init__(
        self,
        samples: Samples,
        measured: np.ndarray,
        weight: np.ndarray,
        settings: Settings,
        prior_label: np.ndarray,
    ) -> None:
        # W (V, 3, P)
        self.samples, self.M, self.W, self.settings = (
            samples,
            measured,
            np.moveaxis(weight, -1, 1),
            settings,
        )
        basis, self.log_cos_h = samples.spline()
        self.basis, self.prior_label = basis, prior_label
        self.energy = (weight * measured**2).sum((1, 2))  # (V,)
        self.label_weight = settings.mu_label + settings.mu / (1 + settings.mu)
        self.scale = 1 / max(self.energy.sum(), 1e-12)

    # --- values and cost

    def _project(self, state):
        """Return columns, weights, active sides and residual N − T (V, 3, P) at a state."""
        mu = self.settings.mu
        L = label_model.values(state.label, self.basis, self.log_cos_h)
        T = (L + mu * self.M) / (1 + mu)
        A = node_model.columns(state.kinds, state.log_alpha, state.tilt, self.samples)
        V, _, K = A.shape
        T = np.moveaxis(T, -1, 1)
        G, b = nnls.normal_equations(A, self.W, T)
        x, active = nnls.solve(G.reshape(-1, K, K), b.reshape(-1, K))
        x, active = x.reshape(V, 3, K), active.reshape(V, 3, K)
        r = x @ np.swapaxes(A, 1, 2) - T
        return A, x, active, G, r, np.moveaxis(L - self.M, -1, 1)

    def _ties(self, state):
        """Return the quadratic penalty's value, gradient (V·2K,) and matrix over [log α, tilt]."""
        s = self.settings
        V, K = state.log_alpha.shape
        energy = 0.5 * (self.energy[1:] + self.energy[:-1])
        D = np.diff(np.eye(V), axis=0)
        chain = (D.T * energy) @ D * 0.5
        upright = np.diag(self.energy) * s.upright
        blocks = [
            (state.log_alpha, s.tie_alpha * chain),
            (state.tilt, s.tie_tilt * chain + upright),
        ]
        value = sum(np.einsum("vk,vu,uk->", p, Q, p) for p, Q in blocks)
        H = np.zeros((V, 2, K, V, 2, K))
        g = np.zeros((V, 2, K))
        for i, (p, Q) in enumerate(blocks):
            g[:, i] = Q @ p
            for k in range(K):
                H[:, i, k, :, i, k] = Q
        return value * self.scale, g.ravel() * self.scale, H.reshape(V * 2 * K, -1) * self.scale

    def _label_prior(self, label):
        """Return value, gradient (108,) and matrix of the label's own penalty."""
        s = self.settings
        d = (label - self.prior_label).reshape(-1, 6)
        curves = label.reshape(-1, 6)
        value = s.prior * (d * d).sum() + s.smooth * np.einsum(
            "ci,ij,cj->", curves, label_model.ROUGHNESS, curves
        )
        H = np.kron(np.eye(18), s.smooth * label_model.ROUGHNESS + s.prior * np.eye(6))
        return value, (s.prior * d + s.smooth * curves @ label_model.ROUGHNESS).ravel(), H

    def cost(self, state: State, projected: Projection | None = None) -> tuple[float, Projection]:
        """Return the cost, relative to the measurement's weighted square, and its projection."""
        mu = self.settings.mu
        projected = projected or self._project(state)
        r, off = projected[4], projected[5]
        data = (1 + mu) * (self.W * r * r).sum() + self.label_weight * (self.W * off * off).sum()
        return (
            data * self.scale + self._ties(state)[0] + self._label_prior(state.label)[0],
            projected,
        )

    # --- one Gauss–Newton system

    def _system(self, state, projected):
        """Return gradient and matrix over [label (108), (log α, tilt) by view and closure]."""
        mu = self.settings.mu
        A, x, active, G, r, off = projected
        V, P, K = A.shape
        _, dL = label_model.slopes(state.label, self.basis.reshape(-1, 6), self.log_cos_h.ravel())
        dL = np.moveaxis(dL.reshape(3, V, P, 36), 0, 1)  # (V, 3, P, 36)
        by_alpha, by_tilt = node_model.slopes(
            state.kinds, state.log_alpha, state.tilt, self.samples, A
        )
        # (V, 3, P, 2K)
        moved = (
            np.concatenate([by_alpha, by_tilt], -1)[:, None]
            * np.concatenate([x, x], -1)[:, :, None]
        )
        Z = np.concatenate(
            [dL * (-1 / (1 + mu)), moved, np.broadcast_to(A[:, None], (V, 3, P, K))], -1
        )
        root = np.sqrt(self.W)
        Z *= root[..., None]
        S = np.swapaxes(Z, 2, 3) @ Z  # (V, 3, 36 + 3K, …)
        n = 36 + 2 * K
        both = active[..., :, None] & active[..., None, :]
        ridge = np.where(active, nnls.RIDGE * np.einsum("vckk->vck", G), 1.0)
        inner = np.where(both, G, 0.0) + ridge[..., None] * np.eye(K)
        C = np.where(active[..., None], S[:, :, n:, :n], 0.0)
        S = S[:, :, :n, :n]
        # (V, 3, 36 + 3K, 2): slopes against both residuals
        both_r = np.swapaxes(Z, 2, 3) @ np.stack([root * r, root * off], -1)
        gradient = both_r[:, :, :n, 0]
        projected_S = S - np.swapaxes(C, 2, 3) @ np.linalg.solve(inner, C)
        size = LABEL + V * 2 * K
        H, g = np.zeros((size, size)), np.zeros(size)
        # Z holds −dL/(1 + μ)
        label_gradient = both_r[:, :, :36, 1].sum(0) * (-self.label_weight * (1 + mu))
        for c in range(3):
            own = slice(36 * c, 36 * c + 36)
            H[own, own] += (1 + mu) * projected_S[:, c, :36, :36].sum(0) + self.label_weight * (
                1 + mu
            ) ** 2 * S[:, c, :36, :36].sum(0)
            g[own] += (1 + mu) * gradient[:, c, :36].sum(0) + label_gradient[c]
            for v in range(V):
                nodes = slice(LABEL + 2 * K * v, LABEL + 2 * K * (v + 1))
                H[nodes, nodes] += (1 + mu) * projected_S[v, c, 36:, 36:]
                H[own, nodes] += (1 + mu) * projected_S[v, c, :36, 36:]
                H[nodes, own] += (1 + mu) * projected_S[v, c, 36:, :36]
                g[nodes] += (1 + mu) * gradient[v, c, 36:]
        H, g = H * self.scale, g * self.scale
        _, g_ties, H_ties = self._ties(state)
        _, g_label, H_label = self._label_prior(state.label)
        H[LABEL:, LABEL:] += H_ties
        g[LABEL:] += g_ties
        H[:LABEL, :LABEL] += H_label
        g[:LABEL] += g_label
        return g, H

    def _move(self, state, step):
        """Return the state after a step, inside its bounds.

        Steps are clipped to the range in which a linear model can be trusted.
        """
        V, K = state.log_alpha.shape
        low, high, least, most = node_model.bounds(state.kinds, self.samples.view_cos)
        nodes = step[LABEL:].reshape(V, 2, K)
        return replace(
            state,
            label=label_model.clip_to_bounds(
                state.label + np.clip(step[:LABEL], -2, 2).reshape(state.label.shape)
            ),
            log_alpha=np.clip(state.log_alpha + np.clip(nodes[:, 0], -0.6, 0.6), low, high),
            tilt=np.clip(state.tilt + np.clip(nodes[:, 1], -0.15, 0.15), least, most),
        )

    def run(
        self, state: State, frozen: Collection[str] = (), iterations: int | None = None
    ) -> State:
        """Return the best state of Levenberg–Marquardt from a state, its weights set.

        frozen  may hold "label", "nodes" and "tilt"
        """
        V, K = state.log_alpha.shape
        free = np.ones(LABEL + 2 * K * V, bool)
        if "label" in frozen:
            free[:LABEL] = False
        if "nodes" in frozen:
            free[LABEL:] = False
        if "tilt" in frozen:
            free[LABEL:].reshape(V, 2, K)[:, 1] = False
        cost, projected = self.cost(state)
        damping, idle = 1e-2, 0
        for _ in range(iterations or self.settings.iterations):
            g, H = self._system(state, projected)
            g, H = g[free], H[np.ix_(free, free)]
            diagonal = np.diag(H)
            for _ in range(8):
                step = np.zeros(len(free))
                damped = H + np.diag(damping * diagonal + 1e-12 * diagonal.max())
                step[free] = np.linalg.solve(damped, -g)
                trial = self._move(state, step)
                trial_cost, trial_projected = self.cost(trial)
                if trial_cost < cost:
                    break
                damping *= 5
            else:
                break
            idle = idle + 1 if cost - trial_cost < self.settings.tolerance * cost else 0
            state, cost, projected, damping = (
                trial,
                trial_cost,
                trial_projected,
                max(damping / 5, 1e-7),
            )
            if idle >= 3:
                break
        return replace(state, weights=np.swapaxes(projected[1], 1, 2), cost=cost)
