"""A car's body as two lofts: the lower body, nose to tail, and the cabin that stands on it.

x forward, y left, z up, metres; the ground is z = 0, the wheelbase's middle need not be x = 0.
t     2 x / length, in [-1, 1]
psi   place along the body, so that (t, plan) = (sin psi, cos psi) stretched onto a superellipse:
      ends as fine as sides
theta angle round half a section: −π/2 underneath, 0 at the widest, π/2 on top
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from factory.shapes.closed_surface import Surface, close_surface, grid_faces
from factory.shapes.lofts import loft

PAINT, DARK = 1, 2  # segments: the body; wheels, glass, lights and trim


@dataclass(frozen=True)
class Form:
    """All numbers of a body. Heights in m above ground; *_at in m along x."""

    length: float
    width: float
    height: float
    clearance: float
    # heights of the upper outline: at the nose, the cowl (foot of the windscreen), the belt, the
    # tail
    nose: float
    cowl: float
    tail: float
    cowl_at: float
    roof_front_at: float
    roof_rear_at: float
    glass_rear_at: float
    axles: tuple[float, float]
    wheel: float  # radius
    corner: float  # the plan's exponent: 4 a round nose, 9 a square one
    shoulder: float  # the section's exponent above its widest line
    tumblehome: float  # how much narrower the roof is than the belt, m per side
    bow: float  # how far the windscreen's middle stands before its sides, m
    bed: tuple[float, float] | None = None  # a pickup's bed or an open cockpit, from x to x
    bed_floor: float = 0.02  # its height above the section's widest line; below it: a cockpit

    @property
    def arch(self) -> float:
        """Return the radius of the wheel arches."""
        u = np.linspace(-0.9, 0.9, 13)  # along the arch; it stays 0.1 m below the bonnet all along
        over = np.array([self.upper(axle + 1.17 * self.wheel * u) for axle in self.axles])
        return min(1.17 * self.wheel, float(((over - 0.1 - self.wheel) / np.sqrt(1 - u**2)).min()))

    def upper(self, x: ArrayLike) -> np.ndarray:
        """Return the height of the lower body's upper outline."""
        half = self.length / 2
        reach = min(0.25, 0.6 * (self.glass_rear_at + half))
        nodes = [
            -half,
            -half + reach,
            self.glass_rear_at,
            self.cowl_at,
            self.cowl_at + 0.55 * (half - self.cowl_at),
            half - 0.12,
            half,
        ]
        middle = self.nose + 0.74 * (self.cowl - self.nose)
        heights = [
            self.tail - 0.05,
            self.tail,
            self.tail + 0.015,
            self.cowl,
            middle,
            self.nose,
            self.nose - 0.05,
        ]
        return PchipInterpolator(nodes, heights)(np.clip(x, -half, half))

    def lower(self, x: Any) -> Any:
        """Return the height of the lower body's underside, which rises at both ends."""
        t = np.abs(2 * x / self.length)
        return self.clearance + 0.13 * np.clip((t - 0.72) / 0.28, 0, 1) ** 2

    def plan(self, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return t and the share of the full width there."""
        s, c = np.sin(psi), np.cos(psi)
        norm = (np.abs(s) ** self.corner + np.abs(c) ** self.corner) ** (1 / self.corner)
        return s / norm, c / norm

    def psi_at(self, x: ArrayLike) -> np.ndarray:
        """Return the psi of a place x."""
        t = np.clip(2 * np.asarray(x) / self.length, -1, 1)
        return np.arctan2(t, (1 - np.abs(t) ** self.corner) ** (1 / self.corner))

    def skin(self, psi: ArrayLike, theta: ArrayLike, cut: bool = True) -> np.ndarray:
        """Return points (..., 3) of the lower body's left half; psi and theta broadcast.

        cut  with wheel arches and bed
        """
        psi, theta = np.broadcast_arrays(psi, theta)
        t, plan = self.plan(psi)
        x = t * self.length / 2
        waist = 1 - 0.025 * t**2 - 0.02 * np.clip(t, 0, 1) ** 2
        high, low = self.upper(x), self.lower(x)
        middle = low + 0.56 * (high - low)
        closing = (1 - np.abs(t) ** 16) ** (1 / 16) * 0.75 + 0.25 * np.clip(
            plan * 3, 0, 1
        )  # the ends close in height too, later than in width
        closing = np.where(plan < 1e-6, 0.25, closing)
        above = np.sin(theta) >= 0
        power = np.where(above, self._shoulder(x), 7.0)
        c, s = np.cos(theta), np.sin(theta)
        norm = (np.abs(c) ** power + np.abs(s) ** power) ** (1 / power)
        y = c / norm * self.width / 2 * plan * waist
        z = middle + s / norm * np.where(above, high - middle, middle - low) * closing
        y = y * (
            1
            - 0.045 * np.clip((z - middle) / (high - middle), 0, 1) ** 2
            - 0.05 * np.clip((middle - z) / (middle - low), 0, 1) ** 2
        )
        if self.bed and cut:
            over = np.where(
                np.min([np.abs(x - axle) for axle in self.axles], axis=0) < self.arch * 1.02,
                self.wheel + self.arch + 0.04,
                0.0,
            )
            inside = (
                (x > self.bed[0])
                & (x < self.bed[1])
                & (y < self.width / 2 * plan * waist - 0.13)
                & above
            )
            z = np.where(inside, np.minimum(z, np.maximum(middle + self.bed_floor, over)), z)
        if cut:
            for axle in self.axles:
                reach = np.abs(x - axle) / self.arch
                roof = self.wheel + self.arch * np.sqrt(np.clip(1 - reach**2, 0, 1))
                raised = (reach < 1) & (z < roof)
                # What is raised above the widest line comes in with the side there
                share = np.clip((roof - middle) / ((high - middle) * closing), 0, 0.99)
                inward = (1 - share ** self._shoulder(x)) ** (1 / self._shoulder(x)) * (
                    1 - 0.045 * share**2
                )
                y, z = np.where(raised, y * inward, y), np.where(raised, roof, z)
        return np.stack([x, y, z], axis=-1)

    def _shoulder(self, x):
        """Return the upper section's exponent; the walls of a bed stand upright."""
        if not self.bed or self.bed_floor < 0:
            return self.shoulder
        return self.shoulder + (14 - self.shoulder) * np.clip((self.bed[1] + 0.35 - x) / 0.3, 0, 1)

    def side(self, x: float, z: float) -> float:
        """Return y of the left side at (x, z), above the sill."""
        theta = np.linspace(-1.2, 1.45, 200)
        points = self.skin(float(self.psi_at(x)), theta, cut=False)
        return float(np.interp(z, points[:, 2], points[:, 1]))


def lower_body(form: Form) -> Surface:
    """Return the body below the belt, wheel arches cut across it, as a closed Surface."""
    places = []
    for axle in form.axles:
        angle = np.linspace(0, np.pi, 17)
        places += [
            *(axle + form.arch * np.cos(angle) * 0.9995),
            axle - form.arch * 1.004,
            axle + form.arch * 1.004,
        ]
    if form.bed:
        places += [edge + gap for edge in form.bed for gap in (-0.004, 0.004)]
    stations = np.unique(
        np.concatenate([np.linspace(-np.pi / 2, np.pi / 2, 61)[1:-1], form.psi_at(places)])
    )
    stations = stations[np.append(True, np.diff(stations) > 1e-4)]
    theta = np.linspace(-np.pi / 2, np.pi / 2, 27)
    left = form.skin(stations[:, None], theta[None, :])
    right = (left * [1, -1, 1])[:, -2:0:-1]
    return loft(np.concatenate([left, right], axis=1))


def cabin(form: Form, around: int = 104) -> tuple[Surface, np.ndarray]:
    """Return the glasshouse as a closed Surface, and which of its faces are glass (F,) bool.

    Rings run from the belt to the roof's edge and then close over the roof. Windows sink 10 mm into
    their frame.
    """
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False) + np.pi / around
    square = 5.5
    norm = (np.abs(np.cos(phi)) ** square + np.abs(np.sin(phi)) ** square) ** (1 / square)
    ahead, across = np.cos(phi) / norm, np.sin(phi) / norm
    front, rear = (
        np.array([form.cowl_at, form.roof_front_at]),
        np.array([form.glass_rear_at, form.roof_rear_at]),
    )
    half = np.array([form.width / 2 - 0.085, form.width / 2 - 0.085 - form.tumblehome])
    steps = [
        (k, 1.0)
        for k in np.concatenate([[0.0, 0.1, 0.19, 0.21], np.linspace(0.27, 0.84, 6), [0.86, 0.93]])
    ]
    steps += [(1.0, s) for s in (0.985, 0.955, 0.9, 0.78, 0.55, 0.25)]
    edge = form.height - 0.05
    rings = []
    for rise, shrink in steps:
        ease = rise - 0.12 * rise * (1 - rise)  # windscreens and sides are slightly convex
        x_front, x_rear, y_half = (
            pair[0] + ease * (pair[1] - pair[0]) for pair in (front, rear, half)
        )
        y_half += 0.03 * np.sin(np.pi * min(rise, 1.0))
        centre, reach = (x_front + x_rear) / 2, (x_front - x_rear) / 2
        x = centre + reach * ahead * shrink
        y = y_half * across * shrink
        x = (
            x
            + (form.bow * np.clip(ahead, 0, 1) - 0.5 * form.bow * np.clip(-ahead, 0, 1))
            * (1 - across**2)
            * shrink
        )
        base = form.upper(np.clip(x, -form.length / 2 + 0.05, None)) - 0.12
        roof_line = edge - 0.03 * np.clip((form.roof_front_at - 0.45 - x) / 1.5, 0, 1) ** 2 * (
            form.roof_rear_at < -0.8
        )
        top = roof_line + 0.05 * (1 - shrink**2.2) if rise == 1.0 else roof_line
        rings.append(np.stack([x, y, base + np.minimum(rise * 1.04, 1.0) * (top - base)], 1))
    grid = np.array(rings)
    glass = _windows(form, grid, ahead, across, np.array([r for r, _ in steps]), front, rear)
    return _sunk(grid, glass)


