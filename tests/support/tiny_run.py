"""`learn train` of two steps on a data set with a shape for each side."""

import json

from learn.data.sources import VALIDATION_SHAPES, number_from_hash
from manifests.cli import main
from tests.support import synthetic
from tests.support.two_materials import SIZE, written

RUN = {
    "name": "tiny",
    "size": SIZE,
    "parts": ["normals"],
    "data": {"sharing": 1, "source": "pictures"},
    "losses": {"normals": 1, "material": 0},
    "schedule": {"steps": 2, "batch": 4, "warm_up": 1},
}


def train(store, out, *options, run=RUN):
    path = store.folder / "run.json"
    path.write_text(json.dumps(run))
    words = [
        "train",
        str(path),
        "--data",
        str(store.folder),
        "--out",
        str(out),
        "--workers",
        "0",
        *options,
    ]
    return main("learn", "", ("train",), words)


def two_sided(folder):
    """The Store of a data set with a shape for each side, four pictures of each."""
    store = written(folder)
    chosen = next(
        f"ball:{k}" for k in range(1000) if number_from_hash(f"ball:{k}", VALIDATION_SHAPES) == 0
    )
    for shape, side in ((chosen, "train"), ("cube:1", "test")):
        synthetic.add_shape(store, shape, side)
    return store
