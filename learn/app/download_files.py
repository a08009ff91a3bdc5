"""The files that a user downloads: pictures, saved work, and what repeats the edit."""

import copy
import math
import re
import secrets
import shutil
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from learn.app import edit_file, work_file
from learn.app.choices import Edit
from learn.app.composition import opacity_of
from learn.app.opening import EXAMPLE
from learn.app.session import Session
from learn.app.viewer import read_labels
from learn.app.work_file import Saved
from learn.data import photographs
from learn.editing import material_file, photograph
from learn.figures import montage
from manifests import files

SHEET_COLUMNS, SHEET_TILE = 3, 640  # of the picture that compares the kept edits; pixels
KEPT_FOLDERS = 2  # of files for download, in a session
LONGEST_NAME = 80  # letters of a file for download


@dataclass(frozen=True)
class Downloads:
    """The files of an edit.

    pictures  of the edit and of the kept ones, and one of all of them side by side
    work      by which the work continues later
    others    for programs, and to repeat the edit by the command
    command   that repeats it
    """

    pictures: list[Path]
    work: Path
    others: list[Path]
    command: str


def write(session: Session) -> Generator[str, None, Downloads]:
    """Write the edit and the kept ones at the photograph's size, with all that repeats it.

    Yields a line about the picture that is rendered next, and returns Downloads. What the user
    changes meanwhile has no part in them.
    Raises  InputError
    """
    as_it_is = copy.copy(session)
    as_it_is.kept = list(session.kept)
    made = session.folder / f"work-{secrets.token_hex(6)}"
    made.mkdir()
    try:
        opened = as_it_is.opened()
        if opened.name != EXAMPLE:  # a photograph that is opened meanwhile replaces its file
            files.write_bytes(made / opened.path.name, opened.path.read_bytes())
        return (yield from _written(as_it_is, made))
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _written(session: Session, made: Path) -> Generator[str, None, Downloads]:
    """As `write`; made: a folder that holds the photograph, for files on the way."""
    viewer, edit = session.decomposed()
    edits = [edit, *(each.edit for each in session.kept if each.edit != edit)]
    yield rendering(1, len(edits))
    folder = session.folder / f"download-{secrets.token_hex(6)}"
    folder.mkdir()
    # an earlier one may still be downloaded, or be made for a page that was loaded again
    before = sorted(session.folder.glob("download-*"), key=lambda path: path.stat().st_mtime_ns)
    for old in before[:-KEPT_FOLDERS]:
        shutil.rmtree(old, ignore_errors=True)
    linear, display = viewer.full(edit)
    opacity = opacity_of(viewer.decomposition.photograph, edit.hide_background)
    pictures = [_write_picture(session, folder, edit, linear, display)]
    photographs.write_picture(folder / "edited.exr", linear, opacity)
    shown = [(edit.caption, display)]
    for number, other in enumerate(edits[1:], 2):
        yield rendering(number, len(edits))
        _, picture = rendered = viewer.full(other)
        pictures.append(_write_picture(session, folder, other, *rendered))
        shown.append((other.caption, picture))
    if len(shown) > 1:
        pictures.append(
            _write_comparison(session, folder, [("photograph", viewer.before()), *shown])
        )
    _, metadata = session.network.loaded()
    decomposed = viewer.decomposition
    parts = [p.parts(own) for p, own in zip(edit.regions, decomposed.label, strict=True)]
    first, second = ([each[k][1] for each in parts] for k in (0, -1))
    read = [label.tobytes() for label in (*decomposed.label, *read_labels(edit.regions))]
    for name, labels in (("material.json", first), ("material-blended.json", second)):
        if labels is first or any(len(p.parts(first[0])) > 1 for p in edit.regions):
            stacked = np.stack(labels)
            framed = decomposed.framed
            were = [label.tobytes() in read for label in stacked]
            path, weights = folder / name, session.network.weights
            material_file.write(path, stacked, framed, metadata, weights, were)
    masks = write_masks(session, folder, decomposed.photograph)
    edit_file.write(folder / "edit.json", edit)
    weights = session.network.weights
    command = edit_file.command_line(
        edit,
        session.opened().name,
        masks,
        session.refined,
        session.fit_was_on,
        weights,
        session.shape_was,
    )
    files.write_text(folder / "command.txt", command + "\n")
    others = sorted(path for path in folder.iterdir() if path not in pictures)
    return Downloads(pictures, _write_work(session, folder, masks, made), others, command)


