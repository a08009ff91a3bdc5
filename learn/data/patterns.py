"""Printed and woven patterns over the material of a relit picture; its label stays the base's.

Radiance is linear in the BRDF, so a print costs one further picture, I_c, however many inks it has.
W_j(x) ∈ [0, 1], Σ W_j ≤ 1: how much of ink j covers pixel x; ρ_j: the ink's albedo, per channel.

dye    recolours the widest lobe, which is the diffuse one, and leaves the others, which are the
       gloss: I + Σ W_j (ρ_j/a − 1) I_c, where I_c is the picture of that lobe alone and a its
       albedo
paint  a matte cover: (1 − Σ W_j) I + Σ W_j ρ_j I_c, where I_c is the picture of a white matte
       surface. Materials whose widest lobe is dark or narrow take paint alone

Where no ink is the picture stays as it was, bit by bit. At least LEAST_BASE of the surface shows
the base, because the base of a surface that ink covers altogether cannot be seen.

Patterns follow the surface. Geometry may be stored without depth, so heights are integrated from
normals (`integrate_slopes`), and the pattern is projected onto the points: along one direction,
onto a cylinder, or onto the sides of a box, with seams. Steep sides are not exact, and need not be.

points (H, W, 3), in units of the object's size; uv (H, W, 2) coordinates of the pattern; d a field
(H, W) that is positive on the ink
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable

import numpy as np
import torch

from learn.layer.albedo import log_albedo
from shaders.dsbrdf import SHAPE

LEAST_BASE = 0.35
STEEPEST = 3.0  # slope that is integrated
DARKEST, NARROWEST = 0.04, 3.0  # albedo and γ of a widest lobe that can be dyed
NO_LOBE = -12.0  # log κ of a lobe that is left out
PARTIAL = 0.35  # share of patterns that end at a line across the object
PAINT = 0.25  # share of paint where the material could be dyed

Weights = np.ndarray  # (K, H, W)


def add_prints(
    rng: np.random.Generator,
    images: np.ndarray,
    n: torch.Tensor,
    segments: torch.Tensor,
    label: np.ndarray,
    render: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return pictures (B, H, W, 3) of objects that carry prints, each its own.

    images    (B, H, W, 3) of the base material; n (B, H, W, 3); segments (B, H, W)
    label     (S, 108) of the base
    render    label (S, 108) → images (B, H, W, 3) of the same objects under the same light
    """
    base, widest = albedos(label)
    is_paint = not all(map(_can_be_dyed, label, widest)) or rng.random() < PAINT
    printed = render(np.stack([_white_label() if is_paint else widest_lobe(m) for m in label]))
    points = surface_points(n, segments)
    result = np.empty_like(images)
    for i, image in enumerate(images):
        inside, normals = segments[i].numpy(), n[i].numpy()
        region = int(rng.integers(len(label)))
        weights = draw_pattern(rng, points[i], normals, inside > 0)
        if len(label) > 1 and rng.random() < 0.5:
            weights = weights * (inside == region + 1)
        inks = [_draw_ink(rng, base[region]) for _ in weights]
        change = np.zeros_like(image)
        for weight, ink in zip(weights, inks, strict=True):
            if is_paint:
                change += weight[..., None] * (ink * printed[i] - image)
            else:
                # what the other lobes reflect is not left for the dye
                rho = np.minimum(ink, np.maximum(0.95 - (base - widest), 0.02))
                factor = np.concatenate([np.ones((1, 3)), rho / widest]).astype(np.float32)
                change += weight[..., None] * (factor[inside] - 1) * printed[i]
        result[i] = np.maximum(image + change, 0)
    return result