def _windows(form, rings, ahead, across, rise, front, rear):
    """Return which quads (rings − 1, around) are glass.

    They lie between the belt and the roof, and between the pillars.
    """
    # halfway up: a pillar is a column of quads, so that its edges are straight
    x = (rings[6, :, 0] + np.roll(rings[6, :, 0], -1)) / 2
    middle = (rise[:-1] + rise[1:]) / 2
    band = ((middle > 0.26) & (middle < 0.85))[:, None]
    ahead_middle, across_middle = (
        (ahead + np.roll(ahead, -1)) / 2,
        (across + np.roll(across, -1)) / 2,
    )
    screen = (np.abs(across_middle) < 0.86) & (np.abs(ahead_middle) > 0.9)
    length = form.roof_front_at - form.roof_rear_at
    count = 1 if length < 1.3 else 2 if length < 2.3 or form.bed else 3
    spacing = (length + 0.15) / (count + 0.7)
    pillars = np.any(
        [np.abs(x - (form.roof_front_at - 0.1 - (k + 1) * spacing)) < 0.045 for k in range(count)],
        axis=0,
    )
    side = (
        (np.abs(across_middle) > 0.93)
        & (x < front.mean() - 0.13)
        & (x > rear.mean() + 0.16)
        & ~pillars
    )
    return band & (screen | side)[None, :]


