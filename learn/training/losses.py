"""The objective of training, term by term.

B pictures, S regions, P pixels. Sums are normalised so that weights mean the same at any size:
normals by the mask's pixels, materials by coefficients, light by solid angle, pictures by sampled
pixels and channels. Of a batch that shows no object, normals and pictures have no loss.

normals         mean |n' − n|²                                                               Eq. 3
material        mean (code' − code)²                                                         Eq. 4
albedo          mean (log a' − log a)², a the albedo seen and lit along the normal, by channel
light_log       mean over solid angle of (log(1 + L') − log(1 + L))², both at unit mean over the
                sphere and the channels
light_rendered  the same of radiance that leaves a matte and two glossy mirrors: the effect of the
                light, not the place of its sources
image           mean (c(I') − c(I))², I' from all three predictions,
                c = learn.networks.coding.compress                                         Eq. 5
target          the same of O' in the target material, from predicted normals and light      Eq. 5
image_features, target_features   squared difference of features of c(I') and c(I), relative to
                c(I)'s; likewise O' and O

I and O are what the layer makes of the truth at the same pixels under the same light resolution, so
that a perfect prediction has no loss. Where a batch has rendered pictures (learn.data.rendered), I
and O are those. Neither is cut off where a camera clipped the picture: training knows how bright a
highlight was, while a loss that asked for no more than "at least white" there would not bound such
pixels from above.
"""

from collections.abc import Callable
from typing import Any

import torch

from learn.data.batch import ExampleBatch
from learn.data.settings import Losses
from learn.layer.light_maps import reduce_maps, solid_angles
from learn.metrics.radiometry import log_albedo, log_rendered
from learn.networks.coding import Ranges, compress
from learn.networks.features import Features, difference
from learn.networks.prediction import Prediction, require_part
from learn.training.rerendering import at_pixels, object_mask, pick, sample_pixels, whole

# texels of half the sharpest lobe's width; with four times as many this is the costliest term
RENDERED_LIGHT = (32, 64)
BRIGHTEST_SEEN = 1.2  # of a compressed picture, for features, which were trained on values up to 1


Terms = dict[str, torch.Tensor]


def terms(
    prediction: Prediction,
    batch: ExampleBatch,
    losses: Losses,
    rng: torch.Generator,
    ranges: Ranges,
    features: Features | None = None,
) -> Terms:
    """Return {name: scalar} of the terms whose weight is not 0.

    rng       of the CPU, for the sampled pixels: the same on every device
    ranges    of the label codes
    features  needed where a term compares by them
    """
    result = {}
    if losses.normals and prediction.n is not None:
        inside = (batch.segments > 0) & (batch.mask[:, 0] > 0)
        squared = ((prediction.n - batch.n) ** 2).sum(1)[inside]
        result["normals"] = squared.mean() if len(squared) else squared.sum()
    if prediction.code is not None:
        result |= material_terms(prediction, batch, losses, ranges)
    if prediction.light is not None:
        result |= light_terms(prediction, batch, losses)
    if through_layer(losses):
        result |= layer_terms(prediction, batch, losses, rng, features)
    return result


def through_layer(losses: Losses) -> bool:
    """Return whether any term is of a picture that the layer renders."""
    return bool(losses.image or losses.target or by_features(losses))


def by_features(losses: Losses) -> bool:
    """Return whether any term compares by features."""
    return bool(losses.image_features or losses.target_features)


def total(values: Terms, losses: Losses) -> Any:
    """Return the weighted sum of terms, a scalar tensor; 0 where there are none."""
    return sum(getattr(losses, name) * value for name, value in values.items())


def material_terms(
    prediction: Prediction, batch: ExampleBatch, losses: Losses, ranges: Ranges
) -> Terms:
    """Return the terms of a predicted material."""
    result = {}
    code, label = require_part(prediction.code), require_part(prediction.label)
    truth = batch.label[:, : label.shape[1]]
    if losses.material:
        result["material"] = ((code - ranges.code(truth)) ** 2).mean()
    if losses.albedo:
        result["albedo"] = ((log_albedo(label) - log_albedo(truth)) ** 2).mean()
    return result


def with_unit_mean(light: torch.Tensor) -> torch.Tensor:
    """Return maps (B, 3, Hl, Wl) scaled to unit mean over the sphere, all channels alike.

    Unit luminance weighs green at 0.72. A blurred map of that luminance is darker, and so nearer to
    the logarithm of a true one, if it is green: networks trained so came out green by 0.16 of log G
    on every picture.
    """
    return light / (light.mean(1, keepdim=True) * solid_angles(light)).sum(
        (2, 3), keepdim=True
    ).clamp(min=1e-6)


