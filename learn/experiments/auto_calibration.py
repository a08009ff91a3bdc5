"""The numbers by which `auto` plans, fitted on this machine: a map's error by spacing and
sharpness, and seconds of each kind of work.

map_error  of_lobe · (h √g)^power + of_light · h², h the spacing of nodes in radians, g ≥
least_sharpness light_error  of a light whose texels are interpolated between larger ones: of_lobe ·
(h √g)^power + of_horizon · h², h their rows' spacing
seconds    of the culled sum: pixels · (lights · share · pair + pixel) + call, share that of the
cone · / √g + block; of a look-up a pixel
"""

import functools
import time

import numpy as np
import torch

from learn.experiments import chart_cases
from learn.methods import directional, light_tables, lobe_shapes, planned, reflectance_map

SIZES = (16, 24, 32, 48, 64, 96)
SHARPNESS = (0.5, 2.0, 8.0, 32.0, 128.0, 512.0)
SUMMED = (4.0, 100.0, 1000.0, 1e4, 1e5)


def fit():
    """The content of learn/methods/calibration.json."""
    torch.set_num_threads(1)
    return {"map_error": map_error(), "light_error": light_error(), "seconds": seconds()}


def one_lobe(sharpness, kappa=0.3):
    m = torch.zeros(3, 3, 2, 6)
    m[:, 0, 0], m[:, :, 1] = kappa, 1.0
    m[:, 0, 1] = sharpness / lobe_shapes.sharpness(m)[0]
    return m


def map_error():
    """Upper envelope over lights: the fit is by least squares of logarithms, then raised until nine
    tenths of the points lie below.
    """
    n = chart_cases.sphere(64)
    n = n[(n != 0).any(-1)]
    points = []
    for L in chart_cases.computed_lights().values():
        lights, E = light_tables.of_map(torch.as_tensor(L).float(), torch.eye(3))
        for g in SHARPNESS:
            m = one_lobe(g)
            truth = directional.radiance(n, None, m, E, lights)
            for size in SIZES:
                seen = reflectance_map.with_nodes(
                    n,
                    size,
                    lambda nodes, m=m, E=E, k=lights: directional.radiance(nodes, None, m, E, k),
                )
                points.append(
                    (
                        2 * np.sqrt(2) / (size - 5),
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


def light_error():
    """The same for coarse lights, under one lit texel: there nothing cancels. The broadest lobe has
    the horizon's error alone.
    """
    n = chart_cases.sphere(64)
    n = n[(n != 0).any(-1)].numpy()
    points = []
    for g in SHARPNESS:
        scene = planned.Scene(
            n,
            one_lobe(g).double().numpy(),
            chart_cases.computed_lights()["one texel"].astype(np.float32),
            tuple(np.eye(3).ravel()),
        )
        truth = scene.at(n, (0,)).radiance
        for level in (1, 2):
            error = np.abs(scene.at(n, (0,), level).radiance - truth).mean() / truth.mean()
            points.append((np.pi / 2 * 2**level / chart_cases.SIZE[0], g, error))
    h, g, error = np.array(points).T
    of_horizon = float(np.median((error / h**2)[g == min(SHARPNESS)]))
    x, rest = h * np.sqrt(g), error - of_horizon * h**2
    inside = (x > 0.2) & (x < 1.0) & (rest > 0)
    power, of_lobe = np.polyfit(np.log(x[inside]), np.log(rest[inside]), 1)
    return {"of_lobe": float(np.exp(of_lobe)), "power": float(power), "of_horizon": of_horizon}


def seconds():
    n = chart_cases.sphere(192)
    n = n[(n != 0).any(-1)]
    lights, E = light_tables.of_map(
        torch.as_tensor(chart_cases.computed_lights()["sky"]).float(), torch.eye(3)
    )
    allowed = 0.1 * directional.scale(n, None, one_lobe(4.0), E, lights)
    took = [
        timed(functools.partial(summed, m=one_lobe(g), E=E, lights=lights, allowed=allowed), n)
        for g in SUMMED
    ]
    whole = 0.5 * len(E) * len(n)  # a broad lobe sees half of all lights
    call = timed(
        functools.partial(summed, m=one_lobe(1e5), E=E, lights=lights, allowed=allowed), n[:64]
    )
    pair = (took[0] - call) / whole
    share = np.clip((np.array(took[1:]) - call) / (pair * len(E) * len(n)), 1e-3, 0.49)
    cone = np.arccos(1 - 2 * share)  # the cone's half angle by sharpness: cone / √g + block
    slope, block = np.polyfit(1 / np.sqrt(SUMMED[1:]), cone, 1)
    nodes = reflectance_map.needed_nodes(n, 64)
    values = torch.rand(len(nodes), 3).requires_grad_()
    look_up = timed(lambda a: reflectance_map.look_up(a, values, nodes, 64), n) / len(n)
    result = {
        "pair": pair,
        "look_up": look_up,
        "pixel": 2e-7,
        "call": call,
        "cone": slope / 1.2,
        "block": max(block, 0.05),
    }
    return {name: float(f"{value:.3g}") for name, value in result.items()}


def summed(n, m, E, lights, allowed):
    return directional.radiance(n, None, m, E, lights, allowed)


def timed(function, n, rounds=3):
    """Best of a few, forward and backward, one thread's CPU seconds."""
    best = np.inf
    for _ in range(rounds):
        leaf = n.clone().requires_grad_()
        start = time.thread_time()
        function(leaf).sum().backward()
        best = min(best, time.thread_time() - start)
    return best
