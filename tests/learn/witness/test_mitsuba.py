"""A third renderer as witness: Mitsuba's path tracer and the layer agree within Mitsuba's noise.

Skips where mitsuba is not installed (`pip install .[witness]`) or finds no LLVM.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from learn.layer import render
from shaders.envmap import unit_mean
from tests.support.witness_scene import material, sky, sphere_normals

SIZE, SUB, SEEDS, SAMPLES, RADIUS = 24, 6, 24, 1024, 0.9  # the sphere spans RADIUS of the picture


@pytest.fixture
def witness(tmp_path):
    """witness(m, L, power) → (SEEDS, SIZE, SIZE, 3) by Mitsuba in a process of its own."""
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed: pip install .[witness]")

    def pictures(m, L, power):
        np.savez(
            tmp_path / "in.npz", m=m, L=L, size=SIZE, power=power, samples=SAMPLES, seeds=SEEDS
        )
        command = [
            sys.executable,
            Path(__file__).with_name("mitsuba_scene.py"),
            tmp_path / "in.npz",
            tmp_path / "out.npz",
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        if "LLVM" in done.stderr and done.returncode:
            pytest.skip(
                "mitsuba finds no LLVM that compiles for this processor: point DRJIT_LIBLLVM_PATH"
                " to a newer libLLVM (19 or later)"
            )
        assert done.returncode == 0, done.stderr
        return np.load(tmp_path / "out.npz", allow_pickle=False)["pictures"]

    return pictures


@pytest.mark.parametrize("lobes, power", [("matte", 2.0), ("satin", 12.0), ("glossy", 60.0)])
def test_mitsuba_agrees_within_its_noise(witness, lobes, power):
    m, L = material(lobes), unit_mean(sky())[0]
    seen = witness(m, L, power)
    inside, n = sphere_normals(SIZE, SUB, RADIUS)
    # Both the box filter over a pixel and the map's texels are integrals: the layer gets finer
    # texels and several rays a pixel.
    fine = torch.as_tensor(np.repeat(np.repeat(L, 6, 0), 6, 1)).float()[None]
    ours = render(
        torch.as_tensor(n).float()[None],
        torch.as_tensor(m.reshape(1, 108)).float(),
        fine,
        method="exact",
        elevation=0.0,
    )[0].numpy()
    ours = ours.reshape(SIZE, SUB, SIZE, SUB, 3).mean((1, 3))[inside]
    mean, sigma = seen.mean(0)[inside], seen.std(0, ddof=1)[inside] / np.sqrt(SEEDS)
    signed = (mean - ours).mean() / ours.mean()
    noise = sigma.mean() / np.sqrt(ours.size) / ours.mean()
    z = (mean - ours) / sigma
    print(
        f"{lobes}: signed mean {signed:.1e} (noise {noise:.1e}), |z| max {np.abs(z).max():.2f}, rms"
        f" {np.sqrt((z**2).mean()):.2f}"
    )
    assert abs(signed) <= 5e-4
    assert np.abs(z).max() <= 5
