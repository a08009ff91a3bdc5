"""`python -m learn`: check the two renderers against each other, and learn from records."""

import sys

from learn.commands.allocator import keep_freed
from manifests.cli import main

COMMANDS = (
    "agree",
    "bench",
    "chart",
    "promise",
    "pace",
    "startup",
    "integral",
    "calibrate",
    "train",
    "predict",
    "edit",
    "transfer",
    "exposure",
    "enlarging",
    "refinement",
    "proof",
    "study",
    "steps",
    "card",
    "baselines",
    "evaluate",
)

if __name__ == "__main__":
    keep_freed()
    sys.exit(main("learn", __doc__.split(": ", 1)[1], COMMANDS))
