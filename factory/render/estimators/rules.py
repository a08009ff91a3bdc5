"""The rules by which estimators are chosen, as values for a fingerprint.

VERSION counts their changes, and those of shaders.direct_light, that no constant shows.
"""

from factory.render import self_shading
from factory.render import shadow_rays as rays
from factory.render.estimators import (
    attempt,
    blends,
    closed_form,
    denoised,
    halves,
    lost_detail,
    path_tracing,
    plans,
    ratio,
    shadow_rays,
)
from factory.render.estimators.renderer import EFFORTS, STANDARD

VERSION = 22  # a change makes new pictures


def identity() -> list[object]:
    """Return everything in these rules that alters pixels, for the fingerprint."""
    from shaders import direct_light  # and numba, which takes half a second

    return [
        ["choice", VERSION, attempt.PILOT, plans.MOST_SAMPLES, attempt.GROWTH, plans.MORE],
        ["halves", halves.OWN, halves.CONFIDENCE, halves.CURVE],
        [path_tracing.NAME, path_tracing.AIM],
        [denoised.NAME, denoised.SCALE, denoised.POWER, denoised.MOST_TRIES, denoised.LEAST],
        [STANDARD, denoised.SIZE, denoised.WITH_NOISE, denoised.CAUTION],
        [ratio.NAME, ratio.SCALE, ratio.POWER, ratio.UNCERTAINTY, ratio.MOST, ratio.MOST_TRIES],
        [ratio.DARK, ratio.LEAST, ratio.WITH_NOISE, ratio.AROUND, ratio.SHARES],
        [ratio.MOST_LEFT],
        [
            shadow_rays.NAME,
            shadow_rays.POINTS,
            shadow_rays.FEW_POINTS,
            sorted(shadow_rays.MUCH.items()),
            shadow_rays.ENOUGH,
            shadow_rays.TOLERATED,
            shadow_rays.OF_THE_REST,
            shadow_rays.FURTHER,
            shadow_rays.ROUNDS,
            shadow_rays.GOAL,
        ],
        [
            shadow_rays.SPREAD,
            sorted(shadow_rays.DOUBT.items()),
            shadow_rays.SCALE,
            shadow_rays.POWER,
            shadow_rays.MOST_LOST,
        ],
        [shadow_rays.SHARES, shadow_rays.LITTLE, shadow_rays.MOST_TRIES, shadow_rays.LEAST],
        [shadow_rays.GROUPS, sorted(shadow_rays.RAYS.items())],
        [rays.MARGIN, rays.GRAZING, rays.STEPS, rays.ROWS],
        [blends.SHARES, blends.MOST_BIAS, blends.DOUBT],
        [lost_detail.SPREAD, lost_detail.RADIUS, lost_detail.NORMALS, lost_detail.VALUES],
        [lost_detail.POWER, lost_detail.LEAST, lost_detail.MOST],
        [denoised.DETAIL, ratio.DETAIL, shadow_rays.DETAIL],
        [closed_form.NAME, closed_form.LEANING, closed_form.MAPS, closed_form.WIDE_MAPS],
        [closed_form.EACH_POINT, closed_form.POINTS, closed_form.MOST_POINTS],
        [closed_form.ENOUGH],
        [closed_form.MOST_PER_PIXEL, closed_form.GEOMETRY],
        [sorted(closed_form.LEFT.items()), closed_form.SMALLER],
        [closed_form.OTHER, closed_form.OTHER_SPREAD],
        [closed_form.USUAL, closed_form.SURPRISING, closed_form.FINER, closed_form.ROUNDS],
        sorted(denoised.COST.items()),
        [sorted(EFFORTS.items()), halves.NOISY_GUIDES],
        direct_light.constants(),
        [
            self_shading.TOLERANCE,
            self_shading.WIDER,
            self_shading.FEW,
            self_shading.LEAST_SHARE,
            self_shading.UNSURE,
        ],
    ]
