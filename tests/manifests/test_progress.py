"""Progress bars while the system's clock jumps."""

import io
import re
import time

import pytest

from manifests.progress import tqdm


@pytest.mark.parametrize("by_hand", [False, True])
def test_a_clock_that_jumps_changes_neither_rate_nor_time_left(monkeypatch, by_hand):
    real, offset = time.time, [0.0]
    monkeypatch.setattr(time, "time", lambda: real() + offset[0])
    monkeypatch.setattr("tqdm.std.time", time.time)
    out = io.StringIO()
    if by_hand:
        with tqdm(total=40, file=out, mininterval=0) as bar:
            for number in range(40):
                offset[0] = 86_400.0 * (-1) ** number
                time.sleep(0.01)
                bar.update()
    else:
        for number in tqdm(range(40), file=out, mininterval=0):
            offset[0] = 86_400.0 * (-1) ** number
            time.sleep(0.01)
    shown = out.getvalue().split("\r")[5:]
    assert len(shown) > 20
    for line in shown:
        elapsed, left, rate = re.search(r"\[([^<]*)<([^,]*), *([\d.]+)it/s\]", line).groups()
        assert (elapsed, left) == ("00:00", "00:00") and 5 < float(rate) <= 110, line


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_log_file_is_not_filled_by_a_bar(monkeypatch, is_terminal):
    out = io.StringIO()
    out.isatty = lambda: is_terminal
    monkeypatch.setattr("sys.stderr", out)
    for _ in tqdm(range(30)):
        time.sleep(0.02)
    shown = out.getvalue().split("\r")[1:]
    assert len(shown) > 3 if is_terminal else len(shown) == 2  # at its beginning and its end
