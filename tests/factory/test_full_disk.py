"""Every command of `factory` that writes, where the disk is full: one line, no draft, nothing lost, and the same command succeeds later.

RLIMIT_FSIZE stands for the full disk: it needs no root. tests/endurance/full_disk.py does the same on real small file systems.
"""

import pytest
from full_disk_case import check
from full_disk_commands import mesh, pictures
from tetrahedron import FAKE, HERE

from factory.assets import resolve
from factory.run import Manner, carry_out, planned
from manifests.schema import Camera, Job

QUICK = (
    "preview",
    "export --tars",
    "export --parquet",
    "lights preview",
    "lights add",
    "lights add, of npz",
    "materials preview",
    "materials report",
    "shapes preview",
    "shapes add",
)


@pytest.fixture(scope="module")
def room(tmp_path_factory, catalogue, light_file):
    """What the commands read; the data set's pictures are made by the fake studio."""
    room = tmp_path_factory.mktemp("room")
    pictures(room)
    mesh(room)
    job = Job(shapes=("cube",), materials=("small",), lights=(str(light_file),), views=(0, 6), samples=1, camera=Camera(size=(16, 16)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(HERE))
        carry_out(planned(job, resolve(job, catalogues=[catalogue])), room / "data", Manner(studio=FAKE))
    return room


@pytest.mark.parametrize("name", QUICK)
def test_a_full_disk_costs_a_line_and_nothing_else(room, tmp_path, small_files, name):
    if name == "export --parquet":
        pytest.importorskip("pyarrow", reason="needs pyarrow, which is optional")
    check(name, room, tmp_path, small_files, seed=QUICK.index(name))
