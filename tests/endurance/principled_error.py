"""How close labels come to principled materials, and how long their fits take.

    PYTHONPATH=. python tests/endurance/principled_error.py [--count 500] [--seed 0]
    [--iterations N]

Draws materials, fits each to a label on one core, and prints the relative L1 of f · cos at the
held-out view angles (mean of the six: median, 90 %, worst), by kind of material and by view, with
the worst materials. The distribution: base_color uniform, roughness uniform in [.05, 1], metallic
one of 0, 1 and uniform, specular uniform; sheen in 30 % of them, a coat in 30 %.
"""

import argparse
import os
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # before numpy is imported

import numpy as np  # noqa: E402

from shaders import principled_fit  # noqa: E402
from shaders.principled import PrincipledMaterial  # noqa: E402


def drawn(rng):
    """A random material."""
    sheen, coat = rng.random(2) < 0.3
    return PrincipledMaterial(
        tuple(rng.random(3)),
        roughness=rng.uniform(0.05, 1),
        metallic=float(rng.choice([0.0, 1.0, rng.random()])),
        specular=rng.random(),
        sheen=rng.random() * sheen,
        sheen_roughness=rng.uniform(0.1, 1),
        coat=rng.random() * coat,
        coat_roughness=rng.uniform(0.05, 0.6),
    )


KINDS = {
    "all": lambda m: True,
    "one layer: no sheen, no coat": lambda m: m.sheen == m.coat == 0,
    "… dielectric": lambda m: m.sheen == m.coat == m.metallic == 0,
    "… metal": lambda m: m.sheen == m.coat == 0 and m.metallic == 1,
    "… metal, roughness below .3": lambda m: (
        m.sheen == m.coat == 0 and m.metallic == 1 and m.roughness < 0.3
    ),
    "… metal, roughness above .7": lambda m: (
        m.sheen == m.coat == 0 and m.metallic == 1 and m.roughness > 0.7
    ),
    "coat, no sheen": lambda m: m.coat > 0 and m.sheen == 0,
    "sheen": lambda m: m.sheen > 0,
}


def row(name, views):
    """A line of the table: one kind of material."""
    mean = views.mean(1)
    shares = " ".join(f"{v:.3f}" for v in (np.median(mean), np.quantile(mean, 0.9), mean.max()))
    by_view = " ".join(f"{v:.3f}" for v in np.median(views, axis=0))
    return f"{name:32s} {len(views):4d}  {shares}   {by_view}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--iterations", type=int, default=principled_fit.ITERATIONS)
    options = parser.parse_args()
    principled_fit.ITERATIONS = options.iterations
    rng = np.random.default_rng(options.seed)
    materials = [drawn(rng) for _ in range(options.count)]
    principled_fit.fit(materials[0])  # tables of the held-out samples
    views, seconds = [], []
    for material in materials:
        start = time.process_time()
        views.append(principled_fit.fit(material).views)
        seconds.append(time.process_time() - start)
    views, seconds = np.array(views), 1e3 * np.array(seconds)
    print(f"{'materials':32s} count median 90 % worst    median at .5 15 30 45 60 75°")
    for name, belongs in KINDS.items():
        if (chosen := np.array([belongs(m) for m in materials])).any():
            print(row(name, views[chosen]))
    print(
        f"CPU ms a fit: median {np.median(seconds):.0f}, 90 % {np.quantile(seconds, 0.9):.0f},"
        f" worst {seconds.max():.0f}"
    )
    for number in np.argsort(-views.mean(1))[:5]:
        print(f"{views[number].mean():.3f}  {materials[number]}")


if __name__ == "__main__":
    main()
