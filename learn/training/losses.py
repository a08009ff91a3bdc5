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
from typing import Any, NamedTuple

import torch

from learn.data.batch import ExampleBatch
from learn.data.settings import Losses
from learn.layer.light_maps import reduce_maps, solid_angles
from learn.metrics.radiometry import log_albedo, log_rendered
from learn.networks.coding import Ranges, compress
from learn.networks.features import Features, difference
from learn.networks.prediction import Prediction, require_part
from learn.training.rerendering import (
    gather_pixels,
    object_mask,
    render_frames,
    render_pixels,
    sample_pixels,
)

# texels of half the sharpest lobe's width; with four times as many this is the costliest term
RENDERED_LIGHT = (32, 64)
BRIGHTEST_SEEN = 1.2  # of a compressed picture, for features, which were trained on values up to 1


Terms = dict[str, torch.Tensor]  # {name in learn.data.settings.Losses: scalar}, without weights


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
    if uses_layer(losses):
        result |= layer_terms(prediction, batch, losses, rng, features)
    return result


def uses_layer(losses: Losses) -> bool:
    """Return whether any term is of a picture that the layer renders."""
    return bool(losses.image or losses.target or uses_features(losses))


def uses_features(losses: Losses) -> bool:
    """Return whether any term compares pictures by features of a trained network."""
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
        log, true_log = (torch.log1p(scaled(light)) for light in lights)
        result["light_log"] = ((log - true_log) ** 2 * solid_angles(batch.light)).sum((2, 3)).mean()
    if losses.light_rendered:
        log, true_log = (
            log_rendered(reduce_maps(scaled(light), RENDERED_LIGHT)) for light in lights
        )
        result["light_rendered"] = ((log - true_log) ** 2).mean()
    return result


class _Scene(NamedTuple):
    """What the layer renders: n (B, 3, H, W), label (B, S, 108), light (B, 3, Hl, Wl)."""

    n: torch.Tensor
    label: torch.Tensor
    light: torch.Tensor


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
    result: Terms = {}
    for name, of_prediction, of_truth, rendered in (
        ("image", label, batch.label, batch.picture),
        ("target", batch.target_label, batch.target_label, batch.target),
    ):
        predicted = _Scene(n, of_prediction, light)
        true = _Scene(batch.n, of_truth, true_light)
        by_pixels, by_features = getattr(losses, name), getattr(losses, f"{name}_features")
        if by_features or (by_pixels and losses.rendered == "all"):
            result |= _terms_of_frames(name, predicted, true, rendered, batch, losses, features)
        elif by_pixels:
            result[name] = _term_of_pixels(predicted, true, rendered, batch, losses, rng)
    return result


def _terms_of_frames(
    name: str,
    predicted: _Scene,
    true: _Scene,
    rendered: torch.Tensor | None,
    batch: ExampleBatch,
    losses: Losses,
    features: Features | None,
) -> Terms:
    """Return the terms `name` and `name`_features, as far as they have a weight, of all pixels.

    rendered  (B, 3, H, W) the true pictures; None: what the layer makes of `true`
    """
    inside = object_mask(batch)
    with torch.no_grad():
        truth = (
            render_frames(*true, batch, method=losses.layer_method)
            if rendered is None
            else rendered * inside
        )
    picture = render_frames(*predicted, batch, losses.gradient_bound, losses.layer_method)
    picture, truth = compress(picture), compress(truth)
    result: Terms = {}
    if getattr(losses, name):
        result[name] = ((picture - truth) ** 2).sum() / (3 * inside.sum().clamp(min=1))
    if getattr(losses, f"{name}_features"):
        result[f"{name}_features"] = feature_difference(features, picture, truth, inside > 0)
    return result


def _term_of_pixels(
    predicted: _Scene,
    true: _Scene,
    rendered: torch.Tensor | None,
    batch: ExampleBatch,
    losses: Losses,
    rng: torch.Generator,
) -> torch.Tensor:
    """Return the term of pixels that `rng` samples; rendered as of `_terms_of_frames`."""
    where, count = sample_pixels(batch, losses.pixels, rng)
    if rendered is None:
        with torch.no_grad():
            truth = render_pixels(*true, batch, where, method=losses.layer_method)
    else:
        truth = gather_pixels(rendered, where)
    picture = render_pixels(*predicted, batch, where, losses.gradient_bound, losses.layer_method)
    sampled = (where >= 0)[..., None]
    return ((compress(picture) - compress(truth)) ** 2 * sampled).sum() / max(3 * count, 3)


def feature_difference(
    features: Features | None, picture: torch.Tensor, truth: torch.Tensor, inside: torch.Tensor
) -> torch.Tensor:
    """Return the difference of the features of compressed pictures and true ones (B, 3, H, W).

    features  ValueError if there are none
    inside    (B, 1, H, W) bool covers the object, outside of which the pictures are black
    """
    if features is None:
        raise ValueError("features: expected those that the run's losses name, found none")
    picture, truth = (
        torch.stack(cut_boxes(pictures.clamp(max=BRIGHTEST_SEEN), inside))
        for pictures in (picture, truth)
    )
    with torch.no_grad():
        of_truth = features(truth)
    return difference(features(picture), of_truth)


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
