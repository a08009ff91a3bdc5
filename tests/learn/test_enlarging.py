"""Ways to bring an edit to the photograph's size, on pictures whose enlargement is known, and the
table that compares them.
"""

import numpy as np
import pytest

from learn.editing import decomposition
from learn.experiments.editing import upsampling_comparison, upsampling_strategies
from learn.layer import predictions
from tests.support.known_ball import NETWORK, SIZE, Knowing, label_of, lit, opened


@pytest.fixture
def edge():
    """A guide with a step between two pixels of the network's, and what has one there too: (guide
    (32, 32), low (8, 8, 1)).
    """
    guide = np.zeros((32, 32))
    guide[:, 14:] = 1.0
    return guide, np.repeat((np.arange(8) >= 4)[None, :, None], 8, 0).astype(np.float64)


def test_a_joint_bilateral_enlargement_steps_where_the_photograph_does(edge):
    guide, low = edge
    result = upsampling_strategies.joint_bilateral(
        low, guide.reshape(8, 4, 8, 4).mean((1, 3)).round(), guide
    )[..., 0]
    assert result[:, :14].max() < 0.05
    assert result[:, 14:].min() > 0.95
    flat = upsampling_strategies.joint_bilateral(low, np.zeros((8, 8)), np.zeros((32, 32)))[..., 0]
    assert 0.2 < flat[16, 15] < 0.8  # without a guide the step is smeared


def test_a_joint_bilateral_enlargement_keeps_a_constant(rng):
    result = upsampling_strategies.joint_bilateral(
        np.full((8, 8, 3), 0.7), rng.random((8, 8)), rng.random((24, 24))
    )
    np.testing.assert_allclose(result, 0.7, rtol=1e-5)


def test_a_guided_enlargement_of_what_is_linear_in_the_guide_is_linear_in_the_photograph(rng):
    guide_low = rng.random((16, 16)).astype(np.float32)
    guide = np.repeat(np.repeat(guide_low, 4, 0), 4, 1)
    result = upsampling_strategies.upsample_guided(
        2.0 * guide_low[..., None] + 0.5, guide_low, guide
    )
    # FLAT against a variance of 1/12
    assert np.abs(result[..., 0] - (2.0 * guide + 0.5)).max() < 0.06
    still = upsampling_strategies.upsample_guided(
        np.full((16, 16, 1), 0.3, np.float32), guide_low, guide
    )
    np.testing.assert_allclose(still, 0.3, atol=1e-5)


def test_every_way_paints_a_smooth_object_alike_and_one_render_serves_all_details(monkeypatch):
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 0.5)
    result = decomposition.decompose(
        opened(radiance, inside.astype(np.int64), 2.0), Knowing(label), NETWORK
    )
    ways = upsampling_strategies.painters(result)
    rendered, render = [], predictions.render
    monkeypatch.setattr(
        predictions, "render", lambda *a, **k: rendered.append(a) or render(*a, **k)
    )
    edits = {name: painter.edit([result.label[0]]) for name, painter in ways.items()}
    # in use and its details together once, three at the network's size, normals once
    assert len(rendered) == 5
    # of 30: at the rim ways differ by right
    core = np.hypot(*(np.indices((SIZE, SIZE)) - SIZE / 2 + 0.5)) < 22
    for name, picture in edits.items():
        assert picture.shape == radiance.shape
        np.testing.assert_allclose(picture[core], radiance[core], rtol=0.06, err_msg=name)


def test_the_table_compares_with_the_way_in_use_on_the_same_edits():
    def ways(l2):
        return {"normals enlarged": {"l2": 100.0, "ssim": 0.8}, "detail 1": {"l2": l2, "ssim": 0.7}}

    rows = [
        {"edit": "e", "shape": shape, "material": "m", "ours": ways(110.0), "true": ways(50.0)}
        for shape in "abc"
    ]
    report = upsampling_comparison.summary(rows)
    assert report["ours"]["detail 1"]["l2_ratio"] == pytest.approx([1.1] * 3)
    assert report["true"]["detail 1"]["l2_ratio"] == pytest.approx([0.5] * 3)
    assert report["true"]["detail 1"]["ssim_gain"] == pytest.approx([-0.1] * 3)


def test_the_truth_itself_has_no_error(rng):
    picture, mask = rng.random((20, 20, 3)), np.ones((20, 20), bool)
    assert upsampling_comparison.compare_pictures(picture, picture, mask) == {
        "l2": 0,
        "ssim": pytest.approx(1),
    }
    assert upsampling_comparison.compare_pictures(picture * 0.5, picture, mask)["l2"] > 100
