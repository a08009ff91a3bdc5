"""Random scenes under small light maps: do the layer's pictures and gradients keep their bounds?

    python -m tests.fuzz.layer_scenes --scenes 10000 --seed 0

It prints a table by method and by size of the map and ends with exit status 1 if anything is beyond
its bound. A scene follows from the seed and its number alone, so that `--first 4321 --scenes 1`
repeats scene 4321.

The reference is the paper's sum in plain float64 torch, differentiated by autograd. It shares with
the methods only the spline, the directions of texels and the rotation of the light, which have
closed-form tests of their own. Errors are means of absolute differences: of a picture over its mean
radiance, for each material and light on its own (as auto defines its tolerance); of a gradient over
the gradient's mean, over a whole scene.

Bounds. Pictures: the tolerance for auto and culled; what the card says for others, at tolerance
1e-2 or below; ROUNDING for exact. Gradients: what the card says, at tolerance 1e-2 or below.
Allowed besides: ROUNDING of float32, and 2^-40 of the height a picture or gradient would have if
all light met each lobe's peak, below which the kernels take a lobe for black
(learn/engines/lights.py).
"""

import argparse
import math
import sys
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import torch
from tqdm import tqdm

from learn import methods
from learn.layer import render
from learn.methods import lobe_shapes
from shaders.dsbrdf import MAX_EXPONENT
from shaders.envmap import directions
from shaders.frames import ELEVATION, camera_from_light, view_vectors
from shaders.spline import basis

HEIGHTS = (1, 1, 2, 2, 3, 3, 4, 5, 6, 7, 8, 9, 12, 13, 16)
WIDTHS = (1, 2, 2, 3, 4, 4, 5, 6, 7, 8, 9, 12, 16, 17, 24, 31, 32)
SIDES = (4, 4, 5, 8, 8, 12, 16, 24, 32)  # of pictures, pixels
TOLERANCES = (5e-2, 1e-2, 1e-2, 1e-3, 1e-4)
METHODS = ("auto", "culled", "exact", "hybrid", "median_cut", "reflectance_map")
BROAD = 40.0  # sharpest lobe of the scenes for the methods that are meant for broad ones
# float32: 1e-5 is the engines' claim (docs/engines.md), normals and views are rounded besides
ROUNDING = 2e-5
BLACK = 2.0**-40
# cosine of a texel's angle with a horizon, or radians from a view, within which derivatives jump
# and pixels are left out
KINK = 1e-5
PAIRS = 2**16  # of a pixel and a texel that the reference works on at a time


@dataclass(frozen=True)
class Scene:
    """Arguments of `render` (`given`), names of those whose gradients are requested, and a
    tolerance.
    """

    given: dict
    with_gradient: tuple
    tolerance: float


# ------------------------------------------------------------------------------------------------
# scenes


