"""Measurements of one scene: the layer's picture against Cycles', in every tier, light and seed.

C    Cycles' radiance, one picture per seed;  I the layer's converged integral, S the paper's sum
     over texels; each (H, W, 3), numpy
D    display values in [0, 255] under one exposure per condition: the 99th percentile of Cycles'
     luminance over the mask becomes 1
L2   mean over pixels of the mean over channels of the squared difference of display values

The noise of one picture is half the L2 of two seeds. Net of it, L2 is the mean product of two
seeds' differences from the layer, (D(C₁) − D(I)) (D(C₂) − D(I)): their noises are independent, so
that only what both share remains. The layer's pictures are rendered from a record's true parts: I
by quadrature at a tolerance that the user sets, S by the method "exact".
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import torch

from learn.agreement import surface
from learn.agreement.scenes import Condition
from learn.data.devices import to_numpy
from learn.data.records import Sample
from learn.layer import render
from learn.layer.predictions import MEASURED, TEXEL_SUM
from learn.methods import quadrature
from learn.metrics.pictures import (
    similarity,
    squared_difference,
    squared_net_of_noise,
    standard_error_net_of_noise,
)
from manifests.materials import Material
from shaders import tone
from shaders.dsbrdf import SHAPE

# largest sharpness of a lobe for which pixels of 2° and texels of 64 rows are fine enough
NARROW = 600.0
# places in a pixel, rightwards and downwards
OFFSETS = np.stack(np.meshgrid(*[np.array([-1, 0, 1]) / 3] * 2), -1).reshape(-1, 2)


@dataclass
class Row:
    """One condition's figures. L2 is in display values squared.

    signed, absolute     mean of I − C and of |I − C|, relative to Cycles' mean over the mask
    l2, l2_frame, ssim   of I against C over the mask, over the frame, over the mask; means over
                         seeds
    noise, net           None with a single seed
    sum_*                the same of the paper's sum S
    edge_share           share of the mask that is on edges; edge_net: their part of net;
                         inner_net: the others' part
    like_net             net over the pixels inside alone, the layer averaged over each pixel's
                         square if Cycles' pictures are
    like_net_error       standard error of like_net that Cycles' noise alone makes
    node_fit             display L2 between label and nodes as the catalogue states it, mean over
                         the scene's materials
    grazing              per bin of surface.GRAZING_DEG, over the pixels inside, like for like:
                         pixels, mean L2, mean relative signed error
    whole                facets.figures, over the whole mask; None where they are not known
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
    like_net_error: float | None
    node_fit: float
    grazing: list
    causes: dict | None = None
    whole: dict | None = None

    def to_json(self) -> dict:
        """Return the row as plain JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Layer:
    """The layer's pictures of a scene, and its surface.

    integral     I, (H, W, 3)
    footprint    I averaged over each pixel's square, (H, W, 3)
    sum          S, (H, W, 3)
    mask, inner  (H, W) bool
    cos_o        (H, W) n·v
    """

    integral: np.ndarray
    footprint: np.ndarray
    sum: np.ndarray
    mask: np.ndarray
    inner: np.ndarray
    cos_o: np.ndarray


def render_sample(sample: Sample, tolerance: float, device: str | torch.device = "cpu") -> Layer:
    """Return the Layer of a Sample, rendered on a device; tolerance: of the converged integral."""
    arguments = sample.for_layer(device)
    with torch.no_grad():
        integral, total = (
            render(**arguments, method=method, tolerance=tolerance)[0]
            for method in (MEASURED.method, TEXEL_SUM.method)
        )
    n, segments, depth = (tensor.numpy() for tensor in (sample.n, sample.segments, sample.depth))
    camera = sample.record.camera
    pixel = 2 * camera.half_extent / max(camera.size)
    view = np.array([0.0, 0.0, 1.0]) if sample.view is None else sample.view.numpy()
    inner = surface.inner(n, segments, depth, pixel)
    centre = to_numpy(integral.double())
    spread = footprint(sample, centre, inner, tolerance, device)
    return Layer(centre, spread, to_numpy(total.double()), segments > 0, inner, (n * view).sum(-1))


def narrow(m: torch.Tensor) -> bool:
    """Return whether texels and pixels are too coarse for a lobe of m (…, 3, 3, 2, 6)."""
    return bool(quadrature.sharpness(m).max() > NARROW)


def footprint(
    sample: Sample,
    integral: np.ndarray,
    inner: np.ndarray,
    tolerance: float,
    device: str | torch.device = "cpu",
) -> np.ndarray:
    """Return the integral (H, W, 3) averaged over the square of each inner pixel.

    Normals inside a pixel are interpolated between its neighbours'. Nothing is rendered where no
    lobe is narrow, since a pixel's centre then stands for its square (display L2 of at most 0.03 on
    24 pictures of six materials), nor where Cycles sampled pixels at their centres.
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


