"""What a run writes about itself: log.jsonl step by step, TensorBoard's events when asked, and
made.json in the end.

A run that was killed may have logged steps beyond its last checkpoint; it makes them again, so
those lines are dropped first.
"""

import json
from pathlib import Path

from manifests.errors import InputError
from manifests.files import write_json, write_lines
from manifests.inputs import require_file
from manifests.store import Lines


class Journal:
    """Figures of one run. step: where it goes on; tensorboard: write events as well. Raises
    InputError if TensorBoard is not installed.
    """

    def __init__(self, out, step, tensorboard=False):
        self.path, self.events = Path(out) / "log.jsonl", None
        if tensorboard:
            self.events = _writer()(str(Path(out) / "tensorboard"), purge_step=step or None)
        _forget(self.path, step)
        self._lines = None

    def write(self, record):
        """One step's figures: {"step": k, name: number, "validation": {name: number}}."""
        self._lines = self._lines or Lines(self.path)
        self._lines.append_line((json.dumps(record) + "\n").encode())
        if self.events:
            for name, value in record.items():
                if isinstance(value, int | float) and name != "step":
                    self.events.add_scalar(f"train/{name}", value, record["step"])
            for name, value in record.get("validation", {}).items():
                self.events.add_scalar(f"validation/{name}", value, record["step"])

    def show(self, step, picture):
        """A sheet of pictures (H, W, 3) uint8."""
        if self.events:
            self.events.add_image("sheet", picture, step, dataformats="HWC")

    def made(self, by, sizes, left_out, step, figures):
        """made.json: the command that ran last, its commit and machine, what it learned from, and
        the last validation's figures.
        """
        report = {
            "made_by": by,
            "sides": sizes,
            "left_out": left_out,
            "step": step,
            "validation": figures,
        }
        write_json(self.path.with_name("made.json"), report)

    def close(self):
        """All events on disk."""
        if self._lines:
            self._lines.close()
        if self.events:
            self.events.close()


def _writer():
    try:
        import tensorboard  # noqa: F401 -- torch's own message takes a page
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise InputError(
            "--tensorboard",
            "the package tensorboard",
            "none",
            "pip install tensorboard, or leave the option out",
        ) from None
    return SummaryWriter


def _forget(path, step):
    """Drop lines of steps from `step` on, and a torn last one."""
    if not path.exists():
        return
    require_file(path, "a log of lines", "give another --out")
    kept, whole = [], path.read_bytes()
    for line in whole.splitlines(keepends=True):
        try:
            # of bytes it would take a byte-order mark
            if line.endswith(b"\n") and json.loads(line.decode())["step"] < step:
                kept.append(line)
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    text = b"".join(kept)
    if text != whole:
        write_lines(path, kept)
