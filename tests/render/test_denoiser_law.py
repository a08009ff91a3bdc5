"""The fit of the law by which samples of the denoiser are planned."""

import numpy as np
import pytest

from factory.render.estimators.renderer import effort
from factory.render.validation import denoiser_law


def test_the_denoisers_law_is_fitted_within_shots():
    rng = np.random.default_rng(3)
    rows = []
    for shot, scale in enumerate((0.5, 1.3, 2.0)):
        for pixels in (4096, 16384, 65536):
            for noise in (400.0, 100.0, 25.0) * np.exp(rng.normal(size=3)):
                samples = 8 if noise > 30 else 64  # which are denoised more thoroughly
                bias = scale * (4096 / pixels) ** 0.3 * noise**0.7 * effort(samples).leaves
                row = {"shot": shot, "pixels": pixels, "noise": noise, "samples": samples}
                rows.append({**row, "bias": bias})
    rows = [{**row, "error": 1.5 * row["bias"]} for row in rows]
    # a bias that is lost in its uncertainty says nothing
    unseen = {"shot": 0, "pixels": 4096, "samples": 4, "noise": 9.0, "bias": -3.0, "error": 1.0}
    law = denoiser_law.fit_law([*rows, unseen])
    assert (law["power"], law["size"]) == pytest.approx((0.7, 0.3))
    assert law["scale_10_50_90"][1] == pytest.approx(1.3)
    assert law["error_over_bias"] == pytest.approx(1.5)
