"""From a run's settings and folders to its batches: who is for training, who is held out."""

import hashlib

import numpy as np

from learn.dataset import Records
from learn.geometry import Geometry
from learn.training.lights import read_maps
from learn.training.relit import Pool
from manifests import materials
from manifests.problems import Problem, closest
from shaders.envmap import same_capture

VALIDATION_SHAPES = 25  # one in so many training shapes is for choosing weights instead
VALIDATION_MATERIALS = 8
TWIN = 0.05


def by_hash(name, parts):
    """A number below `parts` that depends on the name alone."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big") % parts


def pools(data, folder, maps_file=None, progress=True):
    """{"train": Pool, "validation": Pool, "test": Pool}: disjoint in shapes, materials and the lights that the run names.

    A side for which no light is named, validation or test, is lit by all maps; training never sees a named one.

    data       learn.training.settings.Data
    folder     a dataset with geometry; its lights are used too
    maps_file  an .npz of further light maps, or None
    Raises     Problem: a held-out light that is not there, a side without shapes
    """
    geometry = Geometry(folder, progress)
    maps = {} if maps_file is None else read_maps(maps_file)
    records = Records(folder)
    maps = {name: records.light(name) for name in records.dataset.lights} | maps
    for name in (*data.validation_lights, *data.test_lights):
        if name not in maps:
            raise Problem(f"held-out light '{name}'", "a light of the dataset or of --lights", "none of that name", closest(name, maps))
    maps = without_twins(maps, (*data.validation_lights, *data.test_lights))
    held = {"validation": data.validation_lights, "test": data.test_lights}
    held["train"] = [name for name in maps if name not in {*data.validation_lights, *data.test_lights}]
    labels, sides = _materials(), [_side(view) for view in geometry.views]
    found = {}
    for side in ("train", "validation", "test"):
        views = np.array([i for i, s in enumerate(sides) if s == side])
        if not len(views):
            raise Problem(folder, f"shapes for {side}", "none", "render more shapes; a fifth of them is held out")
        names = held[side] if side == "train" else held[side] or maps  # without maps training draws computed light, never a held-out map
        lit = [maps[name] for name in sorted(names)]
        found[side] = Pool(geometry, views, labels[side], lit, side)
    return found


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
