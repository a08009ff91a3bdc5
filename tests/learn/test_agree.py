"""`learn agree` on datasets whose truth is known: what it measures is what was put in."""

import json
import re
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from learn.__main__ import COMMANDS
from learn.agreement import causes, report, surface
from manifests import materials as catalogue
from manifests.cli import main
from shaders.envmap import directions
from shaders.frames import camera_from_light
from shaders.mixture import Mixture
from tests.support import synthetic


@pytest.fixture
def folder(tmp_path, rng):
    """Pictures of the layer itself with noise; the catalogue states a node fit of .1, which the
    noise's mean stays far below.
    """
    synthetic.write_dataset(
        tmp_path / "data", [synthetic.matte(node_fit=0.1)], rng, size=32, noise=0.02
    )
    return tmp_path / "data"


def agree(folder, *arguments):
    status = main(
        "learn",
        "",
        COMMANDS,
        ["agree", str(folder), "--out", str(folder.parent / "report"), *arguments],
    )
    return status, folder.parent / "report"


def test_pictures_of_the_layer_itself_agree_up_to_their_noise(folder):
    status, out = agree(folder)
    read = json.loads((out / "report.json").read_text())
    head, causes = read["summary"]["direct"], read["summary"]["causes"]
    assert status == 0 and head["conditions"] == 2
    noise = read["summary"]["all"]["noise"]
    # 2 % of a display value, where the sRGB curve's exponent is about 1/2.4: (0.02 · 150 / 2.2)² =
    # 1.9, up to twice that in bright parts
    assert 0.5 < noise < 8
    # net: products of independent noises over 750 pixels × 3 channels × 2 pictures scatter by
    # noise/√4500 = 1.5 % of it; clipping adds some
    assert abs(head["net"]) < 0.1 * noise
    assert causes["node_fit"] < 1e-6  # the matte mixture is the label's own closed form
    assert abs(causes["look_up_texels"]["median"]) < 0.5


def test_a_turned_light_is_found_and_told_from_other_causes(tmp_path, rng):
    """The record says 3 texels, the picture was made with 2: the layer sees the light one texel too
    far.
    """
    store = synthetic.write_dataset(
        tmp_path / "data", [synthetic.matte()], rng, size=32, noise=0.001, rotations=(2,)
    )
    synthetic.rename(store, lambda record: msgspec.structs.replace(record, rotation_texels=3))
    _, out = agree(tmp_path / "data")
    causes = json.loads((out / "report.json").read_text())["conditions"][0]["causes"]
    # linear in the turn, over a map of independent texels
    assert causes["look_up_texels"] == pytest.approx(-1.0, abs=0.15)
    assert causes["net"] > causes["noise"] and causes["node_fit"] < 1e-6


def test_taps_are_added_until_small_lamps_are_seen_alike(rng, monkeypatch):
    """Brass under one lamp of two texels: a few taps miss it, as many as are taken by themselves do
    not.
    """
    monkeypatch.setattr(causes, "SAMPLE_COUNTS", (16, 64, 256, 1024, 4096))
    brass = catalogue.load_catalogue()["brass"]
    light = torch.full((64, 128, 3), 0.02)
    light[20, 30:32] = 900.0
    sample, m = (
        SimpleNamespace(light=light, camera_from_light=camera_from_light(0.35)),
        torch.from_numpy(brass.m).double().reshape(3, 3, 2, 6),
    )
    lamp = torch.from_numpy(directions(64, 128)[0][20, 30] @ camera_from_light(0.35).T)
    view = torch.tensor([[0.0, 0.0, 1.0]]).double().expand(4, 3)
    n = torch.nn.functional.normalize(
        lamp + view[0] + 0.1 * torch.from_numpy(rng.standard_normal((4, 3))), dim=-1
    )

    def by(count):
        return causes.sum_difference(
            *causes.lobe_samples(sample, m, count), m, brass.mixture, n, view
        )

    true = by(65536)

    def off(result):
        return np.square(result - true).sum() / np.square(true).sum()

    # 0.0005 where a tap sees the mean of what it stands for, 0.22 where it sees one texel
    assert off(by(1024)) < 0.01
    assert causes.narrow(m) and off(by(64)) > 10 * causes.LARGEST_CHANGE**2
    # the last step's error is below what moved in it
    assert (
        off(causes.converged_difference(sample, m, brass.mixture, n, view))
        < causes.LARGEST_CHANGE**2
    )


