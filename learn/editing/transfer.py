"""`learn transfer`: every picture's shape and light in every picture's material, as in the paper's
Figures 10 and 15.

Row i is the object and light of picture i, column j the material of picture j; on the diagonal
stands the picture itself.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from learn.data.devices import array
from learn.editing import decomposition, edit, photograph
from learn.figures import montage
from learn.networks import weights as checkpoint
from manifests import files
from manifests.errors import InputError
from manifests.inputs import require_file
from shaders import tone

REMEDY = (
    "put NAME.mask.png beside it, white where the object is, or name a folder of masks:"
    " --mask-dir DIR"
)
LARGEST_LIST = 1 << 20  # bytes: ten thousand long paths
MOST_A_GRID = 10  # pictures: more become several grids


def listed(paths, list_file=None):
    """The pictures asked for: paths, and the lines of a file of paths, relative to that file.
    Raises InputError.
    """
    results = [Path(path) for path in paths]
    if list_file is not None:
        require_file(list_file, "a text file with a path a line", maximum_bytes=LARGEST_LIST)
        try:
            lines = Path(list_file).read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            raise InputError(
                list_file,
                "a text file with a path a line",
                "other bytes",
                "write the paths as UTF-8",
            ) from None
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
            "name them, or give --list FILE with a path a line",
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


def run(paths, mask_folder, out, edit_options, per_grid=6, overwrite=False):
    """Write SHAPE-in-MATERIAL.png for every pair, grid.png (grid-01.png … for many) and
    transfer.json. Raises InputError.
    """
    out = Path(out)
    if not 2 <= per_grid <= MOST_A_GRID:
        raise InputError(
            "--per-grid",
            f"2 to {MOST_A_GRID} pictures a grid",
            str(per_grid),
            "more become several grids",
        )
    groups = grouped(paths, per_grid)
    names = (
        ["grid.png"]
        if len(groups) == 1
        else [f"grid-{i:02d}.png" for i in range(1, len(groups) + 1)]
    )
    pairs = [
        f"{a.stem}-in-{b.stem}.png" for group in groups for a in group for b in group if a is not b
    ]
    files.reserve_outputs(out, [*names, *pairs, "transfer.json"], overwrite, paths)
    network, metadata = checkpoint.load_parts(edit_options.weights, edit_options.device)
    for path in (path for group in groups[1:] for path in group):
        opened(
            path,
            mask_folder,
            edit_options,
            # what is wrong with any is said before the first is worked on; kept they would fill the
            # memory
        )
    out.mkdir(parents=True, exist_ok=True)
    report = []
    with (
        files.transaction(),
        tqdm(total=sum(len(group) ** 2 for group in groups), unit="picture") as progress,
    ):
        for group, name in zip(groups, names, strict=True):
            pictures = {path: opened(path, mask_folder, edit_options) for path in group}
            report += grid(
                group, pictures, network, metadata["size"], out, name, edit_options, progress
            )
        files.write_json(out / "transfer.json", {"pictures": report} | edit_options.as_metadata())


def opened(path, mask_folder, edit_options):
    """The Photograph at a path, with its mask."""
    return photograph.opened(
        path,
        masks(path, mask_folder),
        None,
        edit_options.balance,
        edit_options.exposure,
        remedy=REMEDY,
    )


def masks(path, folder):
    """The mask file of a picture, in a list; none where its own transparency serves."""
    beside = edit.mask_beside(path, folder)
    if folder is not None and beside is None:
        raise InputError(
            Path(folder) / f"{Path(path).stem}.png",
            f"the mask of {path}",
            "no such file",
            "name masks as the pictures",
        )
    return [] if beside is None else [beside]


def grouped(paths, per_grid):
    """Lists of at most `per_grid` pictures, in order; a last one alone joins its neighbours."""
    groups = [paths[i : i + per_grid] for i in range(0, len(paths), per_grid)]
    if len(groups) > 1 and len(groups[-1]) == 1:
        groups[-1].insert(0, groups[-2].pop())
    return groups


def grid(group, pictures, network, size, out, name, edit_options, progress):
    """One grid of {path: Photograph}; returns what transfer.json says of them."""
    result, report = {}, []
    for path in group:
        progress.set_description(f"taking {path.stem} apart"[:30])
        result[path] = decomposition.decompose(pictures[path], network, size, edit_options.settings)
        refined = result[path].refined
        energies = None if refined is None else [refined.before["total"], refined.after["total"]]
        report.append(
            {
                "name": path.stem,
                "grid": name,
                "exposure": result[path].framed.exposure,
                "energy": energies,
            }
        )
        progress.update()
    head = [("", np.full((8, 8, 3), montage.GROUND / 2))] + [
        (path.stem, edit.material_sphere(own_label(result[path]), result[path])) for path in group
    ]
    lines = [head]
    for path in group:
        painter = decomposition.Painter(result[path], edit_options.tolerance, edit_options.detail)
        shown = edit.exposure_of(pictures[path])
        before = cropped(
            edit.on_ground(tone.display(pictures[path].radiance, shown), pictures[path]),
            result[path],
        )
        line = [(path.stem, before)]
        for other in group:
            if other is path:
                line.append(("", before))
                continue
            picture = painter.edited([own_label(result[other])])
            whole = tone.display(picture, shown)
            edit.save(
                out / f"{path.stem}-in-{other.stem}.png", edit.with_alpha(whole, pictures[path])
            )
            line.append(("", cropped(edit.on_ground(whole, pictures[path]), result[path])))
            progress.update()
        lines.append(line)
    edit.save(out / name, montage.rows(lines, edit.TILE))
    return report


def own_label(found):
    """(108,) of a picture's object."""
    return array(found.parts.label[0, 0].float())


def cropped(picture, found):
    """The object's square of a picture, as far as it lies inside."""
    top, left, side = found.framed.box
    return picture[max(top, 0) : top + side, max(left, 0) : left + side]
