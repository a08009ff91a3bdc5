"""Labels that a run makes and the patterns it prints: what is rendered is what the batch says."""

import msgspec
import numpy as np
import pytest
import torch

from learn.data import lights, patterns, settings, shadows
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.label_augmentation import LabelAugmentation, in_order, principled_label
from learn.data.relit import BRIGHTEST, RelitDataset
from learn.data.settings import Data, Run
from learn.layer import render
from manifests.errors import InputError
from manifests.materials import load_catalogue
from tests.support import synthetic

SIZE = 32
PLAIN = Data(sharing=2, photograph=False)
NAMES = ("teflon", "gold-metallic-paint", "nickel", "orange-paint", "black-obsidian", "pvc")


@pytest.fixture(scope="module")
def data_split(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    synthetic.write_dataset(
        folder, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="sphere"
    )
    geometry, catalogue = Geometry(folder, progress=False), load_catalogue()
    labels = {
        name: catalogue[name].label.reshape(-1).astype(np.float32)
        for name in NAMES
        if name in catalogue
    }
    maps = [lights.draw_computed(np.random.default_rng(2)).astype(np.float32) for _ in range(2)]
    return DataSplit(geometry, np.arange(len(geometry)), labels, maps, "train")


def with_keys(**keys):
    return msgspec.structs.replace(PLAIN, **keys)


def fields(batch):
    return {
        key: getattr(batch, key)
        for key in ("image", "mask", "n", "segments", "label", "light", "target_label")
    }


def relit(batch):
    """The pictures that the layer makes of a batch's truth, one group of two after another."""
    pictures = []
    for i in range(0, len(batch.n), PLAIN.sharing):
        n = batch.n[i : i + PLAIN.sharing].movedim(1, -1).contiguous()
        light = batch.light[i].movedim(0, -1).contiguous().expand(len(n), -1, -1, -1)
        material = batch.label[i].exp().expand(len(n), -1)
        pictures.append(
            render(n, material, light, tolerance=PLAIN.tolerance, elevation=batch.elevation)
        )
    return torch.cat(pictures).clamp(0, BRIGHTEST).movedim(-1, 1)


@pytest.mark.parametrize("kind", ["label_mixtures", "scaled_lobes", "principled"])
def test_the_picture_is_rendered_from_the_label_that_the_batch_states(kind, data_split):
    source = RelitDataset(data_split, with_keys(**{kind: 1.0, "principled_materials": 2}), 4, 32, 5)
    batch = source[0]
    start = {"label_mixtures": "mixture", "scaled_lobes": "scaled", "principled": "principled"}[
        kind
    ]
    assert all(name.split(" ")[-1].startswith(start) for name in batch.names)
    torch.testing.assert_close(batch.image, relit(batch) * batch.mask, rtol=1e-5, atol=1e-6)
    known = {label.tobytes() for label in data_split.labels.values()}
    assert not known & {label.numpy().tobytes() for label in batch.label[:, 0]}


@pytest.mark.parametrize("kind", ["label_mixtures", "scaled_lobes", "principled"])
def test_drawn_labels_lie_in_the_range_of_the_training_labels_and_in_order(kind, data_split):
    source = LabelAugmentation(
        data_split.labels, with_keys(**{kind: 1, "principled_materials": 3}), 1
    )
    known = np.stack(list(data_split.labels.values())).reshape(-1, 36)
    rng, names = np.random.default_rng(3), sorted(data_split.labels)
    for i in range(60):
        name = names[i % len(names)]
        _, label = source.draw(rng, name, data_split.labels[name], names)
        channels = label.reshape(3, 36)
        assert label.dtype == np.float32
        assert (channels >= known.min(0)).all()
        assert (channels <= known.max(0)).all()
        assert in_order(label)


def test_a_runs_principled_materials_follow_from_its_seed():
    first = principled_label(4, 0).copy()
    principled_label.cache_clear()
    assert (principled_label(4, 0) == first).all()
    assert (principled_label(4, 1) != first).any()
    assert (principled_label(5, 0) != first).any()


def test_materials_come_in_the_shares_that_a_run_asks_for(data_split):
    data = with_keys(label_mixtures=0.5, scaled_lobes=0.2)
    source = LabelAugmentation(data_split.labels, data, 1)
    rng, name = np.random.default_rng(0), sorted(data_split.labels)[0]
    drawn = [
        source.draw(rng, name, data_split.labels[name], sorted(data_split.labels))[0]
        for _ in range(500)
    ]
    shares = [sum(each.startswith(kind) for each in drawn) / 500 for kind in ("mixture", "scaled")]
    assert shares == pytest.approx([0.5, 0.2], abs=0.07)  # three standard deviations
    assert name in drawn


def test_shares_beyond_one_are_refused():
    run = Run(name="x", data=with_keys(label_mixtures=0.6, principled=0.6))
    with pytest.raises(InputError, match=r"at most 1 together, found 1\.2"):
        settings.require_trainable(run, "run")


@pytest.mark.parametrize(
    "keys", [{}, {"patterns": 1e-12}, {"label_mixtures": 1e-12}, {"deformations": 1e-12}]
)
def test_pictures_without_them_are_those_of_a_run_that_has_no_such_keys(keys, data_split):
    plain, other = (
        RelitDataset(data_split, data, 4, SIZE, 5)[7]
        for data in (with_keys(photograph=True), with_keys(photograph=True, **keys))
    )
    assert all(torch.equal(value, fields(other)[key]) for key, value in fields(plain).items())


def test_a_pattern_changes_the_picture_and_nothing_of_its_truth(data_split):
    plain = RelitDataset(data_split, PLAIN, 8, SIZE, 5)[0]
    source = RelitDataset(data_split, with_keys(patterns=1.0), 8, SIZE, 5)
    batch, again = source[0], source[0]
    assert torch.equal(batch.image, again.image)
    for key, value in fields(plain).items():
        assert torch.equal(value, fields(batch)[key]) == (key != "image")
    changed = (batch.image != plain.image).any(1) & (batch.segments > 0)
    share = changed.sum((1, 2)) / (batch.segments > 0).sum((1, 2))
    assert (share > 0).float().mean() > 0.7
    assert batch.image.isfinite().all()
    assert batch.image.min() >= 0


def test_deformed_geometry_is_what_the_picture_shows(data_split):
    plain = RelitDataset(data_split, PLAIN, 8, SIZE, 5)[0]
    source = RelitDataset(data_split, with_keys(deformations=1.0), 8, SIZE, 5)
    batch, again = source[0], source[0]
    assert torch.equal(batch.n, again.n)
    assert all((a != b).any() for a, b in zip(batch.n, plain.n, strict=True))
    assert torch.equal(batch.label, plain.label) and torch.equal(batch.light, plain.light)
    assert torch.equal(batch.segments > 0, batch.mask[:, 0] > 0)
    assert torch.equal(batch.segments > 0, batch.n.norm(dim=1) > 0.5)
    shown, mask = relit(batch), batch.mask > 0
    assert torch.equal(torch.where(mask, shown, 0), batch.image)


def test_shadows_of_deformed_pictures_are_computed_from_the_deformed_depth(data_split, monkeypatch):
    shown = []

    def recorded(n, position, view, segments, *others):
        shown.append((n, position, view, segments))
        return factor(n, position, view, segments, *others)

    factor = shadows.shadow_factor
    monkeypatch.setattr(shadows, "shadow_factor", recorded)
    geometry = Geometry(data_split.geometry.folder, progress=False, depth=True)
    of_train = DataSplit(geometry, data_split.views, data_split.labels, data_split.maps, "train")
    RelitDataset(of_train, with_keys(deformations=1.0, shadows=1.0), 4, SIZE, 5)[0]
    assert len(shown) == 4
    for n, position, view, segments in shown:
        assert (np.linalg.norm(n[segments > 0], axis=-1) > 0.5).all()
        assert not position[segments == 0, 2].any() and (position[segments > 0, 2] != 0).all()
        assert (view == (0, 0, 1)).all()


def test_patterns_come_in_the_share_that_a_run_asks_for_and_in_training_alone(data_split):
    data = with_keys(patterns=0.5)
    plain = RelitDataset(data_split, PLAIN, 16, SIZE, 5)
    source = RelitDataset(data_split, data, 16, SIZE, 5)
    batches = [(source[k].image, plain[k].image) for k in range(4)]
    changed = [
        not torch.equal(printed[i : i + 2], bare[i : i + 2])
        for printed, bare in batches
        for i in range(0, 16, 2)
    ]
    assert 0.2 < np.mean(changed) < 0.8  # 32 groups: more than three standard deviations
    test = DataSplit(
        data_split.geometry, data_split.views, data_split.labels, data_split.maps, "test"
    )
    assert RelitDataset(test, data, 4, SIZE, 5).printed == 0


@pytest.mark.parametrize("pattern", patterns.PATTERNS)
def test_weights_of_inks_add_up_to_at_most_one_and_leave_base(pattern, data_split, monkeypatch):
    monkeypatch.setattr(patterns, "PATTERNS", (pattern,))
    n = torch.from_numpy(data_split.geometry.normals(0))[None]
    segments = torch.from_numpy(data_split.geometry.segments(0))[None]
    points, mask = patterns.surface_points(n, segments)[0], segments[0].numpy() > 0
    for seed in range(12):
        weights = patterns.draw_pattern(np.random.default_rng(seed), points, n[0].numpy(), mask)
        assert weights.min() >= 0
        assert weights.sum(0).max() <= 1 + 1e-5
        assert not weights[:, ~mask].any()
        assert weights.sum(0)[mask].mean() <= 1 - patterns.LEAST_BASE + 1e-4


def test_the_integrated_depth_of_a_sphere_is_round(data_split):
    n = torch.from_numpy(data_split.geometry.normals(0))[None]
    segments = torch.from_numpy(data_split.geometry.segments(0))[None]
    points, inner = patterns.surface_points(n, segments)[0], n[0, ..., 2].numpy() > 0.5
    r = np.corrcoef(points[inner][:, 2], n[0].numpy()[inner][:, 2])[0, 1]
    assert r > 0.98  # z of a sphere's point is n_z


def test_inks_that_cover_nearly_everything_are_thinned(data_split, monkeypatch):
    def everywhere(rng, uv, mask):
        return [np.full(mask.shape, 0.3)] * 3

    monkeypatch.setattr(patterns, "PATTERNS", (everywhere,))
    monkeypatch.setattr(patterns, "PARTIAL", 0)
    n = torch.from_numpy(data_split.geometry.normals(0))[None]
    segments = torch.from_numpy(data_split.geometry.segments(0))[None]
    points, mask = patterns.surface_points(n, segments)[0], segments[0].numpy() > 0
    for seed in range(4):
        weights = patterns.draw_pattern(np.random.default_rng(seed), points, n[0].numpy(), mask)
        assert weights.sum(0)[mask].mean() <= 1 - patterns.LEAST_BASE + 1e-4
