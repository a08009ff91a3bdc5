"""Descend through Mitsuba 3: a program, run as mitsuba_descent.py IN.npz OUT.npz.

It runs in a process of its own, because Mitsuba's LLVM and torch's do not share one. IN.npz and
OUT.npz are written and read by mitsuba_comparison, which says what they hold.

A distant viewer and a distant light make radiance a function of the normal alone. A sphere shows
all normals: Mitsuba renders it under the light map with its principled BSDF, direct light only, and
each pixel of the picture is looked up by its normal, between the four nearest pixels of the sphere.
Base colour, roughness and metallic are descended as logits, and the light as a smooth factor on the
predicted map, whose logarithm is interpolated between GAINS values. `specular` stays where it
begins: Mitsuba 3.9.1 returns a derivative of zero by it.

Frames: Mitsuba's world is the light frame. Its maps are bilinear, with columns centred and rows on
the edges; its u is the light frame's turned by a quarter.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

SPHERE, RADIUS = 48, 0.9  # pixels of the sphere's picture; its radius in half pictures
STEEPEST = 0.99  # |n_xy| beyond which a pixel takes the normal at this ring: the rim is antialiased
SAMPLES, LAST_SAMPLES = 32, 512
UP = 2  # Mitsuba's texels along one of the light's
GAINS = (8, 16)
LEARNING_RATE = 0.05
BSDF = "shape.bsdf."


def look_up(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (4, P) of the sphere's pixels about normals n (P, 3), and their weights."""
    xy = n[:, :2] * np.minimum(1, STEEPEST / np.maximum(np.hypot(n[:, 0], n[:, 1]), 1e-9))[:, None]
    column = np.clip((xy[:, 0] * RADIUS + 1) / 2 * SPHERE - 0.5, 0, SPHERE - 1.001)
    row = np.clip((1 - xy[:, 1] * RADIUS) / 2 * SPHERE - 0.5, 0, SPHERE - 1.001)
    return bilinear(row, column, SPHERE)


def bilinear(row: np.ndarray, column: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (4, P) and weights (4, P) of the points about (row, column), in this width.

    Columns wrap around; the row below the last one is not asked for.
    """
    top, left = np.floor(row).astype(int), np.floor(column).astype(int)
    down, right = row - top, column - left
    left, other = left % width, (left + 1) % width
    index = [top * width + left, top * width + other, (top + 1) * width + left]
    index.append((top + 1) * width + other)
    weight = [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
    return np.stack(index), np.stack(weight)


def mitsuba_map(L: np.ndarray, up: int = UP) -> np.ndarray:
    """Return a map (height, width, 3) in Mitsuba's layout, `up` times as fine."""
    height, width = L.shape[0] * up, L.shape[1] * up
    row = np.clip((np.arange(height) / (height - 1) * L.shape[0]).astype(int), 0, L.shape[0] - 1)
    column = ((((np.arange(width) + 0.5) / width - 0.25) % 1) * L.shape[1]).astype(int)
    return np.ascontiguousarray(L[row][:, column], dtype=np.float32)


def gain_points(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `bilinear` of a map of the light frame's layout between GAINS values."""
    row = np.clip((np.arange(height) + 0.5) / height * GAINS[0] - 0.5, 0, GAINS[0] - 1.001)
    column = (np.arange(width) + 0.5) / width * GAINS[1] - 0.5
    rows, columns = np.meshgrid(row, column, indexing="ij")
    return bilinear(rows.ravel(), columns.ravel(), GAINS[1])


def scene_of(mi: Any, start: dict[str, Any], L: np.ndarray, elevation: float) -> Any:
    """Return a Mitsuba scene: the sphere before an orthographic camera, under a map."""
    eye = [0, 4 * float(np.sin(elevation)), 4 * float(np.cos(elevation))]
    transform = mi.ScalarTransform4f
    camera = transform().look_at(eye, [0, 0, 0], [0, 1, 0]) @ transform().scale(
        [1 / RADIUS, 1 / RADIUS, 1]
    )
    size = {"width": SPHERE, "height": SPHERE}
    output = {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "rgb"} | size
    color = {"type": "rgb", "value": [float(value) for value in start["base_color"]]}
    numbers = {key: float(start[key]) for key in ("roughness", "metallic", "specular")}
    direct = {"emitter_samples": 1, "bsdf_samples": 1, "hide_emitters": True}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"} | direct,
            "sensor": {
                "type": "orthographic",
                "to_world": camera,
                "film": output | {"component_format": "float32"},
            },
            "shape": {
                "type": "sphere",
                "bsdf": {"type": "principled", "base_color": color} | numbers,
            },
            "light": {"type": "envmap", "bitmap": mi.Bitmap(mitsuba_map(L))},
        }
    )


