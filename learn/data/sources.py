"""Loads what a run's settings and folders name, and splits it into training, validation and test.

Shapes, materials and lights come from the data set, which says which of them are for testing; some
of the others are set aside for validation. If the run says "materials": "built-in", the built-in
materials replace those of the data set.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from learn.data import preflight
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry, PackedView
from learn.data.light_copies import KnownLights, Maps, join_maps, without_duplicates
from learn.data.lights import read_maps
from learn.data.records import Records
from learn.data.relit import SIDES, RelitDataset
from learn.data.rendered import MixedDataset, RenderedDataset, RenderedSplit, fits
from learn.data.seen import map_hash
from learn.data.settings import Data, Run
from manifests import measured_lights, splits
from manifests.errors import InputError, closest
from manifests.materials import Material, load_catalogue
from manifests.schema import Record
from manifests.wording import number_of

VALIDATION_SHAPES = 25  # one in this many training shapes is for validation instead
VALIDATION_MATERIALS = 8  # at most, and no more than one in LEAST_FOR_VALIDATION
LEAST_FOR_VALIDATION = 10
VALIDATION_LIGHTS = 6  # one in this many training maps, if the run names none


def number_from_hash(name: str, parts: int) -> int:
    """Return a whole number from 0 to parts − 1 that depends only on the name."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big") % parts


def load_data_splits(
    data: Data,
    folder: str | Path,
    maps_file: str | Path | None = None,
    progress: bool = True,
    pictures: str | Path | None = None,
    skip_bad: bool = False,
) -> dict[str, DataSplit]:
    """Return {"train", "validation", "test": DataSplit}, disjoint in shapes, materials and lights.

    Everything is checked before training starts. If there are no test lights, all maps light the
    test split; if there are no validation lights, all maps but the test lights light the validation
    split. Without materials of their own, both use those of training. Training itself never sees
    anything that is held out.

    data       the settings under "data" of the run
    folder     a data set with geometry, whose lights are used too
    maps_file  an .npz or a folder of further light maps (learn.data.lights.read_maps), or None
    progress   whether to show progress bars
    pictures   a data set with records that Cycles rendered; None: `folder`, if the run needs
               pictures
    skip_bad   whether to leave damaged files out and list them, instead of raising at the first
    Raises     InputError: two lights of one name, a held-out light that is not there, a split
               without shapes, no material for training, a damaged material, damaged geometry or
               pictures
    """
    geometry = Geometry(folder, progress, skip_bad, depth=data.shadows > 0)
    records = Records(folder)
    all_maps = _all_maps(data, records, maps_file)
    maps = without_duplicates(all_maps, (*data.validation_lights, *data.test_lights))
    held_out = (
        {} if data.all_materials_and_lights else _held_out_maps(data, maps, records.dataset.lights)
    )
    side_of_map = {name: (held_out.get(name, "train"), L) for name, L in maps.items()}
    copies = {name: L for name, L in all_maps.items() if name not in maps}
    side_of_copy = _light_sides(copies, side_of_map)
    materials, bad = split_materials(data, records, skip_bad)
    rendered_splits: dict[str, RenderedSplit] = {}
    if pictures is not None or data.source != "relit":
        rendered_splits = _rendered_splits(
            data, pictures or folder, geometry, side_of_map, materials, skip_bad, progress
        )
    result = {}
    for side in SIDES:
        names = _lights_of(side, maps, held_out)
        result[side] = DataSplit(
            geometry=geometry,
            views=_views_of(side, geometry, folder),
            labels={
                material.name: material.label.reshape(-1).astype(np.float32)
                for material in materials[side] or materials["train"]
            },
            maps=[maps[name] for name in names],
            side=side,
            rendered_split=rendered_splits.get(side),
            skipped=bad,
            copies=tuple(map_hash(L) for name, L in copies.items() if side_of_copy[name] == side),
            map_names=tuple(names),
        )
    return result


def _views_of(side: str, geometry: Geometry, folder: str | Path) -> np.ndarray:
    """Return the indices of a side's views. Raises InputError where it has none."""
    views = np.array([i for i, view in enumerate(geometry.views) if _side(view) == side])
    if not len(views):
        raise InputError(
            folder,
            f"shapes for {side}",
            "none",
            "render more shapes: about one in five is for testing, and of the others one in"
            f" {VALIDATION_SHAPES} for validation",
        )
    return views


