"""From one command to records, with Cycles: what is written is what was asked for, and every file
of it can be read back.
"""

import json
import subprocess
import sys
from collections import Counter

import msgspec
import numpy as np
import pytest

from factory.execution.forecast import count_events, probe, probe_shots
from factory.execution.run import RunOptions, carry_out, make_plan
from factory.preview.contact_sheet import light_of_record, render_by_labels
from factory.preview.shading import lights, mirror_sphere, shade
from manifests.materials import load_catalogue
from manifests.picture_files import read_geometry, read_picture
from manifests.schema import Camera, Job
from manifests.store import Store
from manifests.verification import faults_of
from shaders import dsbrdf, envmap
from shaders.frames import camera_from_light
from tests.support.tetrahedron import TETRAHEDRON

blender = pytest.mark.blender


@pytest.fixture(scope="module")
def made(catalogue, light_file, tmp_path_factory):
    """A dataset of a chair in two materials, a mesh file and a sphere; both light resolutions, all
    tiers, two seeds; its Store.
    """
    from factory.planning.assets import resolve

    folder = tmp_path_factory.mktemp("made")
    (folder / "solid.ply").write_bytes(TETRAHEDRON)
    job = Job(
        shapes=("sphere:5", "chair:2", str(folder / "solid.ply")),
        materials=("small",),
        lights=(str(light_file),),
        views=(0, 7),
        rotations=(5,),
        tiers=("direct", "shadow", "full"),
        light_resolutions=("64x128", "full"),
        samples=4,
        camera=Camera(size=(24, 32)),
        segment_materials=1,
        seed=11,
    )
    outcome = carry_out(
        make_plan(job, resolve(job, catalogues=[catalogue])),
        folder / "data",
        RunOptions(device="cpu", threads=1),
    )
    assert (outcome.made, outcome.failed) == (36, 0)
    return Store(folder / "data")


@blender
def test_the_folder_verifies(made):
    assert [f.text for f in faults_of(made)] == []


@blender
def test_geometry_is_rendered_once_a_shape_and_view(made):
    records = list(made.records())
    assert len({r.image for r in records}) == 36
    assert (
        len({r.geometry for r in records})
        == 6
        == sum(1 for _ in (made.folder / "geometry").rglob("*.exr"))
    )


@blender
def test_each_segment_has_a_material_of_its_own(made):
    chairs = [r for r in made.records() if r.shape == "chair:2"]
    assert all(len(set(r.materials)) == 2 for r in chairs)
    segments = read_geometry(made.folder / chairs[0].geometry).segments
    assert set(np.unique(segments)) == {0, 1, 2}


@blender
def test_settings_versions_and_licences_are_written_down(made):
    dataset = made.dataset()
    ((_, settings),) = dataset.settings.items()
    assert settings["picture"]["cycles.use_denoising"]["value"] is False
    assert settings["picture"]["cycles.use_denoising"]["reason"]
    assert dataset.versions["blender"].startswith("4.")
    assert (
        dataset.shapes["chair:2"].licence == "Apache-2.0"
        and dataset.shapes["solid"].licence == "unstated"
    )
    assert set(dataset.lights) == {"lamp"}


@blender
def test_the_stored_light_is_the_one_that_lit_the_picture(made):
    """A matte sphere, direct: the label's sum over the stored, rolled map gives what Cycles gave,
    to its noise at 4 samples.
    """
    materials, dataset = load_catalogue(made.folder / "materials.json"), made.dataset()
    checked = 0
    for record in made.records():
        if (
            record.shape != "sphere:5"
            or record.tier != "direct"
            or record.materials != ("matte",)
            or record.light_resolution != "64x128"
        ):
            continue
        normals, _, segments, _ = geometry = read_geometry(made.folder / record.geometry)
        mask = geometry.mask
        light = light_of_record(made, dataset, record)
        label = render_by_labels(
            record, normals, segments, np.zeros_like(normals), materials, light, np.radians(20.0)
        )
        picture = read_picture(made.folder / record.image)
        inner = (
            mask
            & np.roll(mask, 1, 0)
            & np.roll(mask, -1, 0)
            & np.roll(mask, 1, 1)
            & np.roll(mask, -1, 1)
        )
        # 250 pixels × 4 samples of relative noise near 0.5: the mean is good to 1.6 %
        assert picture[inner].mean() == pytest.approx(label[inner].mean(), rel=0.06)
        # brighter and darker sides agree: a light turned by 5 texels, mirrored or at another
        # azimuth would not correlate so
        assert np.corrcoef(_blurred(picture.mean(-1))[inner], label.mean(-1)[inner])[0, 1] > 0.9
        checked += 1
    assert checked  # seed 11 draws the matte material for the sphere


def _blurred(values):
    return sum(np.roll(np.roll(values, i, 0), j, 1) for i in (-1, 0, 1) for j in (-1, 0, 1)) / 9


