"""Direct light by the closed form of the material, without shadows, interreflection or noise.

what      shaders.direct_light at the normals inside each pixel
bias      all light that the object blocks or reflects onto itself: none in the tier `direct`, and
          in the others none where a shape cannot shade itself, as seen from this side
checked   against the samples of both halves, in every tier: the estimate contains the bias. Where
          it is above a third of the limit a share of the samples is blended in (`blends`). In the
          tier `direct` what is expected by the differences of its points counts too
          (`combine_with_expectation`)
cost      none but its own, for the samples of the pilot are there already
fails     few: edges and mirror-like materials that the points miss, and materials whose lobes at
          grazing angles are not quite Cycles'
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from factory.render.estimators.halves import CONFIDENCE, Estimate, mean_over
from factory.render.estimators.renderer import STANDARD, DirectPicture, DirectWork, Shown
from manifests.schema import Estimator
from shaders import tone

NAME: Estimator = "closed-form"
POINTS = 16  # per pixel, before `plan_more_points`
MOST_POINTS = 1 << 21  # of all pixels that have more than those
MOST_PER_PIXEL = 1024
FINER = ((2,), (4,), (4, 16), (4, 16, 64))  # times the points, of pixels whose points differ
ROUNDS = 3  # of giving more points, after each of which it is known better where they lack
GEOMETRY = 0.35  # of the time that light at a point takes, for what the point sees
# of the limit: doubt about the points' own part of the error that needs no more. By a share of 0.3,
# what points miss is above a quarter of a limit of 5 on 5 of 57 shots of 64², and on one of those
# five by this one
ENOUGH = 0.2
# the error that is expected: LEFT times the points' `error_by_differences`, and OTHER. It is less
# than of points at random, for grids lie between each other, but narrow lobes have the noise of
# their directions. With how much it differs between shots; measured on own shapes and other meshes
# (docs/log.md)
LEFT = {False: (0.2, 0.17), True: (0.25, 0.3)}  # by whether lobes are sampled
SMALLER = -0.2  # power of the frame's pixels in units of STANDARD, by which LEFT is less in larger
OTHER, OTHER_SPREAD = 0.1, 0.2
# standard errors by which a measurement must be above what is expected to count alone: one of few
# samples is above it by two now and then
SURPRISING = 3.0
USUAL = 2.5  # differences of many shots, before any is computed
# samples of each half that take as long: for each point of a pixel; LEANING times the share of
# points that lean from their facets; and if four views share maps, MAPS times their size / pixels,
# and WIDE_MAPS / pixels for wide lobes. Measured on 48 shots (docs/log.md)
EACH_POINT, LEANING, MAPS, WIDE_MAPS = 0.225, 9.0, 20.0, 3000.0


class Finer(NamedTuple):
    """Points per pixel, and the pixels (height, width) bool that need so many."""

    points: int
    where: np.ndarray


def compute_direct_light(shown: Shown, limit: float) -> DirectPicture | None:
    """Return direct light by as many points per pixel as a limit needs; None: no closed form holds.

    limit  on the error
    """
    renderer, mask = shown.renderer, shown.mask
    work, direct = renderer.direct_light_work(POINTS), renderer.direct_light(POINTS)
    if work is None or direct is None:
        return None

    def finer(known: DirectPicture, more: Finer) -> DirectPicture | None:
        return renderer.direct_light(more.points, known, more.where)

    return refine_direct_light(direct, mask, work.points, limit, finer)


def refine_direct_light(
    direct: DirectPicture,
    mask: np.ndarray,
    points: int,
    error: float,
    compute: Callable[[DirectPicture, Finer], DirectPicture | None],
) -> DirectPicture:
    """Return direct light by as many points per pixel as make its own error small beside a limit.

    What more points change in a pixel is the error that its points had before. Where that is more
    than their differences say, as with bright facets that cover a few per cent of a pixel and that
    all grids miss, the pixels that still have as few points are taken to be off by as much more:
    their variance is scaled.

    direct   by `points` per pixel
    compute  returns a picture with more points in some pixels, None if the frame has no more
    """
    counts = np.full(int(mask.sum()), points)
    for _ in range(ROUNDS):
        before, known = direct, counts
        plan = plan_more_points(direct, mask, counts, error)
        if not plan:
            break
        for more in plan:
            result = compute(direct, more)
            if result is None:
                return direct
            direct = result
            counts = np.where(more.where[mask], more.points, counts)
        few = np.zeros_like(mask)
        few[mask] = counts == points
        scale = np.where(few, _surprise(before, direct, mask, counts > known), 1.0)
        direct = direct._replace(variance=direct.variance * scale[..., None].astype(np.float32))
    return direct


def _surprise(
    before: DirectPicture, after: DirectPicture, mask: np.ndarray, changed: np.ndarray
) -> float:
    """Return by how much points were off, in units of what their differences say; at least 1.

    Beside small differences of the pixels that changed it is those of all pixels that count.

    changed  (P,) bool, the pixels that have more points in `after`
    """
    slope = _slope(before.radiance, mask)
    off = (((after.radiance - before.radiance)[mask] * slope) ** 2).mean(-1, dtype=np.float64)
    parts = _errors_by_differences(before, mask)
    said = error_per_difference(before.sampled, mask.size).error * max(
        float(parts[changed].mean()), float(parts.mean())
    )
    return max(1.0, float(off[changed].mean()) / max(said, 1e-12))


def plan_more_points(
    direct: DirectPicture, mask: np.ndarray, counts: np.ndarray, error: float
) -> list[Finer]:
    """Return which pixels get more points, and how many; [] if the points' own error is small.

    It is small below a share ENOUGH of the limit `error`.

    The error lies at edges and in reflections, so that a few pixels are given many points: in
    proportion to the root of their part of it, which falls in proportion to their points. Which
    pixels those are is seen by their neighbours too, for the grids of one may agree by chance.

    direct  by so many points per pixel of the mask: counts (P,)
    """
    most = ENOUGH * error / error_per_difference(direct.sampled, mask.size).bound
    if error_by_differences(direct, mask) <= most:
        return []
    points = int(counts.min())
    # of as many points everywhere
    parts = with_neighbours(_errors_by_differences(direct, mask) * (counts / points), mask)
    best: tuple[float, float, np.ndarray] | None = None
    for levels in FINER:
        steps = np.array([points * times for times in (1, *levels)])
        if steps[-1] > MOST_PER_PIXEL:
            continue
        known = points_per_pixel(parts, counts, steps, most)
        left = float((parts * points / known).mean())
        more = known > counts
        used = steps[1:][[bool((known[more] == count).any()) for count in steps[1:]]]
        work = float(known[more].sum() + GEOMETRY * len(parts) * used.sum())
        plan = (max(left, most), work, known)
        best = min(best, plan, key=lambda each: each[:2]) if best else plan
    if best is None:
        return []
    result = []
    more = best[2] > counts
    for count in np.unique(best[2][more]):
        where = np.zeros_like(mask)
        where[mask] = more & (best[2] == count)
        result.append(Finer(int(count), where))
    return result


def with_neighbours(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return values (P,) of the mask's pixels, in proportion to the most of theirs and the mean of
    3 × 3 pixels, with the same sum.
    """
    from scipy.ndimage import uniform_filter

    frame = np.zeros(mask.shape)
    frame[mask] = values
    sums, inside = (
        uniform_filter(each, 3, mode="constant") for each in (frame, mask.astype(float))
    )
    result = np.maximum(values, sums[mask] / np.maximum(inside[mask], 1e-9))
    return result * (values.sum() / max(result.sum(), 1e-12))


