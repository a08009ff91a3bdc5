"""Materials of MaterialX's standard_surface that come closest to fitted mixtures.

They are for programs that cannot sum many closures. f is a BRDF (…, 3) in 1/sr without cosine,
linear Rec.709.

G(r)     GGX with height-correlated masking, shaders.closures.ggx, α = r²
F(ior)   the Fresnel equations of a dielectric at cos_d
E(r)     directional albedo of G(r) without Fresnel, at cos_o
M        1 + F (1 − E)/E: compensates for light that is scattered more than once
f        layer(coat, layer(specular specular_color, base_color/π)), where
         layer(top, below) = G F M top + (1 − top's albedo) below; the albedo is that of Schlick's
         Fresnel term, times M, without the colour

This is what MaterialX's own shaders compute (its libraries/bxdf/standard_surface.mtlx and
libraries/pbrlib/genglsl/mx_dielectric_bsdf.glsl), with tables for the albedos. `metalness` stays 0:
measured metals are darker at grazing angles than its Fresnel term allows, and a coloured specular
layer of a high index of refraction fits them better.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from shaders import closures, errors
from shaders.mixture import Mixture
from shaders.principled import albedos
from shaders.samples import Samples, held_out_samples

MIN_ALPHA = 1e-3
COAT_IOR = 1.5
LOW_IOR, HIGH_IOR = 1.2, 20.0
VIEWS_DEG = (5, 22, 38, 52, 67, 80)  # fitted; errors are measured at shaders.samples.HELD_OUT_DEG
REWEIGHTED = 3  # times that the colours are fitted, each time with weights nearer to least L1
TABLE_STEP = 0.005  # of roughness between tables of E
# roughness, log ior, coat, coat_roughness from which the search begins
INITIAL = (
    (0.1, 2.0, 0.0, 0.1),
    (0.15, 2.5, 0.0, 0.3),
    (0.3, 2.0, 0.0, 0.1),
    (0.3, 0.4, 0.0, 0.1),
    (0.5, 1.5, 0.3, 0.1),
    (0.8, 0.4, 0.0, 0.5),
)
EVALUATIONS = 60  # of each search
DIGITS = 4  # after the point, as written

Cosines = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class StandardSurface:
    """Inputs of standard_surface; the others keep their defaults, but for base, which is 1."""

    base_color: tuple[float, float, float]
    specular: float
    specular_color: tuple[float, float, float]
    specular_roughness: float
    specular_IOR: float
    coat: float
    coat_roughness: float

    def evaluate(
        self, cos_i: np.ndarray, cos_o: np.ndarray, cos_h: np.ndarray, cos_d: np.ndarray
    ) -> np.ndarray:
        """Return f (…, 3); the cosines broadcast."""
        a, b, c, d = np.broadcast_arrays(cos_i, cos_o, cos_h, cos_d)
        cosines = a, b, c, d
        lobe, albedo = _lobe(self.specular_roughness, self.specular_IOR, cosines)
        f = (self.specular * lobe)[..., None] * np.array(self.specular_color)
        through = (1 - self.specular * albedo) / np.pi
        f = f + through[..., None] * np.array(self.base_color)
        top, albedo = _lobe(self.coat_roughness, COAT_IOR, cosines)
        return (self.coat * top)[..., None] + (1 - self.coat * albedo)[..., None] * f


@dataclass(frozen=True)
class Approximation:
    """A material and its distance from the mixture.

    views  (6,) relative L1 of f · cos at the held-out view angles
    """

    material: StandardSurface
    views: np.ndarray

    @property
    def error(self) -> float:
        """Mean relative L1 of the held-out views."""
        return float(self.views.mean())


def fit(mixture: Mixture) -> Approximation:
    """Return the material nearest to a mixture, by relative L1 of f · cos."""
    samples = Samples(np.radians(VIEWS_DEG), 30, 6)
    problem = _Problem(samples, mixture.evaluate(*samples.cosines))
    results = [
        minimize(
            problem.distance,
            initial,
            method="Nelder-Mead",
            bounds=[(0.03, 1), (np.log(LOW_IOR), np.log(HIGH_IOR)), (0, 1), (0.03, 1)],
            options={"maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-4},
        )
        for initial in INITIAL
    ]
    material = problem.material(min(results, key=lambda result: result.fun).x)
    return Approximation(material, distances(material, mixture))


def distances(material: StandardSurface, mixture: Mixture) -> np.ndarray:
    """Return the relative L1 (6,) of f · cos from a mixture, at the held-out view angles."""
    samples = held_out_samples()
    f, reference = material.evaluate(*samples.cosines), mixture.evaluate(*samples.cosines)
    return errors.relative_l1(f, reference, samples)


class _Problem:
    """A target (V, P, 3) at samples: colours are solved for, the other numbers are searched."""

    def __init__(self, samples: Samples, target: np.ndarray) -> None:
        self.samples, self.target = samples, target
        self.weight = errors.metric(target, samples)

    def material(self, x: np.ndarray) -> StandardSurface:
        """Return the best material of (roughness, log ior, coat, its roughness), as written."""
        roughness, ior, coat, coat_roughness = np.round([x[0], np.exp(x[1]), x[2], x[3]], DIGITS)
        lobe, albedo = _lobe(roughness, ior, self.samples.cosines)
        top, top_albedo = _lobe(coat_roughness, COAT_IOR, self.samples.cosines)
        below = 1 - coat * top_albedo
        left, weight, level = self.target - (coat * top)[..., None], self.weight, 0.0
        for iteration in range(REWEIGHTED):
            columns = below * lobe, below * (1 - level * albedo) / np.pi
            shares = _two_shares(*columns, left, weight)  # (2, 3)
            level = float(shares[0].max())
            f = sum(c[..., None] * s for c, s in zip(columns, shares, strict=True))
            if iteration + 1 < REWEIGHTED:
                weight = errors.reweight(self.target, f + (coat * top)[..., None], self.samples)
        tint = shares[0] / max(level, 1e-9)
        return StandardSurface(
            _round(shares[1]),
            round(level, DIGITS),
            _round(tint),
            roughness,
            ior,
            coat,
            coat_roughness,
        )

    def distance(self, x: np.ndarray) -> float:
        """Return the relative L1 of f · cos plus that of the albedos, means of the fitted views.

        By the first alone, a highlight that is too wide or too narrow would best be black.
        """
        f = self.material(x).evaluate(*self.samples.cosines)
        measure = self.samples.measure[..., None]
        albedo, reference = (measure * f).sum(1), (measure * self.target).sum(1)
        off = np.abs(albedo - reference).sum(1) / reference.sum(1)
        return float((errors.relative_l1(f, self.target, self.samples) + off).mean())


def _two_shares(a: np.ndarray, b: np.ndarray, target: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return x, y (2, 3) in [0, 1] of least weighted squares of x a + y b − target, by channel."""
    aa, ab, bb = (np.einsum("vp,vp,vpc->c", p, q, weight) for p, q in ((a, a), (a, b), (b, b)))
    at, bt = (np.einsum("vp,vpc,vpc->c", p, target, weight) for p in (a, b))
    determinant = aa * bb - ab * ab
    x = np.clip((at * bb - bt * ab) / np.maximum(determinant, 1e-12 * aa * bb + 1e-300), 0, 1)
    for _ in range(8):  # coordinate descent settles what the bounds changed
        y = np.clip((bt - x * ab) / np.maximum(bb, 1e-300), 0, 1)
        x = np.clip((at - y * ab) / np.maximum(aa, 1e-300), 0, 1)
    return np.stack([x, y])