@blender
def test_one_command_without_a_job_makes_pictures_and_a_second_adds_to_them(
    catalogue, light_file, tmp_path
):
    def render(*more):
        words = [
            sys.executable,
            "-c",
            CALL,
            "render",
            "--mesh",
            "sphere:4",
            "--material",
            "matte",
            "--light",
            str(light_file),
            "--size",
            "16",
        ]
        words += [
            "--samples",
            "1",
            "--out",
            str(tmp_path / "data"),
            "--catalogue",
            str(catalogue),
            "--device",
            "cpu",
            *more,
        ]
        return subprocess.run(words, capture_output=True, text=True)

    first = render("--views", "0,6")
    assert first.returncode == 0 and first.stdout.startswith("2 pictures made"), first.stderr
    second = render("--views", "0,6,12", "--material", "metal", "--fov", "40")
    assert second.returncode == 0 and second.stdout.startswith("6 pictures made"), second.stderr
    assert len(Store(tmp_path / "data").ids()) == 8
    third = render("--views", "0,6")
    assert third.stdout.startswith("0 pictures made") and "2 were there" in third.stdout
    words = [
        sys.executable,
        "-c",
        CALL,
        "preview",
        str(tmp_path / "data"),
        "--out",
        str(tmp_path / "p"),
        "--count",
        "4",
        "--size",
        "32",
    ]
    shown = subprocess.run(words, capture_output=True, text=True)
    assert shown.returncode == 0, shown.stderr
    assert (tmp_path / "p" / "sheet.png").stat().st_size > 1000 and "<img" in (
        tmp_path / "p" / "index.html"
    ).read_text()


CALL = """
import sys
from manifests.cli import main
sys.exit(main("factory", "", ("render", "preview"), sys.argv[1:]))
"""


@blender
def test_the_forecast_is_made_of_real_shots_and_leaves_nothing_behind(plan_of, small_job):
    plan = plan_of(msgspec.structs.replace(small_job, shapes=("sphere:3", "cube", "disc")))
    shots = list(probe_shots(plan))
    assert len({shot.shape for shot in shots[:3]}) == 3
    assert len({shot.id for shot in shots}) == len(shots) > 10
    # no shape has most of them
    assert max(Counter(shot.shape for shot in shots).values()) < 0.6 * len(shots)
    forecast = probe(plan, RunOptions(device="cpu"))
    assert 0 < forecast.hours < 1 and 0 < sum(forecast.bytes.values()) < 1e7
    assert {"shape", "light", "geometry", "picture", "writing"} <= set(forecast.seconds)


def test_events_are_counted_as_they_will_happen(plan_of, small_job):
    events = count_events(plan_of(small_job))
    assert events == {
        "shape": 2,
        "geometry": 4,
        "picture": 12,
        "writing": 12,
        "light": 1,
        "materials": 6,
    }


def test_the_plain_sum_gives_irradiance_over_pi_for_a_matte_label(rng):
    """κ chosen so that expm1(κ) = ρ/π and γ = e⁻¹²: f is constant to 1e-5, so radiance = ρ/π ×
    irradiance.
    """
    rho = 0.7
    m = np.zeros((3, 3, 2, 6))
    m[:, 0, 0], m[:, :, 1] = np.log1p(rho / np.pi), np.exp(-12.0)
    L = rng.uniform(0, 1, (64, 128, 3))
    n = rng.normal(size=(20, 3))
    n[:, 2] = np.abs(n[:, 2]) + 0.3
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    w, solid_angle = envmap.directions(64, 128)
    cosine = np.maximum(n @ camera_from_light(0.35) @ w.reshape(-1, 3).T, 0)
    irradiance = cosine @ (L * solid_angle[..., None]).reshape(-1, 3)
    views = np.broadcast_to([0.0, 0.0, 1.0], n.shape)
    for v in (None, views):
        # h·n = 0 texels are left out
        assert shade(n, m, L, 0.35, v) == pytest.approx(rho / np.pi * irradiance, rel=2e-3)


def test_the_plain_sum_is_the_sum_over_texels_of_the_brdf_of_each_pair_of_directions(rng):
    """Against dsbrdf.evaluate, one pixel and all texels at a time, a view of its own for each
    pixel.
    """
    m = rng.uniform(0.05, 1.0, (3, 3, 2, 6))
    m[:, 1, 1], m[:, 2, 1] = 20.0, 300.0
    L = rng.uniform(0, 1, (8, 16, 3))
    n = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.48, 0.8773]])
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    w, power = lights(L, 0.35)
    for views in (
        np.tile([[0.0, 0.0, 1.0]], (3, 1)),
        np.array([[0.1, 0.0, 0.99498744], [0.0, 0.2, 0.9797959], [0.0, 0.0, 1.0]]),
    ):
        expected = []
        for normal, view in zip(n, views, strict=True):
            h, theta_d = dsbrdf.half_angles(w, view)
            f = dsbrdf.evaluate(m, h @ normal, theta_d)
            expected.append((f * np.maximum(w @ normal, 0)[:, None] * power).sum(0))
        distant = (views == views[2]).all()
        assert shade(n, m, L, 0.35, None if distant else views) == pytest.approx(
            np.array(expected), rel=1e-9
        )


def test_the_light_ball_shows_in_its_middle_what_is_behind_the_viewer():
    L = np.zeros((64, 128, 3))
    row, column = envmap.texel(
        camera_from_light(np.radians(20)).T @ np.array([0.0, 0.0, 1.0]), 64, 128
    )
    L[row - 1 : row + 2, column - 1 : column + 2] = 1.0
    ball = mirror_sphere(L, 33, np.radians(20))
    assert ball[16, 16].max() == 1.0 and ball[0, 0].max() == 0.0
    assert np.argwhere(ball.max(-1) > 0).mean(0) == pytest.approx([16, 16], abs=1)


def test_a_job_in_the_dataset_reads_as_it_was_written(render, small_job, tmp_path):
    render(small_job, tmp_path, limit=1)
    assert Store(tmp_path).dataset().orders[0].job == small_job
    assert json.loads((tmp_path / "dataset.json").read_text())["orders"][0]["shots"] == 12
