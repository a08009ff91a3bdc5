"""The command line of `factory` with the fake studio, as a process that can be killed.

python -m tests.support.fake_command render JOB --out OUT …
"""

import sys
from functools import partial

from factory.__main__ import COMMANDS, DESCRIPTION
from factory.execution import run
from manifests.cli import main
from tests.support.tetrahedron import FAKE

if __name__ == "__main__":
    run.RunOptions = partial(run.RunOptions, studio=FAKE)
    sys.exit(main("factory", DESCRIPTION, COMMANDS))
