"""How far a picture is from the true one, as people see them. The one home of the paper's L2.

Both pictures are brought to display values in [0, 255]: times one exposure, which brings the 99th
percentile of the truth's luminance over the mask to 1, clipped, and through the sRGB curve
(shaders.tone). All figures are of display values.

An "image L2" is `l2` of a picture by the layer against a true picture. The layer's picture is
rendered by a policy of learn.layer.predictions: MEASURED in evaluations, VALIDATION in training and
in the card of weights. Figures of different policies are not compared.

l2          the paper's: mean over the mask's pixels of the mean over channels of the squared
            difference; l2_frame: over the full frame
ssim        structural similarity, windows of 7 (scikit-image), mean over the mask; ssim_frame: over
            the full frame
psnr        10 log₁₀ (255² / l2) in dB, at most 68: rounding to whole display values alone is 59
flip        FLIP (Andersson et al. 2020; package flip-evaluator) at 67 pixels per degree, mean over
            the mask: 0 for equal pictures, 1 at most
lpips       only with weights (learn.metrics.lpips)

How bright a light is cannot be determined from one picture of an unknown material, so three figures
of the same l2 forgive brightness (`l2_after_alignments`):

l2_own_exposure   each picture under its own exposure
l2_one_factor     after the one factor on the picture's radiance that makes l2 least
l2_three_factors  after the three factors, one per channel, that make it least
"""

from collections.abc import Callable

import numpy as np
from skimage.metrics import structural_similarity

from shaders import tone
from shaders.tone import squared_difference

LEAST_L2 = 0.01  # of PSNR
STOPS = 5.0  # factors are searched from 2⁻⁵ to 2⁵
GOLDEN_SECTIONS = 12  # of a stop: to its 300th part

Perceptual = Callable[[np.ndarray, np.ndarray], float]  # of two pictures' display values


def compare(
    picture: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
    perceptual: Perceptual | None = None,
) -> dict[str, float | None]:
    """Return {figure: value} of a picture's radiance (H, W, 3) against the true radiance.

    mask        (H, W) bool, not empty
    perceptual  a further distance, named lpips, or None
    ssim is None for pictures smaller than 7 × 7 pixels.
    """
    shown, right = _display(picture, truth, mask)
    result = _l2_and_ssim(shown, right, mask) | {
        "flip": float(flip(shown, right)[mask].mean()),
        **l2_after_alignments(picture, truth, mask),
    }
    return result if perceptual is None else result | {"lpips": perceptual(shown, right)}


def l2_and_ssim(
    picture: np.ndarray, truth: np.ndarray, mask: np.ndarray
) -> dict[str, float | None]:
    """Return `compare`'s figures l2, l2_frame, ssim, ssim_frame and psnr alone."""
    return _l2_and_ssim(*_display(picture, truth, mask), mask)


def display_l2(
    picture: np.ndarray, truth: np.ndarray, mask: np.ndarray, frame: bool = False
) -> float:
    """Return `l2`, or with frame `l2_frame`, of radiance (H, W, 3) against the true radiance."""
    exposure = tone.auto_exposure(truth, mask)
    return float(tone.display_l2(picture, truth, exposure, None if frame else mask))


def l2_after_alignments(
    picture: np.ndarray, truth: np.ndarray, mask: np.ndarray
) -> dict[str, float]:
    """Return `l2` of radiance (H, W, 3) after alignments that forgive its brightness.

    Neither factor's l2 is ever above l2 itself: 1 is among the factors that are tried.
    """
    exposure = tone.auto_exposure(truth, mask)
    shown, right = picture[mask] * exposure, tone.display(truth[mask], exposure)
    own = tone.display(picture[mask], tone.auto_exposure(picture, mask))
    channels = [(shown[:, k : k + 1], right[:, k : k + 1]) for k in range(3)]
    return {
        "l2_own_exposure": float(squared_difference(own, right).mean()),
        "l2_one_factor": _least_l2(shown, right),
        "l2_three_factors": float(np.mean([_least_l2(a, b) for a, b in channels])),
    }


def _least_l2(radiance: np.ndarray, right: np.ndarray) -> float:
    """The least l2 of exposed radiance (P, C) times any factor against display values (P, C).

    Clipping makes several minima possible: the best of factors half a stop apart is refined by
    golden sections between its neighbours.
    """

    def l2(stops: float) -> float:
        return float(squared_difference(tone.display(radiance, 2.0**stops), right).mean())

    tried = np.linspace(-STOPS, STOPS, int(4 * STOPS) + 1)
    values = [l2(stops) for stops in tried]
    best = int(np.argmin(values))
    low, high = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
    ratio = (np.sqrt(5) - 1) / 2
    inner = [high - ratio * (high - low), low + ratio * (high - low)]
    errors = [l2(stops) for stops in inner]
    for _ in range(GOLDEN_SECTIONS):
        if errors[0] < errors[1]:
            high, inner[1], errors[1] = inner[1], inner[0], errors[0]
            inner[0] = high - ratio * (high - low)
            errors[0] = l2(inner[0])
        else:
            low, inner[0], errors[0] = inner[0], inner[1], errors[1]
            inner[1] = low + ratio * (high - low)
            errors[1] = l2(inner[1])
    return min(values[best], *errors)


