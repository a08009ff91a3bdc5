"""Sets of photographs to which a line of exposures is fitted, by their names."""

import argparse
from pathlib import Path

import pytest

from learn.experiments.photographs import exposure_line
from manifests.errors import InputError


@pytest.mark.parametrize(
    ("fit", "judge"),
    [(["a", "a"], []), (["a"], ["a"]), (["all"], []), (["a"], ["in use"]), (["intervals"], [])],
)
def test_sets_whose_figures_would_replace_each_other_are_refused(fit, judge):
    named = argparse.Namespace(
        fit=[(name, Path("missing")) for name in fit],
        judge=[(name, Path("missing")) for name in judge],
    )
    with pytest.raises(InputError, match="expected sets of different names"):
        exposure_line.measure(named)


def test_a_report_of_another_command_is_refused(tmp_path):
    path = tmp_path / "report.json"
    path.write_text('{"rows": [{"shape": "chair"}]}')
    with pytest.raises(InputError, match="rows of photographs with edits"):
        exposure_line.read_edits(path)
