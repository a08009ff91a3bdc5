"""A data set with pictures of the ladder's rungs direct and 8-bit, without the factory."""

import msgspec
import numpy as np

from learn.evaluation import ladder_design
from manifests import picture_files
from manifests.line_files import Lines
from tests.support.synthetic import add_shape, matte, named, with_picture, write_dataset

TURNS = (0, 30, 70)  # of the light, in texels


def written(folder, size, bright=None):
    """Writes two spheres in two materials, the light turned, as pictures of both rungs.

    Both rungs show the same picture, because nothing here casts shadows.

    bright  a material in place of the second one
    """
    both = [matte("dark", 0.2, "test"), bright or matte("bright", 0.7, "test")]
    rng = np.random.default_rng(4)
    store = write_dataset(folder, both, rng, size, 1, 0.0, TURNS, method="quadrature")
    add_shape(store, "car:1", "test")
    dataset, (path,), records = store.dataset(), store.record_files(), list(store.records())
    cameras = ladder_design.cameras(ladder_design.preset("development"))
    lines = Lines(path)
    for record in records:
        image = picture_files.read_picture(
            folder / record.image, record.camera.size, record.image_hash
        )
        geometry = (folder / record.geometry).read_bytes()
        for rung in ladder_design.RUNGS:
            if rung.name in ("direct", "8-bit"):
                words = {
                    "camera": msgspec.structs.replace(cameras[rung.cameras], size=(size, size)),
                    "tier": rung.tier,
                    "light_resolution": rung.light_resolution,
                }
                copy = named(msgspec.structs.replace(record, **words), dataset)
                digest = store.place(copy.geometry, geometry, "test")
                copy = msgspec.structs.replace(copy, geometry_hash=digest)
                lines.append(with_picture(store, copy, image))
    lines.close()