def _display(
    picture: np.ndarray, truth: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    exposure = tone.auto_exposure(truth, mask)
    return tone.display(picture, exposure), tone.display(truth, exposure)


def _l2_and_ssim(shown: np.ndarray, right: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    error, alike = squared_difference(shown, right), similarity_map(shown, right)
    l2 = float(error[mask].mean())
    return {
        "l2": l2,
        "l2_frame": float(error.mean()),
        "ssim": None if alike is None else float(alike[mask].mean()),
        "ssim_frame": None if alike is None else float(alike.mean()),
        "psnr": float(10 * np.log10(255.0**2 / max(l2, LEAST_L2))),
    }


def flip(shown: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return FLIP's error map (H, W) in [0, 1] of display values."""
    from flip_evaluator import evaluate

    test, reference = (np.ascontiguousarray(x / 255.0, np.float32) for x in (shown, right))
    errors, _, _ = evaluate(reference, test, "LDR", inputsRGB=True, applyMagma=False)
    return errors[..., 0]


def squared_net_of_noise(errors: np.ndarray) -> np.ndarray:
    """Return the squared error (…) without the noise of the pictures, from those of several seeds.

    It is the mean over channels and over pairs of seeds of the product of their errors: noises of
    two seeds are independent, so that only what both share remains. It may be negative.

    errors  (seeds, …, 3) differences of display values, two seeds or more
    """
    total, own = errors.sum(0), (errors**2).sum(0)
    count = len(errors)
    return ((total**2 - own) / (count * (count - 1))).mean(-1)


def standard_error_net_of_noise(errors: np.ndarray) -> float:
    """Return the standard error of the mean of `squared_net_of_noise` over pixels, from noise.

    At a pixel let seed s have the errors x_s = e + n_s of three channels, with independent noises
    n_s of covariance Σ. The product of two seeds' errors, the mean over channels of x_1 x_2, has
    the variance (2 e·Σe + tr Σ²) / 9. Where the three channels have the same error e and the same
    noise of deviation s, that is 2 e² s² + s⁴. The mean over the pairs of S seeds has

        (4 e·Σe / S + 2 tr Σ² / (S (S − 1))) / 9.

    With the mean x̄ over seeds and their sample covariance C, the estimate at a pixel is

        (4 x̄·Cx̄ / S − 2 ((S − 1) tr C² − (tr C)²) / (S² (S + 1))) / 9.

    Its mean is the variance above if noise is normal, whether channels share it or not. With two
    seeds it is the square of half the difference of their own squared errors. Pixels are
    independent, so that their estimates are added.

    Of other noise it is wrong: with two seeds its mean is 2 e² s² + 2 e μ₃ + s⁴ (1 + κ/2), where μ₃
    is the noise's third moment and κ its excess kurtosis. It is too large for noise of rare bright
    pixels, and too small for noise with lighter tails than the normal's. It knows nothing of what
    all seeds share, such as a bias.

    errors  (seeds, P, 3) differences of display values, two seeds or more and a pixel or more
    """
    seeds, pixels, channels = errors.shape
    centre = errors.mean(0)
    noise = errors - centre
    covariance = np.einsum("spi,spj->pij", noise, noise) / (seeds - 1)
    along = np.einsum("pi,pij,pj->p", centre, covariance, centre)
    squares = (covariance**2).sum((1, 2))  # tr C²
    trace = np.trace(covariance, axis1=1, axis2=2)
    surplus = ((seeds - 1) * squares - trace**2) / (seeds**2 * (seeds + 1))
    variance = (4 * along / seeds - 2 * surplus).sum() / channels**2
    return float(np.sqrt(max(variance, 0.0)) / pixels)


def similarity(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float | None:
    """Return the mean SSIM of display values over the mask; None below 7 × 7 pixels."""
    values = similarity_map(a, b)
    return None if values is None else float(values[mask].mean())


def similarity_map(a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Return the SSIM (H, W) of display values at each pixel; None below 7 × 7 pixels."""
    if min(a.shape[:2]) < 7:
        return None
    return structural_similarity(a, b, data_range=255.0, channel_axis=-1, full=True)[1].mean(-1)
