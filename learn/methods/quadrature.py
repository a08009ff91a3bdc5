"""Half-vector quadrature: the integral over the piecewise-constant map, for lobes of any width.

The paper's sum evaluates a lobe once per texel, and is wrong by a factor where the lobe is
narrower. Here the sharpness of each lobe decides its strategy: broad ones take the exact sum over
texels, narrow ones take samples about the pixel's normal (learn.methods.half_vectors).

A measured lobe that is narrow at one θ_d is often broad at another, where samples that follow it
are too far apart to see a lamp of one texel. There texels are summed, and the samples see the
others alone. At any θ_d the brightest texels are split as finely as a lobe is narrow there, and
summed (learn.methods.lamps). Where lobes are down to half a texel wide, texels are split into 2 × 2
of the same radiance: only those at a θ_d where a lobe is that narrow (split_texels), which is less
than a tenth of them for many. A sum over split texels leaves out a tenth of the tolerance at most,
except where it is short. Narrower ones take texels split into 4 × 4 at small tolerances, or where
derivatives are requested and there are no kernels. Maps of few texels are too coarse for any lobe,
because the horizon cuts through texels: there all lobes take split texels or samples.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from learn.engines.layout import NEGLIGIBLE
from learn.methods import (
    HELD_SAMPLES,
    Batch,
    Card,
    directional,
    forbid_second_derivatives,
    lamps,
    load,
    radiance_by_numbered_group,
    sampled_sum,
    split_texels,
    wants_gradient,
)
from shaders.dsbrdf import MAX_EXPONENT

CARD = Card(
    name="quadrature",
    approximates=(
        "the integral: narrow lobes by samples that follow them, broad ones by the exact sum over"
        " texels, bright texels by their parts"
    ),
    # no claim against the paper's sum, which is itself wrong there; 1e-2 against the integral
    error=None,
    cost=(
        "pixels × (texels if a lobe is broad + 256 samples for each narrow one), at tolerance 1e-2;"
        " half as many samples at twice the tolerance"
    ),
    memory=(
        "below 64 MiB at any size: chunks of pixels, computed again in the backward pass; with the"
        " gradient of light by kernels also twelve times the light's size, and that of split texels"
    ),
)
# exponent up to which the sum over 64 rows of texels is right to about 3e-3; twice the rows serve
# four times as much
BROAD = 300.0
SPLITS = (1, 2, 4)  # parts of a texel's side; beyond, samples
# parts of a texel's side up to which texels are split at any tolerance: samples that err as little
# take longer there
ALWAYS_SPLIT = 2
# share of texels from which those that a narrow lobe is broad for are worth a sum of their own
WORTHWHILE = 0.02
# share of split texels beyond which broad lobes are summed by themselves over whole ones: measured
# on the 66 built-in materials with a lobe for texels split in two, and on both kinds of camera
JOINT = 0.15
# tolerance from which samples serve the band of the finest split too; below, they would need more
# time than split texels
LOOSE = 5e-3
# pairs of a pixel and a part of a texel up to which split texels are summed whole, and can be
# differentiated twice
SHORT = 2**19
LEFT_OUT = 0.1  # of the tolerance: what a sum over split texels may leave out
CULLED = "whose sums over split texels have first derivatives only"
LEAST, MOST = 64, 16384  # samples


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    # Without kernels, split texels are faster where derivatives are requested. Where all of it is
    # short, they stay the sum that can be differentiated twice.
    derivatives = wants_gradient(batch.n, batch.view, batch.m, batch.light)
    by_texels = tolerance < LOOSE or (
        derivatives and (may_sum_whole(batch, SPLITS[-1]) or not has_kernels(batch))
    )
    rows = min(batch.light.shape[1], batch.light.shape[2] / 2)
    limits, limit = [], -1.0  # sharpness up to which texels of each of SPLITS serve
    for split in SPLITS:
        limit = sharpness_limit(split * rows, tolerance, limit)
        limits.append(limit)
    splits = SPLITS if by_texels else tuple(split for split in SPLITS if split <= ALWAYS_SPLIT)
    sharpest = limits[len(splits) - 1]  # for texels

    sharp = sharpness(batch.m.detach())
    if not wants_gradient(batch.m):
        # lobes that reflect nothing are skipped
        sharp = torch.where(batch.m[..., 0, :].amax(-1) > 0, sharp, -1.0)
    # a lobe whose channels lie on both sides of the limit has one strategy, not two
    of_lobe = sharp.amax(-2, keepdim=True)
    sharp = torch.where((of_lobe > sharpest) & (sharp > sharpest / 2), of_lobe, sharp)

    in_texels = (sharp > -1.0) & (sharp <= sharpest)
    of_group = torch.where(in_texels, sharp, -1.0).amax((-1, -2))
    whole = in_texels & (of_group <= limits[0])[:, None, None]
    out = 0 * batch.n
    lit = whole & lamps.are_split(batch, whole, tolerance)[:, None, None]
    if lit.any():
        out = out + sum_over_texels(batch, lit, 1, limits, tolerance)
    if (whole & ~lit).any():
        out = out + load("exact").radiance(
            replace(batch, m=keep_lobes(batch.m, whole & ~lit)), tolerance
        )
    for split, lower, upper in zip(splits[1:], limits, limits[1:], strict=False):
        groups = (of_group > lower) & (of_group <= upper)
        if groups.any():
            lobes = in_texels & groups[:, None, None]
            out = out + sum_over_texels(batch, lobes, split, limits, tolerance)
    narrow = sharp > sharpest
    if narrow.any():
        out = out + sum_over_samples(batch, narrow, limits, tolerance)
    return out


@dataclass(frozen=True)
class Group:
    """The pixels of a batch that share one material and one light.

    n, view            (p, 3) unit normals, and unit vectors to the viewer or None, camera frame
    m                  (3, 3, 2, 6) control values
    light              (Hl, Wl, 3) radiance, light frame
    camera_from_light  (3, 3) rotation
    """

    n: torch.Tensor
    view: torch.Tensor | None
    m: torch.Tensor
    light: torch.Tensor
    camera_from_light: torch.Tensor

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the light."""
        return self.light.shape[0], self.light.shape[1]

    @property
    def rotation(self) -> np.ndarray:
        """`camera_from_light`, (3, 3) float64 numpy."""
        return self.camera_from_light.double().numpy()