def _write_picture(
    session: Session, folder: Path, edit: Edit, linear: np.ndarray, display: np.ndarray
) -> Path:
    """Write an edit's picture, named after the photograph and the materials."""
    words = edit.caption
    for sign, word in (("%", " per cent"), ("+", " plus "), ("−", " minus ")):
        words = words.replace(sign, word)
    stem = re.sub(r"\W+", "-", f"{stem_of(session)}-{words}")[:LONGEST_NAME].strip("-")
    path, number = folder / f"{stem}.png", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.png", number + 1
    photographs.require_finite(path, linear)
    files.write_image(path, display, "PNG")
    return path


def stem_of(session: Session) -> str:
    """The photograph's name without its ending, of letters that every file's name may have."""
    given = session.opened().name
    name = given.partition(":")[2] if given == EXAMPLE else Path(given).stem
    return re.sub(r"\W+", "-", name).strip("-")[: LONGEST_NAME // 2] or "photograph"


def _write_comparison(session: Session, folder: Path, shown: list[tuple[str, np.ndarray]]) -> Path:
    """Write one picture of captioned pictures, side by side."""
    tiles = [(caption, _on_ground(picture)) for caption, picture in shown]
    columns = min(SHEET_COLUMNS, math.ceil(math.sqrt(len(tiles))))
    rows = [tiles[k : k + columns] for k in range(0, len(tiles), columns)]
    path = folder / f"{stem_of(session)}-compared.jpg"
    files.write_image(path, montage.contact_sheet(rows, SHEET_TILE), quality=90)
    return path


def _on_ground(picture: np.ndarray) -> np.ndarray:
    """Return display values (H, W, 3) of a picture (H, W, 3 or 4), over grey where transparent."""
    opacity = picture[..., 3:] / 255.0 if picture.shape[-1] == 4 else 1.0
    return montage.GROUND + (picture[..., :3] - montage.GROUND) * opacity


def _write_work(session: Session, folder: Path, masks: list[str], made: Path) -> Path:
    """Write the file by which the work continues later, of which `made` holds the photograph."""
    assert session.edit is not None
    opened = session.opened()
    path = folder / f"{stem_of(session)}-work.zip"
    saved = Saved(
        opened.name, session.refined, len(session.kept), session.fit_was_on, session.shape_was
    )
    kept = [each.edit for each in session.kept]
    work_file.write(path, made, saved, [folder / name for name in masks], session.edit, kept)
    return path


def write_masks(session: Session, folder: Path, opened: photograph.Photograph) -> list[str]:
    """Write what the command line needs of the mask; return the files' names."""
    if session.opened().name == EXAMPLE and not session.by_hand:
        return []
    names = []
    if not opened.cut_out and (session.soft_mask is not None or opened.count == 1):
        # as it was before the program fitted or softened it, which it does whenever it is read
        given = opened.given_regions > 0 if session.soft_mask is None else session.soft_mask
        coverage = np.rint(255 * given.astype(np.float32)).astype(np.uint8)
        files.write_image(folder / "mask.png", coverage, "PNG")
        names.append("mask.png")
    if opened.count > 1:
        files.write_image(folder / "regions.png", opened.given_regions, "PNG")
        names.append("regions.png")
    return names


def rendering(number: int, count: int) -> str:
    """Return the line that says which of `count` pictures is rendered."""
    which = f", picture {number} of {count}" if count > 1 else ""
    return f"Rendering at the photograph's size{which} …"
