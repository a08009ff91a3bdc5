"""What may be done next for a shot, and what it costs.

A plan names an estimator and the further samples that it needs by its model; the time of denoisers,
closed forms and rays counts as samples. The cheapest is tried.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from factory.render.estimators import (
    blocked_light,
    closed_form,
    denoised,
    path_tracing,
    ratio,
    shadow_rays,
)
from factory.render.estimators.halves import CONFIDENCE, Estimate
from manifests.schema import Estimator

if TYPE_CHECKING:
    from factory.render.estimators.attempt import Attempt

MOST_SAMPLES = 2048  # of each half
MORE = 1.5  # times the samples of a try that failed, at least


class Plan(NamedTuple):
    """Further samples of each half for an estimator, and all that it costs, as such samples."""

    cost: float
    estimator: Estimator
    samples: int


def plans_of(attempt: Attempt) -> list[Plan]:
    """Return what may be done next; path tracing is always there."""
    samples, error, tier = attempt.halves.samples, attempt.error, attempt.shown.tier
    most = MOST_SAMPLES - samples
    further = min(path_tracing.needed_samples(attempt.now, samples, error), MOST_SAMPLES) - samples
    plans = [Plan(further, path_tracing.NAME, further)]
    if _may_try(attempt, denoised.NAME, denoised.MOST_TRIES):
        count = denoised.needed_samples(attempt.now.noise_bound, samples, attempt.scale, error)
        if tried := attempt.tried.get(denoised.NAME):
            count = math.ceil(max(denoised.CAUTION * count, MORE * tried[1]))
        further = max(count - samples, 0)
        if further <= most:
            cost = denoised.cost_in_samples(samples + further, tier)
            plans.append(Plan(further + cost, denoised.NAME, further))
    if attempt.direct is None:
        return plans
    plans += [plan for plan in (_shadow_rays_plan(attempt), _ratio_plan(attempt)) if plan]
    is_hopeless = blocked_light.is_too_much(attempt.blocked, error)
    if closed_form.NAME in attempt.tried and not is_hopeless:
        total = closed_form.needed_samples(*attempt.tried[closed_form.NAME], error)
        if total is not None and total <= MOST_SAMPLES:
            plans.append(Plan(total - samples, closed_form.NAME, total - samples))
    return plans


def is_direct_light_worth_asking(attempt: Attempt) -> bool:
    """Whether direct light, and what it makes possible, costs less than the other plans."""
    if not {closed_form.NAME, ratio.NAME, shadow_rays.NAME} & set(attempt.estimators):
        return False
    work = attempt.shown.renderer.direct_light_work(closed_form.POINTS)
    if work is None:
        return False
    cost = closed_form.cost_in_samples(int(attempt.shown.mask.sum()), work)
    least = min(plans_of(attempt)).cost
    if least <= cost:
        return False
    if attempt.shown.tier == "direct":
        return True
    by_rays = _shadow_rays_plan(attempt)
    if by_rays is not None and by_rays.cost + cost < least:
        return True
    if attempt.blocked is None:
        attempt.blocked = attempt.halves.error_of_direct_light()
        attempt.measure_noise_left(attempt.halves.pictures)
    if not blocked_light.is_too_much(attempt.blocked, attempt.error):
        return True
    by_ratio = _ratio_plan(attempt)
    return by_ratio is not None and by_ratio.cost + cost < least


def growth_after(failed: Estimate, limit: float) -> float:
    """Return how many times the samples of a try that failed the next one has, at least.

    What is above the limit beyond doubt is noise of indirect light that few paths find. Few samples
    show too little of it, so that the law asks for too few again and again.
    """
    surely = failed.error - CONFIDENCE * failed.standard_error
    return max(MORE, math.sqrt(max(surely, 0.0) / limit))


def _ratio_plan(attempt: Attempt) -> Plan | None:
    """Return the plan of a ratio that keeps the limit by its law, if it needs not too many."""
    if attempt.shown.tier == "direct" or attempt.blocked is None:
        return None
    if not _may_try(attempt, ratio.NAME, ratio.MOST_TRIES) or attempt.left > ratio.MOST_LEFT:
        return None
    halves, least = attempt.halves, ratio.LEAST
    if ratio.NAME in attempt.tried:
        least = math.ceil(MORE * attempt.tried[ratio.NAME][1])
    count = ratio.needed_samples(
        attempt.left * attempt.now.noise_bound,
        halves.samples,
        attempt.ratio_scale,
        attempt.error,
        attempt.direct_light_error,
        least,
    )
    if count > MOST_SAMPLES:
        return None
    further = max(count - halves.samples, 0)
    total = halves.samples + further
    rendered = further + total - halves.unblocked_samples
    cost = rendered + 2 * denoised.cost_in_samples(total, attempt.shown.tier)
    return Plan(cost, ratio.NAME, further)


def _shadow_rays_plan(attempt: Attempt) -> Plan | None:
    """Return the plan of a picture by shadow rays that keeps the limit by its law, if any."""
    name, halves, least = shadow_rays.NAME, attempt.halves, shadow_rays.LEAST
    if attempt.shown.tier == "direct":
        return None
    if not _may_try(attempt, name, shadow_rays.MOST_TRIES):
        return None
    if tried := attempt.tried.get(name):
        least = math.ceil(growth_after(tried[0], attempt.error) * tried[1])
    noise = halves.noise_of_indirect_light()
    count = shadow_rays.needed_samples(
        noise.noise_bound,
        halves.samples,
        attempt.rays_scale,
        attempt.error,
        attempt.shadowed_errors(),
        halves.energy_of_indirect_light(),
        least,
    )
    if count > MOST_SAMPLES:
        return None
    further = max(count - halves.samples, 0)
    pixels = int(attempt.shown.mask.sum())
    points = shadow_rays.points_of(attempt.error, attempt.shown.mask.size, attempt.is_sampled)
    cost = 0.0 if attempt.shadowed else shadow_rays.cost_in_samples(pixels, points)
    if attempt.shown.tier == "full" and not shadow_rays.is_little_noise(noise, attempt.error):
        cost += denoised.cost_in_samples(halves.samples + further, attempt.shown.tier)
    return Plan(further + cost, name, further)


def _may_try(attempt: Attempt, name: Estimator, most: int) -> bool:
    """Whether an estimator may be chosen, and was tried fewer than so many times."""
    return name in attempt.estimators and attempt.tries.get(name, 0) < most
