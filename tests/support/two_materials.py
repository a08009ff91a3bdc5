"""A data set of two materials under one light at two rotations, and ways to damage it."""

import numpy as np

from learn.data.geometry import Geometry
from learn.data.records import Records
from learn.data.rendered import RenderedSplit
from tests.support import synthetic

SIZE = 32


def written(folder):
    both = [synthetic.matte("dark", 0.2), synthetic.matte("light", 0.8)]
    return synthetic.write_dataset(
        folder, both, np.random.default_rng(3), size=SIZE, seeds=1, noise=0.0, category="sphere"
    )


def album_of(folder):
    records = Records(folder)
    return RenderedSplit(records, Geometry(folder, progress=False), records.records)


def first(store):
    return min(store.records(), key=lambda record: record.id)


def damage(store, kind):
    """Make one record's picture bad; returns the file."""
    record = first(store)
    path = store.folder / record.image
    if kind == "missing":
        path.unlink()
    elif kind == "truncated":
        path.write_bytes(path.read_bytes()[:-700])
    elif kind == "not finite":
        image = Records(store.folder).image(record)
        image[SIZE // 2, SIZE // 2] = np.nan
        synthetic.write_exr(
            path, {name: image[..., k].astype(np.float16) for k, name in enumerate("RGB")}
        )
    return path
