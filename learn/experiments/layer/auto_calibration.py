"""The constants by which `auto` plans, fitted on this machine (calibrate_auto).

map_error    error of a map: of_lobe · (h √g)^power + of_light · h², where h is the spacing of
             nodes in radians and the sharpness g is at least least_sharpness
light_error  error of a light whose texels are interpolated between larger ones:
             of_lobe · (h √g)^power + of_horizon · h², where h is the spacing of their rows
seconds      of the culled sum: pixels · (lights · share · pair + pixel) + call, where share is
             that of a cone of half angle cone / √g + block; of a look-up per pixel
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable

import numpy as np
import torch

from learn.experiments.layer import chart_cases
from learn.methods import directional, light_tables, lobe_shapes, planned, reflectance_map

SIZES = (16, 24, 32, 48, 64, 96)
SHARPNESS = (0.5, 2.0, 8.0, 32.0, 128.0, 512.0)
SUMMED = (4.0, 100.0, 1000.0, 1e4, 1e5)


def fit(size: int) -> dict[str, dict[str, float]]:
    """Return the content of learn/methods/calibration.json; `size` is the side of timed pictures.

    The errors are of a sphere in a third of that size.
    """
    torch.set_num_threads(1)
    third = size // 3
    return {
        "map_error": map_error(third),
        "light_error": light_error(third),
        "seconds": seconds(size),
    }


def one_lobe(sharpness: float, kappa: float = 0.3) -> torch.Tensor:
    """Return the material (3, 3, 2, 6) of one lobe of that sharpness."""
    m = torch.zeros(3, 3, 2, 6)
    m[:, 0, 0], m[:, :, 1] = kappa, 1.0
    m[:, 0, 1] = sharpness / lobe_shapes.sharpness(m)[0]
    return m


def map_error(size: int) -> dict[str, float]:
    """Return the upper envelope over lights of a map's error.

    The fit is by least squares of logarithms, then raised until nine tenths of the points lie
    below it.
    """
    n = chart_cases.sphere(size)
    n = n[(n != 0).any(-1)]
    points = []
    for L in chart_cases.computed_lights().values():
        lights, E = light_tables.lights_and_energy(torch.as_tensor(L).float(), torch.eye(3))
        for g in SHARPNESS:
            m = one_lobe(g)
            truth = directional.radiance(n, None, m, E, lights)
            for nodes in SIZES:
                render = functools.partial(_radiance, m=m, E=E, lights=lights)
                seen = reflectance_map.radiance_by_nodes(n, nodes, render)
                points.append(
                    (
                        2 * np.sqrt(2) / (nodes - 5),
                        g,
                        ((seen - truth).abs().mean() / truth.mean()).item(),
                    )
                )
    h, g, error = np.array(points).T
    least = 8.0
    x = h * np.sqrt(np.maximum(g, least))
    inside = (x < 0.8) & (error > 1e-4)
    power = np.polyfit(np.log(x[inside]), np.log(error[inside]), 1)[0]
    of_light = float(np.quantile((error / h**2)[x < 0.25], 0.9))
    of_lobe = float(np.quantile((error / x**power)[inside], 0.9))
    return {
        "of_lobe": of_lobe,
        "power": float(power),
        "least_sharpness": least,
        "of_light": of_light,
    }


def light_error(size: int) -> dict[str, float]:
    """Return the same for coarse lights, under one lit texel, where no errors cancel.

    The broadest lobe has the horizon's error alone.
    """
    sphere = chart_cases.sphere(size)
    n = sphere[(sphere != 0).any(-1)].numpy()
    points = []
    for g in SHARPNESS:
        scene = planned.Scene(
            n,
            one_lobe(g).double().numpy(),
            chart_cases.computed_lights()["one texel"].astype(np.float32),
            tuple(np.eye(3).ravel()),
        )
        truth = scene.list_lobes(n, (0,)).radiance
        for level in (1, 2):
            error = np.abs(scene.list_lobes(n, (0,), level).radiance - truth).mean() / truth.mean()
            points.append((np.pi / 2 * 2**level / chart_cases.SIZE[0], g, error))
    h, g, error = np.array(points).T
    of_horizon = float(np.median((error / h**2)[g == min(SHARPNESS)]))
    x, rest = h * np.sqrt(g), error - of_horizon * h**2
    inside = (x > 0.2) & (x < 1.0) & (rest > 0)
    power, of_lobe = np.polyfit(np.log(x[inside]), np.log(rest[inside]), 1)
    return {"of_lobe": float(np.exp(of_lobe)), "power": float(power), "of_horizon": of_horizon}


def seconds(size: int) -> dict[str, float]:
    """Return seconds of each kind of work, on one thread."""
    n = chart_cases.sphere(size)
    n = n[(n != 0).any(-1)]
    lights, E = light_tables.lights_and_energy(
        torch.as_tensor(chart_cases.computed_lights()["sky"]).float(), torch.eye(3)
    )
    allowed = 0.1 * directional.mean_radiance(n, None, one_lobe(4.0), E, lights)
    took = [
        time_rounds(
            functools.partial(sum_culled, m=one_lobe(g), E=E, lights=lights, allowed=allowed), n
        )
        for g in SUMMED
    ]
    whole = 0.5 * len(E) * len(n)  # a broad lobe sees half of all lights
    call = time_rounds(
        functools.partial(sum_culled, m=one_lobe(1e5), E=E, lights=lights, allowed=allowed), n[:64]
    )
    pair = (took[0] - call) / whole
    share = np.clip((np.array(took[1:]) - call) / (pair * len(E) * len(n)), 1e-3, 0.49)
    cone = np.arccos(1 - 2 * share)  # the cone's half angle by sharpness: cone / √g + block
    slope, block = np.polyfit(1 / np.sqrt(SUMMED[1:]), cone, 1)
    nodes = reflectance_map.needed_nodes(n, 64)
    values = torch.rand(len(nodes), 3).requires_grad_()
    look_up = time_rounds(lambda a: reflectance_map.look_up(a, values, nodes, 64), n) / len(n)
    result = {
        "pair": pair,
        "look_up": look_up,
        "pixel": 2e-7,
        "call": call,
        "cone": slope / 1.2,
        "block": max(block, 0.05),
    }
    return {name: float(f"{value:.3g}") for name, value in result.items()}


def _radiance(
    n: torch.Tensor, m: torch.Tensor, E: torch.Tensor, lights: directional.Lights
) -> torch.Tensor:
    """Return radiance (P, 3) of normals (P, 3) seen by a distant viewer."""
    return directional.radiance(n, None, m, E, lights)


def sum_culled(
    n: torch.Tensor,
    m: torch.Tensor,
    E: torch.Tensor,
    lights: directional.Lights,
    allowed: float,
) -> torch.Tensor:
    """Return the culled sum's radiance (P, 3)."""
    return directional.radiance(n, None, m, E, lights, allowed)


def time_rounds(function: Callable[..., torch.Tensor], n: torch.Tensor, rounds: int = 3) -> float:
    """Return the least processor seconds of a few rounds, forward and backward."""
    best = np.inf
    for _ in range(rounds):
        leaf = n.clone().requires_grad_()
        start = time.thread_time()
        function(leaf).sum().backward()
        best = min(best, time.thread_time() - start)
    return best
