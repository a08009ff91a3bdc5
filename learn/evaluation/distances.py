"""How far shapes, materials and lights of an evaluation are from the nearest of the training.

shapes     mean angle in degrees between the normals of the shape's views and those of the training
           shape that is nearest on the average over these views. Of each training shape that view
           counts that is nearest to the shown one, so that a turn about the vertical costs nothing
           that the training did not show. Normals are compared in cells of a GRID × GRID raster;
           where one shape alone covers a cell the angle counts as ALONE degrees. So the figure is
           the error of a method that answers with the normals of a view of training
materials  brdf_log of learn.metrics.intrinsics against each training label; the least counts
lights     relative root mean square error of irradiance against each training map, under all turns
           of TURN texels and mirrored; the least counts. 0 for a map of training, turned or not
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn.data.geometry import Geometry, view_vectors_of
from learn.data.lights import read_maps
from learn.data.records import Records
from learn.data.seen import DIGITS, Seen, map_hash
from learn.metrics.intrinsics import brdf_log_error
from learn.metrics.radiometry import irradiance
from manifests import measured_lights
from manifests.errors import InputError
from manifests.schema import Record
from shaders import envmap
from shaders.frames import turned_to_viewer

GRID = 16
ALONE = 90.0
TURN = 4  # texels: 11°, a fifth of the half-width of irradiance's lobe


def material_distances(
    labels: Mapping[str, np.ndarray], training: np.ndarray | None
) -> dict[str, float]:
    """Return {name: distance} of labels (108,); {} without training labels (M, 108)."""
    if training is None:
        return {}
    return {
        name: min(
            0.0 if np.allclose(label, other, atol=1e-5) else brdf_log_error(label, other)
            for other in training
        )
        for name, label in labels.items()
    }


def light_distances(
    maps: Mapping[str, np.ndarray], training: Sequence[np.ndarray]
) -> dict[str, float]:
    """Return {name: distance} of maps (64, 128, 3); {} without training maps."""
    if not training:
        return {}
    known = torch.cat([_irradiance_of_turns(L) for L in training])
    result = {}
    for name, L in maps.items():
        if any(envmap.is_same_source(L, other) for other in training):
            result[name] = 0.0
            continue
        right = irradiance(_tensor(envmap.unit_mean(L)[0])[None])
        error = ((known - right) ** 2).mean((1, 2)).min().sqrt() / (right**2).mean().sqrt()
        result[name] = float(error)
    return result


def training_maps(
    path: Path | None, metadata: Mapping[str, Any], seen: Seen | None
) -> list[np.ndarray]:
    """Return the maps that weights were trained on, of a file and of the program's measured ones.

    path      None: no file
    metadata  of the weights: maps that their run held out are left out
    seen      what the weights saw; where they say it, all other maps are left out too. Where they
              do not, the measured ones are left out
    Raises    InputError
    """
    maps = {} if path is None else dict(read_maps(path))
    if seen is not None:
        # last: a file of the same maps may have its columns elsewhere
        maps |= measured_lights.load_all()
    of_data = metadata.get("run", {}).get("data", {})
    held_out = {*of_data.get("validation_lights", ()), *of_data.get("test_lights", ())}
    return [
        L
        for name, L in maps.items()
        if name not in held_out and (seen is None or map_hash(L) in seen.lights)
    ]


def shape_distances(
    tested: Mapping[str, Sequence[np.ndarray]],
    training: Mapping[str, np.ndarray],
    same: Collection[str] = (),
) -> dict[str, float]:
    """Return {shape: distance in degrees}; {} without training shapes.

    tested    {shape: the rasters (GRID, GRID, 3) of its views}
    training  {shape: (V, GRID, GRID, 3)} as of `training_shapes`
    same      names of tested shapes that are themselves of training: 0, whatever rounding says
    """
    if not training:
        return {}
    owner = np.repeat(np.arange(len(training)), [len(views) for views in training.values()])
    known = np.concatenate(list(training.values()))
    result = {}
    for name, views in tested.items():
        nearest = np.full((len(views), len(training)), np.inf)
        for row, view in zip(nearest, views, strict=True):
            np.minimum.at(row, owner, mean_angles(view, known))
        result[name] = 0.0 if name in same else float(nearest.mean(0).min())
    return result


def raster(n: np.ndarray) -> np.ndarray:
    """Return directions (GRID, GRID, 3) of normals (H, W, 3) by cells; 0 where few pixels are.

    n  unit, 0 outside the mask. A cell that the mask covers by less than half is empty
    Raises  ValueError for fewer pixels than cells
    """
    rows, columns = (np.arange(GRID + 1) * side // GRID for side in n.shape[:2])
    if min(n.shape[:2]) < GRID:
        raise ValueError(f"n: expected at least {GRID} pixels a side, found {n.shape[:2]}")
    sums = np.add.reduceat(np.add.reduceat(n, rows[:-1], 0), columns[:-1], 1)
    mask = np.abs(n).sum(-1) > 0
    counts = np.add.reduceat(np.add.reduceat(mask.astype(float), rows[:-1], 0), columns[:-1], 1)
    covered = counts >= 0.5 * np.outer(np.diff(rows), np.diff(columns))
    length = np.linalg.norm(sums, axis=-1)
    covered &= length > 0
    return np.where(covered[..., None], sums / np.where(covered, length, 1)[..., None], 0)


def mean_angles(view: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return mean angles (V,) in degrees of a raster (GRID, GRID, 3) and others (V, …, 3).

    The mean is over the cells that either of the two covers; ALONE where none does.
    """
    mine, theirs = (np.abs(each).sum(-1) > 0 for each in (view, others))
    cosine = np.einsum("ijc,vijc->vij", view, others).clip(-1, 1)
    angle = np.where(mine & theirs, np.degrees(np.arccos(cosine)), ALONE)
    either = mine | theirs
    cells = either.sum((1, 2))
    return np.where(cells > 0, (angle * either).sum((1, 2)) / np.maximum(cells, 1), ALONE)