def _all_maps(data: Data, records: Records, maps_file: str | Path | None) -> dict[str, np.ndarray]:
    """Return {name: light map} of the data set, the program and a file, as far as a run has them.

    Raises InputError for two of one name.
    """
    maps = {name: records.light(name) for name in records.dataset.lights}
    if data.measured_lights:
        where, remedy = "data: measured_lights", "leave it out: the data set has one of that name"
        maps = join_maps(maps, measured_lights.load_all(), where, remedy)
    if maps_file is not None:
        where = f"--lights {maps_file}"
        remedy = "rename it: the data set or the program has one of that name"
        maps = join_maps(maps, read_maps(maps_file), where, remedy)
    return maps


def _lights_of(side: str, maps: Maps, held_out: Mapping[str, str]) -> list[str]:
    """Return the sorted names of the maps that light a side.

    Without maps training draws computed light, never a held-out map.

    held_out  {name: side} as `_held_out_maps` returns it
    """
    names = [name for name in maps if held_out.get(name, "train") == side]
    if not names and side == "validation":
        names = [name for name in maps if held_out.get(name) != "test"]
    if not names and side != "train":
        names = list(maps)
    return sorted(names)


def make_batch_source(
    data_split: DataSplit, run: Run, batch: int, seed: int, part: tuple[int, int] = (0, 1)
) -> RelitDataset | RenderedDataset | MixedDataset:
    """Return the source of one split's batches: relit geometry, Cycles' pictures, or a mixture.

    The run decides which; a split without pictures is always relit.

    batch  number of pictures per batch
    part   (i, n): return only the i-th of n equal parts of each batch, for process i of n
    """
    relit = RelitDataset(data_split, run.data, batch, run.size, seed, part)
    if run.data.source == "relit" or not data_split.rendered_split:
        return relit
    cycles = RenderedDataset(data_split, run.data, batch, run.size, seed, part)
    return (
        cycles
        if run.data.source == "pictures" or data_split.side != "train"
        else MixedDataset(relit, cycles, run.data.pictures_share)
    )


def list_skipped(data_splits: Mapping[str, DataSplit]) -> dict[str, str]:
    """Return {record id, geometry hash or material: what is wrong} for all that was left out."""
    train = data_splits["train"]
    result = train.geometry.skipped | train.skipped
    for data_split in data_splits.values():
        if data_split.rendered_split:
            result = result | data_split.rendered_split.skipped
    return result


def _held_out_maps(data: Data, maps: Maps, entries: Mapping[str, Any]) -> dict[str, str]:
    """Return {name: "validation" or "test"} for the maps that training must not see.

    entries  the lights of dataset.json
    Raises   InputError if the run holds out a light that does not exist
    """
    named = dict.fromkeys(data.test_lights, "test") | dict.fromkeys(
        data.validation_lights, "validation"
    )
    for name in named:
        if name not in maps:
            raise InputError(
                f"held-out light '{name}'",
                "a light of the dataset or of --lights",
                "none of that name",
                closest(name, maps),
            )
    if named:
        return named
    hashes = {
        name: entries[name].hash if name in entries else hashlib.sha256(L.tobytes()).hexdigest()
        for name, L in maps.items()
    }
    sides = {name: splits.light_side(hashes[name]) for name in maps}
    held = {name: "test" for name, side in sides.items() if side == "test"}
    return held | {
        name: "validation"
        for name in maps
        if name not in held and number_from_hash(hashes[name], VALIDATION_LIGHTS) == 0
    }


