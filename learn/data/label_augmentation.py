"""Materials beyond those of training: labels that a relit picture may have, made by arithmetic.

A relit picture needs a label and no shader nodes, so any label will do. A run makes some of its
labels in three ways, each with a share (manifests.training_runs.Data):

mixture     (1 − t) a + t b of the logarithms of two training materials, t between .1 and .9. This
            interpolates labels: κ and γ become geometric means. The BRDF in between is not the
            mean of the two BRDFs, which three lobes could not express
scaled      a training material with the amplitude and width of each lobe scaled, and its colour
            channel by channel
principled  a principled material of a random base colour, roughness, metallic, specular, sheen and
            coat, and its fitted label (shaders.principled_fit)

Every label is clipped to the range of the training materials' labels, number by number, because
networks code labels by that range (learn.networks.coding.Ranges). Its lobes stay in canonical
order. Its albedo is at most LARGEST_ALBEDO, or what the materials that it comes from have. The
picture is rendered from the label that results, so the label is the exact truth of the picture.

label (108,) float32, natural logarithms in canonical order
"""

from __future__ import annotations

import colorsys
import functools
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from learn.data.settings import Data
from learn.layer.albedo import log_albedo
from shaders import label_model, principled_fit
from shaders.dsbrdf import SHAPE
from shaders.principled import PrincipledMaterial

LARGEST_ALBEDO = 1.0  # along the normal; fits of measured materials reach 1.07
LEAST_SHARE = 0.1  # of either material in a mixture
AMPLITUDE, WIDTH, COLOR = 0.4, 0.35, 0.25  # standard deviations of logarithms
DIGITS = 4  # of a fitted label; a fit's last bits may differ between machines
_PRINCIPLED = 30  # of a SeedSequence's key, far from those of pictures (learn.data.relit)


class LabelAugmentation:
    """Draws labels for a run from the labels of its training materials.

    labels  {name: (108,)} of the training materials
    seed    of the run; it decides which principled materials there are
    """

    def __init__(self, labels: Mapping[str, np.ndarray], data: Data, seed: int):
        self.labels, self.data, self.seed = labels, data, seed
        by_channel = np.stack(list(labels.values())).reshape(-1, 36)
        self.low, self.high = (
            np.tile(bound, 3).reshape(SHAPE) for bound in (by_channel.min(0), by_channel.max(0))
        )

    def draw(
        self, rng: np.random.Generator, name: str, label: np.ndarray, admitted: Sequence[str]
    ) -> tuple[str, np.ndarray]:
        """Return the name and label of a material that takes the place of a training material.

        With the remaining share the material stays as it is, and its label the same array.

        name, label  of the training material; its channels may be permuted
        admitted     names of the materials that a mixture's second part is chosen from
        """
        data, kind = self.data, rng.random()
        if kind < data.principled:
            i = int(rng.integers(data.principled_materials))
            result = principled_label(self.seed, i).reshape(SHAPE)[rng.permutation(3)]
            return f"principled-{i}", self._make_valid(result, 0.0)
        kind -= data.principled
        if kind < data.label_mixtures:
            other = admitted[int(rng.integers(len(admitted)))]
            share = rng.uniform(LEAST_SHARE, 1 - LEAST_SHARE)
            second = self.labels[other].reshape(SHAPE)[rng.permutation(3)]
            mixed = (1 - share) * label.reshape(SHAPE) + share * second
            largest = max(_albedo(label), _albedo(second))
            return f"mixture({name},{other})", self._make_valid(mixed, largest)
        kind -= data.label_mixtures
        if kind < data.scaled_lobes:
            scaled = self._scale_lobes(rng, label.reshape(SHAPE))
            return f"scaled({name})", self._make_valid(scaled, _albedo(label))
        return name, label

    def _scale_lobes(self, rng: np.random.Generator, label: np.ndarray) -> np.ndarray:
        """Return a label (3, 3, 2, 6) with scaled lobes, in canonical order."""
        result = label.astype(np.float64)
        result[:, :, 0] += rng.normal(0, AMPLITUDE, 3)[None, :, None]
        result[:, :, 0] += rng.normal(0, COLOR, 3)[:, None, None]
        result[:, :, 1] += rng.normal(0, WIDTH, 3)[None, :, None]
        result = np.clip(result, self.low, self.high)
        if not in_order(result):  # then the lobes keep their widths
            result[:, :, 1] = label[:, :, 1]
        return result

    def _make_valid(self, label: np.ndarray, albedo: float) -> np.ndarray:
        """Return a label as it is rendered: clipped, in order, and no brighter than allowed.

        albedo  that is allowed, where it is more than LARGEST_ALBEDO
        """
        label = np.clip(label, self.low, self.high)
        for _ in range(SHAPE[1]):
            if in_order(label):
                break
            label = np.clip(label_model.in_canonical_order(label), self.low, self.high)
        excess = _albedo(label) / max(albedo, LARGEST_ALBEDO)
        if excess > 1:  # a lobe expm1(κ c^γ) falls at least as fast as κ does
            label[:, :, 0] = np.maximum(label[:, :, 0] - np.log(excess), self.low[:, :, 0])
        return label.reshape(-1).astype(np.float32)


def in_order(label: np.ndarray) -> bool:
    """Return whether a label's lobes are in canonical order: by ascending mean log γ."""
    widths = label.reshape(SHAPE)[:, :, 1].mean((0, 2))
    return bool((np.diff(widths) >= -1e-4).all())  # rounding in float32


@functools.lru_cache(maxsize=8192)
def principled_label(seed: int, i: int) -> np.ndarray:
    """Return the label (108,) of a seed's i-th principled material, fitted when first asked for."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_PRINCIPLED, i)))
    label = np.round(principled_fit.label_of(draw_principled(rng)), DIGITS)
    result = label.reshape(-1).astype(np.float32)
    result.flags.writeable = False
    return result


def draw_principled(rng: np.random.Generator) -> PrincipledMaterial:
    """Return a random principled material.

    30 % are metals, 5 % lie between metal and dielectric, 20 % have a coat and 15 % a sheen. A
    metal's colour is bright and pale, a dielectric's of any saturation and oftener dark; a quarter
    of the dielectrics are grey. Roughness is uniform from .1 to 1.
    """
    kind = rng.random()
    metallic = 1.0 if kind < 0.3 else float(rng.uniform(0, 1)) if kind < 0.35 else 0.0
    if metallic > 0.5:
        saturation, value = rng.uniform(0, 0.6), rng.uniform(0.4, 0.98)
    else:
        saturation = 0.0 if rng.random() < 0.25 else rng.uniform(0.1, 0.95)
        value = 0.02 + 0.88 * rng.random() ** 1.5
    color = colorsys.hsv_to_rgb(float(rng.random()), float(saturation), float(value))
    roughness, specular = float(rng.uniform(0.1, 1)), float(rng.uniform(0.1, 0.9))
    sheen = float(rng.uniform(0.2, 1)) if rng.random() < 0.15 else 0.0
    coat = float(rng.uniform(0.2, 1)) if rng.random() < 0.2 else 0.0
    return PrincipledMaterial(
        color,
        roughness,
        metallic,
        specular,
        sheen,
        float(rng.uniform(0.2, 0.8)),
        coat,
        float(rng.uniform(0.05, 0.4)),
    )


def _albedo(label: np.ndarray) -> float:
    """Return the largest albedo of the three channels, along the normal."""
    flat = torch.from_numpy(np.ascontiguousarray(label, np.float64).reshape(-1))
    return float(log_albedo(flat).max().exp())
