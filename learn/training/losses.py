"""The objective: what stands between a prediction and the truth, term by term.

B pictures, S regions, P pixels. Sums are normalised so that weights mean the same at any size:
normals by the mask's pixels, materials by coefficients, light by solid angle, pictures by sampled
pixels and channels.

normals         mean |n' − n|²
Eq. 3
material        mean (code' − code)²
Eq. 4
albedo          mean (log a' − log a)², a the albedo seen and lit along the normal, by channel
light_log       mean over solid angle of (log(1 + L') − log(1 + L))², both at unit mean over the
sphere and the channels
light_rendered  the same of radiance leaving a matte and two glossy mirrors: what light does, not
where it stands
image           mean (c(I') − c(I))², I' from all three predictions, c =
learn.networks.coding.compressed   Eq. 5
target          the same of O' in the target material, from predicted normals and light
Eq. 5
image_features, target_features   squared difference of features of c(I') and c(I), relative to
c(I)'s; likewise O' and O
I and O are what the layer makes of the truth at the same pixels under the same light resolution, so
that truth has no loss; where a batch has rendered pictures (learn.data.rendered), I and O are
those.
"""

import math

import numpy as np
import torch

from learn.layer import predictions
from learn.metrics.radiometry import log_albedo, log_rendered
from learn.networks.coding import compressed
from learn.networks.features import difference
from shaders import envmap

# texels of half the sharpest lobe's width: four times as many made this the dearest term of a step
RENDERED_LIGHT = (32, 64)
BRIGHTEST_SEEN = 1.2  # of a compressed picture, for features, which never saw anything above 1


def terms(prediction, batch, losses, rng, ranges, features=None):
    """{name: scalar} of the terms whose weight is not 0.

    rng       a torch Generator on the CPU, for the sampled pixels: the same on every device
    ranges    of the label codes
    features  learn.networks.features.Features, if a term compares by them
    """
    result = {}
    if losses.normals and prediction.n is not None:
        inside = (batch.segments > 0) & (batch.mask[:, 0] > 0)
        result["normals"] = ((prediction.n - batch.n) ** 2).sum(1)[inside].mean()
    if prediction.code is not None:
        result |= material_terms(prediction, batch, losses, ranges)
    if prediction.light is not None:
        result |= light_terms(prediction, batch, losses)
    if through_layer(losses):
        result |= layer_terms(prediction, batch, losses, rng, features)
    return result


def through_layer(losses):
    """Whether any term is of a picture that the layer renders."""
    return bool(losses.image or losses.target or by_features(losses))


def by_features(losses):
    """Whether any term compares by features."""
    return bool(losses.image_features or losses.target_features)


def total(found, losses):
    """The weighted sum."""
    return sum(getattr(losses, name) * value for name, value in found.items())


def material_terms(prediction, batch, losses, ranges):
    result = {}
    label = batch.label[:, : prediction.label.shape[1]]
    if losses.material:
        result["material"] = ((prediction.code - ranges.code(label)) ** 2).mean()
    if losses.albedo:
        result["albedo"] = ((log_albedo(prediction.label) - log_albedo(label)) ** 2).mean()
    return result


def light_terms(prediction, batch, losses):
    result = {}
    if losses.light_log:
        mine, its = (torch.log1p(evenly(light)) for light in (prediction.light, batch.light))
        result["light_log"] = ((mine - its) ** 2 * solid_angles(batch.light)).sum((2, 3)).mean()
    if losses.light_rendered:
        mine, its = (
            log_rendered(reduced(evenly(light), RENDERED_LIGHT))
            for light in (prediction.light, batch.light)
        )
        result["light_rendered"] = ((mine - its) ** 2).mean()
    return result


def evenly(light):
    """Maps (B, 3, Hl, Wl) at unit mean over the sphere and all channels alike.

    At unit luminance, which weighs green at 0.72, a blurred map is darker, and so nearer to the
    logarithm of a true one, if what luminance it must have is green: networks trained so were (0.16
    of log G on every picture).
    """
    return light / (light.mean(1, keepdim=True) * solid_angles(light)).sum(
        (2, 3), keepdim=True
    ).clamp(min=1e-6)


def layer_terms(prediction, batch, losses, rng, features=None):
    """What is asked of I' and O'; each at its own sampled pixels, or whole. Parts that are not
    predicted are given true.
    """
    true_light = reduced(batch.light, losses.layer_light)
    light = (
        true_light if prediction.light is None else reduced(prediction.light, losses.layer_light)
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
                    whole(batch.n, its, true_light, batch)
                    if rendered is None
                    else rendered * _inside(batch)
                )
            seen = whole(n, mine, light, batch, losses.gradient_bound)
            mine_c, its_c = compressed(seen), compressed(truth)
            if of_pixels:
                result[name] = ((mine_c - its_c) ** 2).sum() / (3 * _inside(batch).sum())
            if of_features:
                result[f"{name}_features"] = compared_by(
                    features, mine_c, its_c, _inside(batch) > 0
                )
        elif of_pixels:
            where, count = sampled(batch, losses.pixels, rng)
            if rendered is None:
                with torch.no_grad():
                    truth = at_pixels(
                        batch.n, batch.segments, its, true_light, where, batch.elevation
                    )
            else:
                truth = picked(rendered, where)
            seen = at_pixels(
                n, batch.segments, mine, light, where, batch.elevation, losses.gradient_bound
            )
            lit = (where >= 0)[..., None]
            result[name] = ((compressed(seen) - compressed(truth)) ** 2 * lit).sum() / (3 * count)
    return result


