"""`python -m factory`: plan and render datasets, look at them, and keep the assets they are made
of.
"""

import sys

from manifests.cli import main

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
    sys.exit(main("factory", __doc__.split(": ", 1)[1], COMMANDS))
