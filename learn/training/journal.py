"""The log of a run: log.jsonl step by step, TensorBoard's events on request, and made.json.

A run that was killed may have logged steps beyond its last checkpoint. It makes them again, so
those lines are dropped first.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from manifests.errors import InputError
from manifests.files import write_json, write_lines
from manifests.inputs import require_file
from manifests.line_files import Lines


class Journal:
    """The figures of one run.

    out          folder of the run; step: at which it continues
    tensorboard  whether events are written as well
    Raises       InputError if TensorBoard is not installed
    """

    def __init__(self, out: str | Path, step: int, tensorboard: bool = False):
        self.path = Path(out) / "log.jsonl"
        self.events: Any = None
        if tensorboard:
            self.events = _writer()(str(Path(out) / "tensorboard"), purge_step=step or None)
        _drop_lines(self.path, step)
        self._lines: Lines | None = None

    def write(self, record: Mapping[str, Any]) -> None:
        """Log one step's figures: {"step": k, name: number, "validation": {name: number}}."""
        self._lines = self._lines or Lines(self.path)
        self._lines.append_line((json.dumps(record) + "\n").encode())
        if self.events:
            for name, value in record.items():
                if isinstance(value, int | float) and name != "step":
                    self.events.add_scalar(f"train/{name}", value, record["step"])
            for name, value in record.get("validation", {}).items():
                self.events.add_scalar(f"validation/{name}", value, record["step"])

    def add_contact_sheet(self, step: int, picture: np.ndarray) -> None:
        """Log a contact sheet (H, W, 3) uint8 as a TensorBoard event, if there are events."""
        if self.events:
            self.events.add_image("sheet", picture, step, dataformats="HWC")

    def write_made(
        self,
        by: Mapping[str, Any],
        sizes: Mapping[str, Mapping[str, int]],
        left_out: int,
        step: int,
        figures: Mapping[str, float],
    ) -> None:
        """Write made.json.

        by        manifests.provenance.provenance of the command that ran last
        sizes     {split: {kind: number}} of what the run learned from
        left_out  number of records, geometry files and materials that were left out
        figures   of the last validation
        """
        report = {
            "made_by": by,
            "sides": sizes,
            "left_out": left_out,
            "step": step,
            "validation": figures,
        }
        write_json(self.path.with_name("made.json"), report)

    def close(self) -> None:
        """Write all events to disk."""
        if self._lines:
            self._lines.close()
        if self.events:
            self.events.close()


def _writer() -> Any:
    """Return TensorBoard's class of writers. Raises InputError if it is not installed."""
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


def _drop_lines(path: Path, step: int) -> None:
    """Drop the lines of steps from `step` on, and an incomplete last one."""
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
