"""What `plan` says for a cluster: workers, hours, core-hours, cost and disk space."""

from dataclasses import replace

import pytest

from brdfactory.command_line import run
from factory.execution.forecast import Forecast, forecast_cluster

MEASURED = Forecast(
    seconds={"picture": 1500.0, "shape": 100.0},
    bytes={"images": 2e9, "records": 1e6},
    workers=1,
    start=36.0,
)


def test_work_is_divided_among_all_cores_and_the_start_is_paid_for():
    cluster = forecast_cluster(MEASURED, 4, 10, 1600)
    assert cluster.hours == pytest.approx((40 * 1.0 + 36) / 3600)
    assert cluster.core_hours == pytest.approx(40 * cluster.hours)


def test_a_worker_makes_whole_pictures_so_that_too_many_workers_do_not_help():
    assert (
        forecast_cluster(MEASURED, 1, 1599, 1600).hours
        > forecast_cluster(MEASURED, 1, 1600, 1600).hours
    )
    at_most = forecast_cluster(MEASURED, 1, 1600, 1600)
    assert forecast_cluster(MEASURED, 100, 1600, 1600).hours == at_most.hours


@pytest.fixture
def forecast(monkeypatch):
    """`plan` without Blender; the RunOptions that it probed with."""
    given = []
    monkeypatch.setattr(
        "factory.execution.forecast.probe",
        lambda plan, options: given.append(options) or MEASURED,
    )
    return given


def test_the_command_says_hours_disk_and_money(forecast, capsys):
    words = ["plan", "smallest", "--machines", "2", "--cores", "4"]
    assert run([*words, "--price", "0.5"]) == 0
    text = capsys.readouterr().out
    assert "cluster    2 machines of 4 cores: 8 workers of one thread" in text
    # 16 pictures, 2 for each worker, and 36 s: 236 s of 8 cores
    assert "time       about 4 min" in text
    assert "cost       about 0.524 core-hours: 0.262 at 0.5 per core-hour" in text
    assert "disk       about 2.0 GB" in text and "idle" not in text
    assert forecast[0].threads == 1 and "busy" not in text
    assert run(["plan", "smallest", "--machines", "1000", "--cores", "100"]) == 0
    text = capsys.readouterr().out
    assert "idle       99984 of the workers: there are 16 to make" in text
    assert "core-hours (--price P gives the money)" in text


@pytest.mark.parametrize(
    ("computed", "load", "is_said"),
    [(400.0, 9.0, True), (1500.0, 9.0, False), (400.0, 0.5, False), (None, 9.0, False)],
)
def test_a_busy_machine_is_said(monkeypatch, capsys, computed, load, is_said):
    """Of little computation on an idle machine, a GPU is the reason."""
    measured = replace(MEASURED, computed=computed)
    monkeypatch.setattr("factory.execution.forecast.probe", lambda plan, options: measured)
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("manifests.subprocesses.processors", lambda: 2)
    assert run(["plan", "smallest", "--machines", "2", "--cores", "4"]) == 0
    text = capsys.readouterr().out
    assert ("take 4.0 times as long as they compute" in text) == is_said == ("busy" in text)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--price", "1"], "plan --price: expected --machines N"),
        (["--cores", "2"], "plan --cores: expected --machines N"),
        (["--machines", "2", "--workers", "3"], "expected no --workers"),
        (["--machines", "2", "--no-probe"], "expected no --no-probe"),
    ],
)
def test_options_that_do_not_fit_together_are_refused(forecast, capsys, words, message):
    assert run(["plan", "smallest", *words]) == 1
    assert message in capsys.readouterr().err
    assert not forecast
