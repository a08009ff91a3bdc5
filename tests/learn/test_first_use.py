"""The measures of first use and of the converged integral: that they measure what they say."""

import json

import pytest
import torch

from learn.experiments.layer import converged_integrals, first_use


def test_a_start_tells_the_seconds_of_everything_a_program_waits_for(capsys, monkeypatch):
    monkeypatch.setattr(first_use, "SIZE", 64)
    threads = torch.get_num_threads()
    first_use.main("exact", 1)
    torch.set_num_threads(threads)
    report = json.loads(capsys.readouterr().out)
    assert list(report) == [
        "import",
        "picture",
        "derivatives",
        "later picture",
        "later derivatives",
    ]
    assert report["later picture"] > 0.005  # 1,600 pixels × 8,192 texels cannot be summed in less
    assert report["later derivatives"] > 0.005


def test_the_picture_of_a_start_covers_forty_per_cent_and_has_views_if_asked():
    n, material, light, view = first_use.scene(view_per_pixel=True)
    assert (n != 0).any(-1).float().mean().item() == pytest.approx(0.4, abs=1e-3)
    assert material.shape == (1, 108) and light.shape == (1, 64, 128, 3)
    assert (view.norm(dim=-1) - 1).abs().max() < 1e-6
    assert first_use.scene(view_per_pixel=False)[3] is None


def test_quadrature_is_within_a_hundredth_of_the_integral_where_the_sum_is_not():
    """γ = 3e4, a lobe of a quarter of a texel; and at γ = 1, where both are the same sum, both
    are.
    """
    narrow, broad = converged_integrals.compare_lobes(1e-2, 1, gammas=(3e4, 1.0), size=32)
    assert narrow["converged to"] <= 2e-3
    assert narrow["quadrature"]["error"] <= 1e-2 < 0.1 < narrow["exact"]["error"]
    assert broad["quadrature"]["error"] == broad["exact"]["error"] <= 3e-3
