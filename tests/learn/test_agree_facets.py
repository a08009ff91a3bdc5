"""The whole mask: what Cycles does at facets and beside edges is predicted, cause by cause."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from learn.agreement import facets, page, summary
from manifests.facets import OTHERS, Facets
from shaders import frames
from shaders.direct_light import DirectLight
from shaders.mixture import Mixture

SIZE = (6, 8)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def mixtures():
    glossy = Mixture(
        ("diffuse", "ashikhmin_shirley"),
        np.array([0.0]),
        np.log([[1.0, 0.75]]),
        np.zeros((1, 2)),
        np.array([[[0.2, 0.3, 0.1], [0.5, 0.5, 0.4]]]),
    )
    return [glossy, Mixture.lambert([0.7, 0.2, 0.2])]


@pytest.fixture(scope="module")
def sample():
    """Normals that lean from their facets: a row away from the viewer, one near the horizon.

    Every fifth pixel is beside an edge.
    """
    rng = np.random.default_rng(5)
    facet = unit(np.concatenate([rng.uniform(-1, 1, (*SIZE, 2)), np.ones((*SIZE, 1))], axis=-1))
    leaning = unit(facet + rng.normal(0, 0.15, facet.shape))
    leaning[0] = unit(np.stack([np.ones(8), np.linspace(-1, 1, 8), np.full(8, -0.05)], axis=-1))
    leaning[1] = unit(np.stack([np.ones(8), np.linspace(-1, 1, 8), np.full(8, 0.15)], axis=-1))
    facet[1] = unit(leaning[1] + np.array([0, 0, 0.1]))
    facet[0] = unit(leaning[0] + np.array([0, 0, 0.3]))
    cosine = leaning[..., 2].copy()
    stored = leaning.copy()
    stored[..., 2] = np.maximum(stored[..., 2], 1e-3)
    segments = np.ones(SIZE, np.int64)
    segments[:, 5:] = 2
    segments[-1] = 0
    mask = segments > 0
    share = np.where((np.arange(48).reshape(SIZE) % 5 == 0) & mask, 0.4, 0)
    others = np.where(share > 0, 3 - segments, 0)
    others[2] = 0  # the background
    shares = np.zeros((OTHERS, *SIZE))
    shares[0], shares[3] = 0.6 * share, 0.4 * share
    others = np.stack([others] * OTHERS) * (shares > 0)
    other_normals = np.stack(
        [unit(facet + np.array([0.1 * k, 0, 0])) for k in range(1, OTHERS + 1)]
    )
    other_normals *= (others > 0)[..., None]
    L = rng.uniform(0.2, 1.0, (64, 128, 3))
    L[15:20, 60:70] = 30
    given = Facets(
        *(
            (values * mask[..., None] if values.shape[-1] == 3 else values * mask).astype(
                np.float32
            )
            for values in (facet, cosine, shares, other_normals, other_normals)
        ),
        others.astype(np.uint8),
    )
    return SimpleNamespace(
        facets=given,
        record=SimpleNamespace(camera=SimpleNamespace(fov_deg=None)),
        n=torch.from_numpy((unit(stored) * mask[..., None]).astype(np.float32)),
        segments=torch.from_numpy(segments),
        light=torch.from_numpy(L.astype(np.float32)),
        camera_from_light=frames.camera_from_light(),
    )


@pytest.fixture(scope="module")
def truth(sample, mixtures):
    """What Cycles would render: (H, W, 3), by the closed form at each surface of each pixel."""
    surfaces = (
        (
            sample.facets.interpolated_normals(sample.n.numpy()),
            sample.facets.normals,
            sample.segments.numpy(),
            1 - sample.facets.share,
        ),
        *zip(
            sample.facets.other_normals,
            sample.facets.other_facets,
            sample.facets.other_segments,
            sample.facets.shares,
            strict=True,
        ),
    )
    radiance = np.zeros((*SIZE, 3))
    for number, mixture in enumerate(mixtures, 1):
        direct = DirectLight(mixture, sample.light.numpy(), sample.camera_from_light)
        for normals, planes, segments, share in surfaces:
            here = segments == number
            radiance[here] += share[here][:, None] * direct.at(normals[here], 96, planes[here])
    return radiance


def test_all_causes_together_predict_what_cycles_shows(sample, mixtures, truth):
    forms = facets.closed_forms(sample, mixtures)
    mask = sample.segments.numpy() > 0
    rng = np.random.default_rng(1)
    pictures = truth + rng.normal(0, 0.005, (2, *truth.shape))
    # a layer whose label is the nodes' own closed form
    figures = facets.figures(pictures, mask, forms.plain, forms, 0.5)
    assert set(figures) == {*facets.FIGURES, "predicted_error"}
    # of one value: about 0.005 · 150 / 2.2 display values, squared; the net of 105 scatters less
    noise = 0.2
    assert figures["layer"] > 50 * noise
    assert all(figures[cause] > noise for cause in ("facets", "half_vectors", "second_surface"))
    assert abs(figures["predicted"]) < noise and abs(figures["nodes"]) < noise
    assert figures["node_fit"] < 0.05 * noise
    assert figures["beside"] == pytest.approx((sample.facets.share[mask] > 0).mean())
    assert figures["away"] == pytest.approx(8 / mask.sum())
    # a label that is a tenth too bright: the prediction keeps its error, where normals do not lean
    brighter = facets.figures(pictures, mask, 1.1 * forms.plain, forms, 0.5)
    assert brighter["predicted"] == pytest.approx(brighter["node_fit"], rel=0.1)
    assert brighter["node_fit"] > 3 * noise


def test_the_prediction_scatters_as_its_standard_error_says(sample, mixtures, truth):
    forms = facets.closed_forms(sample, mixtures)
    mask, bright = sample.segments.numpy() > 0, truth + 0.05  # no pixel is clipped at black
    rng = np.random.default_rng(2)
    trials = [
        facets.figures(bright + rng.normal(0, 0.005, (2, *truth.shape)), mask, truth, forms, 0.5)
        for _ in range(400)
    ]
    scatter = np.std([trial["predicted"] for trial in trials])
    stated = np.sqrt(np.mean([trial["predicted_error"] ** 2 for trial in trials]))
    assert stated == pytest.approx(scatter, rel=0.12)  # of 400 trials: 4 %


def test_without_facets_in_perspective_or_with_one_seed_nothing_is_said(sample, mixtures, truth):
    mask = sample.segments.numpy() > 0
    forms = facets.closed_forms(sample, mixtures)
    assert facets.figures(truth[None], mask, forms.plain, forms, 0.5) is None
    bare = SimpleNamespace(**vars(sample) | {"facets": None})
    assert facets.closed_forms(bare, mixtures) is None
    near = SimpleNamespace(camera=SimpleNamespace(fov_deg=40.0))
    assert facets.closed_forms(SimpleNamespace(**vars(sample) | {"record": near}), mixtures) is None


@pytest.mark.parametrize("predicted, holds", [(0.5, True), (0.7, False)])
def test_the_limit_is_judged_over_the_whole_mask(predicted, holds):
    whole = dict.fromkeys(facets.FIGURES, 0.1) | {"predicted": predicted, "predicted_error": 0.01}
    row = SimpleNamespace(tier="direct", light_resolution="64x128", whole=whole, node_fit=0.41)
    result = summary.whole([row, SimpleNamespace(**vars(row) | {"whole": None, "node_fit": 9.0})])
    assert result["conditions"] == 1 and result["holds"] is holds
    assert ("within" if holds else "beyond") in page.whole_verdict(result)
    assert len(page.whole_rows(result)) == len(page.WHOLE)
    assert summary.whole([SimpleNamespace(**vars(row) | {"whole": None})]) is None
