"""How far light maps as they are made lie from references of many samples without a denoiser.

python -m factory.render.validation.panorama_error --seeds 10001 10004
"""

import argparse
import time

import numpy as np

from factory.lights import interiors
from factory.render import panorama
from manifests.option_types import positive, whole
from shaders import envmap


def irradiance(L: np.ndarray) -> np.ndarray:
    """Return the irradiance (128, 3) on normals over the sphere of a map L (H, W, 3)."""
    w, solid_angle = envmap.directions(*L.shape[:2])
    n, _ = envmap.directions(8, 16)
    cosine = np.maximum(n.reshape(-1, 3) @ w.reshape(-1, 3).T, 0)
    return cosine @ (L * solid_angle[..., None]).reshape(-1, 3)


def errors(L: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Return the relative errors of the irradiance (mean) and of the texels (median)."""
    exact = irradiance(reference)
    texels = np.abs(L - reference).sum(-1) / np.maximum(reference.sum(-1), 1e-12)
    return float(np.abs(irradiance(L) - exact).sum() / exact.sum()), float(np.median(texels))


def main() -> None:
    """Print a line for each seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=whole, nargs="+", default=[10001, 10004], metavar="SEED")
    parser.add_argument("--samples", type=positive, default=panorama.SAMPLES, metavar="N")
    parser.add_argument("--reference", type=positive, default=4096, metavar="N")
    options = parser.parse_args()
    for seed in options.seeds:
        scene = interiors.draw(seed)
        start = time.process_time()
        L = panorama.render(scene, seed, options.samples)
        seconds = time.process_time() - start
        exact = panorama.render(scene, seed + 1, options.reference, denoise=False)
        of_irradiance, of_texels = errors(L, exact)
        print(
            f"interior-{seed}: irradiance {of_irradiance:.2%}, median texel {of_texels:.2%},"
            f" {seconds:.1f} s of processor time"
        )


if __name__ == "__main__":
    main()