def test_nodes_that_are_not_the_label_show_as_node_fit(tmp_path, rng):
    """The label reflects 0.4, nodes and picture 0.36."""
    label, nodes = synthetic.matte("grey", albedo=0.4), synthetic.matte("grey", albedo=0.36)
    mixed = synthetic.entry(
        "grey", np.exp(np.asarray(label.label)).reshape(3, 3, 2, 6), Mixture.lambert([0.36] * 3)
    )
    store = synthetic.write_dataset(
        tmp_path / "data", [nodes], rng, size=32, noise=0.001, rotations=(0,)
    )
    synthetic.exchange(store, mixed)
    _, out = agree(tmp_path / "data")
    row = json.loads((out / "report.json").read_text())["conditions"][0]
    # the noise of 750 pixels: 0.001
    assert row["signed"] == pytest.approx(0.4 / 0.36 - 1, abs=2e-3)
    assert row["causes"]["node_fit"] == pytest.approx(row["causes"]["net"], rel=0.02)
    assert row["causes"]["rest"] < 0.01 * row["causes"]["node_fit"]


def test_renderers_that_agree_within_the_limit_end_with_status_0(folder, capsys):
    status, out = agree(folder)
    head = json.loads((out / "report.json").read_text())["summary"]["direct"]
    printed = capsys.readouterr().out
    assert head["holds"] is True and "within the limit" in printed
    stated = re.search(r"± (\S+) \(limit 0\.15", printed)
    assert stated and float(stated[1]) == pytest.approx(head["like_net_error"], rel=0.05)
    assert printed.splitlines()[0] in (out / "report.md").read_text()
    assert status == 0


def test_renderers_that_disagree_beyond_the_limit_end_with_status_3_and_a_whole_report(
    tmp_path, rng, capsys
):
    """Cycles' stand-in renders an albedo of .36 where the label says .4: some hundred times the
    stated node fit.
    """
    data = tmp_path / "data"
    store = synthetic.write_dataset(
        data, [synthetic.matte("grey", 0.36)], rng, size=32, noise=0.001
    )
    synthetic.exchange(store, synthetic.matte("grey", 0.4, node_fit=0.1))
    status, out = agree(data)
    head = json.loads((out / "report.json").read_text())["summary"]["direct"]
    assert head["holds"] is False and head["like_net"] > 100 * head["limit"] * head["node_fit"]
    assert "beyond the limit" in capsys.readouterr().out and (out / "index.html").exists()
    assert status == 3


def test_one_seed_leaves_noise_unknown_and_says_so(tmp_path, rng, capsys):
    synthetic.write_dataset(
        tmp_path / "data", [synthetic.matte()], rng, size=16, seeds=1, rotations=(0,)
    )
    status, out = agree(tmp_path / "data")
    assert status == 0 and "repeats = 2" in capsys.readouterr().out
    assert json.loads((out / "report.json").read_text())["conditions"][0]["noise"] is None


def test_the_page_stands_alone(folder):
    _, out = agree(folder, "--limit", "2")
    text = (out / "index.html").read_text()
    assert "http" not in text and text.count("data:image/png;base64,") >= 4
    assert (out / "report.md").read_text().startswith("# Agreement")


def test_a_folder_without_a_dataset_is_one_line(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    status, _ = agree(tmp_path / "empty")
    assert (
        status == 1 and "expected a data set (dataset.json), found none" in capsys.readouterr().err
    )


def test_limit_keeps_whole_scenes():
    class Condition:
        def __init__(self, count):
            self.records = [None] * count

    groups = [[Condition(2), Condition(2)] for _ in range(10)]
    kept = report.limit_scenes(groups, 9)
    assert len(kept) == 2 and all(group in groups for group in kept)
    assert len(report.limit_scenes(groups, 1)) == 1


def test_inner_pixels_leave_out_silhouette_creases_and_steps():
    n, segments, depth = np.zeros((7, 9, 3)), np.ones((7, 9), int), np.zeros((7, 9))
    n[..., 2] = 1
    segments[0] = 0
    n[:, 4:] = [np.sin(0.5), 0, np.cos(0.5)]
    depth[4:, :4] = 5.0
    inner = surface.inner(n, segments, depth, pixel=0.1)
    expected = np.zeros((7, 9), bool)
    expected[2:3, 1:3] = expected[5:6, 1:3] = expected[2:6, 5:8] = True
    np.testing.assert_array_equal(inner, expected)


def test_highlight_width_follows_the_exponent():
    m = np.full((3, 3, 2, 6), 1e-9)
    m[:, 0, 0], m[:, 0, 1] = 1e-3, 1000.0  # κ small: f = κ cos^γ, half at cos θ = 2^(−1/γ)
    expected = np.degrees(np.arccos(0.5 ** (1 / 1000)))
    # the grid's steps are 2.4 %
    assert surface.highlight_half_width(m.reshape(-1)) == pytest.approx(expected, rel=0.03)
    assert surface.width_name(expected) == "sharp, 1–4°"
