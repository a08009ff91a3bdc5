"""`python -m learn.experiments`: the measurements behind the figures in docs/results, each made
again by one command.
"""

import sys

from learn.training.allocator import keep_freed
from manifests.cli import main

COMMANDS = (
    "work-precision",
    "tolerance-check",
    "quadrature-accuracy",
    "latency",
    "cold-start",
    "engine-speed",
    "calibrate-auto",
    "step-profile",
    "layer-ablation",
    "normals-ablation",
    "refinement-ablation",
    "upsampling",
    "exposure",
)

if __name__ == "__main__":
    sys.exit(main("learn.experiments", __doc__.split(": ", 1)[1], COMMANDS, prepare=keep_freed))
