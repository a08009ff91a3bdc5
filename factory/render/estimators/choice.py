"""The choice of an estimator for one shot.

Of an object that cannot shade itself direct light is rendered, which costs less per sample and is
the same. Then the estimator that needs the fewest further samples by its model is tried
(factory.render.estimators.plans), until the error is at most the limit.
"""

from dataclasses import replace

from factory.render.estimators import closed_form, denoised, path_tracing, ratio, shadow_rays
from factory.render.estimators.attempt import Attempt
from factory.render.estimators.picture import Picture
from factory.render.estimators.plans import plans_of
from factory.render.estimators.renderer import Shown
from manifests.schema import Estimator

ALL: tuple[Estimator, ...] = (
    path_tracing.NAME,
    denoised.NAME,
    ratio.NAME,
    closed_form.NAME,
    shadow_rays.NAME,
)


def render_within_error(
    shown: Shown, error: float, estimators: tuple[Estimator, ...] = ALL
) -> Picture:
    """Return a picture whose estimated error is at most `error` with 95 % confidence.

    The estimate is larger if plans.MOST_SAMPLES do not suffice.

    estimators  that may be chosen; "path-tracing" is always one of them
    """
    if shown.tier != "direct" and not shown.renderer.may_shade_itself():
        shown = replace(shown, tier="direct")
    attempt = Attempt(shown, error, estimators)
    while not attempt.is_over:
        if made := attempt.try_closed_form():
            return made
        if made := attempt.run(min(plans_of(attempt))):
            return made
    return attempt.path_traced_picture()