def descend(given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what OUT.npz holds: the parts after each budget, and how many steps these took."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    L = given["light"].astype(np.float32)
    height, width = L.shape[:2]
    scene = scene_of(mi, given, L, float(given["elevation"]))
    values = mi.traverse(scene)
    pixel, share = look_up(given["n"])
    pixels, shares = [mi.UInt32(p) for p in pixel], [mi.Float(s) for s in share]
    gain_index, gain_share = gain_points(height, width)
    # Mitsuba's texels in the order of its map, as indices of ours
    own = mitsuba_map(np.repeat(np.arange(height * width).reshape(height, width, 1), 3, 2))[..., 0]
    order = own.astype(int).ravel()
    gains = [mi.UInt32(g[order]) for g in gain_index], [mi.Float(g[order]) for g in gain_share]
    base = [mi.Float(L.reshape(-1, 3)[order, k].copy()) for k in range(3)]
    seen = [mi.Float(given["seen"][:, k].astype(np.float32)) for k in range(3)]
    exposure, held = float(given["exposure"]), float(given["held"])
    area = np.sin(np.pi * (np.arange(height) + 0.5) / height).repeat(width)[order]
    area_of_texel = mi.Float((area / area.sum()).astype(np.float32))

    def logit(value: Any) -> np.ndarray:
        p = np.clip(np.asarray(value, np.float64), 0.01, 0.99)
        return np.log(p / (1 - p)).astype(np.float32)

    def optimiser() -> Any:
        result = mi.ad.Adam(lr=LEARNING_RATE)
        result["color"] = mi.Color3f(*map(float, logit(given["base_color"])))
        result["roughness"] = mi.Float(float(logit(given["roughness"])))
        result["metallic"] = mi.Float(float(logit(given["metallic"])))
        for k in range(3):
            result[f"gain{k}"] = dr.zeros(mi.Float, GAINS[0] * GAINS[1])
        return result

    adam = optimiser()

    def sigmoid(x: Any) -> Any:
        return 1 / (1 + dr.exp(-x))

    def light(k: int) -> Any:
        log_gain = mi.Float(0)
        for index, weight in zip(*gains, strict=True):
            log_gain += dr.gather(mi.Float, adam[f"gain{k}"], index) * weight
        return base[k] * dr.exp(log_gain)

    def rendered(seed: int, samples: int) -> tuple[list[Any], list[Any]]:
        values[BSDF + "base_color.value"] = sigmoid(adam["color"])
        values[BSDF + "roughness.value"] = sigmoid(adam["roughness"])
        values[BSDF + "metallic.value"] = sigmoid(adam["metallic"])
        maps = [light(k) for k in range(3)]
        flat = dr.ravel(mi.Color3f(*maps))
        values["light.data"] = mi.TensorXf(flat, (height * UP, width * UP, 3))
        values.update()
        image = mi.render(scene, values, spp=samples, seed=seed).array
        picture = []
        for k in range(3):
            value = mi.Float(0)
            for index, weight in zip(pixels, shares, strict=True):
                value += dr.gather(mi.Float, image, index * 3 + k) * weight
            picture.append(value)
        return picture, maps

    def loss(seed: int) -> Any:
        picture, maps = rendered(seed, SAMPLES)
        total = mi.Float(0)
        for k in range(3):
            mine = dr.log(1 + 8 * exposure * dr.maximum(picture[k], 0)) / float(np.log(9))
            total += dr.mean(dr.square(mine - seen[k])) / 3
            moved = dr.square(dr.log(1 + maps[k]) - dr.log(1 + base[k]))
            total += held * dr.sum(moved * area_of_texel) / 3
        return total

    def step(seed: int) -> None:
        dr.backward(loss(seed))
        adam.step()

    result: dict[str, Any] = {}

    def keep(name: str, steps: int, seconds: float) -> None:
        picture, _ = rendered(10_000_000, LAST_SAMPLES)
        result[f"{name}_picture"] = np.stack([np.array(each) for each in picture], -1)
        log_gain = np.stack([np.array(adam[f"gain{k}"]) for k in range(3)], -1)
        of_texel = (log_gain[gain_index] * gain_share[..., None]).sum(0).reshape(height, width, 3)
        result[f"{name}_light"] = L * np.exp(of_texel).astype(np.float32)
        parts = [np.array(adam[key]).ravel() for key in ("color", "roughness", "metallic")]
        result[f"{name}_material"] = 1 / (1 + np.exp(-np.concatenate(parts)))
        result[f"{name}_steps"], result[f"{name}_seconds"] = steps, seconds

    # kernels are compiled before the clock runs, and these two steps are undone
    keep("start", 0, 0.0)
    for seed in range(2):
        step(seed)
    adam = optimiser()
    steps, spent = 0, 0.0
    for number, budget in enumerate(given["budgets"]):
        while spent < budget:
            began = time.process_time()
            step(steps + 2)
            spent += time.process_time() - began
            steps += 1
        keep(f"budget{number}", steps, spent)
    return result


if __name__ == "__main__":
    with np.load(sys.argv[1], allow_pickle=False) as file:
        read = dict(file)
    np.savez(sys.argv[2], **descend(read))
