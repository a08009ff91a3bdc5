"""Dead units: they are found, reinitialised without a change of the output, and learn again."""

import msgspec
import pytest
import torch
from torch import nn

from learn.data.settings import Schedule
from learn.training import revival, schedule

INPUTS, HIDDEN = 12, 40


def head(dead=10):
    """A head whose first units of both hidden layers are never above 0."""
    torch.manual_seed(0)
    layers = nn.Sequential(
        nn.Linear(INPUTS, HIDDEN),
        nn.ReLU(),
        nn.Dropout(0.5),
        nn.Linear(HIDDEN, HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, 3),
    )
    with torch.no_grad():
        layers[0].bias[:dead] = -100
        layers[3].bias[:dead] = -100
    return nn.ModuleDict({"head": layers, "beside": nn.Sequential(nn.Conv2d(1, 1, 1), nn.ReLU())})


def alive(network, x):
    first = network["head"][1](network["head"][0](x))
    second = network["head"][4](network["head"][3](first))
    return [(each > 0).any(0) for each in (first, second)]


@pytest.fixture
def pictures():
    return torch.randn(64, INPUTS, generator=torch.Generator().manual_seed(1))


def revive(network, x):
    rng = torch.Generator().manual_seed(2)
    return revival.revive(network, lambda each: each["head"](x), rng)


def test_dead_units_live_again_and_the_network_computes_what_it_did(pictures):
    network = head().eval()
    before = network["head"](pictures)
    dead = [int((~each).sum()) for each in alive(network, pictures)]
    assert min(dead) >= 10
    assert revive(network, pictures) == {
        "head.1": (dead[0], HIDDEN),
        "head.4": (dead[1], HIDDEN),
    }
    torch.testing.assert_close(network["head"](pictures), before, rtol=0, atol=1e-6)
    assert [int((~each).sum()) for each in alive(network, pictures)] == [0, 0]


def test_living_units_keep_their_weights_and_revived_ones_get_gradients(pictures):
    network = head().train()
    kept = alive(network, pictures)[0]
    weights = network["head"][0].weight.detach().clone()
    revive(network, pictures)
    assert network.training
    assert torch.equal(network["head"][0].weight[kept], weights[kept])
    assert (network["head"][0].weight[~kept] != weights[~kept]).any(1).all()
    network.eval()["head"](pictures).square().sum().backward()
    assert (network["head"][5].weight.grad[:, ~alive(head(), pictures)[1]] != 0).all()


def test_a_second_time_nothing_is_dead(pictures):
    network = head()
    revive(network, pictures)
    state = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    assert revive(network, pictures) == {"head.1": (0, HIDDEN), "head.4": (0, HIDDEN)}
    assert all(torch.equal(state[name], tensor) for name, tensor in network.state_dict().items())


@pytest.mark.parametrize("style", ["compact", "paper"])
def test_fully_connected_layers_have_a_share_of_the_learning_rate(style):
    network = head()
    settings = Schedule(style=style, fully_connected=0.25)
    optimiser = schedule.make_optimiser(network, settings)
    schedule.set_learning_rate(optimiser, 0.04, 0.5)
    rates = {
        id(parameter): group["lr"]
        for group in optimiser.param_groups
        for parameter in group["params"]
    }
    assert len(rates) == len(list(network.parameters()))
    for name, parameter in network.named_parameters():
        assert rates[id(parameter)] == (0.04 if name.startswith("beside") else 0.01)
    assert all(group["betas"][0] == 0.5 for group in optimiser.param_groups)
    alone = schedule.make_optimiser(network, msgspec.structs.replace(settings, fully_connected=1.0))
    assert len(alone.param_groups) == 1
