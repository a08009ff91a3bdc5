"""A photograph's exposure is corrected by what is rendered again from its prediction."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from learn.data.framing import Framed, exposure_of
from learn.data.photographs import read
from learn.editing import decomposition, exposure, photograph
from learn.networks.prediction import Prediction

SIZE = 32


def framed(radiance: np.ndarray, clipped: np.ndarray | None = None) -> Framed:
    mask = np.zeros((SIZE, SIZE), bool)
    mask[4:28, 4:28] = True
    return Framed(radiance * mask[..., None], mask, (0, 0, SIZE), 1.0, clipped)


def grey(value: float) -> np.ndarray:
    return np.full((SIZE, SIZE, 3), value, np.float32)


def test_three_quarters_of_the_stops_between_picture_and_rendering_are_corrected() -> None:
    assert exposure.correction(framed(grey(0.1)), grey(1.6)) == pytest.approx(8)
    assert exposure.correction(framed(grey(1.6)), grey(0.1)) == pytest.approx(1 / 8)
    # what stands behind the object does not count
    beside = grey(1.6)
    beside[:4] = 50
    assert exposure.correction(framed(grey(0.1)), beside) == pytest.approx(8)


def test_clipped_pixels_do_not_count_and_extremes_are_bounded() -> None:
    seen, clipped = grey(0.1), np.zeros((SIZE, SIZE, 3), np.float32)
    seen[:16] = 1
    clipped[:16, :, 1] = 1
    assert exposure.correction(framed(seen, clipped), grey(1.6)) == pytest.approx(8)
    assert exposure.correction(framed(seen, np.ones_like(clipped)), grey(1.6)) == 1
    assert exposure.correction(framed(grey(0.1)), grey(0)) == 1
    assert exposure.correction(framed(grey(1e-4)), grey(1e4)) == 2**exposure.MOST


class Grey(torch.nn.Module):
    """A network that sees a grey matte plane under light from everywhere in every picture."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def forward(self, image, mask, segments=None, **_):
        n = torch.zeros_like(image)
        n[:, 2] = 1
        label = torch.full((1, 1, 108), math.log(1e-6))
        label[..., 0::2] = math.log(math.log(1 + 0.01))
        return Prediction(n, None, label, None, torch.ones(1, 3, 64, 128))


@pytest.mark.parametrize("given", [None, 0.7])
def test_an_estimated_exposure_is_corrected_and_a_given_one_is_kept(tmp_path, given) -> None:
    display = np.full((40, 40, 3), 90, np.uint8)
    mask = np.zeros((40, 40), np.uint8)
    mask[5:35, 5:35] = 255
    Image.fromarray(display).save(tmp_path / "photo.png")
    Image.fromarray(mask).save(tmp_path / "mask.png")
    opened = photograph.opened(tmp_path / "photo.png", (tmp_path / "mask.png",), exposure=given)
    result = decomposition.decompose(opened, Grey(), SIZE)
    inside = result.framed.mask
    factor = result.framed.exposure / (
        given or exposure_of(*read(tmp_path / "photo.png", tmp_path / "mask.png"))
    )
    again = exposure.rendered_again(result.batch, result.start)[inside].mean()
    seen = result.framed.radiance[inside].mean()
    assert result.batch.image[0, 0][torch.from_numpy(inside)].mean() == pytest.approx(seen)
    if given:
        assert factor == pytest.approx(1)
    else:
        # what is left of the ratio is its last quarter
        assert factor == pytest.approx((again / seen) ** 3, rel=1e-3)
        assert abs(math.log(factor)) > 0.1