def _sunk(rings, glass):
    """Return the cabin's Surface with its windows pushed in, and which faces are glass (F,)."""
    count, around, _ = rings.shape
    corners = np.zeros((count, around, 4), bool)
    padded = np.vstack([np.zeros((1, around), bool), glass, np.zeros((1, around), bool)])
    for k, (row, column) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        corners[..., k] = np.roll(padded[row : row + count], column, axis=1)
    inner = corners.all(2)
    along = np.roll(rings, -1, 1) - np.roll(rings, 1, 1)
    normal = np.cross(along, np.gradient(rings, axis=0))
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-9)
    rings = rings - 0.012 * inner[..., None] * normal
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(1)])
    body = grid_faces(count, around, wrap_columns=True)
    j = np.arange(around)
    low = np.stack([np.full(around, count * around), j, (j + 1) % around], 1)
    high = np.stack(
        [
            np.full(around, count * around + 1),
            (count - 1) * around + (j + 1) % around,
            (count - 1) * around + j,
        ],
        1,
    )
    quads = np.concatenate([glass.ravel()] * 2)
    surface = close_surface(vertices, np.concatenate([body, low, high]))
    # `closed` welds and drops nothing here: every face keeps its place
    return Surface(*surface), np.concatenate([quads, np.zeros(2 * around, bool)])
