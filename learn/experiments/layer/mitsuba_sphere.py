"""Time Mitsuba 3 on spheres: python -m learn.experiments.layer.mitsuba_sphere IN.npz OUT.npz.

It runs in a process of its own, because Mitsuba's LLVM and torch's do not share one. IN.npz and
OUT.npz are written and read by learn.experiments.layer.mitsuba_rival.

The DSBRDF is a BSDF of Mitsuba's, and a sphere under an environment map is lit by the integrator
`direct`: one sample of the light and one of the BSDF per sample, weighted against each other. A
ray goes through the middle of each pixel, so that a pixel has one normal, as the layer's have.
Backward is Dr.Jit's reverse mode through the integrator, by the material's control values and by
the map's texels; a sphere has no normals that could be differentiated. Compiling is not timed: each
case is rendered once before.

Frames: Mitsuba's world is the light frame. n and view are in it.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

from learn.experiments.editing.mitsuba_descent import mitsuba_map

UP = 4  # Mitsuba's texels along one of the light's: its map is bilinear, the layer's has steps
DISTANCE = 4.0  # from the sphere's surface to where rays begin
BROAD = 0.3  # of the BSDF's samples that follow the cosine; the others follow the lobes


def bsdf_class(mi: Any, dr: Any) -> Any:
    """Return Mitsuba's BSDF class of the DSBRDF, f_k = Σ_s expm1(κ c^γ).

    Its attributes are set for each case: m (108 floats of one value each), powers (3) and shares
    (3) of the cosine powers by which half vectors are sampled.
    """

    def splines(theta_d: Any) -> list[Any]:
        x = theta_d * (8 / dr.pi)
        r = 4 - x

        def square(a: Any) -> Any:
            return dr.square(dr.maximum(a, 0))

        def end(a: Any) -> Any:
            return dr.select(a < 1, 2 * a - 1.5 * a * a, 0.5 * square(2 - a))

        return [
            square(1 - x),
            end(x),
            0.5 * (square(x) - 3 * square(x - 1) + 3 * square(x - 2) - square(x - 3)),
            0.5 * (square(x - 1) - 3 * square(x - 2) + 3 * square(x - 3)),
            end(r),
            square(1 - r),
        ]

    class Dsbrdf(mi.BSDF):
        def __init__(self, properties: Any) -> None:
            mi.BSDF.__init__(self, properties)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags
            self.m = [mi.Float(0.1)] * 108
            self.powers, self.shares = [mi.Float(1.0)] * 3, [mi.Float(1 / 3)] * 3

        def value(self, wi: Any, wo: Any) -> Any:
            h = dr.normalize(wi + wo)
            basis = splines(dr.acos(dr.clip(dr.dot(wi, h), 0, 0.9999999)))
            log_c = dr.log(dr.maximum(h.z, 1e-7))
            channels = []
            for k in range(3):
                value = mi.Float(0)
                for s in range(3):
                    at = 36 * k + 12 * s
                    kappa = sum(self.m[at + i] * basis[i] for i in range(6))
                    gamma = sum(self.m[at + 6 + i] * basis[i] for i in range(6))
                    value += dr.exp(kappa * dr.exp(gamma * log_c)) - 1
                channels.append(value)
            return mi.Color3f(*channels)

        def density(self, wi: Any, wo: Any) -> Any:
            h = dr.normalize(wi + wo)
            c, shrink = dr.maximum(h.z, 1e-7), 4 * dr.maximum(dr.dot(wo, h), 1e-4)
            lobes = sum(
                share * (power + 1) * dr.power(c, power)
                for share, power in zip(self.shares, self.powers, strict=True)
            )
            return BROAD * dr.maximum(wo.z, 0) / dr.pi + (1 - BROAD) * lobes / (2 * dr.pi * shrink)

        def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> Any:
            del context
            pick = (sample1 - BROAD) / (1 - BROAD)
            power = dr.select(
                pick < self.shares[0],
                self.powers[0],
                dr.select(pick < self.shares[0] + self.shares[1], self.powers[1], self.powers[2]),
            )
            cosine = dr.power(1 - sample2.x, 1 / (power + 1))
            sine, phi = dr.sqrt(dr.maximum(0, 1 - cosine * cosine)), 2 * dr.pi * sample2.y
            h = mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), cosine)
            wo = dr.select(
                sample1 < BROAD,
                mi.warp.square_to_cosine_hemisphere(sample2),
                2 * dr.dot(si.wi, h) * h - si.wi,
            )
            wo = dr.detach(wo)
            result = mi.BSDFSample3f()
            result.wo, result.pdf, result.eta = wo, dr.detach(self.density(si.wi, wo)), 1.0
            result.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            result.sampled_component = 0
            seen = active & (wo.z > 0) & (si.wi.z > 0) & (result.pdf > 0)
            return result, dr.select(seen, self.value(si.wi, wo) * wo.z / result.pdf, 0) & seen

        def eval(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            del context
            seen = active & (wo.z > 0) & (si.wi.z > 0)
            return dr.select(seen, self.value(si.wi, wo) * wo.z, 0) & seen

        def pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            del context
            seen = active & (wo.z > 0) & (si.wi.z > 0)
            return dr.select(seen, dr.detach(self.density(si.wi, wo)), 0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def to_string(self) -> str:
            return "Dsbrdf[]"

    return Dsbrdf


class Sphere:
    """A unit sphere in Mitsuba under a map, and how it is rendered."""

    def __init__(self, mi: Any, dr: Any, height: int, width: int) -> None:
        self.mi, self.dr = mi, dr
        made: list[Any] = []
        kind = bsdf_class(mi, dr)

        def make(properties: Any) -> Any:
            made.append(kind(properties))
            return made[-1]

        mi.register_bsdf("dsbrdf", make)
        grey = mi.Bitmap(mitsuba_map(np.ones((height, width, 3)), UP))
        direct = {"emitter_samples": 1, "bsdf_samples": 1, "hide_emitters": True}
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"} | direct,
                "shape": {"type": "sphere", "bsdf": {"type": "dsbrdf"}},
                "light": {"type": "envmap", "bitmap": grey},
            }
        )
        self.bsdf, self.values = made[-1], mi.traverse(self.scene)
        self.sampler = mi.load_dict({"type": "independent"})
        own = np.repeat(np.arange(height * width).reshape(height, width, 1), 3, 2)
        texel = mitsuba_map(own.astype(np.float64), UP)[..., 0].astype(np.uint32).ravel()
        flat = (3 * texel[:, None] + np.arange(3, dtype=np.uint32)).ravel()
        self.index, self.shape = mi.UInt32(flat), (height * UP, width * UP, 3)

    def render(
        self, case: dict[str, np.ndarray], samples: int, seed: int, backward: bool
    ) -> tuple[float, np.ndarray]:
        """Return processor seconds, and the picture (P, 3).

        case  n, view (P, 3), m (108,), powers, shares (3,), light (height, width, 3)
        """
        mi, dr = self.mi, self.dr
        pixels = len(case["n"])
        n, view = (mi.Vector3f(np.ascontiguousarray(case[k].T)) for k in ("n", "view"))
        light = mi.Float(case["light"].astype(np.float32).ravel())
        m = [dr.opaque(mi.Float, float(value)) for value in case["m"].ravel()]
        dr.eval(n, view, light)
        self.bsdf.powers = [dr.opaque(mi.Float, float(value)) for value in case["powers"]]
        self.bsdf.shares = [dr.opaque(mi.Float, float(value)) for value in case["shares"]]
        began = time.process_time()
        if backward:
            dr.enable_grad(light, *m)
        self.bsdf.m = m
        texels = dr.gather(mi.Float, light, self.index)
        self.values["light.data"] = mi.TensorXf(texels, self.shape)
        self.values.update()
        number = dr.arange(mi.UInt32, pixels * samples) // dr.opaque(mi.UInt32, samples)
        point, towards = (dr.gather(mi.Vector3f, x, number) for x in (n, view))
        ray = mi.RayDifferential3f(o=point + DISTANCE * towards, d=-towards)
        self.sampler.seed(seed, pixels * samples)
        color, _, _ = self.scene.integrator().sample(self.scene, self.sampler, ray)
        picture = [dr.block_sum(channel, samples) / samples for channel in color]
        if backward:
            dr.backward(dr.sum(picture[0] + picture[1] + picture[2]))
            dr.eval(picture, dr.grad(light), *(dr.grad(value) for value in m))
        else:
            dr.eval(picture)
        dr.sync_thread()
        return time.process_time() - began, np.stack([np.array(x) for x in picture], -1)


def render_sphere(given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what OUT.npz holds: seconds and forward (C, S), pictures (C, S, P, 3)."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    sphere = Sphere(mi, dr, *given["light"].shape[1:3])
    count, samples = len(given["m"]), [int(number) for number in given["samples"]]
    seconds, forward = np.zeros((count, len(samples))), np.zeros((count, len(samples)))
    pictures = np.zeros((count, len(samples), *given["n"].shape), np.float32)
    for c in range(count):
        case = {key: given[key][c] for key in ("m", "powers", "shares", "light")}
        case |= {key: given[key] for key in ("n", "view")}
        for s, number in enumerate(samples):
            if not c:  # compiles
                sphere.render(case, number, 0, True)
                sphere.render(case, number, 0, False)
            seconds[c, s], pictures[c, s] = sphere.render(case, number, 1, True)
            forward[c, s], _ = sphere.render(case, number, 2, False)
    return {"seconds": seconds, "forward": forward, "pictures": pictures}


if __name__ == "__main__":
    with np.load(sys.argv[1], allow_pickle=False) as file:
        read = dict(file)
    np.savez(sys.argv[2], **render_sphere(read))
