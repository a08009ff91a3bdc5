"""From a run's settings and folders to its batches: who is for training, who is held out."""

import hashlib

import numpy as np

from learn.data import preflight
from learn.data.geometry import Geometry
from learn.data.lights import read_maps
from learn.data.records import Records
from learn.data.relit import SIDES, Pool, Relit
from learn.data.rendered import Album, Cycles, Mix, fits
from manifests import materials, splits
from manifests.errors import Problem, closest
from shaders.envmap import same_capture

VALIDATION_SHAPES = 25  # one in so many training shapes is for choosing weights instead
VALIDATION_MATERIALS = 8
VALIDATION_LIGHTS = 6  # one in so many training maps, where the run names none
TWIN = 0.05


def by_hash(name, parts):
    """A number below `parts` that depends on the name alone."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big") % parts


def pools(data, folder, maps_file=None, progress=True, pictures=None, skip_bad=False):
    """{"train": Pool, "validation": Pool, "test": Pool}: disjoint in shapes, materials and lights, all checked before anything is trained.

    A side for which no light is left, validation or test, is lit by all maps; training never sees a held-out one.

    data       learn.data.settings.Data
    folder     a dataset with geometry; its lights are used too
    maps_file  an .npz of further light maps, or None
    pictures   a dataset with records that Cycles rendered, or None: those of `folder`, where the run asks for pictures
    skip_bad   leave out what is damaged, and count it; otherwise the first one raises
    Raises     Problem: a held-out light that is not there, a side without shapes, damaged geometry or pictures
    """
    geometry, records = Geometry(folder, progress, skip_bad), Records(folder)
    maps = {name: records.light(name) for name in records.dataset.lights} | ({} if maps_file is None else read_maps(maps_file))
    maps = without_twins(maps, (*data.validation_lights, *data.test_lights))
    held = _held_out(data, maps, records.dataset.lights)
    labels, sides = _materials(), [_side(view) for view in geometry.views]
    albums = {}
    if pictures is not None or data.source != "relit":
        known = {name: (held.get(name, "train"), L) for name, L in maps.items()}
        albums = _albums(data, pictures or folder, geometry, known, skip_bad, progress)
    found = {}
    for side in SIDES:
        views = np.array([i for i, s in enumerate(sides) if s == side])
        if not len(views):
            raise Problem(folder, f"shapes for {side}", "none", "render more shapes; a fifth of them is held out")
        names = [name for name in maps if held.get(name, "train") == side]
        if not names and side != "train":  # without maps training draws computed light, never a held-out map
            names = maps
        found[side] = Pool(geometry, views, labels[side], [maps[name] for name in sorted(names)], side, albums.get(side))
    return found


def source_of(pool, run, batch, seed, part=(0, 1)):
    """Batches of one side as a run wants them: relit, of pictures, or both. Sides without pictures are relit."""
    relit = Relit(pool, run.data, batch, run.size, seed, part)
    if run.data.source == "relit" or not pool.album:
        return relit
    cycles = Cycles(pool, run.data, batch, run.size, seed, part)
    return cycles if run.data.source == "pictures" or pool.side != "train" else Mix(relit, cycles, run.data.pictures_share)


def skipped(pools):
    """{record id or geometry hash: what is wrong} of all that was left out."""
    albums = [pool.album for pool in pools.values() if pool.album]
    return pools["train"].geometry.skipped | {key: told for album in albums for key, told in album.skipped.items()}


def _held_out(data, maps, entries):
    """{name: "validation" or "test"} of the maps that training must not see. Raises Problem for a name that is not there."""
    named = dict.fromkeys(data.test_lights, "test") | dict.fromkeys(data.validation_lights, "validation")
    for name in named:
        if name not in maps:
            raise Problem(f"held-out light '{name}'", "a light of the dataset or of --lights", "none of that name", closest(name, maps))
    if named:
        return named
    hashes = {name: entries[name].hash if name in entries else hashlib.sha256(L.tobytes()).hexdigest() for name, L in maps.items()}
    sides = {name: splits.light_side(hashes[name]) for name in maps}
    held = {name: "test" for name, side in sides.items() if side == "test"}
    return held | {name: "validation" for name in maps if name not in held and by_hash(hashes[name], VALIDATION_LIGHTS) == 0}


def _albums(data, folder, geometry, maps, skip_bad, progress):
    """{side: Album}: a picture is for training or testing if shape, materials and light all are; for validation if its shape is and nothing
    of it is for testing. maps: {name: (side, L)}. Raises Problem for no pictures, or damaged ones.
    """
    records = Records(folder)
    geometry = geometry if geometry.folder.resolve() == records.folder.resolve() else Geometry(folder, progress, skip_bad)
    fitting = [r for r in records.records if fits(r, data.regions)]
    if not fitting:
        remedy = "render some: python -m factory render JOB, or take another number of regions"
        raise Problem(folder, f"pictures of {data.regions} material{'s' * (data.regions > 1)}", f"none in {len(records)} records", remedy)
    good, wrong = preflight.checked(records, fitting, geometry, skip_bad, progress)
    labels = _materials()
    material = {name: side for side in SIDES for name in labels[side]}
    shape = {view.hash: _side(view) for view in geometry.views}
    light = {name: _light_side(records.light(name), maps) for name in {r.light for r in good}}
    chosen = {side: [] for side in SIDES}
    for record in good:
        of_materials = {material.get(name) or _own_side(records.dataset, name) for name in record.materials}
        others = of_materials | {light[record.light]}
        side = shape[record.geometry_hash]
        if others == {side} or (side == "validation" and "test" not in others):
            chosen[side].append(record)
    if not chosen["train"] and data.source != "relit":
        found = f"{len(good)} in which shape, material or light is held out"
        raise Problem(folder, "pictures for training", found, "render shapes, materials and lights of the training side")
    return {side: Album(records, geometry, of_side, wrong) for side, of_side in chosen.items()}


def _own_side(dataset, name):
    """The side of a material that only this dataset knows."""
    return dataset.materials[name].side if name in dataset.materials else "train"


def _light_side(L, maps):
    """The side of the map that this one is, under whatever name; maps that nobody knows are for training."""
    return next((side for side, other in maps.values() if same_capture(L, other) or twins(L, other)), "train")


def without_twins(maps, held):
    """Each capture once, under the name by which it is held out if it is: a copy under another name would let training see it.

    maps  {name: L}; held: names of maps that training must not see
    Raises  Problem if two held-out names mean one map
    """
    kept = {}
    for name in sorted(maps, key=lambda name: name not in held):
        twin = next((other for other, L in kept.items() if (same_capture(L, maps[name]) or twins(L, maps[name]))), None)
        if twin is None:
            kept[name] = maps[name]
        elif name in held:
            raise Problem(f"held-out light '{name}'", "a map of its own", f"'{twin}' again", "name each held-out map once")
    return kept


def twins(a, b):
    """Whether two maps (64, 128, 3) are one, turned or mirrored: their Fourier amplitudes along rows are then the same.

    Averaging to 64×128 by other programs and half floats move them by less than TWIN of the whole.
    """
    A, B = (np.abs(np.fft.rfft(L, axis=1)) for L in (a, b))
    return float(np.abs(A - B).sum() / B.sum()) < TWIN


def _side(view):
    if view.side == "test":
        return "test"
    return "validation" if by_hash(view.shape, VALIDATION_SHAPES) == 0 else "train"


def _materials():
    """{side: {name: label (108,) float32}}: MERL's split of the catalogue; RGL's train; some training ones are for validation."""
    catalogue = materials.load_catalogue()
    train = sorted((name for name, m in catalogue.items() if m.split == "train"), key=lambda name: by_hash(name, 1 << 30))
    chosen = set(train[:VALIDATION_MATERIALS])
    labels = {name: m.label.reshape(-1).astype(np.float32) for name, m in catalogue.items()}
    return {
        "train": {name: labels[name] for name in train if name not in chosen},
        "validation": {name: labels[name] for name in chosen},
        "test": {name: labels[name] for name, m in catalogue.items() if m.split == "test"},
    }
