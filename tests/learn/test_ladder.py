"""The ladder: its design, the pictures of each rung, and a run on a small dataset whose pictures
are computed here.
"""

import json
import shutil
from dataclasses import replace
from itertools import combinations, pairwise
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from learn.commands import evaluate_ladder
from learn.data.records import Records
from learn.evaluation import (
    ladder,
    ladder_design,
    ladder_evaluator,
    ladder_lines,
    ladder_pictures,
    ladder_report,
)
from learn.evaluation.ladder_design import OWN_GROUP, PARTS, RUNGS
from learn.metrics.pictures import display_l2, l2_after_alignments
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.weights import save_weights
from learn.refinement import RefinementSettings
from manifests import exr, picture_files, splits
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.materials import BUILT_IN, load_catalogue
from manifests.reading import read
from manifests.schema import Camera, Job
from shaders import frames, tone
from tests.support import fake_ray
from tests.support.synthetic import SHAPE, add_shape, matte, named, with_picture, write_dataset

SIZE = 32
ALBEDOS = {"dark": 0.2, "bright": 0.7}


@pytest.fixture(scope="module")
def job():
    """A side of one car and one light, in one part."""
    return Job(
        name="ladder-small",
        shapes=("car:1000-1000",),
        materials=tuple(ALBEDOS),
        lights=("sky",),
        tiers=("direct", "shadow", "full"),
        samples=1,
        camera=Camera(size=(SIZE, SIZE), pixel="centre"),
    )


@pytest.fixture
def small(monkeypatch, job):
    """The small side instead of the presets."""
    monkeypatch.setattr(ladder_design, "PARTS", 1)
    monkeypatch.setattr(ladder_design, "preset", lambda side: job)


@pytest.fixture(scope="module")
def data(tmp_path_factory, job):
    """A sphere twice, as car:1000 and as a mesh from outside, on every rung in both materials.

    All rungs but the camera's show the same picture, because nothing here casts shadows.
    """
    folder = tmp_path_factory.mktemp("data")
    entries = [matte(name, albedo, "test") for name, albedo in ALBEDOS.items()]
    store = write_dataset(
        folder,
        entries,
        np.random.default_rng(2),
        size=SIZE,
        seeds=1,
        noise=0.0,
        rotations=(0,),
        method="quadrature",
    )
    (path,) = store.record_files()
    dataset, first = store.dataset(), list(store.records())
    lines = Lines(path)
    for set_, camera in ladder_design.cameras(job).items():
        for record in first:
            image = picture_files.read_picture(
                folder / record.image, record.camera.size, record.image_hash
            )
            made = msgspec.structs.replace(record, camera=camera)
            made = named(made, dataset)
            made = msgspec.structs.replace(
                made, geometry_hash=store.place(made.geometry, geometry_of(camera), "test")
            )
            for rung in RUNGS:
                if rung.cameras != set_ or (rung.eight_bit and set_ == "square"):
                    continue
                words = {"tier": rung.tier, "light_resolution": rung.light_resolution}
                rungs = named(msgspec.structs.replace(made, **words), dataset)
                lines.append(with_picture(store, rungs, image))
    lines.close()
    add_shape(store, "car:1000", "test")
    return folder


