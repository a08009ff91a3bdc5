"""The standard error of the figures that `learn agree` judges, on noise whose variance is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from learn.agreement import facets, measure, page, summary, uncertainty
from learn.metrics.pictures import squared_net_of_noise, standard_error_net_of_noise

PIXELS = 60
TRIALS = 2000


def repeated(noise, e):
    """Return the variance of the figure over trials, and the mean of its estimates.

    noise  (trials, seeds, P, 3);  e  (P, 3)
    """
    figures = [squared_net_of_noise(e + n).mean() for n in noise]
    estimates = [standard_error_net_of_noise(e + n) ** 2 for n in noise]
    return np.var(figures, ddof=1), np.mean(estimates)


@pytest.mark.parametrize("error", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("mixing", ["shared", "independent", "half"])
@pytest.mark.parametrize("seeds", [2, 3, 5])
def test_normal_noise_scatters_the_figure_as_estimated(seeds, mixing, error, rng):
    """Pixels of unequal noise, whose channels share it wholly, not at all or in part."""
    root = {
        "shared": np.outer([1.0, 0.7, 0.4], [1, 0, 0]),
        "independent": np.diag([1.0, 0.7, 0.4]),
        "half": np.array([[1.0, 0, 0], [0.5, 0.5, 0], [0.3, 0.2, 0.2]]),
    }[mixing]
    scale = rng.uniform(0.2, 2.0, (PIXELS, 1))
    e = error * rng.standard_normal((PIXELS, 3))
    noise = scale * (rng.standard_normal((TRIALS, seeds, PIXELS, 3)) @ root.T)
    covariance = scale[..., None] ** 2 * (root @ root.T)
    across = np.einsum("pi,pij,pj->", e, covariance, e)
    own = np.square(covariance).sum()
    true = (4 * across / seeds + 2 * own / (seeds * (seeds - 1))) / (9 * PIXELS**2)
    scatter, estimate = repeated(noise, e)
    # a variance of 2,000 trials scatters by 3 %; its estimate's mean by less
    assert scatter == pytest.approx(true, rel=0.12)
    assert estimate == pytest.approx(true, rel=0.06)


@pytest.mark.parametrize(("share", "height", "factor"), [(0.05, 5.0, 1.93), (0.01, 10.0, 3.51)])
def test_rare_bright_pixels_make_the_estimate_too_large_by_a_known_factor(
    share, height, factor, rng
):
    """The variance's estimate follows 2 e² s² + 2 e μ₃ + s⁴ (1 + κ/2), the truth 2 e² s² + s⁴."""
    shape = (TRIALS, 2, PIXELS, 1)
    noise = rng.standard_normal(shape) + height * ((rng.random(shape) < share) - share)
    e = np.full((PIXELS, 3), 0.5)
    spread = share * (1 - share)
    variance = 1 + height**2 * spread
    third = height**3 * spread * (1 - 2 * share)
    excess = height**4 * spread * (1 - 6 * spread) / variance**2
    true = (0.5 * variance + variance**2) / PIXELS
    stated = (0.5 * variance + third + variance**2 * (1 + excess / 2)) / PIXELS
    scatter, estimate = repeated(np.broadcast_to(noise, (*shape[:3], 3)), e)
    # few trials have a bright pixel in the same place of both seeds
    assert scatter == pytest.approx(true, rel=0.25)
    assert estimate == pytest.approx(stated, rel=0.08)
    assert np.sqrt(estimate / true) == pytest.approx(factor, rel=0.06)


def test_a_row_has_the_error_of_the_pixels_inside_and_none_with_one_seed(rng):
    D_C = 100 + rng.standard_normal((2, 12, 9, 3))
    mask = np.zeros((12, 9), bool)
    mask[2:10] = True
    inner = mask & (np.arange(9) > 2)
    layer = SimpleNamespace(mask=mask, inner=inner)
    D_F = np.full((12, 9, 3), 99.0)
    figures = measure.net_of_noise(D_C, D_F - 7, D_F - 5, D_F, layer)
    own = ((D_C - D_F) ** 2).mean(-1)[:, inner]  # of each seed
    assert figures["like_net_error"] == pytest.approx(
        np.sqrt((((own[0] - own[1]) / 2) ** 2).sum()) / inner.sum()
    )
    assert measure.net_of_noise(D_C[:1], D_F, D_F, D_F, layer)["like_net_error"] is None
    layer.inner = np.zeros_like(mask)
    assert measure.net_of_noise(D_C, D_F, D_F, D_F, layer)["like_net_error"] is None


def row(like, error, fit, whole=None):
    return SimpleNamespace(
        tier="direct",
        light_resolution="64x128",
        net=like,
        like_net=like,
        like_net_error=error,
        node_fit=fit,
        causes=None,
        edge_share=0.2,
        sum_net=like,
        whole=whole,
    )


def test_the_error_of_a_mean_over_pictures_adds_in_squares():
    head = summary.headline([row(0.1, 0.3, 0.2), row(0.3, 0.4, 0.2), row(None, None, 0.2)])
    assert head["like_net"] == pytest.approx(0.2)
    assert head["like_net_error"] == pytest.approx(0.25)  # √(.3² + .4²) / 2
    assert summary.headline([row(None, None, 0.2)])["noise_may_decide"] is None


@pytest.mark.parametrize(
    ("like", "holds", "may_decide"),
    [(0.01, True, False), (0.2, True, True), (0.4, False, True), (0.7, False, False)],
)
def test_a_verdict_close_to_the_limit_says_so_and_stays_what_it_is(like, holds, may_decide):
    """The limit is .3 and 1.645 standard errors are .165, inside and over the whole mask."""
    whole = dict.fromkeys(facets.FIGURES, 0.1) | {"predicted": like, "predicted_error": 0.1}
    rows = [row(like, 0.1, 0.2, whole)]
    head, over = summary.headline(rows), summary.whole(rows)
    for result, text in ((head, page.verdict(head)), (over, page.whole_verdict(over))):
        assert result["holds"] is holds and result["noise_may_decide"] is may_decide
        assert f"{like:.2f} ± 0.10 (limit 0.30)" in text
        assert ("within" if holds else "beyond") + " the limit" in text
        assert ("Noise may have decided" in text and "more samples" in text) is may_decide
    assert f"<b>{like:.2f} ± 0.10 (limit 0.30)</b>" in page.cards({"direct": head, "all": {}})
    assert (page.WHOLE["predicted"], f"{like:.2f} ± 0.10") in page.whole_rows(over)


@pytest.mark.parametrize(
    ("figure", "error", "limit", "text"),
    [
        (0.369, 0.204, 0.368, "0.37 ± 0.20 (limit 0.37)"),
        (0.019, 0.0031, 0.368, "0.0190 ± 0.0031 (limit 0.3680)"),
        (87.3, 31.2, 0.4, "87 ± 31 (limit 0.40)"),
        (0.5, 0.0, None, "0.5"),
        (0.5, None, 0.3, "0.5 (limit 0.30)"),
        (None, None, 0.3, "–"),
    ],
)
def test_figures_are_rounded_as_their_error_asks(figure, error, limit, text):
    assert uncertainty.as_text(figure, error, limit) == text
