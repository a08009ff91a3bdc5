"""`learn train` of two steps on a data set with a shape for each side."""

import json

from manifests.cli import main
from manifests.training_runs import Losses
from tests.support import synthetic
from tests.support.two_materials import SIZE, written

# all terms but those of features, of few pixels
ALL_TERMS = Losses(
    albedo=0.3,
    light_log=0.3,
    light_rendered=1,
    image=1,
    target=1,
    pixels=8,
    layer_light=(8, 16),
)
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
    synthetic.add_sides(store)
    return store
