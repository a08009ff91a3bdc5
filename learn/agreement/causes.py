"""Causes of disagreement in the direct tier, each measured on its own.

The measurements are on at most PIXELS inner pixels of a scene (letters as in
learn.agreement.measure; all L2 in display values squared, over those pixels):

noise        half the L2 of two seeds
node fit     the label against the closed form of the nodes that Cycles renders, both at the same
             normals and for the same directions of the light: texels where no lobe of the label is
             narrow, else sample directions in growing numbers. Each stands for the mean light of
             its solid angle: point samples mistake lamps of a few texels for misfit (79 display L2
             where 31 is right)
texel sum    the paper's sum against the converged integral: the light's discretisation. It is no
             part of I's disagreement
footprint    a pixel of Cycles is the mean over its square, the layer's its centre: I averaged over
             the pixel (measure.footprint) against I
look-up      the turn of the light about the vertical, in texels, that explains most of what is
             left, and the L2 that it explains
net          Cycles' pictures against the layer's, net of noise; net_footprint: the same with the
             footprint included in the layer's
rest         the same with footprint and node fit included: what no known cause explains

Edges (silhouette, segment borders, creases) are left out here; their part of L2 is Row.edge_net.
"""

import zlib
from collections.abc import Callable, Sequence

import numpy as np
import torch

from learn.agreement.measure import Layer, at_pixels, narrow
from learn.data.records import Sample
from learn.methods import half_vectors
from learn.metrics.pictures import squared_difference, squared_net_of_noise
from manifests.schema import Record
from shaders import closures, dsbrdf, tone
from shaders.envmap import directions
from shaders.mixture import Mixture

PIXELS = 96
# Numbers of sample directions for a narrow material: each is tried in turn, until the difference
# from the nodes changes by less than this fraction of itself.
SAMPLE_COUNTS = (1024, 4096, 16384, 65536)
LARGEST_CHANGE = 0.1
CHUNK = 65536  # pairs of pixel and direction at a time, 1.5 MB per array

# n, view (p, 3) → directions w (p, N, 3), their solid angles (p, N), and the light's radiance there
Directions = Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, torch.Tensor, np.ndarray]]


def sampled_pixels(inner: np.ndarray, record: Record, most: int = PIXELS) -> np.ndarray:
    """Return flat indices (Q,) of at most `most` of the pixels `inner` (H, W) bool.

    They are drawn by the geometry's id, and so the same in every run.
    """
    inside = np.flatnonzero(inner)
    rng = np.random.default_rng(zlib.crc32(record.geometry.encode()))
    return np.sort(rng.choice(inside, min(most, len(inside)), replace=False))


def node_difference(sample: Sample, index: np.ndarray, mixtures: Sequence[Mixture]) -> np.ndarray:
    """Return the label's radiance minus the nodes' (Q, 3), for the same directions of the light.

    index     flat indices (Q,) of pixels
    mixtures  one per segment
    """
    # the length of a float32 normal is not exact enough for lobes of α = .003
    n = torch.nn.functional.normalize(sample.n.reshape(-1, 3)[index].double(), dim=-1)
    view = (
        n.new_tensor([[0.0, 0.0, 1.0]]).expand_as(n)
        if sample.view is None
        else sample.view.reshape(-1, 3)[index].double()
    )
    segment = sample.segments.reshape(-1)[index]
    out = np.zeros((len(index), 3))
    for number in segment.unique().tolist():
        m = sample.material[number - 1].double().reshape(dsbrdf.SHAPE)
        here = segment == number
        out[here.numpy()] = converged_difference(
            sample, m, mixtures[number - 1], n[here], view[here]
        )
    return out


def converged_difference(
    sample: Sample, m: torch.Tensor, mixture: Mixture, n: torch.Tensor, view: torch.Tensor
) -> np.ndarray:
    """Return `node_difference` of one material m (3, 3, 2, 6) at normals n and views (p, 3).

    It is summed over texels, or over more and more sample directions until it converges.
    """
    if not narrow(m):
        return sum_difference(*texels(sample), m, mixture, n, view)
    result = sum_difference(*lobe_samples(sample, m, SAMPLE_COUNTS[0]), m, mixture, n, view)
    for count in SAMPLE_COUNTS[1:]:
        coarser, result = (
            result,
            sum_difference(*lobe_samples(sample, m, count), m, mixture, n, view),
        )
        change = np.square(result - coarser).sum()
        if change <= LARGEST_CHANGE**2 * np.square(result).sum():
            break
    return result


