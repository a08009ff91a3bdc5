"""The camera of training: what it changes, what stays in register with the truth, what it costs."""

import numpy as np
import pytest
import torch

from learn.data import augmentation, camera_model
from learn.data.framing import DEPENDENCE, TYPICAL
from manifests.training_runs import Data
from shaders.tone import LUMINANCE

SIDE = 64
ROWS, COLUMNS = np.mgrid[0:SIDE, 0:SIDE]
DISK = np.hypot(ROWS - 31.5, COLUMNS - 31.5) < 25


def shaded() -> np.ndarray:
    """A disk that is brighter to the right, (SIDE, SIDE, 3) float32."""
    value = 0.1 + COLUMNS / SIDE
    return (value[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)


def taken(seed: int, mask: np.ndarray = DISK) -> tuple:
    rng = np.random.default_rng(seed)
    numbered = torch.from_numpy(1.0 + ROWS * SIDE + COLUMNS)
    return augmentation.prepare_photograph(
        rng, shaded(), mask, (numbered, torch.ones(SIDE, SIDE, 3))
    )


def test_the_truth_moves_along_and_is_cut_where_the_object_is_hidden() -> None:
    """A pixel's number says where it came from: brightness must be that of the same place."""
    cut = 0
    for seed in range(40):
        image, mask, (numbered, ones) = taken(seed)
        number = numbered.numpy()
        assert ((number == 0) == (ones.numpy()[..., 0] == 0)).all()
        both = mask & (number > 0)
        assert both.sum() >= 0.15 * DISK.sum()
        column = (number[both] - 1) % SIDE
        seen = image[both] @ LUMINANCE
        # bins of columns, as noise and compression change single pixels
        left, right = seen[column < 25], seen[column > 38]
        if len(left) > 20 and len(right) > 20:
            assert left.mean() < right.mean()
        cut += bool(mask.sum() < 0.8 * DISK.sum() or (mask & (number == 0)).any())
    assert 10 < cut < 40  # occluders, holes and masks with errors are neither absent nor always


def test_nothing_is_seen_outside_the_drawn_mask() -> None:
    for seed in range(10):
        image, mask, _ = taken(seed)
        assert not image[~mask].any()
        assert np.isfinite(image).all() and (image >= 0).all()


def test_the_same_seed_takes_the_same_picture() -> None:
    for one, two in zip(taken(3)[:2], taken(3)[:2], strict=True):
        np.testing.assert_array_equal(one, two)


def test_exposures_spread_over_four_stops() -> None:
    """White, in the picture's own units, is the 99th percentile over 2^-3 to 2^1."""
    percentile = np.percentile(shaded()[DISK] @ LUMINANCE, 99)
    stops = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        _, clipping = camera_model.take_photograph(rng, shaded(), DISK)
        # blur and white balance move a channel's white, not the mean over channels, by much
        stops.append(np.log2(percentile / (1 / (LUMINANCE @ (1 / clipping.white)))))
    low, high = np.percentile(stops, [2, 98])
    assert -3.2 < low < -2.7 and 0.7 < high < 1.2


def test_the_exposure_is_the_readers() -> None:
    """radiance = file x TYPICAL x Y^-DEPENDENCE, so that the mean is TYPICAL Y^(1 - DEPENDENCE)."""
    for seed in range(20):
        image, _ = camera_model.take_photograph(np.random.default_rng(seed), shaded(), DISK)
        mean = float((image[DISK] @ LUMINANCE).mean())
        Y = (mean / TYPICAL) ** (1 / (1 - DEPENDENCE))
        assert 0.005 < Y < 1.0


def test_what_exceeds_white_is_clipped_and_nothing_else_much() -> None:
    clipped = 0
    for seed in range(40):
        _, clipping = camera_model.take_photograph(np.random.default_rng(seed), shaded(), DISK)
        bright = (shaded() > 1.3 * clipping.white) & DISK[..., None]
        dark = (shaded() < 0.3 * clipping.white) & DISK[..., None]
        assert bright.sum() < 20 or clipping.clipped[bright].mean() > 0.9
        assert not dark.any() or clipping.clipped[dark].mean() < 0.02
        clipped += bool(clipping.clipped.any())
    assert clipped > 5


@pytest.mark.parametrize("value", [0.0, 1e-12, 5e4])
def test_black_and_very_bright_objects_stay_finite(value: float) -> None:
    image = np.full((SIDE, SIDE, 3), value, np.float32)
    for seed in range(5):
        result, clipping = camera_model.take_photograph(np.random.default_rng(seed), image, DISK)
        assert np.isfinite(result).all() and np.isfinite(clipping.white).all()


def test_drawn_masks_are_near_the_object_and_not_all_alike() -> None:
    sizes = []
    for seed in range(60):
        drawn = camera_model.draw_mask(np.random.default_rng(seed), DISK)
        assert not drawn[:3].any() and not drawn[:, :3].any()
        sizes.append(drawn.sum() / DISK.sum())
    assert 0.7 < min(sizes) < 0.99 and 1.01 < max(sizes) < 1.4


def test_a_mask_of_a_thin_object_is_never_worn_away() -> None:
    bars = np.zeros((SIDE, SIDE), bool)
    bars[4:-4, SIDE // 2 : SIDE // 2 + 2] = True
    sizes = [
        camera_model.draw_mask(np.random.default_rng(seed), bars).sum() / bars.sum()
        for seed in range(400)
    ]
    assert min(sizes) >= camera_model.LEAST_SHARE


def test_a_share_of_pictures_is_taken_by_the_camera_model() -> None:
    """Others are augmented as before."""
    along, simple = (torch.ones(SIDE, SIDE),), 0
    for seed in range(100):
        image, _, _ = augmentation.augment(
            Data(camera_model=0.7), True, np.random.default_rng(seed), shaded(), DISK, along
        )
        rng = np.random.default_rng(seed)
        rng.random()
        simple += np.array_equal(
            image, augmentation.prepare_picture(rng, shaded(), DISK, along, True)[0]
        )
    assert 15 < simple < 45
    for data, training in ((Data(), True), (Data(camera_model=0.7), False)):
        one = augmentation.augment(data, training, np.random.default_rng(5), shaded(), DISK, along)
        two = augmentation.prepare_picture(
            np.random.default_rng(5), shaded(), DISK, along, training
        )
        np.testing.assert_array_equal(one[0], two[0])
