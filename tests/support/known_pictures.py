"""Pictures of known truth, noise and bias in place of Cycles', for tests of error estimates."""

import numpy as np

from factory.render.estimators.renderer import DirectPicture, DirectWork, Portion, Share, Shown
from shaders import tone

SIZE = 48
NO_GUIDES = np.zeros((SIZE, SIZE, 6), np.float32)
MASK = np.hypot(*(np.mgrid[:SIZE, :SIZE] - SIZE / 2 + 0.5)) < 0.45 * SIZE


class Known:
    """A renderer of a ramp with normal noise: `noise` at one sample, in linear radiance.

    Its denoiser leaves a share of the noise, and adds `bias` where the columns are even.
    """

    def __init__(self, noise=0.3, left=0.3, bias=0.0):
        self.noise, self.left, self.bias = noise, left, bias
        self.requested, self.tries = [], 0  # portions, and calls of the denoiser
        ramp = np.linspace(0.25, 0.9, SIZE, dtype=np.float32)
        self.truth = np.broadcast_to(ramp[:, None, None], (SIZE, SIZE, 3)).copy()

    def portion(self, first, count, seed, tier):
        self.requested.append((first, count, seed))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(first, count)))
        noise = self.noise * rng.normal(size=self.truth.shape) / np.sqrt(count)
        noisy = (self.truth + noise).astype(np.float32)
        return Portion(noisy, MASK.astype(np.float32), NO_GUIDES, np.zeros_like(noisy))

    def denoise(self, portion, effort):
        self.tries += 1
        smooth = self.truth + self.left * (portion.noisy - self.truth)
        smooth[:, ::2] += self.bias
        return smooth.astype(np.float32)

    def may_shade_itself(self):
        return True

    def direct_light_work(self, points):
        return None

    def direct_light(self, points, known=None, where=None):
        return None

    def visible_share(self, points, rays, seed, half, where=None, turn=0):
        return None


class Shaded(Known):
    """A ramp of unblocked light, of which a share arrives: steps from column to column.

    Both tiers' noise is that of the unblocked light. The denoiser blurs the steps. `closed` is what
    the closed form is off by, as a factor.
    """

    def __init__(self, noise=0.6, deepest=0.4, closed=1.0, blur=True):
        super().__init__(noise, left=0.1)
        self.unblocked, self.closed, self.blur = self.truth, closed, blur
        self.closed_forms = 0  # that were computed
        steps = (np.arange(SIZE) % 8 < 4).astype(np.float32)
        self.share = (deepest + (1 - deepest) * steps)[None, :, None]
        self.truth = self.unblocked * self.share

    def portion(self, first, count, seed, tier):
        self.requested.append((first, count, seed))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(first, count)))
        noise = self.noise * rng.normal(size=self.truth.shape) / np.sqrt(count)
        share = np.float32(self.share if tier != "direct" else np.ones_like(self.share))
        noisy = np.float32(share * (self.unblocked + noise))
        # the share is seen by the denoiser as guides are
        guides = np.broadcast_to(share, (*MASK.shape, 1))
        return Portion(noisy, MASK.astype(np.float32), guides, np.zeros_like(noisy))

    def denoise(self, portion, effort):
        self.tries += 1
        unblocked = portion.guides * self.unblocked
        smooth = unblocked + self.left * (portion.noisy - unblocked)
        # what the noise hides is blurred in both pictures alike
        ripple = 1 + (0.3 * np.sin(np.arange(SIZE))[None, :, None] if self.blur else 0)
        return np.float32(smooth * ripple)

    def direct_light_work(self, points):
        return DirectWork(points)

    def direct_light(self, points=64, known=None, where=None):
        self.closed_forms += 1
        radiance = np.float32(self.unblocked * self.closed)
        return DirectPicture(radiance, MASK.astype(np.float32), np.zeros_like(radiance))


class Rays(Shaded):
    """The same, with rays: which find the share that arrives, with noise, and `off` by a factor."""

    def __init__(self, off=1.0, spread=0.3, **words):
        super().__init__(**words)
        self.off, self.spread, self.rays = off, spread, []

    def visible_share(self, points, rays, seed, half, where=None, turn=0):
        self.rays.append((rays, half, where))
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        shape = self.truth.shape
        noise = self.spread * rng.normal(size=shape) * (self.share < 1) / np.sqrt(rays * points / 2)
        sent = np.full(shape, float(rays * points)) * (1 if where is None else where[..., None])
        return Share(sent * np.clip(self.share * self.off + noise, 0, 1), sent)


class Mirrored(Rays):
    """The same, with light that the object reflects onto itself, and that the denoiser spoils."""

    def __init__(self, reflected=0.08, spoilt=0.1, grain=0.2, **words):
        super().__init__(**words)
        self.reflected, self.spoilt, self.grain = reflected, spoilt, grain
        self.smoothed = 0
        self.truth = self.truth + np.float32(reflected)

    def portion(self, first, count, seed, tier):
        part = super().portion(first, count, seed, tier)
        if tier == "direct":
            return part
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(first, count, 1)))
        noise = self.grain * rng.normal(size=self.truth.shape) / np.sqrt(count)
        indirect = np.float32(self.reflected + noise)
        return part._replace(noisy=part.noisy + indirect, indirect=indirect)

    def denoise(self, portion, effort):
        if portion.noisy is not portion.indirect:
            return super().denoise(portion, effort)
        self.smoothed += 1
        stripes = self.spoilt * (np.arange(SIZE) % 2)
        return np.float32(self.reflected + stripes[None, :, None] + 0 * portion.noisy)


def error(picture, known):
    exposure = tone.auto_exposure(known.truth, MASK)
    return tone.display_l2(picture, known.truth, exposure, MASK)


def shown(known, seed=5):
    return Shown(known, seed, "full", MASK)
