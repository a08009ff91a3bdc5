"""What Cycles does at facets, by the closed form of direct light, over the whole mask of a scene.

The layer alone is compared inside silhouettes and creases only. Over the whole mask Cycles differs
from it by three causes that shaders.direct_light computes, and by pixels that show several
surfaces. With geometry files that hold what these depend on (manifests.facets), four closed forms
of the nodes are computed at every pixel (letters as in learn.agreement.measure):

N   at the record's normals, as the layer has them
F   with facets: light from below them is lost in part, and normals may face away
H   and with the half vectors that Cycles draws wrongly
M   and with the other surfaces of pixels beside edges: the mean that Cycles' filter takes

The layer's prediction of Cycles' picture is I · H / N, and beside edges (1 − s) I · H / N + s H′,
where the share s of the pixel shows other surfaces with the mean closed form H′. Where the
interpolated normal faces away the layer has nothing to predict, for a record's normals face the
viewer: H itself is the prediction there, and `away` counts these pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from learn.data.records import Sample
from learn.metrics.pictures import (
    squared_difference,
    squared_net_of_noise,
    standard_error_net_of_noise,
)
from shaders import tone
from shaders.direct_light import DirectLight
from shaders.mixture import Mixture
from shaders.normal_groups import COS_LEANING, FACING

SAMPLES = 192  # of each narrow lobe at each normal, as many as the factory takes for a point
LARGEST_RATIO = (
    4.0  # of H / N: where the nodes are nearly black at a record's normal, it says nothing
)
UNFITTED = 0.07  # n·v below which label and nodes only continue what was fitted above
DARK = 1e-6  # radiance added to both sides of the ratio, of a light of unit mean
FIGURES = (
    "layer",
    "facets",
    "half_vectors",
    "second_surface",
    "predicted",
    "predicted_points",
    "predicted_low",
    "node_fit",
    "nodes",
    "nodes_points",
    "nodes_low",
    "beside",
    "away",
)


@dataclass(frozen=True)
class ClosedForms:
    """The closed forms N, F, H and M of the nodes, (H, W, 3) float64, 0 outside the mask.

    share  (H, W) of each pixel that shows other surfaces than the point
    away   (H, W) bool: the interpolated normal faces away
    low    (H, W) bool: it does not, but lies closer to the horizon than UNFITTED
    """

    plain: np.ndarray
    cut: np.ndarray
    points: np.ndarray
    pixels: np.ndarray
    share: np.ndarray
    away: np.ndarray
    low: np.ndarray

    def predicted(self, integral: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what the layer's integral I (H, W, 3) predicts of F, H and M."""
        steps = []
        for form in (self.cut, self.points):
            ratio = np.minimum((form + DARK) / (self.plain + DARK), LARGEST_RATIO)
            steps.append(np.where(self.away[..., None], form, integral * ratio))
        beside = self.share[..., None]
        other = self.pixels - (1 - beside) * self.points  # s H′
        return steps[0], steps[1], (1 - beside) * steps[1] + other


def closed_forms(sample: Sample, mixtures: Sequence[Mixture]) -> ClosedForms | None:
    """Return the closed forms of a Sample's pixels; mixtures: one per segment.

    None where they are not known: for perspective and for geometry files without facets
    """
    facets, camera = sample.facets, sample.record.camera
    if facets is None or camera.fov_deg is not None:
        return None
    n = sample.n.numpy()
    interpolated = facets.interpolated_normals(n)
    segments = sample.segments.numpy()
    leaning = (interpolated * facets.normals).sum(-1) < COS_LEANING
    away = (segments > 0) & (facets.cosine < FACING)
    leaning |= away
    plain, cut, points, others = (np.zeros(n.shape) for _ in range(4))
    for number, mixture in enumerate(mixtures, 1):
        direct = DirectLight(mixture, sample.light.numpy(), sample.camera_from_light)
        here = segments == number
        plain[here] = cut[here] = direct.at(n[here], SAMPLES, misdirected=False)
        differs = here & leaning
        cut[differs] = direct.at(
            interpolated[differs], SAMPLES, facets.normals[differs], misdirected=False
        )
        points[here] = cut[here] + direct.mistaken(interpolated[here], facets.normals[here])
        there = (facets.shares > 0) & (facets.other_segments == number)
        added = direct.at(facets.other_normals[there], SAMPLES, facets.other_facets[there])
        # a pixel may show several surfaces of this material
        np.add.at(others, np.nonzero(there)[1:], facets.shares[there][:, None] * added)
    share = facets.share
    pixels = (1 - share[..., None]) * points + others
    low = (segments > 0) & ~away & (facets.cosine < UNFITTED)
    return ClosedForms(plain, cut, points, pixels, share, away, low)


def figures(
    pictures: np.ndarray,
    mask: np.ndarray,
    integral: np.ndarray,
    forms: ClosedForms,
    exposure: float,
) -> dict[str, float] | None:
    """Return FIGURES and predicted_error of one condition over the whole mask (H, W).

    None with a single seed.

    layer             display L2 net of noise of I
    facets, half_vectors, second_surface   display L2 between the prediction with and without each
    predicted         net, of the prediction with all of them
    predicted_error   standard error of predicted that Cycles' noise alone makes
    predicted_points  its part without pixels beside edges
    predicted_low     of that, the part of pixels with n·v below UNFITTED
    node_fit          display L2 between the prediction and the nodes' closed form M
    nodes             net, of M itself: what no cause explains
    nodes_points      its part without pixels beside edges
    nodes_low         of that, the part of pixels with n·v below UNFITTED
    beside, away      share of the mask beside edges, and where normals face away

    pictures  (seeds, H, W, 3) Cycles' radiance
    integral  I (H, W, 3)
    """
    if len(pictures) < 2:
        return None
    C = tone.display(pictures.astype(np.float64), exposure)[:, mask]
    I, F, H, P, M = (  # noqa: E741 -- the papers' letters
        tone.display(np.maximum(each, 0), exposure)[mask]
        for each in (integral, *forms.predicted(integral), forms.pixels)
    )
    beside, low = forms.share[mask] > 0, forms.low[mask]

    def net(D: np.ndarray) -> np.ndarray:
        return squared_net_of_noise(C - D)

    def without_edges(values: np.ndarray) -> float:
        return float(values[~beside].sum() / len(values))

    return {
        "layer": float(net(I).mean()),
        "facets": float(squared_difference(I, F).mean()),
        "half_vectors": float(squared_difference(F, H).mean()),
        "second_surface": float(squared_difference(H, P).mean()),
        "predicted": float(net(P).mean()),
        "predicted_error": standard_error_net_of_noise(C - P),
        "predicted_points": without_edges(net(P)),
        "predicted_low": without_edges(net(P) * low),
        "node_fit": float(squared_difference(P, M).mean()),
        "nodes": float(net(M).mean()),
        "nodes_points": without_edges(net(M)),
        "nodes_low": without_edges(net(M) * low),
        "beside": float(beside.mean()),
        "away": float(forms.away[mask].mean()),
    }
