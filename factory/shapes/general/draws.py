"""Random numbers that every general family draws: sizes, turns, waves, outlines."""

from collections.abc import Callable, Sequence

import numpy as np

Generator = np.random.Generator


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """A number between low and high, as likely to be doubled as to be halved."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def log_uniforms(rng: Generator, low: float, high: float, count: int) -> np.ndarray:
    """Numbers (count,) drawn as by `log_uniform`."""
    return np.exp(rng.uniform(np.log(low), np.log(high), count))


def rotation(rng: Generator) -> np.ndarray:
    """A rotation (3, 3), uniform over all."""
    quaternion = rng.normal(size=4)
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def about_z(angle: float) -> np.ndarray:
    """The rotation (3, 3) about z by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def waves(
    rng: Generator, amplitude: float, low: float, high: float, count: int = 6
) -> Callable[[np.ndarray], np.ndarray]:
    """A smooth random function of points (…, 3): plane waves of wave numbers from low to high, of
    about the amplitude, longer ones higher.
    """
    numbers = log_uniforms(rng, low, high, count)
    vectors = rng.normal(size=(count, 3))
    vectors *= (numbers / np.linalg.norm(vectors, axis=1))[:, None]
    phases = rng.uniform(0, 2 * np.pi, count)
    weights = amplitude * numbers.min() / numbers
    return lambda p: (np.sin(p @ vectors.T + phases) * weights).sum(-1)


def round_outline(rng: Generator, roughness: float = 0.3, points: int = 160) -> np.ndarray:
    """A smooth closed outline (points, 2) about the origin, radius about 1."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    radius = np.ones(points)
    for number in range(2, 7):
        size = roughness * rng.normal() / number
        radius += size * np.cos(number * angle + rng.uniform(0, 2 * np.pi))
    radius = np.maximum(radius, 0.3)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)


def star_outline(rng: Generator) -> np.ndarray:
    """A star, a flower or a gear (N, 2), outer radius 1."""
    spikes = int(rng.integers(3, 13))
    inner = rng.uniform(0.45, 0.9)
    kind = rng.choice(["star", "flower", "gear"])
    if kind == "star":
        angle = np.arange(2 * spikes) * np.pi / spikes
        radius = np.where(np.arange(2 * spikes) % 2, inner, 1.0)
    elif kind == "flower":
        angle = np.linspace(0, 2 * np.pi, 40 * spikes, endpoint=False)
        radius = inner + (1 - inner) * np.abs(np.cos(spikes * angle / 2)) ** rng.uniform(0.5, 2)
    else:
        tooth = np.array([0.0, 0.18, 0.3, 0.62, 0.74]) / spikes * 2 * np.pi
        angle = (np.arange(spikes)[:, None] * 2 * np.pi / spikes + tooth).ravel()
        radius = np.tile([inner, inner, 1.0, 1.0, inner], spikes)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)


def block_outline(rng: Generator) -> np.ndarray:
    """A profile with right angles (N, 2), such as L, T, U, plus or steps; half sides at most 1."""
    a, b = rng.uniform(0.25, 0.6, 2)
    c = rng.uniform(0.55, 1.0)
    sides = int(rng.integers(3, 9))
    kinds: dict[str, Sequence[tuple[float, float]]] = {
        "L": [(-1, -c), (1, -c), (1, -c + a), (-1 + b, -c + a), (-1 + b, c), (-1, c)],
        "T": [(-a, -1), (a, -1), (a, 1 - b), (c, 1 - b), (c, 1), (-c, 1), (-c, 1 - b), (-a, 1 - b)],
        "U": [
            (-1, -c),
            (1, -c),
            (1, c),
            (1 - a, c),
            (1 - a, -c + b),
            (-1 + a, -c + b),
            (-1 + a, c),
            (-1, c),
        ],
        "plus": [
            (-a, -1),
            (a, -1),
            (a, -b),
            (1, -b),
            (1, b),
            (a, b),
            (a, 1),
            (-a, 1),
            (-a, b),
            (-1, b),
            (-1, -b),
            (-a, -b),
        ],
        "steps": [
            (-1, -1),
            (1, -1),
            (1, -0.4),
            (0.3, -0.4),
            (0.3, 0.2),
            (-0.4, 0.2),
            (-0.4, 0.8),
            (-1, 0.8),
        ],
        "polygon": [(np.cos(t), np.sin(t)) for t in np.arange(sides) * 2 * np.pi / sides],
    }
    return np.array(kinds[str(rng.choice(list(kinds)))], float)


def profile(rng: Generator, height: float, points: int = 48) -> np.ndarray:
    """Radii and heights (points, 2) of a smooth turned form that stands on z = 0."""
    from scipy.interpolate import PchipInterpolator

    knots = int(rng.integers(3, 8))
    z = np.concatenate([[0.0], np.sort(rng.uniform(0.05, 0.95, knots - 2)), [1.0]])
    radius = np.clip(rng.normal(0.5, 0.22, knots), 0.12, 1.0)
    t = np.linspace(0, 1, points)
    return np.stack([PchipInterpolator(z, radius)(t), t * height], 1)
