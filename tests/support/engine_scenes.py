"""Scenes for the engines, and the float64 reference they are held to.

Error, everywhere in these tests: the largest absolute difference over the largest absolute value of
the reference, for the picture and for each gradient on its own. Inputs are float32 numbers; the
reference is given the same numbers in float64, vectors scaled to unit length there. Gradients by n
and view are compared in their tangential part: the other does not pass the layer's normalisation.
"""

from dataclasses import dataclass

import numpy as np
import torch

from learn.methods import Batch, exact
from shaders.frames import camera_from_light

ROTATION = camera_from_light(np.radians(20.0))
# the engines' claim; rounding of 8192 terms and κ up to 30 spends about 3e-6 of it
TOLERANCE = 1e-5


@dataclass
class Scene:
    """n, view (P, 3) float32 numpy (view None: orthographic), m (3, 3, 2, 6), light (height, width,
    3), g (P, 3) by radiance.
    """

    n: np.ndarray
    view: np.ndarray | None
    m: np.ndarray
    light: np.ndarray
    g: np.ndarray

    def arguments(self, rotation=ROTATION):
        """For learn.engines.cpu."""
        rotation = tuple(rotation.flatten().tolist())
        return self.n, self.view, self.m[None], self.light[None], rotation, (len(self.n),), (0,)


def unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def material(kappa, gamma):
    """The same κ and γ in all channels, lobes and angles; or arrays that broadcast to (3, 3, 6)."""
    m = np.empty((3, 3, 2, 6), np.float32)
    m[:, :, 0], m[:, :, 1] = kappa, gamma
    return m


def random_material(rng):
    """Three lobes from matte to sharp, every control value different."""
    kappa = np.exp(rng.normal(-2, 1.2, (3, 3, 6)))
    gamma = np.exp(rng.normal(0, 1, (3, 3, 6))) * np.array([0.3, 20.0, 400.0])[None, :, None]
    return material(kappa, gamma)


def make_scene(rng, m, pixels=96, size=(32, 64), perspective=False, light=None, normals=None):
    """A scene of random normals that face the viewer (or those given), under random light (or the
    one given).
    """
    n = rng.normal(size=(pixels, 3)) if normals is None else np.asarray(normals, dtype=np.float64)
    if normals is None:
        n[:, 2] = np.abs(n[:, 2]) + 0.02
    n = unit(n).astype(np.float32)
    view = None
    if perspective:
        view = unit(np.array([0.0, 0.0, 1.0]) + rng.normal(size=n.shape) * 0.15).astype(np.float32)
        facing = (n * view).sum(1) > 1e-3
        n, view = n[facing].copy(), view[facing].copy()
    light = (3.0 * rng.random((*size, 3)) ** 4) if light is None else light
    return Scene(
        n,
        view,
        m.astype(np.float32),
        light.astype(np.float32),
        rng.normal(size=n.shape).astype(np.float32),
    )


def tangential(by, x):
    return by - (by * x).sum(-1, keepdims=True) * x


def reference(scene, rotation=ROTATION):
    """Radiance and gradients {n, m, light, view} in float64, those by n and view tangential."""
    names = ["n", "m", "light"] + ([] if scene.view is None else ["view"])
    leaves = {name: np.asarray(getattr(scene, name), dtype=np.float64) for name in names}
    leaves |= {name: unit(leaves[name]) for name in ("n", "view") if name in leaves}
    tensors = {name: torch.tensor(value).requires_grad_() for name, value in leaves.items()}
    batch = Batch(
        tensors["n"],
        tensors.get("view"),
        tensors["m"][None],
        tensors["light"][None],
        (len(scene.n),),
        (0,),
        torch.as_tensor(rotation),
    )
    radiance = exact.radiance(batch, 1e-2)
    result = torch.autograd.grad(
        (radiance * torch.as_tensor(scene.g)).sum(), list(tensors.values())
    )
    result = {name: by.numpy() for name, by in zip(names, result, strict=True)}
    for name in ("n", "view"):
        if name in result:
            result[name] = tangential(result[name], leaves[name])
    return radiance.detach().numpy(), result


def engine(scene, workers=1, rotation=ROTATION):
    """The same by the CPU engine."""
    from learn.engines import cpu

    arguments = scene.arguments(rotation)
    by_n, by_view, by_m, by_light = cpu.gradients(scene.g, *arguments, workers)
    result = {
        "n": tangential(by_n.astype(np.float64), unit(scene.n.astype(np.float64))),
        "m": by_m[0],
        "light": by_light[0],
    }
    if by_view is not None:
        result["view"] = tangential(by_view.astype(np.float64), unit(scene.view.astype(np.float64)))
    return cpu.radiance(*arguments, workers), result


def errors(scene):
    """{what: error of the engine against the reference}."""
    right, right_by = reference(scene)
    seen, by = engine(scene)
    pairs = {"radiance": (seen, right)} | {name: (by[name], right_by[name]) for name in right_by}
    return {
        name: float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-30))
        for name, (a, b) in pairs.items()
    }