def _lobe(roughness: float, ior: float, cosines: Cosines) -> tuple[np.ndarray, np.ndarray]:
    """Return G F M and the layer's directional albedo, both with the cosines' shape."""
    cos_o, cos_d = cosines[1], cosines[3]
    f0 = ((ior - 1) / (ior + 1)) ** 2
    straight, grazing = _albedos(round(roughness / TABLE_STEP), cos_o)
    whole = np.minimum(straight + grazing, 1.0)
    fresnel = _fresnel(ior, cos_d)
    facets = closures.ggx(max(roughness**2, MIN_ALPHA), *cosines)
    compensation = 1 + fresnel * (1 - whole) / whole
    albedo = (f0 * straight + grazing) * compensation
    return facets * fresnel * compensation, np.minimum(albedo, 1.0)


def _albedos(step: int, cos_o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return shaders.principled.albedos of GGX at the nearest roughness that has a table."""
    return albedos("ggx", max((step * TABLE_STEP) ** 2, MIN_ALPHA), cos_o)


def _fresnel(ior: float, cosine: np.ndarray) -> np.ndarray:
    """Return the reflectance of unpolarised light at a dielectric's surface."""
    g = np.sqrt(ior * ior - 1 + cosine * cosine)
    ratio = ((cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)) ** 2
    return 0.5 * ((g - cosine) / (g + cosine)) ** 2 * (1 + ratio)


def _round(rgb: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = np.round(np.clip(rgb, 0, 1), DIGITS).tolist()
    return red, green, blue
