"""`python -m factory`: plan and render data sets, look at them, and manage their assets."""

import sys

from manifests.cli import main

DESCRIPTION = (
    "Plans, renders, checks and exports data sets, and manages the materials, shapes and lights"
    " that they use."
)
COMMANDS = (
    "plan",
    "render",
    "status",
    "verify",
    "preview",
    "export",
    "materials",
    "shapes",
    "lights",
)

if __name__ == "__main__":
    sys.exit(main("factory", DESCRIPTION, COMMANDS))
