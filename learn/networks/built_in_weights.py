"""Weights that come with the program, by their names. Nothing here imports torch."""

from pathlib import Path

FOLDER = Path(__file__).parents[1] / "weights"
EDITING = FOLDER / "general-compact.safetensors"  # for pictures of users


def options_for(weights: Path) -> list[str]:
    """Return the words of a command line that choose weights; none where they are the default.

    A file's path is absolute, as the command is typed in another folder.
    """
    path = weights.resolve()
    if path == EDITING.resolve():
        return []
    own = path.parent == FOLDER.resolve() and path.suffix == EDITING.suffix
    return ["--weights", path.stem if own else str(path)]
