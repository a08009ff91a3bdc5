"""Two weights on the same edits: which figures of an evaluation are paired, and their names."""

import argparse
import json

import pytest

from learn.experiments.editing import compare_weights
from manifests.errors import InputError

LINE = {"category": "ball", "viewpoint": 0, "rotation_texels": 0, "split": "test"}


def written(folder, factor, edits=("a", "b", "c")):
    """Write an evaluation's lines, whose errors are `factor` times the same ones."""
    folder.mkdir(parents=True)
    lines = {"edits.jsonl": [], "pictures.jsonl": []}
    for k, name in enumerate(edits, 1):
        line = LINE | {"id": name, "shape": f"s{name}", "light": "sky", "materials": ["red-fabric"]}
        figures = {"l2": 100.0 * k * factor, "l2_frame": 1.0, "psnr": 1.0, "flip": 1.0}
        figures |= {"ssim": 1.0, "ssim_frame": 1.0, "l2_one_factor": 10.0 * k * factor}
        target = "brass" if k == 1 else "red-fabric"
        edit = {"source": name, "truth": name, "several": False, "wanted": [target, target]}
        edit |= {"methods": {"ours": figures}, "layer": dict.fromkeys(("l2_inner", "node_fit"))}
        edit["layer"]["l2"] = 1.0
        lines["edits.jsonl"].append(line | edit)
        parts = {"normals": {"mean_deg": k * factor}, "light": {"irradiance": None}}
        lines["pictures.jsonl"].append(line | {"methods": {"ours": parts}})
    for name, rows in lines.items():
        (folder / name).write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_edits_and_pictures_of_both_evaluations_are_paired_by_their_ids(tmp_path):
    before = written(tmp_path / "general", 1.0)
    after = written(tmp_path / "special", 0.5, ("a", "b"))
    report = compare_weights.measure(argparse.Namespace(before=before, after=after))
    rows = {(row["set"], row["figure"]): row for row in report["rows"]}
    assert {key: row["count"] for key, row in rows.items()} == {
        ("all, predicted", compare_weights.EDIT): 2,
        ("all, predicted", compare_weights.ONE_FACTOR): 2,
        ("edits into metals, predicted", compare_weights.EDIT): 1,
        ("edits into metals, predicted", compare_weights.ONE_FACTOR): 1,
        ("edits into others, predicted", compare_weights.EDIT): 1,
        ("edits into others, predicted", compare_weights.ONE_FACTOR): 1,
        ("all, predicted", "normals, °"): 2,
    }
    row = rows["all, predicted", compare_weights.EDIT]
    assert (row["before"], row["after"]) == (150, 75)
    assert row["ratio"] == pytest.approx([0.5] * 3)
    assert "| general | special | ratio |" in compare_weights.tables(report)


def test_folders_of_one_name_are_named_with_their_parents(tmp_path):
    folders = [written(tmp_path / name / "evaluation", 1.0) for name in ("old", "new")]
    report = compare_weights.measure(argparse.Namespace(before=folders[0], after=folders[1]))
    assert (report["before"], report["after"]) == ("old/evaluation", "new/evaluation")


def test_evaluations_of_other_pictures_and_other_folders_are_refused(tmp_path):
    before, after = written(tmp_path / "x", 1.0), written(tmp_path / "y", 1.0, ("d",))
    with pytest.raises(InputError, match="measure the same pictures by both"):
        compare_weights.measure(argparse.Namespace(before=before, after=after))
    with pytest.raises(InputError, match=r"edits\.jsonl or lines\.jsonl"):
        compare_weights.measure(argparse.Namespace(before=before, after=tmp_path))


def test_lines_of_another_command_are_refused(tmp_path):
    (tmp_path / "lines.jsonl").write_text('{"id": "a", "other": 1}\n')
    with pytest.raises(InputError, match="expected lines of evaluate-ladder"):
        compare_weights.measure(argparse.Namespace(before=tmp_path, after=tmp_path))
