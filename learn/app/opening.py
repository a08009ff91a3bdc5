"""Opens what users send to the page: photographs and saved work, and the program's example.

Files are bounded before they are decoded (learn.data.photographs, learn.app.work_file). All that
was sent is read before anything is kept, so that what is open stays if it cannot be read.
"""

import re
import secrets
import shutil
from pathlib import Path

import numpy as np

from learn.app import work_file
from learn.app.marked_photograph import MarkedPhotograph
from learn.data import photographs
from learn.data.picture_decoding import MOST_PIXELS
from learn.editing import photograph
from learn.selection.display import display_for_marking
from learn.selection.marks import Selection
from manifests import files
from manifests.errors import InputError

ENDING = re.compile(r"\.[a-z0-9]{2,5}")  # of a photograph's file that saved work can have
EXAMPLE = "example:espresso-cup"
MOST_BYTES = 64 << 20  # of a photograph's file


def open_file(sent: Path, folder: Path) -> MarkedPhotograph:
    """Return the photograph of a file that was sent, of which a copy is kept in a folder.

    Raises  InputError: no picture, a damaged or too large one
    """
    if (size := sent.stat().st_size) > MOST_BYTES:
        rule, result = f"at most {MOST_BYTES >> 20} MB", f"{size / (1 << 20):.1f} MB"
        raise InputError(sent.name, rule, result, "save it smaller, or as JPEG")
    return _kept(sent, folder, sent.name, *_read(sent))


def _read(sent: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance (H, W, 3) and alpha (H, W) of a photograph. Raises InputError."""
    radiance, alpha = photographs.read_pixels(sent)
    height, width = radiance.shape[:2]
    if height * width > MOST_PIXELS:  # an EXR, which is not made smaller
        rule = f"at most {MOST_PIXELS / 1e6:g} megapixels"
        raise InputError(sent, rule, f"{width} × {height}", "make it smaller")
    photographs.require_finite(sent, radiance)
    return radiance, alpha


def _kept(
    sent: Path, folder: Path, name: str, radiance: np.ndarray, alpha: np.ndarray
) -> MarkedPhotograph:
    """Copy a file that was read into a folder; return its photograph."""
    ending = sent.suffix.lower()
    if not ENDING.fullmatch(ending):  # such as .jpg_large, which saved work could not have
        ending = ".img"
    path = folder / f"photograph{ending}"
    files.write_bytes(path, sent.read_bytes())
    display, is_brightened = display_for_marking(radiance, photographs.holds_radiance(path))
    result = MarkedPhotograph(path, name, Selection(display), is_brightened=is_brightened)
    result.reduction = photographs.describe_reduction(path, radiance.shape[:2])
    if (alpha < 0.5).any():
        result.coverage = alpha
        result.selection.given = (alpha >= 0.5).astype(np.uint8)
    return result


def open_example() -> MarkedPhotograph:
    """Return the program's example, a cup on a saucer, with its two regions."""
    path, regions = photograph.resolve_example(EXAMPLE, [], None)
    assert regions is not None
    radiance, _ = photographs.read_pixels(path)
    mask = photographs.read_labels(regions, radiance.shape[:2])
    selection = Selection(display_for_marking(radiance, photographs.holds_radiance(path))[0], mask)
    return MarkedPhotograph(path, EXAMPLE, selection, example_mask=mask)


def open_work(sent: Path, folder: Path) -> tuple[MarkedPhotograph, work_file.Work]:
    """Return the photograph of saved work, with its mask, and the Work.

    Raises  InputError: no saved work, a damaged or too large file
    """
    unpacked = folder / f"work-{secrets.token_hex(6)}"
    unpacked.mkdir()
    try:
        work = work_file.read(sent, unpacked)
        return _photograph_of(work, folder), work
    except InputError as error:  # the names of files alone are what the user knows
        name = Path(str(error.where).replace(str(unpacked), "").lstrip("/")).name
        where = sent.name if name == sent.name else f"{sent.name}: {name}"
        result = str(error.found).replace(str(unpacked), "").lstrip("/")
        raise InputError(where, error.expected, result, error.remedy) from None
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)


def _photograph_of(work: work_file.Work, folder: Path) -> MarkedPhotograph:
    if work.photograph is None and work.name != EXAMPLE:
        raise InputError(work.name, EXAMPLE, "another example", work_file.REMEDY)
    opened = work.photograph or photograph.resolve_example(EXAMPLE, [], None)[0]
    radiance, alpha = _read(opened)
    if work.mask is not None:
        coverage = photographs.read_mask(work.mask, radiance.shape[:2])
        photographs.require_object(work.mask, coverage)
    if work.regions is not None:
        photographs.read_labels(work.regions, radiance.shape[:2])
    if work.photograph is None:
        result = open_example()
    else:
        result = _kept(opened, folder, work.name, radiance, alpha)
    if work.mask is not None:
        result.give_mask(work.mask)
    if work.regions is not None:
        result.selection.given = photographs.read_labels(work.regions, result.selection.size)
    return result
