"""Principled materials: a few numbers that name a material, and its isotropic BRDF.

cos_i, cos_o, cos_h, cos_d  as in shaders.closures; positive
F(c)   Schlick's Fresnel term F0 + (F90 − F0)(1 − c)^5, F90 = min(1, 50 F0) for a dielectric: a
       surface that reflects nothing straight on reflects nothing at grazing angles either
E      share of the light that a layer reflects towards a viewer at cos_o: its directional albedo
α      roughness², at least MIN_ALPHA
f      (…, 3) BRDF in 1/sr, without cosine, linear Rec.709

The layers, from the top down. What lies under a layer is weighted by what the layer lets through
towards the viewer, as Cycles does it, so that no material reflects more light than it receives:

sheen   Burley's (1 − cos_d)^k with k = 2.5/sheen_roughness, 5 at one half: Blender's sheen before
        version 4.0; lets through 1 − sheen E_sheen
coat    GGX with F0 = .04; lets through 1 − coat E_coat
base    metallic: GGX with F0 = base_color.
        dielectric: GGX with F0 = .08 specular, over a Lambertian base_color/π weighted by 1 − E.
        `metallic` mixes the two linearly

Every lobe is a closed form and reciprocal. The weights are not (they depend on cos_o alone), and
their E are integrals, tabulated once for each width (`albedos`).

Deviates from Blender's Principled BSDF: single scattering only, so that rough metals are darker;
Schlick's term instead of the dielectric Fresnel equations and of Blender's metallic edge tint;
Burley's sheen, fainter than Blender's microfibres; no tints, diffuse roughness, subsurface
scattering, transmission, anisotropy, thin film or emission.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from shaders import closures
from shaders.samples import Samples

COAT_F0 = 0.04
SPECULAR_F0 = 0.08  # of a specular level of 1: the IOR level of Blender, .5 = F0 .04
THETA_O = np.radians([*range(0, 60, 6), *range(60, 87, 3), 87, 89])  # of the tables of E
MIN_ALPHA = 1e-3  # a perfect mirror has no BRDF values
MIN_SHEEN_ROUGHNESS = 0.1  # below, nothing is left of it but the last degrees
_NO_COLOR = (0.8, 0.8, 0.8)


@dataclass(frozen=True)
class PrincipledMaterial:
    """A material of the layers above; every number lies in [0, 1].

    base_color  linear Rec.709
    specular    IOR level of a dielectric: .5 is F0 = .04; no part in a metal
    """

    base_color: tuple[float, float, float] = _NO_COLOR
    roughness: float = 0.5
    metallic: float = 0.0
    specular: float = 0.5
    sheen: float = 0.0
    sheen_roughness: float = 0.5
    coat: float = 0.0
    coat_roughness: float = 0.03

    def __post_init__(self) -> None:
        color = tuple(float(value) for value in self.base_color)
        if len(color) != 3:
            raise ValueError(
                f"base_color: three numbers in [0, 1] expected, found {len(color)} (linear red,"
                " green, blue)"
            )
        object.__setattr__(self, "base_color", color)
        numbers = {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        for name, value in [*(("base_color", value) for value in color), *numbers.items()]:
            low = MIN_SHEEN_ROUGHNESS if name == "sheen_roughness" else 0.0
            if not low <= value <= 1:  # NaN is not
                raise ValueError(
                    f"{name}: a number in [{low:g}, 1] expected, found {value:g} (see"
                    " shaders/principled.py)"
                )

    @property
    def narrowest(self) -> float:
        """Width α of its narrowest glossy layer; 1 where there is none."""
        glossy = self.metallic > 0 or self.specular > 0
        widths = [_alpha(self.roughness)] * glossy + [_alpha(self.coat_roughness)] * (self.coat > 0)
        return min(widths, default=1.0)

    def evaluate(
        self, cos_i: np.ndarray, cos_o: np.ndarray, cos_h: np.ndarray, cos_d: np.ndarray
    ) -> np.ndarray:
        """Return f (…, 3) in 1/sr; the cosines broadcast."""
        cos_i, cos_o, cos_h, cos_d = np.broadcast_arrays(cos_i, cos_o, cos_h, cos_d)
        cosines = cos_i, cos_o, cos_h, cos_d
        constant, slope = self._base(*cosines)
        f = constant[..., None] + slope[..., None] * np.array(self.base_color)
        if self.coat > 0:
            width = _alpha(self.coat_roughness)
            through = 1 - self.coat * dielectric_albedo(COAT_F0, width, cos_o)
            lobe = self.coat * dielectric(COAT_F0, cos_d) * closures.ggx(width, *cosines)
            f = lobe[..., None] + through[..., None] * f
        if self.sheen > 0:
            straight, grazing = albedos("sheen", self.sheen_roughness, cos_o)
            through = 1 - self.sheen * (straight + grazing)
            lobe = self.sheen * burley_sheen(self.sheen_roughness, *cosines)
            f = lobe[..., None] + through[..., None] * f
        return f

    def _base(
        self, cos_i: np.ndarray, cos_o: np.ndarray, cos_h: np.ndarray, cos_d: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a and b (…): the base layer is a + b base_color in every channel."""
        width, f0 = _alpha(self.roughness), SPECULAR_F0 * self.specular
        facets = closures.ggx(width, cos_i, cos_o, cos_h, cos_d)
        grazing = (1 - cos_d) ** 5
        through = 1 - dielectric_albedo(f0, width, cos_o)
        constant = facets * (self.metallic * grazing + (1 - self.metallic) * dielectric(f0, cos_d))
        slope = self.metallic * facets * (1 - grazing) + (1 - self.metallic) * through / closures.PI
        return constant, slope