def light_terms(
    prediction: Prediction,
    batch: ExampleBatch,
    losses: Losses,
    scaled: Callable[[torch.Tensor], torch.Tensor] = with_unit_mean,
) -> Terms:
    """Return the terms of a predicted light.

    scaled  by which maps (B, 3, Hl, Wl) are scaled before they are compared
    """
    result = {}
    lights = require_part(prediction.light), batch.light
    if losses.light_log:
        mine, its = (torch.log1p(scaled(light)) for light in lights)
        result["light_log"] = ((mine - its) ** 2 * solid_angles(batch.light)).sum((2, 3)).mean()
    if losses.light_rendered:
        mine, its = (log_rendered(reduce_maps(scaled(light), RENDERED_LIGHT)) for light in lights)
        result["light_rendered"] = ((mine - its) ** 2).mean()
    return result


def layer_terms(
    prediction: Prediction,
    batch: ExampleBatch,
    losses: Losses,
    rng: torch.Generator,
    features: Features | None = None,
) -> Terms:
    """Return the terms of I' and O', each at its own sampled pixels or at all pixels.

    Parts that are not predicted are replaced by the truth.
    """
    true_light = reduce_maps(batch.light, losses.layer_light)
    light = (
        true_light
        if prediction.light is None
        else reduce_maps(prediction.light, losses.layer_light)
    )
    label = batch.label if prediction.label is None else prediction.label
    n = batch.n if prediction.n is None else prediction.n
    result = {}
    parts = (
        ("image", label, batch.label, batch.picture),
        ("target", batch.target_label, batch.target_label, batch.target),
    )
    for name, mine, its, rendered in parts:
        of_pixels, of_features = getattr(losses, name), getattr(losses, f"{name}_features")
        if of_features or (of_pixels and losses.rendered == "all"):
            with torch.no_grad():
                truth = (
                    whole(batch.n, its, true_light, batch, method=losses.layer_method)
                    if rendered is None
                    else rendered * object_mask(batch)
                )
            seen = whole(n, mine, light, batch, losses.gradient_bound, losses.layer_method)
            mine_c, its_c = compress(seen), compress(truth)
            if of_pixels:
                pixels = object_mask(batch).sum().clamp(min=1)
                result[name] = ((mine_c - its_c) ** 2).sum() / (3 * pixels)
            if of_features:
                result[f"{name}_features"] = compared_by(
                    features, mine_c, its_c, object_mask(batch) > 0
                )
        elif of_pixels:
            where, count = sample_pixels(batch, losses.pixels, rng)
            if rendered is None:
                with torch.no_grad():
                    truth = at_pixels(
                        batch.n,
                        batch.segments,
                        its,
                        true_light,
                        where,
                        batch.elevation,
                        method=losses.layer_method,
                    )
            else:
                truth = pick(rendered, where)
            seen = at_pixels(
                n,
                batch.segments,
                mine,
                light,
                where,
                batch.elevation,
                losses.gradient_bound,
                losses.layer_method,
            )
            lit = (where >= 0)[..., None]
            result[name] = ((compress(seen) - compress(truth)) ** 2 * lit).sum() / max(3 * count, 3)
    return result


def compared_by(
    features: Features | None, mine: torch.Tensor, its: torch.Tensor, inside: torch.Tensor
) -> torch.Tensor:
    """Return the difference of two compressed pictures (B, 3, H, W) by features.

    inside (B, 1, H, W) bool covers the object, outside of which the pictures are black.
    """
    if features is None:
        raise ValueError("features: expected those that the run's losses name, found none")
    mine, its = (
        torch.stack(cut_boxes(pictures.clamp(max=BRIGHTEST_SEEN), inside))
        for pictures in (mine, its)
    )
    with torch.no_grad():
        truth = features(its)
    return difference(features(mine), truth)


def cut_boxes(pictures: torch.Tensor, inside: torch.Tensor, margin: int = 4) -> list[torch.Tensor]:
    """Return each picture cut to a box around its object, [(C, h, w)] of one size for all.

    Most of a frame is empty. The margin is in pixels.
    """
    H, W = inside.shape[-2:]
    rows, columns = inside.any(3)[:, 0], inside.any(2)[:, 0]
    spans = [
        [
            (int(line.nonzero()[0]), int(line.nonzero()[-1]) + 1) if line.any() else (0, 1)
            for line in axis
        ]
        for axis in (rows, columns)
    ]
    h, w = (
        min(-(-(max(b - a for a, b in span) + 2 * margin) // 8) * 8, side)
        for span, side in zip(spans, (H, W), strict=True)
    )
    results = []
    for picture, (a, b), (c, d) in zip(pictures, *spans, strict=True):
        top, left = (
            min(max((x + y - size) // 2, 0), side - size)
            for x, y, size, side in ((a, b, h, H), (c, d, w, W))
        )
        results.append(picture[:, top : top + h, left : left + w])
    return results