def at_pixels(
    sample: Sample,
    index: np.ndarray,
    n: np.ndarray | None = None,
    turn: int = 0,
    tolerance: float = 1e-2,
    device: str | torch.device = "cpu",
) -> np.ndarray:
    """Return the layer's integral (Q, 3) at flat pixel indices (Q,).

    n     (Q, 3) other normals, camera frame, or None
    turn  of the light about the vertical, in whole texels
    """
    one = sample.for_layer(device)
    picked = {
        key: one[key].flatten(1, 2)[:, None, index]
        for key in ("n", "view", "segments")
        if one[key] is not None
    }
    one = one | picked | {"light": one["light"].roll(turn, 2)}
    if n is not None:
        given = sample.upright(torch.from_numpy(n.astype(np.float32)))
        one["n"] = given[None, None].to(device)
    with torch.no_grad():
        return to_numpy(render(**one, method=MEASURED.method, tolerance=tolerance)[0, 0].double())


def measure(
    condition: Condition, pictures: np.ndarray, layer: Layer, entries: Sequence[Material]
) -> tuple[Row, tuple[np.ndarray, np.ndarray]]:
    """Return the Row of a Condition, and its display pictures (Cycles', layer's) for the page.

    pictures  (seeds, H, W, 3) Cycles' radiance
    entries   the material of each of the record's segments
    """
    record, mask = condition.records[0], layer.mask
    C, pictures = pictures.mean(0), pictures.astype(np.float64)
    exposure = tone.auto_exposure(C, mask)
    D_C, D_I, D_S = (
        tone.display(radiance, exposure) for radiance in (pictures, layer.integral, layer.sum)
    )
    per_pixel = squared_difference(D_C, D_I).mean(0)
    level = max(float(C[mask].mean()), 1e-12)
    D_F = tone.display(layer.footprint, exposure)
    alike = [s for s in (similarity(D, D_I, mask) for D in D_C) if s is not None]
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
        ssim=float(np.mean(alike or [np.nan])),
        sum_signed=float((layer.sum - C)[mask].mean() / level),
        sum_l2=float(squared_difference(D_C, D_S).mean(0)[mask].mean()),
        edge_share=float((mask & ~layer.inner).sum() / mask.sum()),
        node_fit=float(
            np.mean(
                [np.mean(entry.errors.nodes_vs_label.display_l2 or (np.nan,)) for entry in entries]
            )
        ),
        grazing=by_grazing(
            D_C,
            D_F,
            (layer.footprint - C).mean(-1) / level,
            layer,
        ),
        **net_of_noise(D_C, D_I, D_S, D_F, layer),
    )
    return row, (D_C[0], D_I)


def net_of_noise(
    D_C: np.ndarray, D_I: np.ndarray, D_S: np.ndarray, D_F: np.ndarray, layer: Layer
) -> dict:
    """Return a Row's figures that need two seeds; None each where there is one.

    The standard error is learn.metrics.pictures.standard_error_net_of_noise.

    D_C  (seeds, H, W, 3) of Cycles; D_I, D_S, D_F (H, W, 3) of the layer's integral, sum and
         footprint: display values
    """
    names = ("noise", "net", "sum_net", "edge_net", "inner_net", "like_net", "like_net_error")
    if len(D_C) < 2:
        return dict.fromkeys(names)
    mask, inner = layer.mask, layer.inner
    net, count = squared_net_of_noise(D_C - D_I), mask.sum()
    like = (D_C - D_F)[:, inner]
    return {
        "noise": float(squared_difference(D_C[0], D_C[1])[mask].mean() / 2),
        "net": float(net[mask].mean()),
        "sum_net": float(squared_net_of_noise(D_C - D_S)[mask].mean()),
        "edge_net": float(net[mask & ~inner].sum() / count),
        "inner_net": float(net[mask & inner].sum() / count),
        "like_net": float(squared_net_of_noise(like).mean()) if inner.any() else None,
        "like_net_error": standard_error_net_of_noise(like) if inner.any() else None,
    }


def by_grazing(
    D_C: np.ndarray, D: np.ndarray, relative: np.ndarray, layer: Layer
) -> list[dict[str, float]]:
    """Return pixels, mean L2 and mean relative error of each bin of the grazing angle.

    They are of the pixels inside; L2 is net of noise where it is known.
    """
    per_pixel = (
        squared_net_of_noise(D_C - D) if len(D_C) > 1 else squared_difference(D_C, D).mean(0)
    )
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
