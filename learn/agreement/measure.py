"""One scene measured: the layer's picture against Cycles', in every tier, light resolution and seed
there is.

C    Cycles' radiance, one picture a seed;  I the layer's converged integral, S the paper's sum;
each (H, W, 3), numpy
D    display values in [0, 255] under one exposure a condition: the 99th percentile of Cycles'
luminance over the mask becomes 1
L2   mean over pixels of the mean over channels of the squared difference of display values

The noise of one picture is half the L2 of two seeds. Net of it, L2 is the mean product of two
seeds' differences from the layer, (D(C₁) − D(I)) (D(C₂) − D(I)): their noises are independent, so
that only what both share remains.
"""

from dataclasses import asdict, dataclass

import numpy as np
import torch

from learn.agreement import surface
from learn.data.devices import array
from learn.layer import render
from learn.methods import quadrature
from learn.metrics.pictures import shared, similarity, squared
from shaders import tone
from shaders.dsbrdf import SHAPE

# largest exponent of a lobe that texels of 64 rows and pixels of 2° are fine enough for
NARROW = 1200.0
# places in a pixel, rightwards and downwards
OFFSETS = np.stack(np.meshgrid(*[np.array([-1, 0, 1]) / 3] * 2), -1).reshape(-1, 2)


@dataclass
class Row:
    """One condition's figures. Per cent are fractions of Cycles' mean over the mask; L2 in display
    values squared.

    signed, absolute     mean of I − C and of |I − C|, relative
    l2, l2_frame, ssim   of I against C over the mask, over the frame, over the mask; means over
    seeds
    noise, net           None with a single seed
    sum_*                the same of the paper's sum S
    edge_share           share of the mask that lies on edges; edge_net: their part of net;
    inner_net the others' part
    like_net             net over the pixels inside alone, the layer averaged over each pixel's
    square if Cycles' pictures are
    node_fit             display L2 between label and nodes as the catalogue states it, mean over
    the scene's materials
    grazing              per bin of surface.GRAZING_DEG, over the pixels inside, like for like:
    pixels, mean L2, mean relative signed error
    """

    id: str
    shape: str
    category: str
    materials: tuple
    families: tuple
    light: str
    rotation_texels: int
    viewpoint: int
    fov_deg: float | None
    tier: str
    light_resolution: str
    samples: int
    seeds: int
    size: tuple
    pixels: int
    exposure: float
    half_width_deg: float
    signed: float
    absolute: float
    l2: float
    l2_frame: float
    ssim: float
    noise: float | None
    net: float | None
    sum_signed: float
    sum_l2: float
    sum_net: float | None
    edge_share: float
    edge_net: float | None
    inner_net: float | None
    like_net: float | None
    node_fit: float
    grazing: list
    causes: dict | None = None

    def to_json(self):
        return asdict(self)


@dataclass(frozen=True)
class Layer:
    """The layer's pictures of a scene, and its surface.

    integral I, footprint (I averaged over pixels), sum S (H, W, 3); mask, inner (H, W) bool; cos_o
    (H, W) = n·v
    """

    integral: np.ndarray
    footprint: np.ndarray
    sum: np.ndarray
    mask: np.ndarray
    inner: np.ndarray
    cos_o: np.ndarray


def rendered(sample, tolerance, device="cpu"):
    """The Layer of a learn.data.records.Sample, rendered on a device; tolerance: of the
    quadrature.
    """
    arguments = sample.for_layer(device)
    with torch.no_grad():
        integral, total = (
            render(**arguments, method=method, tolerance=tolerance)[0]
            for method in ("quadrature", "exact")
        )
    n, segments, depth = (tensor.numpy() for tensor in (sample.n, sample.segments, sample.depth))
    camera = sample.record.camera
    pixel = 2 * camera.half_extent / max(camera.size)
    view = np.array([0.0, 0.0, 1.0]) if sample.view is None else sample.view.numpy()
    inner = surface.inner(n, segments, depth, pixel)
    integral = array(integral.double())
    spread = footprint(sample, integral, inner, tolerance, device)
    return Layer(integral, spread, array(total.double()), segments > 0, inner, (n * view).sum(-1))


def narrow(m):
    """Whether a lobe of m (…, 3, 3, 2, 6) is so narrow that texels and pixels are coarse beside
    it.
    """
    return bool(quadrature.sharpness_bound(m).max() > NARROW)


def footprint(sample, integral, inner, tolerance, device="cpu"):
    """The integral averaged over each inner pixel's square, by normals between the neighbours' (H,
    W, 3); elsewhere as it is.

    Where no lobe is narrow, a pixel's centre stands for its square (measured: below 0.001 display
    L2), and nothing is rendered; nor where Cycles looked at pixels' centres itself.
    """
    index = np.flatnonzero(inner)
    if (
        sample.record.camera.pixel == "centre"
        or not narrow(sample.material.reshape(-1, *SHAPE))
        or not len(index)
    ):
        return integral
    places = surface.sub_pixel_normals(sample.n.numpy(), OFFSETS).reshape(len(OFFSETS), -1, 3)[
        :, index
    ]
    spread = integral.reshape(-1, 3).copy()
    spread[index] = np.mean(
        [at_pixels(sample, index, n=place, tolerance=tolerance, device=device) for place in places],
        axis=0,
    )
    return spread.reshape(integral.shape)


