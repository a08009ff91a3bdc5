"""The filter by which masks follow the edges of a picture."""

import numpy as np

from learn.selection.guided_filter import GuidedFilter


def test_edges_of_a_map_move_to_those_of_the_picture():
    rows, columns = np.mgrid[:96, :128]
    rng = np.random.default_rng(0)
    lab = np.where((columns < 64)[..., None], (40.0, 30, 20), (70.0, -10, 5))
    lab = lab + rng.normal(0, 1, lab.shape)
    teeth = columns < 64 + 3 * np.sign(np.sin(rows))
    assert (teeth != (columns < 64)).mean() > 0.015
    moved = GuidedFilter(lab)(teeth) > 0.5
    assert (moved != (columns < 64)).mean() < 0.002


def test_a_map_keeps_its_edge_where_the_picture_has_none():
    rows, columns = np.mgrid[:96, :128]
    inside = np.hypot(rows - 48, columns - 64) < 30
    flat = GuidedFilter(np.full((96, 128, 3), 50.0))(inside)
    assert ((flat > 0.5) != inside).mean() < 0.005 and flat.dtype == np.float32
