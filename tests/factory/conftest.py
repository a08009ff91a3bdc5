"""Assets and runs without Blender."""

import hashlib

import msgspec
import numpy as np
import pytest

from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning.assets import resolve, resolve_unread
from manifests.schema import Camera, Job
from tests.support.small_catalogue import write_catalogue
from tests.support.tetrahedron import FAKE, ROOT


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory):
    """A catalogue of three materials; its set is called "small"."""
    return write_catalogue(tmp_path_factory.mktemp("catalogue") / "small.json")


@pytest.fixture(scope="session")
def light_file(tmp_path_factory):
    """A small .exr map."""
    import OpenEXR

    path = tmp_path_factory.mktemp("light") / "lamp.exr"
    ramp = np.linspace(0.1, 2.0, 16 * 32, dtype=np.float32).reshape(16, 32)
    with OpenEXR.File(
        {"compression": OpenEXR.ZIP_COMPRESSION}, {c: ramp * (k + 1) for k, c in enumerate("RGB")}
    ) as file:
        file.write(str(path))
    return path


@pytest.fixture
def small_job(light_file):
    """Two shapes, three materials, one light, two views: 12 shots of 16 × 16."""
    return Job(
        shapes=("cube", "disc"),
        materials=("small",),
        lights=(str(light_file),),
        views=(0, 6),
        samples=1,
        camera=Camera(size=(16, 16)),
    )


@pytest.fixture
def job(small_job, tmp_path):
    """A job of the meshes in tmp_path/meshes, two views each, without pictures."""
    return msgspec.structs.replace(
        small_job, shapes=(f"{tmp_path}/meshes/",), materials=("small",), pictures=False
    )


@pytest.fixture
def plan_of(catalogue):
    """A function of a Job: its Plan."""
    return lambda job: make_plan(job, resolve(job, catalogues=[catalogue]))


@pytest.fixture
def render(plan_of, monkeypatch):
    """A function (job, folder, **manner): render with the fake studio; returns the Outcome."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def run(job, folder, watch=None, **run_options):
        return carry_out(plan_of(job), folder, RunOptions(studio=FAKE, **run_options), watch)

    return run


@pytest.fixture
def stream(catalogue, monkeypatch):
    """A function (job, folder, watch): carry out a job whose shapes are unread at its start."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def run(job, folder, watch=None, **run_options):
        plan = make_plan(job, resolve_unread(job, catalogues=[catalogue]))
        return carry_out(plan, folder, RunOptions(studio=FAKE, **run_options), watch)

    return run


@pytest.fixture
def hash_of():
    """A stand-in hash of a name."""
    return lambda name: hashlib.sha256(name.encode()).hexdigest()
