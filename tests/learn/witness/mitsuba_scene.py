"""A sphere in Mitsuba 3: the same camera, the same piecewise-constant map, the DSBRDF as a BSDF.

Run as a program, in a process of its own (its LLVM and torch's do not share one): mitsuba_scene.py
IN.npz OUT.npz, with m, L, size, power, samples and seeds in, pictures (seeds, size, size, 3) out.

Frames: Mitsuba's world is our light frame (x right, y up, z towards the viewer); the camera looks
along −z, elevation 0. Mitsuba's map is bilinear, its columns centred, its rows on the edges: each
of our texels becomes UP × UP of Mitsuba's, so that only the rim of a texel is blurred. Its u is
ours turned by a quarter.
"""

import sys

import drjit as dr
import mitsuba as mi
import numpy as np

UP = 32
RADIUS = 0.9  # of the sphere, in half pictures


def register(variant="llvm_ad_rgb"):
    mi.set_variant(variant)

    class Dsbrdf(mi.BSDF):
        """f_k = Σ_s expm1(κ c^γ), sampled by a mixture of a cosine and a cosine power of the half
        vector.
        """

        def __init__(self, properties):
            mi.BSDF.__init__(self, properties)
            self.m = np.array([float(x) for x in properties["m"].split()]).reshape(3, 3, 2, 6)
            self.power, self.broad = float(properties["power"]), 0.5
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags

        def f(self, wi, wo):
            h = dr.normalize(wi + wo)
            x = dr.acos(dr.clip(dr.dot(wi, h), 0, 0.9999999)) * (8 / dr.pi)
            square = lambda a: dr.square(dr.maximum(a, 0))  # noqa: E731
            r = 4 - x
            b = [
                square(1 - x),
                dr.select(x < 1, 2 * x - 1.5 * x * x, 0.5 * square(2 - x)),
                0.5 * (square(x) - 3 * square(x - 1) + 3 * square(x - 2) - square(x - 3)),
                0.5 * (square(x - 1) - 3 * square(x - 2) + 3 * square(x - 3)),
                dr.select(r < 1, 2 * r - 1.5 * r * r, 0.5 * square(2 - r)),
                square(1 - r),
            ]
            log_c = dr.log(dr.maximum(h.z, 1e-7))
            channels = []
            for k in range(3):
                value = mi.Float(0)
                for s in range(3):
                    kappa, gamma = (
                        sum(float(self.m[k, s, j, i]) * b[i] for i in range(6)) for j in (0, 1)
                    )
                    value += dr.exp(kappa * dr.exp(gamma * log_c)) - 1
                channels.append(value)
            return mi.Color3f(*channels)

        def density(self, wi, wo):
            h = dr.normalize(wi + wo)
            sharp = (
                (self.power + 1)
                / (2 * dr.pi)
                * dr.maximum(h.z, 1e-7) ** self.power
                / (4 * dr.maximum(dr.dot(wo, h), 1e-4))
            )
            return self.broad * dr.maximum(wo.z, 0) / dr.pi + (1 - self.broad) * sharp

        def sample(self, context, si, sample1, sample2, active):
            cosine = (1 - sample2.x) ** (1 / (self.power + 1))
            sine, phi = dr.sqrt(dr.maximum(0, 1 - cosine * cosine)), 2 * dr.pi * sample2.y
            h = mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), cosine)
            wo = dr.select(
                sample1 < self.broad,
                mi.warp.square_to_cosine_hemisphere(sample2),
                2 * dr.dot(si.wi, h) * h - si.wi,
            )
            result = mi.BSDFSample3f()
            result.wo, result.pdf, result.eta = wo, self.density(si.wi, wo), 1.0
            result.sampled_type, result.sampled_component = (
                mi.UInt32(+mi.BSDFFlags.GlossyReflection),
                0,
            )
            seen = active & (wo.z > 0) & (si.wi.z > 0) & (result.pdf > 0)
            return result, dr.select(seen, self.f(si.wi, wo) * wo.z / result.pdf, 0) & seen

        def eval(self, context, si, wo, active):
            seen = active & (wo.z > 0) & (si.wi.z > 0)
            return dr.select(seen, self.f(si.wi, wo) * wo.z, 0) & seen

        def pdf(self, context, si, wo, active):
            return dr.select(active & (wo.z > 0) & (si.wi.z > 0), self.density(si.wi, wo), 0)

        def eval_pdf(self, context, si, wo, active):
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def to_string(self):
            return "Dsbrdf[]"

    mi.register_bsdf("dsbrdf", lambda properties: Dsbrdf(properties))


def bitmap(L):
    """Our map (height, width, 3) as Mitsuba's, UP times as fine."""
    height, width = L.shape[0] * UP, L.shape[1] * UP
    row = np.clip((np.arange(height) / (height - 1) * L.shape[0]).astype(int), 0, L.shape[0] - 1)
    column = ((((np.arange(width) + 0.5) / width - 0.25) % 1) * L.shape[1]).astype(int)
    return mi.Bitmap(np.ascontiguousarray(L[row][:, column], dtype=np.float32))


def scene(m, L, size, power):
    """An orthographic camera before a sphere that spans RADIUS of the picture."""
    camera = mi.ScalarTransform4f().look_at(
        [0, 0, 4], [0, 0, 0], [0, 1, 0]
    ) @ mi.ScalarTransform4f().scale([1 / RADIUS, 1 / RADIUS, 1])
    film = {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": "direct",
                "emitter_samples": 1,
                "bsdf_samples": 1,
                "hide_emitters": True,
            },
            "sensor": {
                "type": "orthographic",
                "to_world": camera,
                "film": film | {"component_format": "float32"},
            },
            "shape": {
                "type": "sphere",
                "bsdf": {
                    "type": "dsbrdf",
                    "m": " ".join(map(repr, m.reshape(-1).tolist())),
                    "power": power,
                },
            },
            "light": {"type": "envmap", "bitmap": bitmap(L)},
        }
    )


def pictures(scene, samples, seeds):
    """(seeds, size, size, 3) independent pictures."""
    return np.stack([np.array(mi.render(scene, spp=samples, seed=seed)) for seed in seeds]).astype(
        np.float64
    )


if __name__ == "__main__":
    register()
    given = np.load(sys.argv[1], allow_pickle=False)
    shown = scene(given["m"], given["L"], int(given["size"]), float(given["power"]))
    np.savez(
        sys.argv[2], pictures=pictures(shown, int(given["samples"]), range(int(given["seeds"])))
    )
