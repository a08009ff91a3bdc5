"""The files of `learn edit`: their names, and how they are written."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from learn.data import photographs
from learn.data.devices import to_numpy
from learn.editing import drawing, material_file, targets
from learn.figures import montage
from learn.metrics.pictures import display_l2
from manifests import earlier_results, files, outputs
from manifests.errors import InputError
from manifests.notices import notice
from shaders import tone

if TYPE_CHECKING:
    from learn.editing.decomposition import Decomposition
    from learn.editing.edit import EditOptions, EditResult

DECOMPOSITION_FILES = (
    "normals.exr",
    "normals.png",
    "light.exr",
    "light.png",
    "rendering.png",
    "material.json",
    "ball.png",
    "reflectance.png",
)
# files that not every run writes
SOMETIMES_WRITTEN = re.compile(r"edited(-.+)?\.(png|exr)|interactive\.html")


def reserve_names(
    path: Path,
    materials: Sequence[str],
    inputs: Sequence[str | Path],
    out: Path,
    overwrite: bool,
    pages: Sequence[str] = (),
) -> list[str]:
    """Return the names, without endings, of the edited pictures, and reserve all files of the edit.

    path    the photograph
    inputs  files that are read, which no result may replace
    pages   names of text files that are written as well
    Raises  InputError for a material named twice, or for files that are there already
    """
    if len(set(materials)) < len(materials):
        raise InputError(
            "--material", "materials of different names", ", ".join(materials), "name each once"
        )
    names = (
        ["edited"]
        if len(materials) == 1
        else [f"edited-{targets.file_name(text)}" for text in materials]
    )
    names = [
        name if names.count(name) == 1 else f"{name}-{number}"
        for number, name in enumerate(names, 1)
    ]
    if len(set(names)) < len(names):  # a name with its number is also the name of another material
        names = [f"{name}-{number}" for number, name in enumerate(names, 1)]
    linear = Path(path).is_dir() or Path(path).suffix.lower() == ".exr"
    endings = (".png", ".exr") if linear else (".png",)
    edited = [name + ending for name in names for ending in endings]
    outputs.reserve_outputs(
        out,
        [*DECOMPOSITION_FILES, "sheet.png", "edit.json", *pages, *edited],
        overwrite,
        list(inputs),
    )
    return names


def write(
    out: Path,
    names: Sequence[str],
    result: "EditResult",
    edit_options: "EditOptions",
    texts: Mapping[str, str] | None = None,
    inputs: Sequence[str | Path] | None = None,
) -> dict:
    """Write every file into the folder `out`, all or none, and return what edit.json holds.

    texts   {name: content} of text files that are written as well
    inputs  which stay where other results of an earlier run are removed; None: all of them stay
    """
    decomposed, opened = result.decomposition, result.decomposition.photograph
    exposure = drawing.display_exposure(opened)
    report = make_report(result, edit_options)
    # drawn once: each takes a third of a second where a material is sharp
    own = [drawing.material_sphere(label, decomposed) for label in decomposed.parts.label[0]]
    maps = drawing.reflectance_maps(decomposed)
    out.mkdir(parents=True, exist_ok=True)
    with files.transaction():
        write_decomposition(out, decomposed)
        save_png(out / "rendering.png", tone.display(result.rendering, exposure))
        save_png(out / "ball.png", own[0])
        save_png(out / "reflectance.png", montage.contact_sheet([maps], drawing.TILE))
        material_file.write(
            out / "material.json",
            to_numpy(decomposed.parts.label[0]),
            decomposed.framed,
            result.metadata,
            edit_options.weights,
        )
        for name, edit in zip(names, result.edits, strict=True):
            picture = tone.display(edit.picture, exposure)
            save_png(out / f"{name}.png", drawing.with_alpha(picture, opened))
            if opened.linear:
                photographs.write_picture(out / f"{name}.exr", edit.picture, opened.opacity)
        # made last: the rows hold pictures of the photograph's size
        rows = drawing.make_sheet_rows(result, exposure, own, maps)
        save_png(out / "sheet.png", montage.contact_sheet(rows, drawing.TILE))
        for name, text in (texts or {}).items():
            files.write_text(out / name, text)
        report["files"] = earlier_results.written_hashes()
        files.write_json(out / "edit.json", report)
        if inputs is not None:
            line = earlier_results.remove(
                out / "edit.json", report["files"], SOMETIMES_WRITTEN, inputs
            )
            if line is not None:
                notice(line)
    return report


def write_decomposition(out: Path, decomposed: "Decomposition") -> None:
    """Write normals and light of a decomposition into the folder `out`, as EXR and as PNG."""
    parts, mask = decomposed.parts, decomposed.framed.mask
    n, L = to_numpy(parts.n[0].movedim(0, -1)), to_numpy(parts.light[0].movedim(0, -1))
    photographs.write_exr(out / "normals.exr", n * mask[..., None], "XYZ")
    photographs.write_exr(out / "light.exr", L)
    save_png(out / "normals.png", montage.normals_picture(n, mask))
    save_png(out / "light.png", montage.light_picture(L))


def make_report(result: "EditResult", edit_options: "EditOptions") -> dict:
    """Return what edit.json holds."""
    decomposed, opened = result.decomposition, result.decomposition.photograph
    refined = decomposed.refined
    return {
        "photograph": opened.name,
        "size": opened.mask.shape,
        "materials": [edit.text for edit in result.edits],
        "fit_relative_l1": targets.fit_errors(edit.text for edit in result.edits),
        "exposure": decomposed.framed.exposure,
        "brightness_stops": edit_options.stops,
        "white_balance": [float(x) for x in opened.balance],
        "regions": opened.count,
        "mask_fitted": opened.given is not None,
        "shape_overlap": decomposed.shape_overlap,
        "refined": (
            None if refined is None else {"before": refined.before, "after": refined.after}
        ),
        "display_l2": {
            edit.text: {
                "mask": display_l2(edit.picture, edit.truth, opened.mask),
                "frame": display_l2(edit.picture, edit.truth, opened.mask, frame=True),
            }
            for edit in result.edits
            if edit.truth is not None
        },
    } | edit_options.as_metadata()


def save_png(path: Path, picture: np.ndarray) -> None:
    """Write a PNG of display values (H, W, 3 or 4). Raises InputError for values not finite."""
    photographs.require_finite(path, picture)
    # half the time of Pillow's usual level 6, for files one per cent larger
    files.write_image(path, montage.eight_bit(picture), "PNG", compress_level=4)
