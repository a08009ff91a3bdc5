"""Why the two renderers differ where they should not: a direct-tier disagreement taken apart, each cause measured on its own.

On at most PIXELS inner pixels of a scene (letters as in learn.agreement.measure; all L2 in display values squared, over those pixels):

noise        half the L2 of two seeds
node fit     the label against the closed form of the nodes that Cycles renders, both by the same taps at the same normals
texel sum    the paper's sum against the converged integral: the light's discretisation. It is no part of I's disagreement
footprint    a pixel of Cycles is the mean over its square, the layer's is its centre: I averaged over 3 × 3 places in the pixel against I
look-up      the turn of the light about the vertical, in texels, that explains most of what is left, and the L2 it explains
rest         what remains of Cycles' pictures after node fit and footprint are put into the layer's, net of noise

Edges (silhouette, segment borders, creases) are the pixels left out here; their part of L2 is measured apart (Row.edge_net).
"""

import zlib

import numpy as np
import torch

from learn.agreement import surface
from learn.agreement.measure import shared, squared
from learn.layer import render
from learn.methods import quadrature
from shaders import closures, dsbrdf, tone
from shaders.frames import camera_from_light

PIXELS = 192
TAPS = 1024
CHUNK = 64  # pixels × TAPS at a time, 1.5 MB an array
OFFSETS = np.stack(np.meshgrid(*[np.array([-1, 0, 1]) / 3] * 2), -1).reshape(-1, 2)


def chosen(layer, record):
    """Indices (Q,) of at most PIXELS inner pixels, drawn by the record's id: the same on every run."""
    inner = np.flatnonzero(layer.inner.reshape(-1))
    rng = np.random.default_rng(zlib.crc32(record.geometry.encode()))
    return np.sort(rng.choice(inner, min(PIXELS, len(inner)), replace=False))


def at_pixels(sample, index, n=None, turn=0):
    """The layer's integral (Q, 3) at flat pixel indices, by other normals n (Q, 3) or under a light turned by whole texels."""
    one = sample.for_layer()
    picked = {key: one[key].flatten(1, 2)[:, None, index] for key in ("n", "view", "segments") if one[key] is not None}
    one = one | picked | {"light": one["light"].roll(turn, 2)}
    if n is not None:
        one["n"] = torch.from_numpy(n.astype(np.float32))[None, None]
    with torch.no_grad():
        return render(**one, method="quadrature", tolerance=1e-2)[0, 0].double().numpy()


def node_difference(sample, index, mixtures):
    """The label's radiance minus the nodes', (Q, 3), by the same taps; mixtures: one shaders.mixture.Mixture a segment."""
    n = sample.n.reshape(-1, 3)[index].double()
    view = n.new_tensor([[0.0, 0.0, 1.0]]).expand_as(n) if sample.view is None else sample.view.reshape(-1, 3)[index].double()
    segment = sample.segments.reshape(-1)[index]
    rotation = torch.as_tensor(camera_from_light(sample.elevation))
    out = np.zeros((len(index), 3))
    for number in segment.unique().tolist():
        m = sample.material[number - 1].double().reshape(dsbrdf.SHAPE)
        taps = tuple(torch.as_tensor(x) for x in quadrature.spiral(m, TAPS))
        here = torch.nonzero(segment == number)[:, 0]
        for part in here.split(CHUNK):
            w, weight, texel = quadrature.place(n[part], view[part], *taps, rotation, sample.light.shape[:2])
            L = sample.light.reshape(-1, 3)[texel].double().numpy()
            difference = brdf_difference(m.numpy(), mixtures[number - 1], w.numpy(), n[part].numpy(), view[part].numpy())
            mu = (w * n[part][:, None]).sum(-1) * weight
            out[part.numpy()] = np.einsum("pik,pik,pi->pk", difference, L, mu.numpy())
    return out


def brdf_difference(m, mixture, w, n, view):
    """f of the label minus f of the nodes, (p, N, 3); w (p, N, 3), n and view (p, 3)."""
    h, theta_d = dsbrdf.half_angles(w, np.broadcast_to(view[:, None], w.shape))
    cos_h, cos_i, cos_o = (h * n[:, None]).sum(-1), (w * n[:, None]).sum(-1), (view * n).sum(-1)[:, None]
    f = dsbrdf.evaluate(m, cos_h.reshape(-1), theta_d.reshape(-1)).reshape(w.shape)
    log_alpha, tilt, weights = mixture.at(cos_o[:, 0])  # once a pixel, not once a tap
    for k, kind in enumerate(mixture.kinds):
        alpha = np.exp(log_alpha[:, k, None])
        value = closures.evaluate(kind, alpha, tilt[:, k, None], np.maximum(cos_i, 1e-9), cos_o, cos_h, np.cos(theta_d))
        f -= weights[:, None, k] * value[..., None]
    return f


def take_apart(sample, pictures, layer, mixtures, exposure):
    """The causes of one direct-tier condition as a dict of figures, or None where no pixel is inside.

    pictures  (seeds, H, W, 3) Cycles' radiance
    """
    index = chosen(layer, sample.record)
    if not len(index):
        return None
    C = pictures.reshape(len(pictures), -1, 3)[:, index].astype(np.float64)
    I, S = (x.reshape(-1, 3)[index] for x in (layer.integral, layer.sum))  # noqa: E741 -- the paper's letter
    nodes = np.maximum(I - node_difference(sample, index, mixtures), 0)
    places = surface.sub_pixel_normals(sample.n.numpy(), OFFSETS).reshape(len(OFFSETS), -1, 3)[:, index]
    spread = np.mean([at_pixels(sample, index, n=place) for place in places], axis=0)
    predicted = np.maximum(nodes + spread - I, 0)
    turned = 0.5 * (at_pixels(sample, index, turn=1) - at_pixels(sample, index, turn=-1))  # per texel
    weight = 1 / (predicted + predicted.mean() + 1e-12) ** 2
    slope = (weight * turned**2).sum()
    shift = float((weight * turned * (C.mean(0) - predicted)).sum() / max(slope, 1e-30))

    def D(radiance):
        return tone.display(radiance, exposure)

    several = len(C) > 1
    return {
        "pixels": len(index),
        "noise": float(squared(D(C[0]), D(C[1])).mean() / 2) if several else None,
        "node_fit": float(squared(D(I), D(nodes)).mean()),
        "texel_sum": float(squared(D(I), D(S)).mean()),
        "footprint": float(squared(D(I), D(spread)).mean()),
        "look_up": float(squared(D(predicted), D(np.maximum(predicted + shift * turned, 0))).mean()),
        "look_up_texels": shift,
        "net": float(shared(D(C) - D(I)).mean()) if several else None,
        "rest": float(shared(D(C) - D(predicted)).mean()) if several else None,
        "rest_signed": float((predicted - C.mean(0)).mean() / max(C.mean(), 1e-12)),
    }