def albedos(label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the albedo (S, 3) of labels (S, 108), and that of the widest lobe alone."""
    both = np.stack([label, np.stack([widest_lobe(m) for m in label])])
    whole, widest = np.exp(log_albedo(torch.from_numpy(both)).numpy()) - 1e-3
    return whole, np.maximum(widest, 1e-3)


def widest_lobe(label: np.ndarray) -> np.ndarray:
    """Return the label (108,) of the widest lobe alone."""
    result = label.reshape(SHAPE).copy()
    result[:, 1:, 0] = NO_LOBE
    return result.reshape(-1)


def can_be_dyed(label: np.ndarray) -> bool:
    """Return whether the widest lobe of a label (108,) is a matte part, which dye recolours."""
    return _can_be_dyed(label, albedos(label[None])[1][0])


def _can_be_dyed(label: np.ndarray, widest: np.ndarray) -> bool:
    gamma = np.exp(label.reshape(SHAPE)[:, 0, 1]).mean()
    return bool(widest.max() >= DARKEST and gamma <= NARROWEST)


def _white_label() -> np.ndarray:
    """Return the label (108,) of a white matte surface: f = 1/π."""
    result = np.zeros(SHAPE, np.float32)
    result[:, :, 0], result[:, 0, 1] = NO_LOBE, -4.0
    result[:, 0, 0] = np.log(np.log1p(1 / np.pi))
    return result.reshape(-1)


def _draw_ink(rng: np.random.Generator, base: np.ndarray) -> np.ndarray:
    """Return an ink's albedo (3,): of two random ones, that which differs more from the base."""
    inks = []
    for _ in range(2):
        saturation = 0.0 if rng.random() < 0.3 else rng.uniform(0.2, 1)
        value = 0.02 + 0.88 * rng.random() ** 1.3
        inks.append(colorsys.hsv_to_rgb(float(rng.random()), float(saturation), float(value)))
    colors = np.maximum(np.array(inks), 0.01)
    difference = np.abs(np.log(colors) - np.log(np.maximum(base, 0.01))).max(1)
    return colors[int(difference.argmax())]


def integrate_slopes(n: torch.Tensor) -> torch.Tensor:
    """Return height (B, H, W) towards the viewer, in units of half the frame's width.

    Its sign is the opposite of depth's elsewhere, and its mean is 0.

    It is the least-squares integral of the slopes that normals (B, H, W, 3) have (Frankot and
    Chellappa 1988), with slopes of at most STEEPEST and none in the background.
    """
    H, W = n.shape[1:3]
    facing = n[..., 2].clamp(min=1 / (4 * STEEPEST))
    along_x, along_row = (
        (slope / facing).clamp(-STEEPEST, STEEPEST) * (2 / W) for slope in (-n[..., 0], n[..., 1])
    )
    f_x = torch.fft.rfftfreq(W)[None] * (2 * np.pi)
    f_y = torch.fft.fftfreq(H)[:, None] * (2 * np.pi)
    squared = f_x**2 + f_y**2
    squared[0, 0] = 1
    spectrum = f_x * torch.fft.rfft2(along_x) + f_y * torch.fft.rfft2(along_row)
    return torch.fft.irfft2(-1j * spectrum / squared, s=(H, W))


def surface_points(n: torch.Tensor, segments: torch.Tensor) -> np.ndarray:
    """Return points (B, H, W, 3) about the object's centre, in units of its size.

    The size is the largest distance, within the picture, of the object from its centre. The frame
    is the camera's; what is in the background means nothing.
    """
    B, H, W = segments.shape
    z = integrate_slopes(n).numpy()
    x = (2 * np.arange(W, dtype=np.float32) + 1) / W - 1
    y = (H - 2 * np.arange(H, dtype=np.float32) - 1) / W
    grid = np.broadcast_to(np.stack(np.meshgrid(x, y), -1), (B, H, W, 2))
    points = np.concatenate([grid, z[..., None]], -1)
    for i, mask in enumerate(segments.numpy() > 0):
        if mask.any():
            points[i] -= points[i][mask].mean(0)
            points[i] /= np.linalg.norm(points[i][mask][:, :2], axis=-1).max() + 1e-6
    return points


def draw_pattern(
    rng: np.random.Generator, points: np.ndarray, n: np.ndarray, mask: np.ndarray
) -> Weights:
    """Return the weights (K, H, W) of a random pattern's K inks; they add up to at most 1.

    points, n  (H, W, 3); mask (H, W): the object
    """
    if not mask.any():
        return np.zeros((1, *mask.shape), np.float32)
    uv = _project(rng, points, n)
    pattern = PATTERNS[int(rng.integers(len(PATTERNS)))]
    weights = np.stack(pattern(rng, uv, mask))
    opacity = rng.uniform(0.7, 1) if rng.random() < 0.5 else 1.0
    weights = (opacity * weights).astype(np.float32)
    base = 1 - weights.sum(0)
    shares = weights[:, mask].mean(1)
    if base[mask].mean() < max(LEAST_BASE, shares.max()):
        weights[shares.argmax()] = base  # the base takes the place of the commonest ink
    if pattern is not logo and rng.random() < PARTIAL:
        weights *= _cut_at_line(rng, uv, mask)
    weights = np.clip(weights, 0, 1) * mask
    return weights * min(1.0, (1 - LEAST_BASE) / max(float(weights[:, mask].sum(0).mean()), 1e-6))


def _project(rng: np.random.Generator, points: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return uv of a projection from a random direction; the object is about 2 across."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0].astype(np.float32)
    p, facing = points @ turn, np.abs(n @ turn)
    kind = rng.integers(3)
    if kind == 0:
        return p[..., :2]
    if kind == 1:
        return np.stack([np.arctan2(p[..., 0], p[..., 2]), p[..., 1]], -1)
    side = facing.argmax(-1)
    return np.stack(
        [np.where(side == 0, p[..., 1], p[..., 0]), np.where(side == 2, p[..., 1], p[..., 2])], -1
    )


def _antialias(d: np.ndarray) -> np.ndarray:
    """Return the share of each pixel where d > 0, from d and its differences between pixels."""
    step = np.abs(np.diff(d, axis=0, append=d[-1:])) + np.abs(np.diff(d, axis=1, append=d[:, -1:]))
    return np.clip(0.5 + d / np.maximum(step, 1e-4), 0, 1)


def _distance_to_integer(t: np.ndarray) -> np.ndarray:
    """Return the distance of t from the nearest whole number."""
    return np.abs(t - np.rint(t))


def _cut_at_line(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the part (H, W) of the object on one side of a line."""
    angle = rng.uniform(0, 2 * np.pi)
    t = uv @ np.array([np.cos(angle), np.sin(angle)], np.float32)
    return _antialias(t - np.quantile(t[mask], rng.uniform(0.25, 0.65)))


def _to_periods(rng: np.random.Generator, uv: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return uv in periods, turned and shifted; low to high periods in a unit of length."""
    angle, frequency = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(np.log(low), np.log(high)))
    c, s = frequency * np.cos(angle), frequency * np.sin(angle)
    return uv @ np.array([[c, -s], [s, c]], np.float32) + rng.random(2).astype(np.float32)


def _sample(texture: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return a periodic texture (h, w) at t (H, W, 2) in texels, between texels smoothly."""
    whole = np.floor(t).astype(np.int64)
    f = t - whole
    f = f * f * (3 - 2 * f)
    h, w = texture.shape
    x, y = whole[..., 0], whole[..., 1]
    left, right, above, below = x % w, (x + 1) % w, y % h, (y + 1) % h
    top = texture[above, left] * (1 - f[..., 0]) + texture[above, right] * f[..., 0]
    bottom = texture[below, left] * (1 - f[..., 0]) + texture[below, right] * f[..., 0]
    return top * (1 - f[..., 1]) + bottom * f[..., 1]


def _noise(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Return noise (H, W) of two octaves at t (H, W, 2) in periods."""
    first, second = rng.normal(size=(2, 16, 16)).astype(np.float32)
    return _sample(first, t) + 0.5 * _sample(second, 2 * t)


def _stack_layers(upper: np.ndarray, *lower: np.ndarray) -> list[np.ndarray]:
    """Return the weights (H, W) of layers, of which each hides those after it."""
    layers, free = [upper], 1 - upper
    for layer in lower:
        layers.append(layer * free)
        free = free * (1 - layer)
    return layers


def stripes(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return one broad stripe in a period, and at times a narrow one beside it."""
    t = _to_periods(rng, uv, 1, 5)[..., 0]
    layers = [_antialias(rng.uniform(0.1, 0.3) - _distance_to_integer(t))]
    if rng.random() < 0.5:
        layers.append(_antialias(rng.uniform(0.05, 0.12) - _distance_to_integer(t + 0.5)))
    return _stack_layers(*layers)


def checks(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return the dark squares of a chessboard."""
    t = _to_periods(rng, uv, 0.7, 3)
    a, b = (_antialias(0.25 - _distance_to_integer(t[..., i])) for i in range(2))
    return [a + b - 2 * a * b]


def plaid(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return woven bands: threads of two directions each show in half of the cloth."""
    t = _to_periods(rng, uv, 0.7, 3)
    broad, narrow, place = rng.uniform(0.12, 0.3), rng.uniform(0.03, 0.08), rng.uniform(0.3, 0.5)
    bands, lines = (
        (
            _antialias(width - _distance_to_integer(t[..., 0] + shift))
            + _antialias(width - _distance_to_integer(t[..., 1] + shift))
        )
        / 2
        for width, shift in ((broad, 0.0), (narrow, place))
    )
    return [bands * (1 - lines), lines]


def dots(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return discs on a square or a staggered grid, of one ink or of two in turn."""
    t = _to_periods(rng, uv, 1, 4)
    row = np.rint(t[..., 1])
    t = t + np.stack([rng.integers(2) * 0.5 * row, 0 * row], -1)
    radius = np.hypot(_distance_to_integer(t[..., 0]), _distance_to_integer(t[..., 1]))
    inside = _antialias(rng.uniform(0.2, 0.42) - radius)
    if rng.random() < 0.5:
        return [inside]
    second = (np.rint(t[..., 0]) + row) % 2
    return [inside * (1 - second), inside * second]


def camouflage(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return two or three layers of patches with smooth, irregular edges."""
    t = _to_periods(rng, uv, 0.8, 3)
    layers = []
    for _ in range(int(rng.integers(2, 4))):
        noise = _noise(rng, t)
        layers.append(_antialias(noise - np.quantile(noise[mask], rng.uniform(0.6, 0.85))))
    return _stack_layers(*layers)


def glyphs(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return rows of shapes like letters, each on five by five texels."""
    cells = np.zeros((8, 7, 8, 7), np.float32)
    cells[:, 1:6, :, 1:6] = rng.random((8, 5, 8, 5)) < 0.55
    return [_antialias(_sample(cells.reshape(56, 56), 7 * _to_periods(rng, uv, 0.5, 2)) - 0.5)]


def gradient(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return a smooth change from the base to an ink across the object, or to another ink."""
    t = _to_periods(rng, uv, 0.5, 1)[..., 0]
    low, middle, high = np.quantile(t[mask], (0.05, rng.uniform(0.3, 0.7), 0.95))
    layers = [np.clip((t - middle) / (high - middle + 1e-6), 0, 1)]
    if rng.random() < 0.4:
        layers.append(np.clip((middle - t) / (middle - low + 1e-6), 0, 1))
    return layers


def logo(rng: np.random.Generator, uv: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return a single patch, round or square, with a mark of another ink inside."""
    rows, columns = np.nonzero(mask)
    at = int(rng.integers(len(rows)))
    t = (uv - uv[rows[at], columns[at]]) / rng.uniform(0.25, 0.6)
    t = np.abs(_to_periods(rng, t, 1, 1.01) - 0.5)
    power = (1.0, 2.0, 6.0)[int(rng.integers(3))]
    radius = ((t**power).sum(-1)) ** (1 / power)
    patch = _antialias(1 - radius)
    if rng.random() < 0.5:
        mark = _antialias(rng.uniform(0.1, 0.2) - np.abs(radius - rng.uniform(0.4, 0.7)))
    else:
        texels = np.zeros((7, 7), np.float32)
        texels[1:6, 1:6] = rng.random((5, 5)) < 0.5
        mark = _antialias(_sample(texels, 4 * (uv - uv[rows[at], columns[at]]) + 3) - 0.5)
    return [patch * (1 - mark), patch * mark]


PATTERNS = (stripes, checks, plaid, dots, camouflage, glyphs, gradient, logo)
