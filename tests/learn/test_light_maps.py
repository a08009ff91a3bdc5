"""Layers for light maps treat all azimuths alike, and continue a map across its poles."""

import torch

from learn.networks.light_maps import MapConvolution, enlarge, pad

MAP = torch.rand(2, 3, 4, 8, generator=torch.Generator().manual_seed(3))


def test_a_turned_map_gives_turned_features() -> None:
    """A convolution, and an enlarged map, turn with the map."""
    torch.manual_seed(1)
    convolution = MapConvolution(3, 5)
    for columns in (1, 3, 7):
        turned = MAP.roll(columns, -1)
        torch.testing.assert_close(convolution(turned), convolution(MAP).roll(columns, -1))
        torch.testing.assert_close(enlarge(turned), enlarge(MAP).roll(2 * columns, -1))


def test_padding_continues_across_the_poles() -> None:
    """The texel beyond the pole is the one next to the pole on the other side of the circle."""
    x = pad(MAP)
    assert x.shape == (2, 3, 6, 10)
    for column in range(8):
        torch.testing.assert_close(x[:, :, 0, 1 + column], MAP[:, :, 0, (column + 4) % 8])
        torch.testing.assert_close(x[:, :, 5, 1 + column], MAP[:, :, 3, (column + 4) % 8])
    torch.testing.assert_close(x[:, :, 1:5, 0], MAP[..., 7])
    torch.testing.assert_close(x[:, :, 1:5, 9], MAP[..., 0])


def test_a_constant_map_stays_constant() -> None:
    """There is no dark frame: features of a constant map are the same at all texels."""
    torch.manual_seed(1)
    features = MapConvolution(3, 5)(enlarge(torch.ones(1, 3, 4, 8)))
    torch.testing.assert_close(features, features[:, :, :1, :1].expand_as(features))


def test_enlarging_interpolates() -> None:
    """A texel inside the map is nine sixteenths of its parent, the rest of the neighbours."""
    x = torch.zeros(1, 1, 4, 8)
    x[0, 0, 1, 2] = 16.0
    result = enlarge(x)[0, 0]
    assert result.shape == (8, 16)
    expected = torch.tensor([1.0, 3.0, 3.0, 1.0])
    torch.testing.assert_close(result[1:5, 3:7], expected[:, None] * expected)
    assert result.sum() == 64.0
