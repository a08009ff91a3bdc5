"""`learn transfer`: every picture's object and light in every picture's material.

As in the paper's Figures 10 and 15, row i of a grid is the object and light of picture i, column j
the material of picture j; on the diagonal is the picture itself.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn.data.devices import to_numpy
from learn.editing import (
    decomposition,
    desired_light,
    drawing,
    photograph,
    region_masks,
    transfer_grids,
)
from learn.editing.decomposition import Decomposition
from learn.editing.edit import EditOptions
from learn.editing.edit_files import save_png
from learn.editing.photograph import Photograph
from learn.figures import montage
from learn.networks import weights as checkpoint
from manifests import earlier_results, files, outputs
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.notices import notice
from manifests.progress import tqdm
from shaders import envmap

REMEDY = (
    "put NAME.mask.png beside it, white where the object is, or name a folder of masks:"
    " --mask-dir DIR"
)
LARGEST_LIST = 1 << 20  # bytes, enough for ten thousand long paths
MOST_PER_GRID = 10  # pictures
# files that not every run writes
PICTURES = re.compile(r".+-in-.+\.png|grid(-\d+)?(-under-.+)?\.png", re.DOTALL)


def list_pictures(paths: Iterable[Path], list_file: Path | None = None) -> list[Path]:
    """Return the requested pictures: paths, and the lines of a file of paths, relative to it.

    Raises  InputError for fewer than two pictures, or two of one name
    """
    results = [Path(path) for path in paths]
    if list_file is not None:
        rule = "a text file with one path per line"
        require_file(list_file, rule, maximum_bytes=LARGEST_LIST)
        try:
            lines = Path(list_file).read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            raise InputError(list_file, rule, "other bytes", "write the paths as UTF-8") from None
        results += [
            Path(list_file).parent / line.strip()
            for line in lines
            if line.strip() and not line.startswith("#")
        ]
    results = [path for path in results if not path.name.endswith(".mask.png")]
    if len(results) < 2:
        raise InputError(
            "pictures",
            "two or more",
            str(len(results)),
            "name them, or give --list FILE with one path per line",
        )
    names = [path.stem for path in results]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InputError(
            "pictures",
            "names that differ",
            f"{', '.join(twice[:3])} twice",
            "rename one: results are named after them",
        )
    return results


def run(
    paths: Sequence[Path],
    mask_folder: Path | None,
    out: Path,
    edit_options: EditOptions,
    per_grid: int = 6,
    overwrite: bool = False,
    lights: Sequence[str] = (),
    rotation_deg: float = 0.0,
) -> None:
    """Write the edit of every pair of pictures, the grids, and transfer.json.

    The files are SHAPE-in-MATERIAL.png for every pair, and grid.png, or grid-01.png … for many
    pictures. With desired lights (texts of learn.editing.desired_light), they are
    SHAPE-in-MATERIAL-under-LIGHT.png for every object, material and light, and
    grid-under-LIGHT.png; the objects stand alone, on a transparent ground. Raises InputError.
    """
    out = Path(out)
    groups, light_names, grids, names = plan_results(paths, per_grid, lights)
    inputs: list[str | Path] = [
        *paths,
        *(desired_light.split_collection(text)[0] for text in lights),
    ]
    outputs.reserve_outputs(out, [*grids, *names, "transfer.json"], overwrite, inputs)
    if edit_options.fit_mask and not any(list_masks(path, mask_folder) for path in paths):
        rule, remedy = "a mask besides the pictures' own transparency", "leave it out"
        raise InputError("--fit-mask", rule, "none", remedy)
    network, metadata = checkpoint.load_full_network(edit_options.weights, edit_options.device)
    size = metadata["size"]
    # Unusable pictures are refused before the first is worked on; they are read again when their
    # turn comes, since all of them together would fill the memory.
    as_given = replace(edit_options, fit_mask=False)
    for path in (path for group in groups[1:] for path in group):
        open_with_mask(path, mask_folder, as_given)

    def of_picture(path: Path) -> np.ndarray:
        photo = open_with_mask(path, mask_folder, edit_options)
        return light_of(decomposition.decompose(photo, network, size, edit_options.refinement))

    maps = [desired_light.resolve_light(text, of_picture, rotation_deg) for text in lights]
    out.mkdir(parents=True, exist_ok=True)
    report = []
    count = sum(len(group) * (1 + len(group) * len(maps)) for group in groups)
    if not maps:
        count = sum(len(group) ** 2 for group in groups)
    with files.transaction(), tqdm(total=count, unit="picture") as progress:
        per_group = max(len(maps), 1)
        for number, group in enumerate(groups):
            of_group = grids[number * per_group : (number + 1) * per_group]
            pictures = {path: open_with_mask(path, mask_folder, edit_options) for path in group}
            decompositions = decompose_pictures(pictures, network, size, edit_options, progress)
            report += transfer_grids.metadata_of(decompositions, of_group[0])
            if maps:
                for name, light, grid in zip(light_names, maps, of_group, strict=True):
                    rows = transfer_grids.relit_rows(
                        out, decompositions, name, light, edit_options, progress
                    )
                    save_png(out / grid, montage.contact_sheet(rows, drawing.TILE))
            else:
                rows = transfer_grids.edit_rows(
                    out, pictures, decompositions, edit_options, progress
                )
                save_png(out / of_group[0], montage.contact_sheet(rows, drawing.TILE))
        light_settings = (
            {"lights": list(lights), "light_rotation_deg": rotation_deg} if lights else {}
        )
        written = earlier_results.written_hashes()
        files.write_json(
            out / "transfer.json",
            {"pictures": report} | light_settings | edit_options.as_metadata() | {"files": written},
        )
        if overwrite and (
            line := earlier_results.remove(out / "transfer.json", written, PICTURES, inputs)
        ):
            notice(line)


def plan_results(
    paths: Sequence[Path], per_grid: int, lights: Sequence[str]
) -> tuple[list[list[Path]], list[str], list[str], list[str]]:
    """Return the pictures of each grid, the lights' names, and the files of the grids and edits.

    With lights, each grid of pictures has one file per light, in the order of the lights.

    Raises  InputError: a wrong number of pictures per grid, or two results of one name
    """
    if not 2 <= per_grid <= MOST_PER_GRID:
        raise InputError(
            "--per-grid",
            f"2 to {MOST_PER_GRID} pictures per grid",
            str(per_grid),
            "more become several grids",
        )
    groups = transfer_grids.group_pictures(paths, per_grid)
    light_names = transfer_grids.light_names(lights)
    grids, names = transfer_grids.result_names(groups, light_names)
    if len(set(names)) < len(names):  # a in b-in-c, and a-in-b in c
        twice = next(name for name in names if names.count(name) > 1)
        remedy = "rename one: results are named after them"
        raise InputError("pictures", "one result of each name", f"{twice} twice", remedy)
    return groups, light_names, grids, names


def light_of(decomposed: Decomposition) -> np.ndarray:
    """Return the light (64, 128, 3) of a decomposed picture, at unit mean."""
    L = to_numpy(decomposed.parts.light[0].movedim(0, -1))
    return envmap.unit_mean(np.ascontiguousarray(L))[0].astype(np.float32)


def open_with_mask(path: Path, mask_folder: Path | None, edit_options: EditOptions) -> Photograph:
    """Return the Photograph at a path, with its mask; transparency is never fitted."""
    given = list_masks(path, mask_folder)
    return photograph.open_photograph(
        path,
        given,
        None,
        edit_options.balance,
        edit_options.exposure,
        remedy=REMEDY,
        fit_mask=edit_options.fit_mask if given else None,
    )


def list_masks(path: Path, folder: Path | None) -> list[Path]:
    """Return the mask file of a picture in a list, which is empty if its transparency serves."""
    beside = region_masks.find_mask_beside(path, folder)
    if folder is not None and beside is None:
        raise InputError(
            Path(folder) / f"{Path(path).stem}.png",
            f"the mask of {path}",
            "no such file",
            "name masks as the pictures",
        )
    return [] if beside is None else [beside]


def decompose_pictures(
    pictures: Mapping[Path, Photograph],
    network: torch.nn.Module,
    size: int,
    edit_options: EditOptions,
    progress: tqdm,
) -> dict[Path, Decomposition]:
    """Return {path: Decomposition} of the pictures of one grid."""
    decompositions = {}
    for path, photo in pictures.items():
        progress.set_description(f"decomposing {path.stem}"[:30])
        decompositions[path] = decomposition.decompose(
            photo, network, size, edit_options.refinement
        )
        progress.update()
    return decompositions
