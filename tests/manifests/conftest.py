"""Records and folders made up for tests of the contract."""

import msgspec
import pytest

from manifests.line_files import Lines
from manifests.schema import (
    Camera,
    Dataset,
    LightEntry,
    MaterialEntry,
    Record,
    ShapeEntry,
    Statistics,
)
from manifests.store import Store
from manifests.store_paths import file_hash, geometry_path, image_path
from tests.support.whole_dataset import JOB, entry, write_dataset


@pytest.fixture
def a_record():
    """A function of an id: a record whose other fields are always alike, but for those given."""

    def make(id_, **changes):
        record = Record(
            id=id_,
            shape="sphere",
            shape_hash="5" * 64,
            category="primitive",
            viewpoint=0,
            azimuth_deg=0.0,
            camera=Camera(size=(8, 8)),
            materials=("matte",),
            light="lamp",
            light_hash="7" * 64,
            rotation_texels=3,
            tier="full",
            light_resolution="64x128",
            samples=4,
            seed=9,
            image=image_path(id_),
            image_hash="0" * 64,
            geometry=geometry_path("9" * 24),
            geometry_hash="0" * 64,
            split="train",
            statistics=Statistics(coverage=0.5, mean=1.0, max=2.0),
            seconds=0.1,
        )
        return msgspec.structs.replace(record, **changes)

    return make


@pytest.fixture
def a_dataset(tmp_path, a_record):
    """A folder with three records whose files are stand-ins of a few bytes; returns its Store."""
    store = Store(tmp_path / "data")
    write_materials(store)
    light = store.place("lights/lamp-777777777777.npz", b"light", "t")
    store.write_json(
        "dataset.json",
        Dataset(
            shapes={
                "sphere": ShapeEntry(
                    hash="5" * 64,
                    category="primitive",
                    side="train",
                    role="train",
                    segments=1,
                    licence="",
                )
            },
            materials={"matte": MaterialEntry(hash=hash_of_matte(store), side="train", licence="")},
            lights={
                "lamp": LightEntry(
                    hash="7" * 64,
                    file="lights/lamp-777777777777.npz",
                    file_hash=light,
                    scale=1.0,
                    licence="",
                )
            },
        ),
    )
    geometry = store.place(geometry_path("9" * 24), b"normals", "t")
    lines = Lines(store.folder / "records" / "worker-00.jsonl")
    for k in range(3):
        id_ = f"{k:024x}"
        image = store.place(image_path(id_), b"picture %d" % k, "t")
        lines.append(a_record(id_, image_hash=image, geometry_hash=geometry))
    lines.close()
    assert file_hash(store.folder / geometry_path("9" * 24)) == geometry
    return store


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """A function (segments=1, **changes of the job): the folder of a whole data set, made once;
    copy it before you change it.
    """
    made = {}

    def folder(segments=1, **changes):
        job = msgspec.structs.replace(JOB, **changes)
        if (segments, job) not in made:
            made[segments, job] = write_dataset(
                tmp_path_factory.mktemp("whole") / "data", job, segments
            ).folder
        return made[segments, job]

    return folder


def hash_of_matte(store):
    from manifests.materials import read_catalogue

    return read_catalogue(store.folder / "materials.json").materials[0].hash


def write_materials(store):
    """materials.json with one material of plain numbers."""
    from manifests.materials import Catalogue, encode

    store.place(
        "materials.json",
        encode(Catalogue(title="", credit="", materials=(entry("matte", 0.0),))),
        "t",
    )
