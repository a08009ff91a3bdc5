"""A million adversarial pixels through a method: how many values or derivatives are not finite. Run
by hand, the result is kept.

    PYTHONPATH=. python tests/endurance/layer_stress.py --samples 1000000
        --out docs/results/layer-stress/report.json [--method NAME …] [--view-per-pixel]

Each picture is rendered with derivatives and without. It has 2,000 pixels whose normals lie at the
silhouette, at right angles to a light, at a lobe's peak, at the poles or anywhere; κ up to 30, γ
from 1e-3 to 1e5, both jumping between the extremes; light black, in one texel, up to 1e6, or
denormal. A view per pixel lies along a light, opposite to it, across the normal, beside it, or
anywhere. tests/learn/methods/test_stress.py runs a few of them.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import torch

from learn import methods
from learn.layer import render
from manifests.provenance import provenance, shorten
from shaders.dsbrdf import half_angles
from shaders.envmap import directions

PIXELS, SIZE, VIEWER = 2000, (8, 16), np.array([0.0, 0.0, 1.0])


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def normals(rng, pixels):
    w = directions(*SIZE)[0].reshape(-1, 3)
    light, n = w[rng.integers(len(w), size=pixels)], rng.normal(size=(pixels, 3))
    kind, tiny = rng.integers(5, size=pixels)[:, None], 10.0 ** rng.uniform(-8, -1, (pixels, 1))
    n = np.where(kind == 0, np.cross(n, VIEWER) + tiny * VIEWER, n)
    n = np.where(kind == 1, np.cross(n, light) + tiny * light, n)
    n = np.where(kind == 2, half_angles(light, VIEWER)[0] + tiny * n + 1e-9, n)
    n = np.where(kind == 3, np.array([0.0, 1.0, 0.0]) + tiny * VIEWER, n)
    n = unit(n)
    return np.where(n[:, 2:] < 0, -n, n)


def views(rng, n):
    """(P, 3) towards the viewer, of pixels with normals (P, 3)."""
    w = directions(*SIZE)[0].reshape(-1, 3)[rng.integers(SIZE[0] * SIZE[1], size=len(n))]
    kind, tiny = rng.integers(5, size=len(n))[:, None], 10.0 ** rng.uniform(-8, -1, (len(n), 1))
    v = rng.normal(size=n.shape)
    v = np.where(kind == 0, w + (rng.random((len(n), 1)) < 0.5) * tiny * v, v)
    v = np.where(kind == 1, -w + (rng.random((len(n), 1)) < 0.5) * tiny * v, v)
    v = np.where(kind == 2, np.cross(n, v) + tiny * n, v)
    v = np.where(kind == 3, n + tiny * v, v)
    v = unit(v)
    return np.where((v * n).sum(-1, keepdims=True) < 0, -v, v)


def scene(rng, pixels=PIXELS, view_per_pixel=False):
    """render's arguments, float32."""
    m = np.stack(
        [10.0 ** rng.uniform(-6, np.log10(30), (3, 3, 6)), 10.0 ** rng.uniform(-3, 5, (3, 3, 6))], 2
    )
    if rng.random() < 0.5:
        m[:, :, 0, ::2], m[:, :, 1, ::2] = 30.0, rng.choice([1e-3, 1e5], (3, 3, 3))
    if rng.random() < 0.2:
        m[:, :, 0] = 0.0
    L = 10.0 ** rng.uniform(-6, 6, (*SIZE, 3))
    which = rng.integers(5)
    L = {0: 0 * L, 1: 0 * L + 1e-40, 2: L * (rng.random((*SIZE, 1)) < 0.02)}.get(int(which), L)
    n = normals(rng, pixels)
    arrays = {"n": n[None, None], "material": m.reshape(1, 108), "light": L[None]}
    if view_per_pixel:
        arrays["view"] = views(rng, n)[None, None]
    return {name: torch.as_tensor(a, dtype=torch.float32) for name, a in arrays.items()}


def not_finite(method, samples, seed, tolerance=1e-2, pixels=PIXELS, view_per_pixel=False):
    """How many values and derivatives of `samples` pixels are not finite."""
    wrong = 0
    for i in range(-(-samples // pixels)):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        leaves = {
            name: x.requires_grad_() for name, x in scene(rng, pixels, view_per_pixel).items()
        }
        seen = render(**leaves, method=method, tolerance=tolerance)
        seen.sum().backward()
        with torch.no_grad():
            alone = render(**leaves, method=method, tolerance=tolerance)
        wrong += sum(
            int((~x.isfinite()).sum())
            for x in (seen, alone, *(leaf.grad for leaf in leaves.values()))
        )
    return wrong


def main():
    parser = argparse.ArgumentParser(
        description="Adversarial pixels through the rendering methods."
    )
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--method", nargs="+", default=list(methods.NAMES), choices=methods.NAMES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-2,
        help="given to the methods; samples, taps and lights follow from it",
    )
    parser.add_argument("--view-per-pixel", action="store_true")
    options = parser.parse_args()
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/layer_stress.py {words}")
    for method in options.method:
        start = time.perf_counter()
        wrong = not_finite(
            method,
            options.samples,
            options.seed,
            options.tolerance,
            view_per_pixel=options.view_per_pixel,
        )
        name = f"{method}, view per pixel" if options.view_per_pixel else method
        result = json.loads(options.out.read_text()) if options.out.exists() else {}
        result[name] = made_by | {
            "samples": options.samples,
            "seed": options.seed,
            "tolerance": options.tolerance,
            "not finite": wrong,
        }
        print(
            f"{method}: {wrong} of {options.samples} pixels' values and derivatives,"
            f" {time.perf_counter() - start:.0f} s",
            flush=True,
        )
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