def sum_difference(
    places: Directions,
    count: int,
    m: torch.Tensor,
    mixture: Mixture,
    n: torch.Tensor,
    view: torch.Tensor,
) -> np.ndarray:
    """Return radiance (p, 3) of m minus that of the mixture, over `count` directions per pixel."""
    out = np.zeros((len(n), 3))
    for part in torch.arange(len(n)).split(max(1, CHUNK // count)):
        w, weight, L = places(n[part], view[part])
        difference = brdf_difference(
            m.numpy(), mixture, w.numpy(), n[part].numpy(), view[part].numpy()
        )
        mu = (w * n[part][:, None]).sum(-1).clamp(min=0) * weight
        out[part.numpy()] = np.einsum(
            "pik,pik,pi->pk", difference, np.broadcast_to(L, difference.shape), mu.numpy()
        )
    return out


def texels(sample: Sample) -> tuple[Directions, int]:
    """Return the light map's texels as Directions, and their number.

    Texels below the horizon have a solid angle of 0; the radiance is (T, 3).
    """
    centres, solid_angle = directions(*sample.light.shape[:2])
    w = torch.as_tensor(centres.reshape(-1, 3) @ sample.camera_from_light.T)
    weight, L = (
        torch.as_tensor(solid_angle.reshape(1, -1)),
        sample.light.reshape(-1, 3).double().numpy(),
    )

    def places(
        n: torch.Tensor, view: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        above = n @ w.T > 0
        return torch.where(above[..., None], w, n[:, None]), weight * above, L

    return places, len(w)


def lobe_samples(sample: Sample, m: torch.Tensor, count: int) -> tuple[Directions, int]:
    """Return sample directions that follow the lobes of m as Directions, and their number.

    The radiance (p, N, 3) of a direction is the mean over the solid angle that it stands for, as in
    the layer's integral.
    """
    half, solid_angle = (torch.as_tensor(x) for x in half_vectors.spiral(m, count))
    rotation, light = (
        torch.as_tensor(sample.camera_from_light),
        sample.light.reshape(-1, 3).double(),
    )

    def places(
        n: torch.Tensor, view: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        w, weight, _ = half_vectors.place_samples(
            n, view, half, solid_angle, rotation, (sample.light.shape[0], sample.light.shape[1])
        )
        texel, share = half_vectors.footprint(w @ rotation, weight, *sample.light.shape[:2])
        return w, weight, torch.einsum("pic,pick->pik", share, light[texel]).numpy()

    return places, count


def brdf_difference(
    m: np.ndarray, mixture: Mixture, w: np.ndarray, n: np.ndarray, view: np.ndarray
) -> np.ndarray:
    """Return f of the label minus f of the nodes, (p, N, 3); w (p, N, 3), n and view (p, 3)."""
    h, theta_d = dsbrdf.half_angles(w, np.broadcast_to(view[:, None], w.shape))
    cos_h, cos_i, cos_o = (
        (h * n[:, None]).sum(-1),
        (w * n[:, None]).sum(-1),
        (view * n).sum(-1)[:, None],
    )
    f = dsbrdf.evaluate(m, cos_h.reshape(-1), theta_d.reshape(-1)).reshape(w.shape)
    log_alpha, tilt, weights = mixture.at(cos_o[:, 0])  # once per pixel, not per direction
    for k, kind in enumerate(mixture.kinds):
        alpha = np.exp(log_alpha[:, k, None])
        value = closures.evaluate(
            kind, alpha, tilt[:, k, None], np.maximum(cos_i, 1e-9), cos_o, cos_h, np.cos(theta_d)
        )
        f -= weights[:, None, k] * value[..., None]
    return f


def separate_causes(
    sample: Sample,
    pictures: np.ndarray,
    layer: Layer,
    mixtures: Sequence[Mixture],
    exposure: float,
) -> dict[str, float | None] | None:
    """Return the figures of each cause in one direct-tier condition, None without inner pixels.

    pictures  (seeds, H, W, 3) Cycles' radiance
    """
    index = sampled_pixels(layer.inner, sample.record)
    if not len(index):
        return None
    C = pictures.reshape(len(pictures), -1, 3)[:, index].astype(np.float64)
    I, S = (x.reshape(-1, 3)[index] for x in (layer.integral, layer.sum))  # noqa: E741 -- the paper's letter
    nodes = np.maximum(I - node_difference(sample, index, mixtures), 0)
    spread = layer.footprint.reshape(-1, 3)[index]
    predicted = np.maximum(nodes + spread - I, 0)
    # derivative of the radiance by the light's turn, per texel
    turned = 0.5 * (at_pixels(sample, index, turn=1) - at_pixels(sample, index, turn=-1))
    weight = 1 / (predicted + predicted.mean() + 1e-12) ** 2
    slope = (weight * turned**2).sum()
    shift = float((weight * turned * (C.mean(0) - predicted)).sum() / max(slope, 1e-30))

    def D(radiance: np.ndarray) -> np.ndarray:
        return tone.display(radiance, exposure)

    several = len(C) > 1
    return {
        "pixels": len(index),
        "noise": float(squared_difference(D(C[0]), D(C[1])).mean() / 2) if several else None,
        "node_fit": float(squared_difference(D(I), D(nodes)).mean()),
        "texel_sum": float(squared_difference(D(I), D(S)).mean()),
        "footprint": float(squared_difference(D(I), D(spread)).mean()),
        "look_up": float(
            squared_difference(D(predicted), D(np.maximum(predicted + shift * turned, 0))).mean()
        ),
        "look_up_texels": shift,
        "net": float(squared_net_of_noise(D(C) - D(I)).mean()) if several else None,
        "net_footprint": float(squared_net_of_noise(D(C) - D(spread)).mean()) if several else None,
        "rest": float(squared_net_of_noise(D(C) - D(predicted)).mean()) if several else None,
        "rest_signed": float((predicted - C.mean(0)).mean() / max(C.mean(), 1e-12)),
    }