def sum_each_group(
    batch: Batch, lobes: torch.Tensor, function: Callable[[Group, torch.Tensor], torch.Tensor]
) -> torch.Tensor:
    """Radiance (P, 3) by a function of one Group and of those of its lobes (3, 3) that count.

    lobes  (G, 3, 3) bool, channels and lobes of each group
    """

    def of_group(
        g: int, n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        return function(Group(n, view, m, light, batch.camera_from_light), lobes[g])

    return radiance_by_numbered_group(batch, of_group)


def may_sum_whole(batch: Batch, split: int) -> bool:
    """Return whether a sum over a map whose texels are all split may be made whole."""
    texels = batch.light.shape[1] * batch.light.shape[2]
    return len(batch.n) * split**2 * texels <= SHORT


def has_kernels(batch: Batch) -> bool:
    """Return whether compiled kernels serve a batch, derivatives included."""
    return sampled_sum.has_kernels(batch.n, batch.m) and bool(
        batch.m.detach()[..., 0, :].max() <= MAX_EXPONENT
    )


def sum_over_texels(
    batch: Batch, lobes: torch.Tensor, split: int, limits: Sequence[float], tolerance: float
) -> torch.Tensor:
    """Radiance (P, 3) of some lobes of a batch by sums over texels, some or all of which are split.

    Without kernels, and where the sum is short, all are split alike, and lamps no finer.

    lobes   (G, 3, 3) bool, channels and lobes of each group
    split   parts of a texel's side that the sharpest of them needs
    limits  sharpness up to which texels of each of SPLITS serve
    """
    chosen = replace(batch, m=keep_lobes(batch.m, lobes))
    if may_sum_whole(batch, split) or not has_kernels(batch):
        light = batch.light.repeat_interleave(split, 1).repeat_interleave(split, 2)
        return load("exact").radiance(replace(chosen, light=light), tolerance)
    return sum_each_group(
        forbid_second_derivatives(chosen, CARD.name, CULLED),
        lobes,
        functools.partial(
            sum_over_split_texels, limits=limits[: SPLITS.index(split) + 1], tolerance=tolerance
        ),
    )


def sum_over_split_texels(
    group: Group, lobes: torch.Tensor, limits: Sequence[float], tolerance: float
) -> torch.Tensor:
    """Radiance (p, 3) of one group by the sum over texels that are split where lobes are narrow.

    lobes   (3, 3) bool, channels and lobes that count
    limits  sharpness up to which texels of each of the first SPLITS serve

    Texels where lobes are faint are skipped: a pixel may lack LEFT_OUT of the tolerance.
    Broad lobes take part in the same sum where few texels are split, and else have one of their own
    over whole texels.
    """
    n, view, m, light, rotation = group.n, group.view, group.m, group.light, group.rotation
    if not lobes.any():
        return n * 0 + 0 * (m.sum() + light.sum() + (0 if view is None else view.sum()))

    def parts_of(some: torch.Tensor) -> np.ndarray:
        return split_texels.parts_of_texels(m, some, view, group.size, rotation, limits, SPLITS)

    sums = [(lobes, parts_of(lobes))]
    if (sums[0][1] > 1).mean() > JOINT:
        broad = lobes & (sharpness(m.detach()) <= limits[0])
        sums = [(each, parts_of(each)) for each in (broad, lobes & ~broad) if each.any()]
    out = 0 * n
    for each, parts in sums:
        parts = np.maximum(parts, lamps.parts_of(light, m, each, view, rotation, tolerance))
        out = out + sum_over_parts(group, each, parts, LEFT_OUT * tolerance / len(sums))
    return out


def sum_over_parts(
    group: Group, lobes: torch.Tensor, parts: np.ndarray, left_out: float
) -> torch.Tensor:
    """Radiance (p, 3) of some lobes (3, 3) of one group by a sum over texels split into parts.

    parts     (H, W) of each texel's side
    left_out  part of the mean radiance that a pixel may lack
    """
    kept = keep_lobes(group.m, lobes)
    lights, energy = split_texels.lights_of(group.light, group.camera_from_light, parts)
    lacking = 0.0
    if group.view is None:
        lacking = left_out * directional.mean_radiance(group.n, None, kept, energy, lights)
    return directional.radiance(
        group.n,
        group.view,
        kept,
        energy,
        lights,
        lacking,
        lobes=tuple(lobes.any(0).nonzero().flatten().tolist()),
        method=CARD.name,
        negligible=math.log2(max(left_out, 2.0**NEGLIGIBLE)),
    )


def sum_over_samples(
    batch: Batch, lobes: torch.Tensor, limits: Sequence[float], tolerance: float
) -> torch.Tensor:
    """Radiance (P, 3) of narrow lobes by samples, and by texels at angles where they are broad.

    lobes   (G, 3, 3) bool, channels and lobes of each group
    limits  sharpness up to which texels of each of SPLITS serve
    """
    narrow = replace(batch, m=keep_lobes(batch.m, lobes))
    return sum_each_group(
        forbid_second_derivatives(narrow, CARD.name, HELD_SAMPLES),
        lobes,
        functools.partial(sum_over_samples_and_texels, limits=limits, tolerance=tolerance),
    )


def sum_over_samples_and_texels(
    group: Group, lobes: torch.Tensor, limits: Sequence[float], tolerance: float
) -> torch.Tensor:
    """Radiance (p, 3) of the narrow lobes (3, 3) of one group; others as of `sum_over_samples`.

    Samples that follow a lobe where it is narrow are too far apart to see a lamp of one texel at a
    θ_d where it is broad. Texels at such a θ_d are summed, lamps too, and black for the samples.
    Each lobe has samples of its own: of those that two share, too few would lie in the broader one.
    """
    view, m, light, rotation = group.view, group.m, group.light, group.rotation
    out = 0 * group.n
    for lobe in lobes.any(0).nonzero().flatten().tolist():
        one = lobes & (torch.arange(3, device=lobes.device) == lobe)
        parts = split_texels.parts_of_texels(m, one, view, group.size, rotation, limits[:1], SPLITS)
        if (parts > 0).mean() < WORTHWHILE:
            parts = np.zeros_like(parts)
        parts = np.maximum(parts, lamps.parts_of(light, m, one, view, rotation, tolerance))
        sampled = light
        if parts.any():
            out = out + sum_over_parts(group, one, parts, LEFT_OUT * tolerance)
            sampled = torch.from_numpy(parts == 0).to(light)[..., None] * light
        out = out + sampled_sum.radiance(
            group.n,
            view,
            keep_lobes(m, one),
            sampled,
            group.camera_from_light,
            sample_count_for(tolerance),
        )
    return out


def sharpness_limit(rows: float, tolerance: float, otherwise: float) -> float:
    """Return the largest sharpness for which a sum over so many rows serves.

    otherwise  what is returned if it serves none
    """
    return BROAD * (rows / 64) ** 2 if rows >= least_rows(tolerance) else otherwise


def least_rows(tolerance: float) -> float:
    """Return the rows of a map (half its columns, if fewer) from which its sum serves broad lobes.

    The cosine has an edge at the horizon: however broad the lobe, the sum is wrong there by 0.5 /
    rows² of the mean under random maps of 3 to 16 rows. Below tolerance 1e-3 nothing is claimed.
    """
    return math.sqrt(0.55 / max(tolerance, 1e-3))


def sample_count_for(tolerance: float) -> int:
    """Return the number of samples for a tolerance, a power of two in [LEAST, MOST].

    The error falls about as 1 / samples. Under measured lights half as many keep the tolerance of
    pictures too, but leave twice the error in a texel's derivative.
    """
    return int(np.clip(2 ** math.ceil(math.log2(2.5 / tolerance)), LEAST, MOST))


def sharpness(m: torch.Tensor) -> torch.Tensor:
    """The sharpness of each lobe and channel (…, 3, 3): the largest γ · max(κ, 1) along its curves.

    It is 0.63 to 1 of the largest `lobe_sharpness`, since κ / (1 − e^−κ) is 1 to 1.58 times max(κ,
    1). BROAD is calibrated for it (docs/engines.md).
    """
    return split_texels.sharpness_along(m).amax(-1)


def keep_lobes(m: torch.Tensor, lobes: torch.Tensor) -> torch.Tensor:
    """m with no reflection (κ = 0) in all lobes but those marked (G, 3, 3).

    The others' γ is set high, so that engines skip them.
    """
    nothing = torch.tensor([0.0, 1e5], dtype=m.dtype, device=m.device)[:, None]
    return torch.where(lobes[..., None, None], m, nothing)
