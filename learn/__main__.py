"""`python -m learn`: train networks, edit photographs with them, and compare the two renderers."""

import sys

from learn.commands import prepare
from manifests.cli import main

COMMANDS = (
    "train",
    "predict",
    "app",
    "mask",
    "edit",
    "transfer",
    "agree",
    "evaluate",
    "evaluate-network",
    "evaluate-ladder",
    "train-baselines",
    "join-weights",
)
MOVED = {  # earlier names of commands, and what to type now
    "baselines": "python -m learn train-baselines",
    "bench": "python -m learn.experiments engine-speed",
    "calibrate": "python -m learn.experiments calibrate-auto",
    "card": "python -m learn evaluate-network",
    "chart": "python -m learn.experiments work-precision",
    "enlarging": "python -m learn.experiments upsampling",
    "exposure": "python -m learn.experiments exposure",
    "integral": "python -m learn.experiments quadrature-accuracy",
    "pace": "python -m learn.experiments latency",
    "promise": "python -m learn.experiments tolerance-check",
    "proof": "python -m learn.experiments layer-ablation",
    "refinement": "python -m learn.experiments refinement-ablation",
    "startup": "python -m learn.experiments cold-start",
    "steps": "python -m learn.experiments step-profile",
    "study": "python -m learn.experiments normals-ablation",
}


if __name__ == "__main__":
    sys.exit(main("learn", __doc__.split(": ", 1)[1], COMMANDS, moved=MOVED, prepare=prepare))
