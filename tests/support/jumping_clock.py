"""A wall clock that jumps, for processes that a test or a measurement starts.

jumping_clock.c is compiled and loaded before the C library, so that whatever runs in the processes
(Python, Blender, a library in Rust) sees the shifted time. The system's own clock is not touched.
"""

import os
import shutil
import struct
import subprocess
from pathlib import Path

SOURCE = Path(__file__).with_suffix(".c")
COMPILER = shutil.which("cc") or shutil.which("gcc")


class JumpingClock:
    """A wall clock of its own, at first the system's.

    folder  where the library and the clock's file are written; several clocks may share it
    name    of this clock in the folder
    """

    def __init__(self, folder: Path, name: str = "clock"):
        self._file, library = Path(folder) / name, Path(folder) / "jumping_clock.so"
        if not library.exists():
            words = [COMPILER, "-shared", "-fPIC", "-O1", "-Wall", "-o", library, SOURCE]
            subprocess.run([*words, "-ldl", "-lm"], check=True)
        self.jump(0.0)
        # what a process needs to see this clock
        self.environment = {"LD_PRELOAD": str(library), "JUMPING_CLOCK": str(self._file)}

    def jump(self, seconds: float) -> None:
        """Let the clock be that many seconds ahead of the system's; processes see it at once."""
        descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o600)
        os.pwrite(descriptor, struct.pack("d", seconds), 0)
        os.close(descriptor)
