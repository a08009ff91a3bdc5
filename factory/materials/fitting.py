"""Fits of many materials, each kept when it is done, and their catalogue.

Beside the catalogue FILE a folder FILE.fits/ holds one entry per material, named by a hash of all
that determines its fit: the measurement, the recipe, the light maps and the version of the fitting
code. A second call reads them from there; another recipe makes others.
"""

import concurrent.futures
import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from factory.materials import recipe
from factory.materials.sources import Source
from factory.materials.sphere import Sphere
from manifests import materials as catalogue
from manifests import subprocesses
from manifests.errors import InputError
from manifests.files import write_bytes
from manifests.inputs import require_file
from manifests.materials import Distance, Entry, Errors, MixtureData, Neighbour
from manifests.progress import tqdm
from manifests.reading import decode
from shaders import errors
from shaders.samples import held_out_samples

# of the fitting code: raise it with any change that alters a fit, and kept fits are made again
VERSION = 3
# cos_h, cos_d at which a measurement is hashed
PROBE = np.linspace(0.01, 0.999, 64)[:, None], np.linspace(0.05, 0.999, 16)

_WORKER: dict[str, Any] = {}  # of each worker process: sources, recipe, sphere


def key(source: Source, recipe_: recipe.Recipe, maps: Mapping[str, np.ndarray]) -> str:
    """Return the hash that names the fit of a source by a recipe under light maps."""
    digest = hashlib.sha256(
        repr(recipe_).encode() + source.name.encode() + source.measured(*PROBE).tobytes()
    )
    for name, L in maps.items():
        digest.update(name.encode() + np.asarray(L, np.float32).tobytes())
    digest.update(str(VERSION).encode())
    return digest.hexdigest()[:16]


def fit_all(
    sources: Mapping[str, Source],
    recipe_: recipe.Recipe,
    maps: Mapping[str, np.ndarray],
    out: str | Path,
    workers: int = 1,
) -> list[Entry]:
    """Return entries of all sources, in their order; each is kept under OUT.fits when it is done.

    sources  {name: Source}
    maps     {name: (height, width, 3)} light maps for the display errors, may be empty
    """
    folder = Path(f"{out}.fits")
    folder.mkdir(parents=True, exist_ok=True)
    files = {
        name: folder / f"{name}.{key(source, recipe_, maps)}.json"
        for name, source in sources.items()
    }
    todo = [name for name, file in files.items() if _kept_fit(file) is None]
    _WORKER.update(sources=sources, recipe=recipe_, files=files, sphere=None)
    bar = tqdm(
        total=len(files),
        initial=len(files) - len(todo),
        unit="material",
        desc="fitting materials",
        dynamic_ncols=True,
    )
    with bar:
        if todo and maps:
            bar.set_postfix_str("gathering the light of the maps")
            _WORKER["sphere"] = Sphere(maps, np.random.default_rng(0))  # forked workers share it
        for name in _each(todo, workers):
            bar.set_postfix_str(name)
            bar.update()
    return [msgspec.json.decode(files[name].read_bytes(), type=Entry) for name in sources]


def _kept_fit(file):
    """Return the entry of a kept fit; None if there is none, or a damaged one.

    Raises  InputError where something else than a file lies at its path
    """
    if not os.path.lexists(file):
        return None
    require_file(file, "a kept fit", "delete it")
    try:
        entry_ = decode(file.read_bytes(), Entry, file)
        catalogue.material(entry_, file)  # numbers that were altered are no JSON error
    except InputError:
        return None
    return entry_


def _each(names, workers):
    """Fit the names, in this process or in a pool of forked ones; yield each when it is done.

    Raises  InputError where a process was ended, and what a fit raises; those that were not begun
            are left out
    """
    if workers <= 1:
        for name in names:
            yield _fit_one(name)
        return
    pool = concurrent.futures.ProcessPoolExecutor(workers, _fork(), subprocesses.end_with_parent)
    remedy = "give the same command with fewer --workers: fits that are done are kept"
    for _, name in subprocesses.results_of(pool, _fit_one, names, "materials", remedy):
        yield name


def _fork():
    import multiprocessing

    return multiprocessing.get_context("fork")


def _fit_one(name):
    source, sphere = _WORKER["sources"][name], _WORKER["sphere"]
    result = recipe.round_fit(recipe.fit(source.measured, _WORKER["recipe"]), source.measured)
    write_entry(entry(source, result, sphere), _WORKER["files"][name])
    return name


def write_entry(entry_: Entry, path: str | Path) -> None:
    """Write one entry as JSON, completely or not at all."""
    write_bytes(path, msgspec.json.encode(entry_))


def entry(source: Source, fit: recipe.Fit, sphere: Sphere | None = None) -> Entry:
    """Return the catalogue's entry of a fit, with display errors if a sphere is given."""
    shown = recipe.display(fit, source.measured, sphere) if sphere else ((), (), ())
    distances = [
        Distance(_short(l1), _short(l2))
        for l1, l2 in zip(
            (fit.nodes_vs_label, fit.nodes_vs_source, fit.label_vs_source), shown, strict=True
        )
    ]
    mixture = MixtureData(**fit.mixture.to_json(recipe.DIGITS))
    label = tuple(map(float, fit.label.ravel()))
    return Entry(
        name=source.name,
        family=source.family,
        source=source.source,
        licence=source.licence,
        split=source.split,
        hash=catalogue.material_hash(label, mixture),
        errors=Errors(*distances),
        label=label,
        mixture=mixture,
    )


def _short(values):
    return tuple(float(f"{v:.4g}") for v in values)


def with_neighbours(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries, each of the test split with the nearest one of the training split.

    The distance is the relative L1 of their labels' f · cos, mean over the held-out views.
    """
    samples = held_out_samples()
    f = {e.name: errors.label_values(np.reshape(e.label, (3, 3, 2, 6)), samples) for e in entries}
    train = [e.name for e in entries if e.split == "train"]

    def nearest(e):
        if e.split == "train" or not train:
            return None
        distance = {name: errors.relative_l1(f[name], f[e.name], samples).mean() for name in train}
        name = min(distance, key=distance.__getitem__)
        return Neighbour(name, float(f"{distance[name]:.4g}"))

    return [msgspec.structs.replace(e, nearest_train=nearest(e)) for e in entries]


def duplicates(entries: Sequence[Entry]) -> list[list[str]]:
    """Return groups of names that share a hash: the same fit under several names."""
    groups: dict[str, list[str]] = {}
    for e in entries:
        groups.setdefault(e.hash, []).append(e.name)
    return [names for names in groups.values() if len(names) > 1]


def write_catalogue(
    entries: Sequence[Entry], path: str | Path, title: str, credit: str, light_maps: Iterable[str]
) -> None:
    """Write the catalogue of these entries, with their nearest training materials, to `path`."""
    catalogue.write(
        catalogue.Catalogue(
            title=title,
            credit=credit,
            light_maps=tuple(light_maps),
            materials=tuple(with_neighbours(entries)),
        ),
        path,
    )
