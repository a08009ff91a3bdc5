"""Pictures that people look at, compared with those in tests/goldens as an observer would.

The measure is FLIP (Andersson and others, 2020): 0 for equal pictures, 1 for black beside white, at
0.7 m from a screen. It is averaged over blocks of 16² pixels, and the worst block counts, because a
caption that is missing is a small part of a contact sheet.
"""

import os
import tempfile
from pathlib import Path

import numpy as np
from flip_evaluator import evaluate
from PIL import Image

FOLDER = Path(__file__).resolve().parents[1] / "goldens"
BLOCK = 16
# Another processor rounds values to the next of 256 levels, for which FLIP is at most 0.01; the
# layer's own tolerance of 1 % moves a value by two levels at most. A material that is 10 % brighter
# or a caption of another word gives 0.1 and more.
LIMIT = 0.04
LONGEST = 256  # pixels: a larger picture is reduced before it is stored or compared


def failed_folder():
    """Where pictures that fail are saved."""
    default = Path(tempfile.gettempdir()) / "brdfactory-failed-pictures"
    return Path(os.environ.get("BRDFACTORY_FAILED_PICTURES", default))


def reduced(picture):
    """A display picture (H, W, 3) uint8 as it is stored: its longest side at most LONGEST."""
    picture = Image.fromarray(np.asarray(picture)).convert("RGB")
    factor = -(-max(picture.size) // LONGEST)
    return np.asarray(picture.reduce(factor) if factor > 1 else picture)


def difference(picture, golden):
    """The mean FLIP (rows, columns) of each block of BLOCK² pixels, of pictures (H, W, 3) uint8."""
    errors = evaluate(golden / np.float32(255), picture / np.float32(255), "LDR")[0][..., 0]
    rows, columns = (range(0, side, BLOCK) for side in errors.shape)
    return np.array([[errors[y : y + BLOCK, x : x + BLOCK].mean() for x in columns] for y in rows])


def check(name, picture):
    """Fail if a display picture (H, W, 3) uint8 does not look like the golden of this name."""
    picture, path = reduced(picture), FOLDER / f"{name}.png"
    if not path.is_file():
        fault = f"there is no {path.name} in tests/goldens"
    else:
        golden = np.asarray(Image.open(path).convert("RGB"))
        if golden.shape != picture.shape:
            fault = f"expected {golden.shape[:2]} pixels, found {picture.shape[:2]}"
        elif (worst := difference(picture, golden).max()) > LIMIT:
            fault = f"a block of {BLOCK}² pixels has a FLIP of {worst:.3f}, the limit is {LIMIT}"
        else:
            return
    saved = failed_folder() / path.name
    saved.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(saved, optimize=True)
    raise AssertionError(f"{name}: {fault}; look at {saved}, and if it is right, copy it there")