def points_per_pixel(
    parts: np.ndarray, counts: np.ndarray, levels: np.ndarray, most: float
) -> np.ndarray:
    """Return points per pixel (P,) by which the mean of the parts is `most`: its own, or a level.

    It is more where memory does not suffice.

    parts   (P,) of the error, by levels[0] points everywhere
    counts  (P,) points per pixel so far, none of which is taken away
    levels  rising
    """
    roots = np.sqrt(parts)
    steps = np.sqrt(levels[1:] * levels[:-1].astype(float)) / levels[0]
    low, high = 1e-6 * (float(roots.max()) + 1e-12), float(roots.max()) + 1e-12
    largest, settled = counts, False
    for _ in range(30):  # halvings, on a log scale, of the root that more points are worth
        middle = math.sqrt(low * high)
        known = np.maximum(counts, levels[np.searchsorted(steps, roots / middle)])
        enough = float((parts * levels[0] / known).mean()) <= most
        if int(known[known > counts].sum()) > MOST_POINTS:
            low = middle
            continue
        # the last step that is enough: the last one of all would depend on the last bit of a part
        if enough or not settled:
            largest, settled = known, enough
        low, high = (middle, high) if enough else (low, middle)
    return largest


def error_per_difference(sampled: bool, pixels: int) -> Estimate:
    """Return the error in units of the differences, and how much it differs between shots.

    sampled  whether lobes are sampled
    pixels   of the frame
    """
    smaller = (pixels / STANDARD) ** SMALLER
    error, spread = LEFT[sampled]
    return Estimate(error * smaller, spread * smaller)