def geometry_of(camera):
    """The bytes of a sphere's geometry file, without pixels that perspective turns away."""
    x, y = (axis * camera.half_extent for axis in frames.pixel_grid(*camera.size))
    mask = x * x + y * y < 1
    n = np.stack([x, y, np.sqrt(np.where(mask, 1 - x * x - y * y, 0))], -1).astype(np.float32)
    fov = None if camera.fov_deg is None else np.radians(camera.fov_deg)
    view = frames.view_vectors(*camera.size, fov=fov)
    mask &= (n * view).sum(-1) > 1e-3
    n = np.where(mask[..., None], n, 0)
    channels = {f"normal.{axis}": n[..., k] for k, axis in enumerate("XYZ")}
    return exr.encode(channels | {"depth.Z": n[..., 2], "segment": mask.astype(np.uint32)})


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A compact network that knows nothing."""
    torch.manual_seed(3)
    labels = torch.stack([torch.tensor(matte("a", albedo).label) for albedo in (0.1, 0.4)]).float()
    network = Compact(Ranges.of(labels))
    path = tmp_path_factory.mktemp("weights") / "weights.safetensors"
    save_weights(path, network, network.state_dict(), "{}", SIZE)
    return path


@pytest.fixture
def options(data, weights, tmp_path, small):
    return ladder.Options(data, weights, tmp_path / "out")


@pytest.fixture(scope="module")
def measured(data, weights, job, tmp_path_factory):
    """What `options` leave in an empty folder: its path, and the report."""
    options = ladder.Options(data, weights, tmp_path_factory.mktemp("measured") / "out")
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ladder_design, "PARTS", 1)
        patch.setattr(ladder_design, "preset", lambda side: job)
        torch.set_num_threads(1)  # as in the tests
        try:
            return SimpleNamespace(out=options.out, report=ladder.evaluate(options))
        finally:
            torch.set_num_threads(threads)


@pytest.fixture
def continued(options, measured):
    """`options` of a folder in which they are already measured."""
    shutil.copytree(measured.out, options.out)
    return options


def test_the_sides_share_no_shape_or_light():
    sides = [ladder_design.preset(side) for side in ladder_design.SIDES]
    for get in (lambda job: ladder_design._each(job.shapes), lambda job: job.lights):
        for one, other in combinations(sides, 2):
            assert len(get(one)) > 1 and not set(get(one)) & set(get(other))
    assert [len(job.lights) for job in sides] == [9, 9, 9]
    assert [len(ladder_design.light_seeds(job)) for job in sides] == [6, 9, 9]


def test_materials_of_a_side_are_for_testing_and_no_others_are_in_the_first_two():
    known = load_catalogue(*BUILT_IN)
    development, test, second = (
        set(ladder_design.preset(side).materials) for side in ladder_design.SIDES
    )
    assert len(development) == len(test) == len(second) == 6 and not development & test
    assert all(known[name].split == "test" for name in development | test | second)
    # only four metals are for testing: two of them come again on the third side
    assert {known[n].family for n in second & (development | test)} == {"metal"}


def test_the_second_test_side_has_families_that_no_training_has_on_two_rungs():
    side = ladder_design.preset("second-test")
    assert [rung.name for rung in ladder_design.rungs_of(side)] == ["direct", "8-bit"]
    jobs = ladder_design.jobs(side, ["a.obj"])
    assert len(jobs) == 2 * PARTS
    assert {job.tiers for name, job in jobs.items() if "centre" in name} == {("direct",)}
    assert {job.light_resolutions for name, job in jobs.items() if "square" in name} == {("full",)}
    for spec in ladder_design._each(side.shapes):
        assert splits.is_test_only(spec)
        group, family = ladder_design.group_of(spec, "")
        assert group == "held-out families" and spec.startswith(family)


def test_jobs_show_the_same_shapes_materials_and_lights_on_every_rung():
    side = ladder_design.preset("development")
    jobs = ladder_design.jobs(side, ["a.obj", "b.obj"])
    assert len(jobs) == 3 * PARTS
    shapes = []
    for part in range(PARTS):
        of_part = [jobs[f"{side.name}-{set_}-{part}"] for set_ in ladder_design.SETS]
        assert len({(job.shapes, job.materials, job.lights, job.views) for job in of_part}) == 1
        shapes += of_part[0].shapes
        assert len(of_part[0].materials) == 2 and len(of_part[0].lights) == 3
    assert sorted(shapes) == sorted([*ladder_design._each(side.shapes), "a.obj", "b.obj"])
    tiers = [jobs[f"{side.name}-{set_}-0"].tiers for set_ in ladder_design.SETS]
    assert tiers == [("direct", "shadow", "full"), ("full",), ("full",)]


def test_each_rung_differs_from_the_one_before():
    keys = ("cameras", "tier", "light_resolution", "eight_bit")
    differences = [
        {key for key in keys if getattr(a, key) != getattr(b, key)} for a, b in pairwise(RUNGS)
    ]
    # square pixels and the full-resolution light come together, as the ladder says
    assert differences == [
        {"tier"}, {"tier"}, {"cameras", "light_resolution"}, {"eight_bit"}, {"cameras"},
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "group"),
    [
        ("chair:1000", (OWN_GROUP, "chair")),
        ("dish:3", ("held-out families", "dish")),
        ("vessel:3", ("general families of training", "vessel")),
        ("kettle", ("outside meshes", "object")),
        ("kettle:2", ("outside meshes", "object")),
    ],
)
def test_groups_follow_from_names(shape, group):
    assert ladder_design.group_of(shape, "object") == group


def test_scenes_are_the_same_on_every_rung(data, job, small):
    scenes = ladder_design.scenes(Records(data).records, job)
    assert {scene.shape for scene in scenes} == {"car:1000", "sphere"}
    for scene in scenes:
        pictures = [*scene.source.values(), *scene.truth.values()]
        assert set(scene.source) == set(scene.truth) == {rung.name for rung in RUNGS}
        assert {picture.shape for picture in pictures} == {scene.shape}
        assert len({picture.materials for picture in scene.source.values()}) == 1
        assert scene.source["direct"].materials != scene.truth["direct"].materials
        assert scene.source["full"].tier == "full" and scene.source["camera"].camera.fov_deg


def test_missing_pictures_are_counted(data, job, small):
    records = [record for record in Records(data).records if record.tier != "shadow"]
    with pytest.raises(InputError, match=r"12 pictures.*2 missing.*car:1000, sky, shadow"):
        ladder_design.scenes(records, job)
    with pytest.raises(InputError, match="found none"):
        ladder_design.scenes(records, job, incomplete=True)
    one = [r for r in Records(data).records if r.tier != "shadow" or r.shape == "sphere"]
    assert [s.shape for s in ladder_design.scenes(one, job, incomplete=True)] == ["sphere"]


def test_perspective_is_taken_out_of_normals():
    view = frames.view_vectors(9, 9, np.radians(50))
    assert np.allclose(frames.turned_to_viewer(view, view), (0, 0, 1))
    n = np.random.default_rng(0).standard_normal((9, 9, 3))
    turned = frames.turned_to_viewer(n, view)
    assert np.allclose(np.linalg.norm(turned, axis=-1), np.linalg.norm(n, axis=-1))
    assert np.allclose(turned[..., 2], (n * view).sum(-1))
    assert np.allclose(frames.turned_to_viewer(n, frames.view_vectors(9, 9)), n)


def test_a_png_clips_and_rounds_and_nothing_else():
    radiance = np.linspace(0, 3, 40 * 40 * 3).reshape(40, 40, 3)
    mask = np.zeros((40, 40), bool)
    mask[4:36, 4:36] = True
    exposure = tone.auto_exposure(radiance, mask)
    back, read_mask = ladder_pictures.through_png(radiance, mask)
    assert (read_mask == mask).all()
    difference = tone.display(back, 1.0) - tone.display(radiance, exposure)
    assert np.abs(difference[mask]).max() < 0.51
    assert back[mask].max() == pytest.approx(1) and (radiance * exposure)[mask].max() > 1


def test_pictures_of_rungs(data, job, small):
    records = Records(data)
    scene = ladder_design.scenes(records.records, job)[0]
    by_name = {rung.name: ladder_pictures.load_scene(records, scene, rung, SIZE) for rung in RUNGS}
    direct, eight_bit, camera = (by_name[name] for name in ("direct", "8-bit", "camera"))
    assert torch.equal(direct.batch.image, by_name["full"].batch.image) and direct.exposure == 1
    for picture in by_name.values():
        n = picture.batch.n[0].numpy()
        assert np.allclose(np.linalg.norm(n, axis=0)[picture.mask], 1, atol=1e-5)
        assert (n[2][picture.mask] > 0).all() and picture.batch.image.shape[-1] == SIZE
        assert (picture.target[~picture.mask] == 0).all()
    # the exposure of a file is estimated, and its truth keeps the true one
    assert eight_bit.exposure != 1
    assert eight_bit.target.max() == pytest.approx(direct.target.max(), rel=0.2)
    assert eight_bit.mask.sum() < direct.mask.sum()  # a margin about the object
    sample = records.load(scene.source["camera"])
    facing = (sample.n * sample.view).sum(-1).numpy()
    assert np.allclose(ladder_pictures.ray_frame_normals(sample)[..., 2], facing, atol=1e-6)
    assert not np.allclose(sample.n[..., 2], facing, atol=0.05)
    # what is compared with a prediction is that, cropped: the sphere's middle faces the viewer
    assert camera.batch.n[0, 2].max() > 0.99


def test_alignment_is_free_of_exposure():
    rng = np.random.default_rng(4)
    truth, mask = rng.uniform(0.01, 1, (8, 8, 3)), np.ones((8, 8), bool)
    one_factor = lambda picture: l2_after_alignments(picture, truth, mask)["l2_one_factor"]  # noqa: E731
    assert one_factor(3.7 * truth) < 0.05
    other = rng.uniform(0.01, 1, (8, 8, 3))
    least = one_factor(other)
    assert 100 < least <= display_l2(other, truth, mask)
    assert one_factor(0.2 * other) == pytest.approx(least, rel=0.02)


def test_a_run_and_its_continuation(continued, measured, monkeypatch):
    options, report = continued, measured.report
    lines = ladder.rows_of(options.out)
    assert len(lines) == 2 * len(RUNGS)
    # Cycles is the layer here, so that true parts give the truth
    floors = [line["floor_l2"] for line in lines.values() if line["rung"] in ("direct", "square")]
    assert len(floors) == 4 and max(floors) < 0.05
    assert all(line["floor_l2"] is None for line in lines.values() if line["rung"] == "camera")
    names = [row["name"] for row in report["tables"]["ladder"]["rows"]]
    assert names == [f"{g}: {r.name}" for g in (OWN_GROUP, "outside meshes") for r in RUNGS]
    assert report["headline"][0].startswith("Own families, full transport, 8-bit PNG: normals ")
    for line in lines.values():
        of = line["predicted"]
        assert of["edit_l2_three_factors"] <= of["edit_l2_aligned"] + 1e-3 <= of["edit_l2"] + 2e-3
    cells = report["tables"]["alignment"]["rows"][0]["cells"]
    (direct,) = [e for e in lines.values() if (e["shape"], e["rung"]) == ("car:1000", "direct")]
    assert cells["edit_l2_three_factors_mean"] == direct["predicted"]["edit_l2_three_factors"]
    assert "refined_alignment" not in report["tables"]
    text = (options.out / "report.md").read_text()
    assert "the layer itself can compute" in text and "![" in text and "1 light." in text
    assert (options.out / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((options.out / "report.json").read_text())["about"]["designed"] == 1

    def never(*_):
        raise AssertionError("measured twice")

    monkeypatch.setattr(ladder_evaluator.LadderEvaluator, "measure", never)
    assert ladder.evaluate(options)["tables"] == report["tables"]


def test_lines_of_before_have_no_row_of_alignments(measured):
    """Their other tables are made all the same."""
    lines = list(ladder.rows_of(measured.out).values())
    for line in lines:
        line["predicted"]["edit_l2_three_factors"] = None
    assert ladder_report.aligned_table(lines, "predicted", "") is None
    assert ladder_report.ladder_table(lines) is not None


def test_some_rungs_are_measured_without_pictures_of_the_others(options, data, job, small):
    assert tuple(rung.name for rung in RUNGS) == evaluate_ladder.RUNGS
    report = ladder.evaluate(replace(options, rungs=("8-bit", "square")))
    lines = ladder.rows_of(options.out).values()
    assert [line["rung"] for line in lines] == 2 * ["square", "8-bit"]
    assert len(report["tables"]["ladder"]["rows"]) == 4
    some = [r for r in Records(data).records if r.camera.pixel == "square"]
    (square,) = [rung for rung in RUNGS if rung.name == "square"]
    assert len(ladder_design.scenes(some, job, rungs=(square,))) == 2
    with pytest.raises(InputError):
        ladder_design.scenes(some, job)


def test_more_refined_scenes_are_added(continued, monkeypatch):

    def unrefined(batch, prediction, labels):
        return SimpleNamespace(prediction=prediction)

    monkeypatch.setattr(ladder_evaluator, "refine", unrefined)
    report = ladder.evaluate(replace(continued, refined=1))
    lines = ladder.rows_of(continued.out).values()
    assert all(line["refined"] == line["predicted"] for line in lines)
    rows = report["tables"]["refinement"]["rows"]
    assert len(rows) == 2 * len(RUNGS) and rows[0]["cells"]["ratio"] == pytest.approx(1)
    same = [report["tables"][f"{kind}alignment"]["rows"] for kind in ("", "refined_")]
    assert same[0] == same[1]


def test_a_side_of_two_rungs_is_measured_and_charted_on_them(options, monkeypatch):
    names = ("direct", "8-bit")
    monkeypatch.setitem(ladder_design.RUNGS_OF, "ladder-small", names)
    report = ladder.evaluate(options)
    assert {line["rung"] for line in ladder.rows_of(options.out).values()} == set(names)
    rows = report["tables"]["ladder"]["rows"]
    assert [row["name"] for row in rows] == [
        f"{group}: {name}" for group in (OWN_GROUP, "outside meshes") for name in names
    ]
    assert "unknown camera" not in (options.out / "report.md").read_text()


def test_other_settings_are_refused(continued, monkeypatch):
    monkeypatch.setattr(
        ladder, "RefinementSettings", lambda: RefinementSettings(outer_iterations=7)
    )
    with pytest.raises(InputError, match="other refine"):
        ladder.evaluate(continued)


def test_targets_count_as_tested(data, job, small):
    records = Records(data)
    scenes = ladder_design.scenes(records.records, job)
    result = ladder.list_tested(records, scenes)
    assert set(result["materials"].values()) == set(ALBEDOS)
    assert set(result["lights"].values()) == {"sky"} and SHAPE[:16] in result["shapes"]


def test_the_command_writes_jobs(tmp_path, capsys):
    from learn.__main__ import COMMANDS
    from manifests.cli import main

    (tmp_path / "meshes" / "inner").mkdir(parents=True)
    (tmp_path / "meshes" / "inner" / "kettle.obj").write_text("v 0 0 0\n")
    words = ["evaluate-ladder", "--jobs", tmp_path / "jobs", "--meshes", tmp_path / "meshes"]
    assert main("learn", "", COMMANDS, list(map(str, words))) == 0
    printed = capsys.readouterr().out
    jobs = [read(path, Job) for path in sorted((tmp_path / "jobs").glob("*.json"))]
    assert len(jobs) == 3 * PARTS == printed.count("factory render")
    assert sum("inner/kettle.obj" in job.shapes for job in jobs) == len(ladder_design.SETS)
    assert "--first 9000 --count 6" in printed and f"--assets {tmp_path / 'meshes'}" in printed


def test_the_command_needs_data_and_a_folder(capsys):
    from learn.__main__ import COMMANDS
    from manifests.cli import main

    assert main("learn", "", COMMANDS, ["evaluate-ladder", "--out", "o"]) == 1
    assert "--data" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--meshes", "folder"], ["--mesh-count", "3"]])
def test_meshes_are_of_jobs_alone(capsys, words):
    from learn.__main__ import COMMANDS
    from manifests.cli import main

    command = ["evaluate-ladder", "--data", "d", "--out", "o", *words]
    assert main("learn", "", COMMANDS, command) == 1
    assert f"{words[0]}: expected --jobs DIR with it" in capsys.readouterr().err


def test_intervals_need_several_shapes_materials_and_lights():
    def line(number, shape):
        return {"shape": shape, "target": f"m{number % 2}", "light": f"l{number // 2 % 3}"} | {
            "value": float(number)
        }

    several = ladder_lines.Figures([line(k, f"s{k // 3}") for k in range(12)])
    mean, low, high = several.interval(lambda row: row["value"])
    assert mean == 5.5 and low < 4 and high > 7
    one = ladder_lines.Figures([line(k, "s") for k in range(12)])
    assert one.interval(lambda row: row["value"]) == 5.5
    assert one.interval(lambda row: None) is None


def test_a_group_without_scenes_has_no_row():
    assert ladder_report.ladder_table([]) is None


def test_a_cluster_measures_the_same_lines_and_continues_them(options, monkeypatch, tmp_path):
    """Its first worker, and the first that has the third line in hand, are lost."""
    monkeypatch.setitem(ladder_design.RUNGS_OF, "ladder-small", ("direct", "8-bit"))
    lines = {"here": replace(options, out=tmp_path / "here"), "there": replace(options, ray="auto")}
    ladder.evaluate(lines["here"])
    given = []

    def lost(piece):
        given.append(piece)
        return piece in (None, 2) and given.count(piece) == 1

    fake_ray.installed(monkeypatch, lost)
    ladder.evaluate(lines["there"])
    path = options.out / "lines.jsonl"
    kept = path.read_bytes()
    assert ladder.rows_of(options.out) == ladder.rows_of(tmp_path / "here")
    assert kept.count(b"\n") == len(ladder.rows_of(options.out)) == 4
    path.write_bytes(kept[: kept.index(b"\n") + 20])
    ladder.evaluate(lines["there"])
    assert sorted(path.read_bytes().splitlines()) == sorted(kept.splitlines())
