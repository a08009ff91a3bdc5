"""A photograph's exposure: what is seen of it, and the line through that."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from learn.data import framing
from learn.data.batch import ExampleBatch
from learn.data.photographs import read
from learn.editing import decomposition, exposure, photograph
from learn.editing.exposure import Cues
from learn.figures import spheres
from learn.layer import predictions
from learn.networks.prediction import Prediction
from manifests.materials import load_catalogue

SIZE = 32


def framed(radiance: np.ndarray, clipped: np.ndarray | None = None) -> framing.Framed:
    mask = np.zeros((SIZE, SIZE), bool)
    mask[4:28, 4:28] = True
    return framing.Framed(radiance * mask[..., None], mask, (0, 0, SIZE), 1.0, clipped)


def grey(value: float) -> np.ndarray:
    return np.full((SIZE, SIZE, 3), value, np.float32)


def test_cues_are_stops_of_the_object_and_of_how_much_brighter_it_is_rendered_again() -> None:
    cues = exposure.measure_cues(framed(grey(0.125)), grey(2.0), -2.5)
    assert (cues.object, cues.again, cues.background) == pytest.approx((-3, 4, -2.5), abs=1e-5)
    # what stands behind the object does not count
    beside = grey(2.0)
    beside[:4] = 50
    assert exposure.measure_cues(framed(grey(0.125)), beside, None) == Cues(
        cues.object, cues.again, None
    )


def test_clipped_pixels_do_not_count_and_nothing_is_said_of_white_or_black() -> None:
    seen, clipped = grey(0.125), np.zeros((SIZE, SIZE, 3), np.float32)
    seen[:16] = 1
    clipped[:16, :, 1] = 1
    assert exposure.measure_cues(framed(seen, clipped), grey(2.0), None).again == pytest.approx(4)
    assert exposure.measure_cues(framed(seen, np.ones_like(clipped)), grey(2.0), None).again is None
    assert exposure.measure_cues(framed(grey(0.125)), grey(0), None).again is None


def test_the_first_guess_is_the_readers_rule_and_bounds_what_is_made_of_it() -> None:
    unknown, usual = Cues(0.0, None, -2.0), Cues(0.0, exposure.USUAL, -2.0)
    assert exposure.exposure_from_cues(unknown) == exposure.exposure_from_cues(usual)
    assert exposure.exposure_from_cues(Cues(0.0, 99.0, None)) == pytest.approx(
        framing.TYPICAL * 2**exposure.MOST
    )
    assert exposure.exposure_from_cues(Cues(0.0, -99.0, -3.0)) == pytest.approx(
        framing.TYPICAL / 2**exposure.MOST
    )


def test_what_is_darker_than_its_background_has_the_larger_exposure_before_a_darker_one() -> None:
    """The same object before a darker background was under less light: multiply by more."""
    bright, dark = (exposure.exposure_from_cues(Cues(-3.0, 1.0, behind)) for behind in (-1.0, -3.0))
    assert dark > 1.2 * bright
    black = exposure.exposure_from_cues(Cues(-3.0, 1.0, -9.0))
    assert black == exposure.exposure_from_cues(Cues(-3.0, 1.0, exposure.BACKGROUNDS[0]))
    brighter_again = exposure.exposure_from_cues(Cues(-3.0, 2.0, -3.0))
    assert brighter_again > 1.2 * dark


def test_the_background_is_a_mean_logarithm_that_neither_lamps_nor_black_pixels_decide(
    tmp_path,
) -> None:
    picture = np.full((40, 40, 3), 0.25, np.float32)
    mask = np.zeros((40, 40), bool)
    mask[12:28, 12:28] = True
    picture[mask] = 0.9
    assert exposure.measure_background(photograph.from_arrays(picture, mask)) == pytest.approx(
        -2, abs=1e-3
    )
    picture[0, 0], picture[0, 1] = 1.0, 0.0
    assert exposure.measure_background(photograph.from_arrays(picture, mask)) == pytest.approx(
        -2, abs=0.01
    )


def test_a_cut_out_a_close_up_and_a_black_ground_have_no_background() -> None:
    picture = np.full((40, 40, 3), 0.25, np.float32)
    mask = np.zeros((40, 40), bool)
    mask[5:35, 5:35] = True
    cut_out = np.concatenate([picture, mask[..., None].astype(np.float32)], -1)
    assert exposure.measure_background(photograph.from_arrays(cut_out)) is None
    assert exposure.measure_background(photograph.from_arrays(picture, mask)) is not None
    black = picture * mask[..., None]
    assert exposure.measure_background(photograph.from_arrays(black, mask)) is None
    mask[1:39, 1:39] = True
    assert exposure.measure_background(photograph.from_arrays(picture, mask)) is None


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


def test_a_prediction_of_two_regions_is_rendered_as_the_layer_does() -> None:
    names = ("brass", "white-fabric")
    label = torch.tensor(np.stack([load_catalogue()[name].label.ravel() for name in names])).float()
    n = torch.from_numpy(spheres.sphere_normals(SIZE)).movedim(-1, 0)[None].contiguous()
    segments = (n[0].abs().sum(0) > 0).long()[None]
    segments[:, :, SIZE // 2 :] *= 2
    light = torch.full((1, 3, 64, 128), 0.5)
    light[:, :, 8:20, 30:60] = 6.0
    image = torch.zeros(1, 3, SIZE, SIZE)
    batch = ExampleBatch(
        image, image[:, :1], image, segments, label[None], light, label[None], ("picture",), 0.35
    )
    again = exposure.render_prediction(batch, Prediction(n, None, label[None], None, light))
    picture = predictions.picture(n, label[None], light, segments, 0.35, predictions.SHOWN)
    whole = picture[0].numpy()
    assert not again[segments[0].numpy() == 0].any()
    for number in (1, 2):
        inside = segments[0].numpy() == number
        error = np.abs(again[inside] - whole[inside]).mean() / whole[inside].mean()
        assert error < predictions.SHOWN.tolerance
        assert again[inside].mean() == pytest.approx(whole[inside].mean(), rel=5e-3)


@pytest.mark.parametrize("given", [None, 0.7])
def test_an_estimated_exposure_is_corrected_and_a_given_one_is_kept(tmp_path, given) -> None:
    display = np.full((40, 40, 3), 90, np.uint8)
    mask = np.zeros((40, 40), np.uint8)
    mask[5:35, 5:35] = 255
    Image.fromarray(display).save(tmp_path / "photo.png")
    Image.fromarray(mask).save(tmp_path / "mask.png")
    opened = photograph.open_photograph(
        tmp_path / "photo.png", (tmp_path / "mask.png",), exposure=given
    )
    result = decomposition.decompose(opened, Grey(), SIZE)
    inside = result.framed.mask
    factor = result.framed.exposure / (
        given or framing.resolve_exposure(*read(tmp_path / "photo.png", tmp_path / "mask.png"))
    )
    again = exposure.render_prediction(result.batch, result.start)[inside].mean()
    seen = result.framed.radiance[inside].mean()
    assert result.batch.image[0, 0][torch.from_numpy(inside)].mean() == pytest.approx(seen)
    if given:
        assert factor == pytest.approx(1)
        assert result.cues is None
    else:
        # under the first exposure it was brighter again by as much as the exposure has grown
        cues = exposure.Cues(
            float(np.log2(seen / result.framed.exposure)),
            float(np.log2(again * factor / seen)),
            exposure.measure_background(opened),
        )
        assert result.framed.exposure == pytest.approx(exposure.exposure_from_cues(cues), rel=1e-3)
        assert abs(math.log(factor)) > 0.1
