"""The mean of two networks' normals, material and light by one, in one file of weights."""

import json

import pytest
import torch

from learn.__main__ import COMMANDS
from learn.data.settings import Run, require_trainable
from learn.networks import joining, weights
from learn.networks.coding import Ranges
from learn.networks.compact import CompactWrapped
from learn.networks.pretrained import CompactPretrained
from learn.networks.two_encoders import TwoEncoders
from manifests.cli import main
from manifests.errors import InputError

SIZE = 32
FIRST = Ranges(torch.full((108,), -2.0), torch.full((108,), 1.0))
SECOND = Ranges(torch.full((108,), -3.0), torch.full((108,), 2.0))


def shaken(network, seed):
    """The network with other running statistics than those of a new one, ready to predict."""
    rng = torch.Generator().manual_seed(seed)
    for name, buffer in network.named_buffers():
        if name.endswith("running_mean"):
            buffer.copy_(0.1 * torch.randn(buffer.shape, generator=rng))
    return network.eval()


@pytest.fixture
def files(tmp_path):
    torch.manual_seed(1)
    both = shaken(CompactPretrained(FIRST), 1), shaken(CompactWrapped(SECOND), 2)
    paths = [tmp_path / "normals.safetensors", tmp_path / "others.safetensors"]
    runs = {"name": "first", "parts": ["normals"]}, {"name": "second"}
    for path, network, run in zip(paths, both, runs, strict=True):
        state = network.state_dict()
        weights.save_weights(path, network, state, json.dumps(run), SIZE, 5)
    return paths


def picture():
    rng = torch.Generator().manual_seed(3)
    mask = torch.zeros(2, 1, SIZE, SIZE)
    mask[:, :, 4:28, 6:30] = 1
    return torch.rand(2, 3, SIZE, SIZE, generator=rng) * mask, mask


def test_normals_are_the_mean_of_both_networks_and_the_rest_the_seconds(files, tmp_path):
    out = tmp_path / "a" / "joined.safetensors"
    joining.join(*files, out)  # a folder that is missing is made
    joined, about = weights.load_full_network(out)
    first, second = (weights.load_network(path)[0] for path in files)
    image, mask = picture()
    with torch.no_grad():
        ours = joined(image, mask)
        both = [each(image, mask, parts=("normals",)).n for each in (first, second)]
        mean = torch.nn.functional.normalize(both[0] + both[1], dim=1)
        others = second(image, mask)
    torch.testing.assert_close(ours.n, mean, rtol=0, atol=1e-6)
    assert torch.equal(ours.label, others.label)
    assert torch.equal(ours.light, others.light)
    assert torch.equal(joined.ranges.centre, second.ranges.centre)
    assert about["network"] == "two-encoders"
    assert about["run"]["name"] == "second"
    assert json.loads(about[joining.RUN_OF_NORMALS])["name"] == "first"


def test_normals_that_are_given_are_the_ones_pixels_are_binned_by(files, tmp_path):
    out = tmp_path / "joined.safetensors"
    joining.join(*files, out)
    joined, second = weights.load_network(out)[0], weights.load_network(files[1])[0]
    image, mask = picture()
    n = torch.nn.functional.normalize(torch.rand(2, 3, SIZE, SIZE) + 0.1, dim=1)
    with torch.no_grad():
        ours = joined(image, mask, parts=("material",), n=n)
        theirs = second(image, mask, parts=("material",), n=n)
    assert ours.n is None
    assert torch.equal(ours.label, theirs.label)


def test_what_either_saw_the_joined_weights_have_seen(tmp_path, files):
    from learn.data import seen

    lists = [
        seen.make_seen({"shapes": [mark * 16], "materials": ["a" * 16], "lights": []})
        for mark in "bc"
    ]
    for path, network, own in zip(
        files, (CompactPretrained(FIRST), CompactWrapped(SECOND)), lists, strict=True
    ):
        weights.save_weights(path, network, network.state_dict(), "{}", SIZE, seen=own)
    joining.join(*files, tmp_path / "joined.safetensors")
    result = weights.seen_by(tmp_path / "joined.safetensors")
    assert result == lists[0].join(lists[1])
    assert len(result.shapes) == 2
    assert result.complete


def test_weights_that_do_not_say_what_they_saw_leave_the_lists_incomplete(tmp_path, files):
    joining.join(*files, tmp_path / "joined.safetensors")
    assert not weights.seen_by(tmp_path / "joined.safetensors").complete


def test_the_command_writes_weights_and_refuses_those_of_other_networks(files, tmp_path, capsys):
    out = tmp_path / "joined.safetensors"
    words = ["join-weights", "--normals", str(files[0]), "--others", str(files[1])]
    assert main("learn", "", COMMANDS, [*words, "--out", str(out)]) == 0
    assert weights.load_network(out)[1]["size"] == SIZE
    swapped = ["join-weights", "--normals", str(files[1]), "--others", str(files[0])]
    assert main("learn", "", COMMANDS, [*swapped, "--out", str(tmp_path / "no")]) == 1
    assert "expected weights of the network compact-pretrained, found" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_weights_for_pictures_of_two_sizes_are_refused(files, tmp_path):
    network = CompactWrapped(SECOND)
    weights.save_weights(files[1], network, network.state_dict(), "{}", 64)
    with pytest.raises(InputError, match=r"for pictures of 32², as .*, found 64²"):
        joining.join(*files, tmp_path / "joined.safetensors")


def test_a_picture_of_a_size_that_the_encoder_cannot_halve_is_refused():
    with pytest.raises(InputError, match="a multiple of 32"):
        require_trainable(Run(name="x", network="two-encoders", size=48), "run")
    require_trainable(Run(name="x", network="two-encoders", size=96), "run")


def test_the_network_holds_nothing_that_it_does_not_use():
    network = TwoEncoders(FIRST).train()
    image, mask = picture()
    result = network(image, mask)
    sum(part.float().sum() for part in result if part is not None).backward()
    assert [name for name, each in network.named_parameters() if each.grad is None] == []