def compared_by(features, mine, its, inside):
    """Difference of two compressed pictures (B, 3, H, W) by features; inside (B, 1, H, W): the
    object, all else of them is black.
    """
    mine, its = (
        torch.stack(boxed(pictures.clamp(max=BRIGHTEST_SEEN), inside)) for pictures in (mine, its)
    )
    with torch.no_grad():
        truth = features(its)
    return difference(features(mine), truth)


def boxed(pictures, inside, margin=4):
    """[(C, h, w)]: each picture cut to a box around its object, of one size for all of them: most
    of a frame is empty.
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


def _inside(batch):
    """(B, 1, H, W) float: where there is truth and the network looks."""
    return ((batch.segments > 0) & (batch.mask[:, 0] > 0))[:, None].float()


def whole(n, label, light, batch, gradient_bound=0.0):
    """(B, 3, H, W) radiance of all of the mask, 0 outside; by the policy
    learn.layer.predictions.FRAME_LOSS.

    n (B, 3, H, W), label (B, S, 108), light (B, 3, h, w); gradient_bound: see `bounded`, over all
    the pixels
    """
    inside = _inside(batch) > 0
    normals = (
        torch.where(inside, n, n.new_tensor([0.0, 0.0, 1.0])[:, None, None])
        .movedim(1, -1)
        .contiguous()
    )
    if normals.requires_grad:
        normals.register_hook(bounded(gradient_bound / inside.sum().clamp(min=1)))
    picture = predictions.radiance(
        normals,
        label,
        light,
        batch.segments.clamp(min=1),
        inside[:, 0],
        batch.elevation,
        predictions.FRAME_LOSS,
    )
    return picture.movedim(-1, 1)


def sampled(batch, pixels, rng):
    """Flat indices (B, P) of pixels drawn from each object, −1 where an object has fewer; and how
    many there are.
    """
    inside = ((batch.segments > 0) & (batch.mask[:, 0] > 0)).flatten(1)
    draw = torch.rand(inside.shape, generator=rng).to(inside.device).masked_fill(~inside, -1.0)
    value, index = draw.topk(min(pixels, inside.shape[1]), dim=1)
    return index.masked_fill(value < 0, -1), int((value >= 0).sum())


def at_pixels(n, segments, label, light, where, elevation, gradient_bound=0.0):
    """(B, P, 3) radiance at flat indices (B, P); 0 where they are −1. n (B, 3, H, W).

    gradient_bound  see `bounded`, over all the pixels
    """
    region = segments.flatten(1).gather(1, where.clamp(min=0))
    mask = where >= 0
    normals = torch.where(mask[..., None], picked(n, where), n.new_tensor([0.0, 0.0, 1.0]))
    if normals.requires_grad:
        normals.register_hook(bounded(gradient_bound / mask.sum().clamp(min=1)))
    picture = predictions.radiance(
        normals[:, None],
        label,
        light,
        region.clamp(min=1)[:, None],
        mask[:, None],
        elevation,
        predictions.PIXEL_LOSS,
    )
    return picture[:, 0]


def picked(values, where):
    """(B, P, 3) of values (B, 3, H, W) at flat indices (B, P); anything where they are −1."""
    return values.flatten(2).gather(2, where.clamp(min=0)[:, None].expand(-1, 3, -1)).movedim(1, -1)


def bounded(most):
    """A hook that shortens each pixel's gradient to at most `most`.

    A glossy material's picture changes by leaps once a normal is off by more than a lobe's width,
    and its gradient then points anywhere: unbounded it drives normals from the truth (18.0° → 21.6°
    in a first trial on 64² pictures).
    """

    def hook(gradient):
        length = gradient.norm(dim=-1, keepdim=True)
        return gradient * (most / length.clamp(min=1e-30)).clamp(max=1)

    return hook


def reduced(light, size):
    """(B, 3, h, w): the map averaged over solid angle to a coarser one, energy kept."""
    H, W = light.shape[-2:]
    if tuple(size) == (H, W):
        return light
    rows = torch.as_tensor(row_means(H, size[0]), dtype=light.dtype).to(light.device)
    columns = light.reshape(*light.shape[:-1], size[1], W // size[1]).mean(-1)
    return torch.einsum("rh,bchw->bcrw", rows, columns)


def row_means(before, after):
    """(after, before) weights that average rows by solid angle."""
    weight = np.asarray(envmap.row_solid_angles(before, 1)).reshape(after, -1)
    out = np.zeros((after, before))
    for r, w in enumerate(weight):
        out[r, r * len(w) : (r + 1) * len(w)] = w / w.sum()
    return out


def solid_angles(light):
    """(Hl, Wl) shares of the sphere, summing to 1."""
    H, W = light.shape[-2:]
    share = torch.as_tensor(
        np.asarray(envmap.row_solid_angles(H, W)).reshape(-1), dtype=light.dtype
    ).to(light.device) / (4 * math.pi)
    return share[:, None].expand(H, W)
