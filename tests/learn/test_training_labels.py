"""Refinement's material directions: of the materials that the weights were trained on."""

import numpy as np
import pytest
import torch

from learn.networks import weights
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.refinement.coordinates import MaterialCoordinates, principal_directions
from manifests.errors import InputError


def written(path, labels):
    network = Compact(Ranges(torch.zeros(108), torch.ones(108)))
    weights.save_weights(path, network, network.state_dict(), "{}", 32, labels=labels)
    return path


def test_weights_hold_the_labels_of_a_data_sets_materials_bit_by_bit(tmp_path, rng):
    labels = rng.normal(0, 1, (3, 108)).astype(np.float32)
    network, _ = weights.load_network(written(tmp_path / "w.safetensors", labels))
    assert np.array_equal(network.training_labels, labels)


def test_weights_without_labels_stand_for_the_built_in_materials(tmp_path):
    network, _ = weights.load_network(written(tmp_path / "w.safetensors", None))
    assert network.training_labels is None
    assert np.array_equal(principal_directions(network.training_labels), principal_directions())


def test_directions_of_given_labels_span_these_labels_alone(rng):
    labels = rng.normal(0, 1, (3, 108))
    directions = principal_directions(labels)
    basis = np.linalg.svd(directions, full_matrices=False)[2]
    centred = labels - np.mean(
        [labels.reshape(-1, 3, 36)[:, [c]] for c in range(3)], (0, 1)
    ).repeat(3, 0).reshape(108)
    np.testing.assert_allclose(centred @ basis.T @ basis, centred, atol=1e-9)
    assert len(directions) < len(principal_directions())
    z = torch.zeros(1, len(directions), dtype=torch.float64)
    label = torch.zeros(1, 1, 108)
    assert torch.equal(MaterialCoordinates(label, directions)(z), label.double())


def test_labels_that_do_not_vary_stand_for_the_built_in_materials():
    grey = np.zeros((2, 108))
    assert np.array_equal(principal_directions(grey), principal_directions())


@pytest.mark.parametrize("labels", [np.full((1, 108), 1e3), np.zeros((2, 107)), np.zeros((0, 108))])
def test_labels_that_no_material_has_are_refused(tmp_path, labels):
    with pytest.raises(InputError, match="training_labels"):
        weights.load_network(written(tmp_path / "w.safetensors", labels))
