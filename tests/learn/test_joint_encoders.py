"""Two encoders that learn together: what they begin with, what they see, what learns."""

import pytest
import torch

from learn.data.settings import Run, require_trainable
from learn.networks import pretrained, tensor_file, weights
from learn.networks.coding import Ranges, picture_code
from learn.networks.compact import CompactWrapped
from learn.networks.joint_encoders import JointEncoders, JointWide
from learn.networks.pretrained import CompactPretrained
from learn.networks.two_encoders import TwoEncoders
from manifests.errors import InputError
from tests.support.tiny_run import RUN, train, two_sided

SIZE = 32
RANGES = Ranges(torch.full((108,), -2.0), torch.full((108,), 1.0))
OTHERS = Ranges(torch.full((108,), -3.0), torch.full((108,), 2.0))


def picture():
    rng = torch.Generator().manual_seed(3)
    mask = torch.zeros(2, 1, SIZE, SIZE)
    mask[:, :, 4:28, 6:30] = 1
    return torch.rand(2, 3, SIZE, SIZE, generator=rng) * mask, mask


@pytest.fixture
def separate_weights(tmp_path):
    torch.manual_seed(1)
    network = TwoEncoders(OTHERS)
    path = tmp_path / "separate.safetensors"
    weights.save_weights(path, network, network.state_dict(), "{}", SIZE)
    return path


def kept_by(network, path):
    """Names of the modules that keep their weights when a network begins with those of a file."""
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    with tensor_file.open_tensor_file(path) as stored:
        weights.fill_joint(network, stored)
    return {
        name.split(".")[0]
        for name, tensor in network.state_dict().items()
        if torch.equal(tensor, before[name]) and tensor.ndim > 1
    }


def test_it_begins_with_the_normals_of_weights_whose_encoders_learned_separately(separate_weights):
    network = JointEncoders(RANGES)
    assert kept_by(network, separate_weights) == {"narrow", "material", "illumination"}
    assert torch.equal(network.ranges.centre, RANGES.centre)
    theirs = weights.load_network(separate_weights)[0]
    image, mask = picture()
    with torch.no_grad():
        assert torch.equal(network.eval()(image, mask).n, theirs(image, mask).n)


def test_it_begins_with_the_normals_of_a_pretrained_network(tmp_path):
    torch.manual_seed(1)
    other = CompactPretrained(OTHERS).eval()
    path = tmp_path / "normals.safetensors"
    weights.save_weights(path, other, other.state_dict(), "{}", SIZE)
    network = JointEncoders(RANGES).eval()
    compact = network.down[0][0].weight.clone()
    with tensor_file.open_tensor_file(path) as stored:
        weights.fill_joint(network, stored)
    theirs = weights.load_network(path)[0]
    image, mask = picture()
    with torch.no_grad():
        features = network.of_normals.features_of(picture_code(image, mask))
        ours = network.of_normals.normals_of(features)
        assert torch.equal(ours, theirs(image, mask, parts=("normals",)).n)
    assert torch.equal(network.down[0][0].weight, compact)


def test_weights_of_one_encoder_are_no_beginning(tmp_path):
    network = CompactWrapped(RANGES)
    path = tmp_path / "weights.safetensors"
    weights.save_weights(path, network, network.state_dict(), "{}", SIZE)
    with (
        tensor_file.open_tensor_file(path) as stored,
        pytest.raises(InputError, match="a two-encoders network"),
    ):
        weights.fill_joint(JointEncoders(RANGES), stored)


def test_normals_material_and_light_depend_on_both_encoders():
    torch.manual_seed(1)
    network = JointEncoders(RANGES).eval()
    image, mask = picture()

    def predicted():
        with torch.no_grad():
            return network(image, mask)

    first = predicted()
    with torch.no_grad():
        network.of_normals.stem[0].weight.mul_(-1)
    second = predicted()
    with torch.no_grad():
        network.down[0][0].weight.mul_(-1)
    third = predicted()
    for before, after in ((first, second), (second, third)):
        for part in ("n", "label", "light"):
            assert not torch.equal(getattr(before, part), getattr(after, part)), part


def test_the_wide_one_takes_the_pretrained_part_and_learns_its_own_encoder_anew(separate_weights):
    network = JointWide(RANGES)
    assert kept_by(network, separate_weights) == {
        "narrow",
        "material",
        "illumination",
        "down",
        "deepen",
        "up",
        "normals",
    }
    theirs = weights.load_network(separate_weights)[0].of_normals.state_dict()
    ours = network.of_normals.state_dict()
    assert all(torch.equal(ours[name], tensor) for name, tensor in theirs.items())


def test_the_wide_ones_weights_take_less_than_32_mebibytes(tmp_path):
    network, path = JointWide(RANGES), tmp_path / "wide.safetensors"
    weights.save_weights(path, network, network.state_dict(), "{}", SIZE)
    assert 30 << 20 < path.stat().st_size < 31 << 20  # what it saw comes beside it


@pytest.mark.parametrize("kind", [JointEncoders, JointWide])
def test_every_parameter_learns(kind):
    network = kind(RANGES).train()
    image, mask = picture()
    result = network(image, mask)
    sum(part.float().sum() for part in result if part is not None).backward()
    assert [name for name, each in network.named_parameters() if each.grad is None] == []


def test_a_picture_of_a_size_that_the_encoder_cannot_halve_is_refused():
    with pytest.raises(InputError, match="a multiple of 32"):
        require_trainable(Run(name="x", network="joint-encoders", size=48), "run")


def test_weights_that_were_saved_predict_the_same(tmp_path):
    torch.manual_seed(2)
    network = JointEncoders(RANGES).eval()
    network.load_state_dict(
        {
            name: tensor.half().float()
            if tensor.is_floating_point() and tensor.ndim > 1
            else tensor
            for name, tensor in network.state_dict().items()
        }
    )
    path = tmp_path / "weights.safetensors"
    weights.save_weights(path, network, network.state_dict(), "{}", SIZE)
    loaded = weights.load_full_network(path)[0]
    image, mask = picture()
    with torch.no_grad():
        ours, theirs = network(image, mask), loaded(image, mask)
    for part in ("n", "label", "light"):
        assert torch.equal(getattr(ours, part), getattr(theirs, part)), part


def test_depthwise_filters_learn_in_float32_whatever_the_others_compute_in():
    network = pretrained.SamePadded(8, 8, 3, 1, 8)
    x = torch.rand(1, 8, 6, 6)
    with torch.autocast("cpu", torch.bfloat16):
        assert network.train()(x).dtype == torch.float32
        assert network.eval()(x).dtype == torch.bfloat16
        others = pretrained.SamePadded(8, 8, 3, 1).train()
        assert others(x).dtype == torch.bfloat16


def test_a_run_starts_from_weights_whose_encoders_learned_separately(tmp_path, separate_weights):
    store = two_sided(tmp_path / "data")
    schedule = {"steps": 1, "batch": 2, "learning_rate": 1e-9}
    run = RUN | {"network": "joint-encoders", "schedule": schedule}
    assert train(store, tmp_path / "out", "--start", str(separate_weights), run=run) == 0
    ours = weights.load_network(tmp_path / "out" / "weights.safetensors")[0].state_dict()
    theirs = weights.load_network(separate_weights)[0].state_dict()
    for name in ("down.0.0.weight", "of_normals.stem.0.weight", "up.0.0.weight"):
        torch.testing.assert_close(ours[name], theirs[name], rtol=2e-3, atol=1e-5)
    assert ours["material.0.weight"].shape != theirs["material.0.weight"].shape