def scene(seed, number, sides=SIDES):
    """The `Scene` of a number, its pictures of one of some sides."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    size, side = (int(rng.choice(HEIGHTS)), int(rng.choice(WIDTHS))), int(rng.choice(sides))
    images, materials = int(rng.choice([1, 1, 1, 2])), int(rng.choice([1, 1, 1, 2, 3]))
    elevation = float(rng.choice([ELEVATION, 0.0, rng.uniform(-math.pi / 2, math.pi / 2)]))
    n, view = normals(rng, images, side), None
    if rng.random() < 0.35:
        view = np.broadcast_to(view_vectors(side, side, rng.uniform(0.1, 1.8)), n.shape)
    m, light = material(rng, images, materials), lights(rng, images, size)
    mask = rng.random(n.shape[:3]) < (0.7 if rng.random() < 0.3 else 2.0)
    mask &= without_kinks(n, np.array([0.0, 0.0, 1.0]) if view is None else view, size, elevation)
    arrays = {"n": n, "material": m if materials > 1 else m[:, 0], "light": light, "view": view}
    given = {
        name: None if a is None else torch.tensor(a, dtype=torch.float32)
        for name, a in arrays.items()
    }
    given |= {"mask": torch.as_tensor(mask), "segments": None, "elevation": elevation}
    if materials > 1:
        given["segments"] = torch.as_tensor(
            rng.integers(rng.integers(2), materials + 1, n.shape[:3])
        )
    expected = (("n", "material", "light", "view"), ("n", "material", "view"), ())[rng.integers(3)]
    return Scene(given, expected, float(rng.choice(TOLERANCES)))


def normals(rng, images, side):
    """Unit normals (images, side, side, 3) that face the viewer, or 0: a sphere, some of
    everywhere, or all about one direction.
    """
    kind = rng.integers(4)
    if kind < 2:
        x = (np.arange(side) + 0.5) / side * 2 - 1
        y, x = np.meshgrid(-x, x, indexing="ij")
        height = 1 - (x * x + y * y) / rng.uniform(0.8, 2.2)
        n = np.where(
            height[..., None] > 0, np.stack([x, y, np.sqrt(np.maximum(height, 0))], -1), 0.0
        )[None].repeat(images, 0)
    elif kind == 2:
        n = rng.normal(size=(images, side, side, 3))
        n[..., 2] = np.abs(n[..., 2]) * 10 ** rng.uniform(-3, 0)
    else:
        n = rng.normal(size=(images, 1, 1, 3)) + 10 ** rng.uniform(-4, -0.5) * rng.normal(
            size=(images, side, side, 3)
        )
        n[..., 2] = np.abs(n[..., 2])
    n = n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-9)
    return np.where(n[..., 2:] > 1e-3, n, 0.0)


def material(rng, images, materials):
    """(images, materials, 108): κ from 1e-6 to 30 and γ from 0.1 to 1e5, half of each from the
    middle of that.
    """
    shape = (materials, 1, 3, 1)
    kappa = 10 ** (
        rng.uniform(-2, 0.3, shape)
        if rng.random() < 0.5
        else rng.uniform(-6, math.log10(30), shape)
    )
    gamma = 10 ** (rng.uniform(-1, 2.3, shape) if rng.random() < 0.5 else rng.uniform(-1, 5, shape))
    uneven = rng.choice([0.0, 0.05, 0.3, 1.0])
    kappa, gamma = (
        value * 10 ** (uneven * rng.normal(size=(materials, 3, 3, 6))) for value in (kappa, gamma)
    )
    m = np.stack([kappa.clip(0, 30), gamma.clip(0.1, 1e5)], -2).reshape(1, materials, 108)
    return m.repeat(images, 0)


def lights(rng, images, size):
    """(images, *size, 3): even, textured, some texels lit, or one; from 1e-3 to 1e3."""
    light = rng.random((images, *size, 3))
    kind = rng.integers(4)
    if kind == 1:
        light = 3 * light**6
    elif kind == 2:
        light = light * (rng.random((images, *size, 1)) < 0.3) + 1e-3
    elif kind == 3:
        light = np.full_like(light, 1e-2)
        light[
            np.arange(images),
            rng.integers(size[0], size=images),
            rng.integers(size[1], size=images),
        ] = 10 ** rng.uniform(0, 4)
    return light * 10 ** rng.uniform(-3, 3)


def without_kinks(n, view, size, elevation):
    """(images, side, side) bool: pixels that face the viewer, with no texel on their horizon or
    where the viewer stands.
    """
    w = directions(*size)[0].reshape(-1, 3) @ camera_from_light(elevation).T
    facing = (n * view).sum(-1) > 1e-3
    return facing & (np.abs(n @ w.T) > KINK).all(-1) & (view @ w.T < math.cos(KINK * 100)).all(-1)


# ------------------------------------------------------------------------------------------------
# reference


def radiance(n, view, m, light, elevation):
    """The paper's sum (P, 3) of n, view (P, 3), m (3, 3, 2, 6) and light (height, width, 3), all
    float64, for any lengths of n and view.
    """
    n, view = (torch.nn.functional.normalize(x, dim=-1)[:, None] for x in (n, view))
    w, solid_angle = directions(*light.shape[:2])
    w = torch.as_tensor(w.reshape(1, -1, 3) @ camera_from_light(elevation).T)
    E = (light * torch.as_tensor(solid_angle)[..., None]).reshape(-1, 3)
    s, d = w + view, w - view
    length_s, length_d = (x.square().sum(-1).clamp(min=1e-24).sqrt() for x in (s, d))
    mu, h, theta_d = (
        (n * w).sum(-1).clamp(min=0),
        s / length_s[..., None],
        torch.atan2(length_d, length_s),
    )
    # 1 − c, without its cancellation at a lobe's peak
    gap = torch.where(mu > 0, 0.5 * (h - n).square().sum(-1), 0.0)
    kappa, gamma = torch.einsum("ptb,ksjb->jptks", basis(theta_d), m)
    exponent = kappa * torch.exp(gamma * torch.log1p(-gap.clamp(max=1 - 1e-12))[..., None, None])
    f = torch.expm1(exponent.clamp(max=MAX_EXPONENT)).sum(-1)
    return torch.einsum("ptk,pt,tk->pk", f, mu, E)


def groups(given):
    """(image, material, flat pixels (P,)) of each group of a scene that has pixels."""
    segments, mask = given["segments"], given["mask"]
    for image in range(len(mask)):
        for segment in range(1, parted(given["material"]).shape[1] + 1):
            inside = mask[image] if segments is None else mask[image] & (segments[image] == segment)
            if inside.any():
                yield image, segment - 1, inside.flatten().nonzero().squeeze(-1)


def parted(m):
    """The materials (images, materials, 3, 3, 2, 6), where they are given flat."""
    return m.reshape(len(m), -1, 3, 3, 2, 6)


def reference(given, weights):
    """The picture, and gradients {name: …} of Σ weights × picture, all float64."""
    names = [name for name in ("n", "material", "light", "view") if given[name] is not None]
    leaves = {name: given[name].double().clone().requires_grad_() for name in names}
    n, out = leaves["n"], torch.zeros_like(given["n"], dtype=torch.float64)
    view = (
        leaves["view"]
        if "view" in leaves
        else torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(n)
    )
    for image, segment, pixels in groups(given):
        light = leaves["light"][image]
        for part in pixels.split(max(1, PAIRS // (light.shape[0] * light.shape[1]))):
            vectors = (x[image].reshape(-1, 3)[part] for x in (n, view))
            seen = radiance(
                *vectors, parted(leaves["material"])[image, segment], light, given["elevation"]
            )
            (seen * weights[image].reshape(-1, 3)[part]).sum().backward()
            out[image].view(-1, 3)[part] = seen.detach()
    return out, {
        name: torch.zeros_like(leaf) if leaf.grad is None else leaf.grad
        for name, leaf in leaves.items()
    }


def peak(given, image, segment):
    """Radiance if all light of an image met the peak of each lobe: what BLACK is a part of."""
    light = given["light"][image].double()
    energy = (
        (light * torch.as_tensor(directions(*light.shape[:2])[1])[..., None])
        .sum((0, 1))
        .max()
        .item()
    )
    kappa = parted(given["material"])[image, segment, :, :, 0].double().amax(-1)
    return energy * torch.expm1(kappa.clamp(max=MAX_EXPONENT)).sum(-1).max().item()


# ------------------------------------------------------------------------------------------------
# measurement


def suits(method, given):
    """Whether a method promises an error for a scene."""
    if method not in ("median_cut", "reflectance_map"):
        return True
    if method == "reflectance_map" and given["view"] is not None:
        return False
    materials = parted(given["material"]).flatten(0, 1)
    return max(lobe_shapes.sharpness(m).max() for m in materials) <= BROAD


def weights_of(picture):
    """What the pictures are weighted by in the sum that is differentiated."""
    return torch.linspace(0.5, 1.5, picture.numel(), dtype=picture.dtype).reshape(picture.shape)


def rendered(scene, method):
    """The picture, and gradients {name: …} of the same sum, as the layer gives them."""
    leaves = {
        name: scene.given[name].clone().requires_grad_()
        for name in scene.with_gradient
        if scene.given[name] is not None
    }
    picture = render(**scene.given | leaves, method=method, tolerance=scene.tolerance)
    if leaves:
        (picture * weights_of(picture)).sum().backward()
    return picture.detach(), {name: leaf.grad for name, leaf in leaves.items()}


def bound_of(method, tolerance):
    """The largest error of a picture that is right."""
    if method == "exact":
        return 0.0
    if method in ("auto", "culled"):
        return tolerance
    return methods.load(method).CARD.error if tolerance <= 1e-2 else math.inf


@dataclass(frozen=True)
class Finding:
    """What was compared (value, or an argument's name), its error, and the part of its bound that
    it takes (beyond 1: wrong).
    """

    what: str
    error: float
    part: float


def measured(scene, method, truth):
    """The `Finding`s of one method on a scene whose reference is `truth`."""
    picture, by = rendered(scene, method)
    right, right_by = truth
    result, given = [], scene.given
    for image, segment, pixels in groups(given):
        seen, true = (x[image].reshape(-1, 3)[pixels].double() for x in (picture, right))
        mean, error = true.mean().item(), (seen - true).abs().mean().item()
        bound = bound_of(method, scene.tolerance)
        allowed = (
            (bound + ROUNDING) * mean + BLACK * peak(given, image, segment) + 1e-37
            if bound < math.inf
            else math.inf
        )
        result.append(Finding("value", error / max(mean, 1e-300), part_of(error, allowed)))
    outside = (
        picture[~given["mask"]]
        if given["segments"] is None
        else picture[~given["mask"] | (given["segments"] == 0)]
    )
    if outside.abs().sum() != 0:
        result.append(Finding("value outside of the mask", math.inf, math.inf))
    claim = 1e-4 if method == "exact" else methods.load(method).CARD.gradient
    for name, slope in by.items():
        true = right_by[name]
        mean, error = true.abs().mean().item(), (slope.double() - true).abs().mean().item()
        allowed = (
            claim * mean + slope_of_black(given, name) if scene.tolerance <= 1e-2 else math.inf
        )
        result.append(Finding(name, error / max(mean, 1e-300), part_of(error, allowed)))
    return result


def part_of(error, allowed):
    """Error over what is allowed; NaN and infinite errors are beyond everything."""
    if not math.isfinite(error):
        return math.inf
    return error / allowed if allowed < math.inf else 0.0


def slope_of_black(given, name):
    """What BLACK means for a gradient: by the light per its size, by κ per 1, by n and by the view
    per radian of a lobe's width.
    """
    total = sum(
        len(pixels) * peak(given, image, segment) for image, segment, pixels in groups(given)
    )
    steepest = parted(given["material"])[..., 1, :].max().item()
    if name in ("n", "view"):
        return BLACK * total * steepest / given["n"].numel()
    if name == "light":
        return BLACK * total / max(given["light"].double().sum().item(), 1e-30)
    return (
        BLACK
        * total
        * (1 + 1 / max(parted(given["material"])[..., 0, :].max().item(), 1e-6))
        / given["material"].numel()
    )


def survey(numbers, seed, names=METHODS, sides=SIDES, progress=False):
    """Yields (number, method, size of the map, `Finding`) of each scene, method and quantity."""
    for number in tqdm(numbers, desc="scenes", disable=not progress, mininterval=10.0):
        one = scene(seed, number, sides)
        if not any(True for _ in groups(one.given)):
            continue
        truth = reference(one.given, weights_of(one.given["n"].double()))
        for method in names:
            if suits(method, one.given):
                for finding in measured(one, method, truth):
                    yield number, method, tuple(one.given["light"].shape[1:3]), finding


def band(size):
    """The row of the table that a map belongs to."""
    texels = size[0] * size[1]
    return next(f"up to {limit} texels" for limit in (4, 16, 64, 256, 512) if texels <= limit)


def table(rows):
    """Lines of text; rows {(method, band or quantity): [compared, beyond, largest part of the
    bound]}.
    """
    lines = [
        f"{'method':16} {'of':22} {'compared':>9} {'beyond':>7} {'largest part of its bound':>26}"
    ]
    for (method, what), (compared, beyond, largest) in sorted(rows.items()):
        lines.append(f"{method:16} {what:22} {compared:9} {beyond:7} {largest:26.3g}")
    return "\n".join(lines)


def main(arguments=None):
    """Exit status 1 if anything was beyond its bound."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.layer_scenes",
        description="Random scenes under small light maps.",
    )
    parser.add_argument(
        "--scenes", type=int, default=10_000, metavar="N", help="how many (default 10,000)"
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="I", help="number of the first (default 0)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="of everything left to chance (default 0)"
    )
    parser.add_argument(
        "--method",
        nargs="+",
        default=METHODS,
        choices=METHODS,
        help="all of these if none is given",
    )
    parser.add_argument(
        "--sides",
        nargs="+",
        type=int,
        default=SIDES,
        metavar="S",
        help="of the pictures, pixels (default 4 to 32)",
    )
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows, wrong, begun = defaultdict(lambda: [0, 0, 0.0]), set(), time.monotonic()
    numbers = range(options.first, options.first + options.scenes)
    for number, method, size, finding in survey(
        numbers, options.seed, options.method, options.sides, progress=True
    ):
        what = band(size) if finding.what.startswith("value") else f"gradient by {finding.what}"
        row = rows[method, what]
        row[0], row[1], row[2] = (
            row[0] + 1,
            row[1] + (not finding.part <= 1),
            max(row[2], finding.part),
        )
        if not finding.part <= 1:
            wrong.add(number)
            much = f"error {finding.error:.3g}, {finding.part:.3g} of its bound"
            tqdm.write(
                f"scene {number}, map {size}, {method}: {finding.what}: {much}", file=sys.stdout
            )
    print(table(rows))
    print(
        f"{options.scenes} scenes, seed {options.seed}, {time.monotonic() - begun:.0f} s:"
        f" {len(wrong)} beyond a bound"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