def rasters(records: Records, shown: Sequence[Record]) -> dict[str, list[np.ndarray]]:
    """Return {shape: the rasters of its views} of records, each view once. Raises InputError."""
    views = {record.geometry_hash: record for record in shown}
    result: dict[str, list[np.ndarray]] = {}
    for record in views.values():
        n, _, segments = records.geometry(record)
        if record.camera.fov_deg is not None:
            n = turned_to_viewer(n, view_vectors_of(record.camera))
        n = np.where((segments > 0)[..., None], n, 0)
        result.setdefault(record.shape, []).append(raster(n))
    return result


def training_shapes(folder: Path | None, seen: Seen | None) -> dict[str, np.ndarray]:
    """Return {shape: rasters (V, GRID, GRID, 3)} of a data set's shapes that are of training.

    folder  a data set with geometry; None: {}
    seen    what the weights saw: their shapes count. Where they do not say it, all shapes count
            that are not of the data set's test side
    Raises  InputError: no geometry, damaged geometry, no shape of training
    """
    if folder is None:
        return {}
    geometry = Geometry(folder)
    result: dict[str, list[np.ndarray]] = {}
    for i, view in enumerate(geometry.views):
        known = view.side != "test" if seen is None else view.shape_hash[:DIGITS] in seen.shapes
        if known:
            result.setdefault(view.shape, []).append(raster(geometry.normals(i)))
    if not result:
        raise InputError(
            folder,
            "shapes that the weights were trained on",
            f"none among its {len({view.shape for view in geometry.views})}",
            "name the data set of their training, or leave --geometry out",
        )
    return {name: np.stack(views) for name, views in result.items()}


def _irradiance_of_turns(L: np.ndarray) -> torch.Tensor:
    """Return the irradiance (T, 3, directions) of a map under all turns, and mirrored."""
    L = envmap.unit_mean(L)[0]
    both = (L, L[:, ::-1])
    turns = range(0, L.shape[1], TURN)
    return torch.cat(
        [irradiance(torch.stack([_tensor(envmap.roll(x, k)) for k in turns])) for x in both]
    )


def _tensor(L: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(L, np.float32)).movedim(-1, 0)