def lambert(color: Sequence[float]) -> PrincipledMaterial:
    """Return a matte surface of a linear albedo: f = color/π."""
    return PrincipledMaterial(_triple(color), specular=0.0)


def ggx(f0: float | Sequence[float], roughness: float) -> PrincipledMaterial:
    """Return one GGX lobe with Schlick's Fresnel term, F0 grey or linear RGB: a metal."""
    return PrincipledMaterial(_triple(f0), roughness=roughness, metallic=1.0)


def burley_sheen(
    roughness: float, cos_i: np.ndarray, cos_o: np.ndarray, cos_h: np.ndarray, cos_d: np.ndarray
) -> np.ndarray:
    """Return Burley's sheen (1 − cos_d)^(2.5/roughness), with the arguments of a closure."""
    return (1 - cos_d) ** (2.5 / roughness)


LOBES = {"ggx": closures.ggx, "sheen": burley_sheen}


def dielectric(f0: float, cosine: np.ndarray) -> np.ndarray:
    """Return F(c) of a dielectric with the reflectance `f0` straight on."""
    return f0 + (min(1.0, 50 * f0) - f0) * (1 - cosine) ** 5


def dielectric_albedo(f0: float, alpha: float, cos_o: np.ndarray) -> np.ndarray:
    """Return the directional albedo of a dielectric's GGX lobe."""
    straight, grazing = albedos("ggx", alpha, cos_o)
    return f0 * straight + min(1.0, 50 * f0) * grazing


def albedos(kind: str, alpha: float, cos_o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ∫ f (1 − (1 − cos_d)^5) cos_i dω and ∫ f (1 − cos_d)^5 cos_i dω of a lobe.

    F0 and F90 times these are its directional albedo under Schlick's term; a lobe without Fresnel
    reflects their sum. They are tabulated and interpolated linearly in θ_o.
    """
    straight, grazing = _albedo_table(kind, alpha)
    theta_o = np.arccos(np.clip(cos_o, 0, 1))
    return np.interp(theta_o, THETA_O, straight), np.interp(theta_o, THETA_O, grazing)


@functools.lru_cache(maxsize=256)
def _albedo_table(kind: str, alpha: float) -> np.ndarray:
    """Return both integrals (2, V) at the view angles THETA_O."""
    samples = Samples(THETA_O, 48, 12, narrowest=alpha)
    flux = LOBES[kind](alpha, *samples.cosines) * samples.measure
    grazing = (1 - samples.cos_d) ** 5
    return np.stack([(flux * (1 - grazing)).sum(1), (flux * grazing).sum(1)])


def _alpha(roughness: float) -> float:
    return max(roughness * roughness, MIN_ALPHA)


def _triple(values: float | Sequence[float]) -> tuple[float, float, float]:
    red, green, blue = np.broadcast_to(np.asarray(values, dtype=np.float64), 3).tolist()
    return red, green, blue