def _rendered_splits(
    data: Data,
    folder: str | Path,
    geometry: Geometry,
    maps: dict[str, tuple[str, np.ndarray]],
    materials: dict[str, list[Material]],
    skip_bad: bool,
    progress: bool,
) -> dict[str, RenderedSplit]:
    """Return {side: pictures that Cycles rendered}.

    A picture is for training or for testing if its shape, materials and light all are. It is for
    validation if its shape is, and nothing in it is for testing.

    maps       {name: (side, L)}
    materials  {side: materials} as `split_materials` returns them
    Raises     InputError if there are no pictures, or damaged ones
    """
    records = Records(folder)
    geometry = (
        geometry
        if geometry.folder.resolve() == records.folder.resolve()
        else Geometry(folder, progress, skip_bad)
    )
    fitting = [r for r in records.records if fits(r, data.regions)]
    if not fitting:
        remedy = "render some: python -m factory render JOB, or take another number of regions"
        raise InputError(
            folder,
            f"pictures of {number_of(data.regions, 'material')}",
            f"none in {number_of(len(records), 'record')}",
            remedy,
        )
    good, wrong = preflight.check_records(records, fitting, geometry, skip_bad, progress)
    side_of = {key: side for side in SIDES for m in materials[side] for key in (m.name, m.hash)}
    shape = {view.hash: _side(view) for view in geometry.views}
    light = _light_sides({name: records.light(name) for name in {r.light for r in good}}, maps)
    chosen: dict[str, list[Record]] = {side: [] for side in SIDES}
    for record in good:
        of_materials = {_side_of_material(records, name, side_of) for name in record.materials}
        others = of_materials | {light[record.light]}
        if data.all_materials_and_lights:
            others = {"train"}
        side = shape[record.geometry_hash]
        if others == {side} or (side == "validation" and "test" not in others):
            chosen[side].append(record)
    if not chosen["train"] and data.source != "relit":
        result = f"{len(good)} in which shape, material or light is held out"
        raise InputError(
            folder,
            "pictures for training",
            result,
            "render shapes, materials and lights of the training side",
        )
    return {
        side: RenderedSplit(records, geometry, of_side, wrong) for side, of_side in chosen.items()
    }


def _side_of_material(records: Records, name: str, side_of: Mapping[str, str]) -> str:
    """Return the strictest of the sides that a material's data set, name and hash put it on.

    side_of  {name or hash: side} of the materials that the run draws from
    """
    sides = {records.side(name), side_of.get(name), side_of.get(records.material(name).hash)}
    return next(side for side in ("test", "validation", "train") if side in sides)


def _light_sides(
    lights: Mapping[str, np.ndarray], maps: Mapping[str, tuple[str, np.ndarray]]
) -> dict[str, str]:
    """Return {name: side} of lights, recognised by their content; unknown ones are for training.

    maps  {name: (side, L)} of the known lights
    """
    known = KnownLights({name: L for name, (_, L) in maps.items()})
    copies = {name: known.copy_of(L) for name, L in lights.items()}
    return {name: "train" if copy is None else maps[copy][0] for name, copy in copies.items()}


def _side(view: PackedView) -> str:
    """Return the side of a view's shape: training shapes give some of theirs to validation."""
    if view.side == "test":
        return "test"
    return "validation" if number_from_hash(view.shape, VALIDATION_SHAPES) == 0 else "train"


def split_materials(
    data: Data, records: Records | None, skip_bad: bool = False
) -> tuple[dict[str, list[Material]], dict[str, str]]:
    """Return ({side: materials that a run draws from}, {name: what is wrong} of those left out).

    One in ten of the training materials, but at most eight, is set aside for validation. A data set
    with fewer than ten keeps all of them for training, and so does a run that uses all materials.

    data      says whose materials to use: the data set's own, or the built-in ones
    records   the data set's; may be None for the built-in materials
    skip_bad  whether to leave damaged materials out, instead of raising at the first
    Raises    InputError: a damaged material, no material for training
    """
    bad: dict[str, str] = {}
    if data.materials == "built-in":
        known = [(m, m.split) for m in load_catalogue().values()]
    elif records is None:
        raise ValueError("records: expected those of a data set, found none")
    else:
        known = []
        for name in records.materials:
            try:
                known.append((records.material(name), records.side(name)))
            except InputError as problem:
                if not skip_bad:
                    raise preflight.mention_skip_bad(problem) from None
                bad[name] = str(problem)
    if data.all_materials_and_lights:
        known = [(m, "train") for m, _ in known]
    train = sorted(
        (m for m, side in known if side == "train"), key=lambda m: number_from_hash(m.name, 1 << 30)
    )
    if not train:
        result = f"{len(known)}, all of them for testing" if known else "none"
        remedy = (
            'name some of the training side in the job (merl/train), or set "materials": "built-in"'
            " in the run"
        )
        raise InputError(
            "materials" if records is None else records.folder,
            "materials for training",
            result,
            remedy,
        )
    count = min(VALIDATION_MATERIALS, len(train) // LEAST_FOR_VALIDATION)
    chosen = [] if data.all_materials_and_lights else train[:count]
    names = {m.name for m in chosen}
    rest = [m for m in train if m.name not in names]
    return {
        "train": rest,
        "validation": chosen,
        "test": [m for m, side in known if side == "test"],
    }, bad