def cost_in_samples(pixels: int, work: DirectWork) -> float:
    """Return the samples of each half that take as long as the closed form of so many pixels."""
    maps = (MAPS * work.maps + WIDE_MAPS) / max(pixels, 1)
    return EACH_POINT * work.points + LEANING * work.leaning + maps


def error_by_differences(direct: DirectPicture, mask: np.ndarray) -> float:
    """Return the display error that a picture would have if its grids were placed at random."""
    return float(_errors_by_differences(direct, mask).mean())


def _errors_by_differences(direct: DirectPicture, mask: np.ndarray) -> np.ndarray:
    """Return the same of each pixel of the mask, (P,) float64."""
    slope = _slope(direct.radiance, mask)
    return (direct.variance[mask] * slope**2).mean(-1, dtype=np.float64)


def _slope(radiance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the display curve's slope (P, 3) at the mask's pixels, in the picture's exposure."""
    return tone.display_slope(radiance[mask], tone.auto_exposure(radiance, mask))


def expected_error(direct: DirectPicture, mask: np.ndarray) -> Estimate:
    """Return the closed form's error in the tier `direct` before samples measure it."""
    left = error_per_difference(direct.sampled, mask.size)
    return _expected_error(error_by_differences(direct, mask), left)


def expected_error_at_limit(error: float, pixels: int) -> Estimate:
    """Return the same before direct light is computed by as many points as a limit needs.

    pixels  of the frame
    """
    left = error_per_difference(False, pixels)
    return _expected_error(min(USUAL, ENOUGH * error / left.bound), left)


def _expected_error(own: float, left: Estimate) -> Estimate:
    return Estimate(left.error * own + OTHER, left.standard_error * own + OTHER_SPREAD)


def measure_error(
    direct: np.ndarray, unblocked: Sequence[np.ndarray], mask: np.ndarray
) -> Estimate:
    """Return the closed form's error by two independent pictures of the tier `direct`.

    Differences are taken of radiance and scaled by the display curve's slope (tone.display_slope).

    direct     (height, width, 3) by the closed form
    unblocked  two such pictures of equally many samples
    """
    exact, slope = direct[mask], _slope(direct, mask)
    one, other = ((each[mask] - exact) * slope for each in unblocked)
    return mean_over((one * other).mean(-1))


def combine_with_expectation(measured: Estimate, expected: Estimate) -> Estimate:
    """Return the closed form's error in the tier `direct` by a measurement and by what is expected.

    Both count as their certainty: few samples say less than the points' differences. What is
    beyond doubt not as expected counts as it was measured.
    """
    if measured.error - SURPRISING * measured.standard_error > expected.bound:
        return measured
    spread = expected.standard_error
    weight = spread**2 / (spread**2 + measured.standard_error**2)
    error = expected.error + weight * (measured.error - expected.error)
    return Estimate(max(error, 0.0), math.sqrt(weight) * measured.standard_error)


def error_with_more_samples(
    known: Estimate, expected: Estimate, samples: int, count: int
) -> Estimate:
    """Return an error as `count` samples of each half will show it, by what is known so far.

    The best guess stays what it is, and its uncertainty falls.

    known     by `samples` and by what was expected (`combine_with_expectation`)
    expected  before samples measured it: what they do not say
    """
    before = 1 / max(expected.standard_error, 1e-9) ** 2  # a precision, as what follows
    seen = max(1 / max(known.standard_error, 1e-9) ** 2 - before, 0.0)
    precision = before + seen * (count / samples) ** 2
    return Estimate(known.error, 1 / math.sqrt(precision))


def is_surely_above(estimate: Estimate, error: float) -> bool:
    """Whether an estimate is above the limit beyond doubt, whatever more samples would say."""
    return estimate.error - CONFIDENCE * estimate.standard_error > error


def needed_samples(estimate: Estimate, samples: int, error: float) -> int | None:
    """Return the samples of each half that show that the error is kept, or None if it seems not so.

    An error that seems above the limit may be below it, but further samples for that alone are a
    bad bet: those of whatever else is tried show it at no cost.

    estimate  by `samples` of each half; its uncertainty falls in proportion to 1/samples
    """
    if estimate.bound <= error:  # its bias may be too large: a look that is twice as close
        return 2 * samples
    left = error - max(estimate.error, 0.0)
    if left <= 0:
        return None
    return max(samples + 1, math.ceil(samples * CONFIDENCE * estimate.standard_error / left))
