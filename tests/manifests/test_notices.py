"""Lines of spawned processes begin with the program that was typed, as those of their parent do."""

import subprocess
import sys

import pytest

from manifests.subprocesses import environment

PARENT = """
import multiprocessing, subprocess, sys
from manifests.notices import notice, set_program
from manifests.subprocesses import command_of, environment

if __name__ == "__main__":
    for name in NAMES:
        set_program(name)
    notice("here")
    child = multiprocessing.get_context("spawn").Process(target=notice, args=("spawned",))
    child.start()
    child.join()
    code = "from manifests.notices import notice; notice('a command')"
    subprocess.run([sys.executable, "-P", "-c", code], env=environment(), check=True)
"""


@pytest.mark.parametrize(
    ("names", "program"),
    [((), "brdfactory"), (("learn",), "learn"), (("learn", "factory"), "factory")],
)
def test_lines_of_spawned_processes_begin_with_the_program_that_was_typed(names, program, tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT.replace("NAMES", repr(names)))
    variables = {k: v for k, v in environment().items() if k != "BRDFACTORY_PROGRAM"}
    done = subprocess.run(
        [sys.executable, str(script)], env=variables, capture_output=True, text=True, check=True
    )
    assert done.stderr.splitlines() == [
        f"{program}: here",
        f"{program}: spawned",
        f"{program}: a command",
    ]