def at_pixels(sample, index, n=None, turn=0, tolerance=1e-2, device="cpu"):
    """The layer's integral (Q, 3) at flat pixel indices, by other normals n (Q, 3), or under the
    light turned by whole texels.
    """
    one = sample.for_layer(device)
    picked = {
        key: one[key].flatten(1, 2)[:, None, index]
        for key in ("n", "view", "segments")
        if one[key] is not None
    }
    one = one | picked | {"light": one["light"].roll(turn, 2)}
    if n is not None:
        one["n"] = torch.from_numpy(n.astype(np.float32))[None, None].to(device)
    with torch.no_grad():
        return array(render(**one, method="quadrature", tolerance=tolerance)[0, 0].double())


def measure(condition, pictures, layer, entries):
    """The Row of a Condition, and its display pictures (Cycles', layer's) for the page.

    pictures  (seeds, H, W, 3) Cycles' radiance; entries: manifests.materials.Material of each of
    the record's segments
    """
    record, mask = condition.records[0], layer.mask
    C, pictures = pictures.mean(0), pictures.astype(np.float64)
    exposure = tone.auto_exposure(C, mask)
    D_C, D_I, D_S = (
        tone.display(radiance, exposure) for radiance in (pictures, layer.integral, layer.sum)
    )
    per_pixel = squared(D_C, D_I).mean(0)
    level = max(float(C[mask].mean()), 1e-12)
    several = len(pictures) > 1
    net = shared(D_C - D_I) if several else None
    like = (
        shared(D_C - tone.display(layer.footprint, exposure))[layer.inner]
        if several and layer.inner.any()
        else None
    )
    row = Row(
        id=record.id,
        shape=record.shape,
        category=record.category,
        materials=record.materials,
        families=tuple(entry.family for entry in entries),
        light=record.light,
        rotation_texels=record.rotation_texels,
        viewpoint=record.viewpoint,
        fov_deg=record.camera.fov_deg,
        tier=condition.tier,
        light_resolution=condition.light_resolution,
        samples=condition.samples,
        seeds=len(pictures),
        size=tuple(record.camera.size),
        pixels=int(mask.sum()),
        exposure=exposure,
        half_width_deg=min(surface.highlight_half_width(entry.m.reshape(-1)) for entry in entries),
        signed=float((layer.integral - C)[mask].mean() / level),
        absolute=float(np.abs(layer.integral - C)[mask].mean() / level),
        l2=float(per_pixel[mask].mean()),
        l2_frame=float(per_pixel.mean()),
        ssim=float(
            np.mean(
                [s for s in (similarity(D, D_I, mask) for D in D_C) if s is not None] or [np.nan]
            )
        ),
        noise=float(squared(D_C[0], D_C[1])[mask].mean() / 2) if several else None,
        net=float(net[mask].mean()) if several else None,
        sum_signed=float((layer.sum - C)[mask].mean() / level),
        sum_l2=float(squared(D_C, D_S).mean(0)[mask].mean()),
        sum_net=float(shared(D_C - D_S)[mask].mean()) if several else None,
        edge_share=float((mask & ~layer.inner).sum() / mask.sum()),
        edge_net=float(net[mask & ~layer.inner].sum() / mask.sum()) if several else None,
        inner_net=float(net[mask & layer.inner].sum() / mask.sum()) if several else None,
        like_net=None if like is None else float(like.mean()),
        node_fit=float(
            np.mean(
                [np.mean(entry.errors.nodes_vs_label.display_l2 or (np.nan,)) for entry in entries]
            )
        ),
        grazing=by_grazing(
            D_C,
            tone.display(layer.footprint, exposure),
            (layer.footprint - C).mean(-1) / level,
            layer,
        ),
    )
    return row, (D_C[0], D_I)


def by_grazing(D_C, D, relative, layer):
    """For each bin of the angle between normal and view, inside: pixels, mean L2 (net of noise
    where known), mean relative error.
    """
    per_pixel = shared(D_C - D) if len(D_C) > 1 else squared(D_C, D).mean(0)
    angle = np.degrees(np.arccos(np.clip(layer.cos_o, 0, 1)))
    bins = []
    for low, high in zip(surface.GRAZING_DEG[:-1], surface.GRAZING_DEG[1:], strict=True):
        here = layer.inner & (angle >= low) & (angle < high)
        count = int(here.sum())
        bins.append(
            {
                "pixels": count,
                "l2": float(per_pixel[here].mean()) if count else 0.0,
                "signed": float(relative[here].mean()) if count else 0.0,
            }
        )
    return bins
