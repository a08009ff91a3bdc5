"""A job as shots: the paper's counts, draws that do not depend on other shapes, splits that share
nothing, and no memory.
"""

import argparse
import dataclasses
import re
import tracemalloc
from collections import Counter
from itertools import islice, pairwise

import msgspec
import numpy as np
import pytest

from factory.commands import render
from factory.commands.plan import describe, split_counts
from factory.execution import forecast
from factory.lights.catalogue import library_maps
from factory.planning import jobs
from factory.planning.assets import Assets, Light, Material, resolve
from factory.planning.job_shapes import Shape
from factory.planning.plan import Plan, Shot, camera_words, shot_seed
from factory.planning.shape_names import Source, list_sources, resolve_path
from factory.shapes.libraries import find
from manifests import splits
from manifests.errors import InputError
from manifests.schema import Camera, Draw, Failure, Job, Record, View
from manifests.viewpoints import azimuths_deg
from tests.support.tetrahedron import TETRAHEDRON
from tests.support.work_count import calls


@pytest.fixture
def stub(hash_of):
    """A function of a Job: its Plan over shapes and materials that are only names and hashes."""

    def make(job, training=60, testing=20):
        names = list(dict.fromkeys(source.place for source in list_sources(job, None)))
        roles = splits.shape_roles([(n, n.split(":")[0], hash_of(n)) for n in names], job.split)
        expected = set(job.roles) or set(splits.SIDES)
        shapes = [
            Shape(
                name=n,
                source=Source(n),
                category=n.split(":")[0],
                hash=hash_of(n),
                segments=2,
                side=splits.SIDES[roles[n]],
                role=roles[n],
                licence="",
                report="",
            )
            for n in names
            if roles[n] in expected
        ]
        sides = ["train"] * (training if "merl/paper-train" in job.materials else 0) + ["test"] * (
            testing if "merl/test" in job.materials else 0
        )
        materials = [
            Material(
                name=f"m{k}-{side}",
                hash=hash_of(f"m{k}-{side}"),
                side=side,
                licence="",
                source="",
                entry=None,
            )
            for k, side in enumerate(sides or ["train", "test"])
        ]
        lights = {n: Light(n, n, hash_of(n), 1.0, "", "", None) for n in job.lights}
        return Plan(job, Assets(shapes, materials, lights), "settings")

    return make


@pytest.fixture
def job():
    return Job(
        shapes=("chair:0-3",),
        materials=("all",),
        lights=("a", "b"),
        views=Draw(random=5),
        rotations=Draw(random=1),
        camera=Camera(size=(8, 8)),
    )


@pytest.mark.parametrize(
    ("preset", "count"),
    [("pretrain", 240_000), ("finetune", 480_000), ("test", 40_000), ("multi-material", 20_000)],
)
def test_presets_have_the_papers_counts(stub, preset, count):
    assert len(stub(jobs.load(preset)[0])) == count


def test_a_preset_is_found_beside_a_data_set_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()
    assert jobs.load("demo")[1] == jobs.presets()["demo"].parent
    (tmp_path / "mine").mkdir()
    with pytest.raises(InputError, match="a folder"):
        jobs.load("mine")


def test_over_the_whole_paper_plan_training_and_test_share_no_shape_and_no_material(stub):
    """All 760,000 pictures, as (shape, material) pairs: one group under one light has every pair of
    a shape.
    """
    sides = {"shape": {}, "material": {}}
    pictures = 0
    for preset in ("pretrain", "finetune", "test"):
        plan = stub(jobs.load(preset)[0])
        pictures += len(plan)
        for shape in plan.assets.shapes:
            for shot in plan.shots_under(shape, *plan.lights[0])[::5]:
                assert shot.split == ("test" if preset == "test" else "train")
                for kind, name in (
                    ("shape", shot.shape),
                    *(("material", m) for m in shot.materials),
                ):
                    assert sides[kind].setdefault(name, shot.split) == shot.split
    assert pictures == 760_000
    assert len(sides["shape"]) == 280 and len(sides["material"]) == 80


def test_multi_material_gives_each_region_its_own_from_the_chairs_side(stub):
    plan = stub(jobs.load("multi-material")[0])
    shots = list(islice(plan, 2000))
    assert all(len(set(shot.materials)) == 2 for shot in shots)
    assert all({m.split("-")[1] for m in shot.materials} == {shot.split} for shot in shots)
    assert len({shot.materials for shot in shots}) > 300  # 400 draws of two from 60
    assert split_counts(plan) == {"train": 16_000, "test": 4_000}


def test_the_length_is_the_number_of_shots_and_ids_are_unique(stub, job):
    for change in (
        {},
        {"mixed": False},
        {"tiers": ("direct", "full"), "repeats": 2},
        {"segment_materials": 3},
        {"lights": ("a", "a", "b")},
    ):
        plan = stub(msgspec.structs.replace(job, **change))
        shots = list(plan)
        assert len(plan) == len(shots) == len({shot.id for shot in shots})
        assert sum(split_counts(plan).values()) == len(shots)


def test_a_plan_is_the_same_every_time_and_sorted_so_that_what_is_dear_changes_least(stub, job):
    fixed = msgspec.structs.replace(job, views=(0, 6), rotations=(0, 64))
    assert list(stub(fixed)) == list(stub(fixed))
    seen = [
        (s.shape, s.light, s.light_resolution, s.tier, s.materials, s.rotation_texels)
        for s in stub(fixed)
    ]
    # shapes × lights × materials × rotations, once each
    assert sum(a != b for a, b in pairwise(seen)) == 4 * 2 * 2 * 2 - 1


@pytest.mark.parametrize(
    "change",
    [
        {"shapes": ("chair:0-5", "sofa:1")},
        {"lights": ("c", "a", "b")},
        {"tiers": ("direct", "full")},
        {"repeats": 2},
    ],
)
def test_what_is_added_to_a_job_alters_no_other_shot(stub, job, change):
    ours, theirs = stub(job), stub(msgspec.structs.replace(job, **change))
    assert {s.id for s in ours} < {s.id for s in theirs}


def test_each_input_alters_the_id(stub, job):
    fixed = msgspec.structs.replace(
        job, views=(3,), rotations=(7,), shapes=("chair:0",), lights=("a",)
    )
    ids = {shot.id for shot in stub(fixed)}
    changes = [
        {"seed": 1},
        {"samples": 65},
        {"camera": Camera(size=(8, 9))},
        {"camera": Camera(size=(8, 8), fov_deg=40.0)},
        {"views": (4,)},
        {"camera": Camera(size=(8, 8), pixel="centre")},
        {"rotations": (8,)},
        {"tiers": ("shadow",)},
        {"light_resolutions": ("full",)},
        {"lights": ("b",)},
        {"shapes": ("chair:1",)},
    ]
    for change in changes:
        assert not ids & {shot.id for shot in stub(msgspec.structs.replace(fixed, **change))}, (
            change
        )
    # and the seed, so that no two share their noise
    for word in ("view", "turn", "tier", "resolution", "repeat"):
        assert shot_seed(1, word) != shot_seed(1, "") != shot_seed(2, "")
    other = stub(fixed)
    assert not ids & {shot.id for shot in Plan(other.job, other.assets, "other settings")}


def test_five_different_views_are_drawn_and_all_viewpoints_come_up(stub, job):
    by_combination = {}
    for shot in stub(job):
        by_combination.setdefault((shot.shape, shot.materials, shot.light), []).append(
            shot.viewpoint
        )
    assert all(len(set(views)) == 5 for views in by_combination.values())
    plan = stub(jobs.load("pretrain")[0])
    counts = [0] * 24
    turns = set()
    for shot in islice(plan, 12_000):
        counts[shot.viewpoint] += 1
        turns.add(shot.rotation_texels)
    assert all(abs(count - 500) < 6 * 500**0.5 for count in counts)  # 6 σ of a Poisson count
    assert turns == set(range(128))


def test_seeds_are_31_bits_and_no_two_pictures_share_their_noise(stub, job):
    seeds = [shot.seed for shot in islice(stub(jobs.load("pretrain")[0]), 6000)]
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert len(set(seeds)) >= 5998  # 6000 draws of 2³¹ meet by chance .008 times


def test_shots_are_made_lazily_in_little_memory(stub):
    plan = stub(jobs.load("finetune")[0])
    next(iter(plan))
    tracemalloc.start()
    for _ in islice(plan, 9000):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20  # one shape under one light: 300 shots; all 480,000 would take 300 MB


def test_ids_are_quick_to_make(stub):
    plan, count = stub(jobs.load("pretrain")[0]), 3000
    # 19 µs per shot (tests/endurance/timings.py): a hash, a draw and a few look-ups
    assert calls(lambda: sum(1 for _ in islice(plan, count))) < 40 * count


def test_cameras_that_are_alike_hash_alike():
    assert camera_words(Camera(elevation_deg=20, fov_deg=40)) == camera_words(
        Camera(elevation_deg=20.0, fov_deg=40.0)
    )


def test_the_viewpoints_are_24_steps_of_15_degrees():
    assert azimuths_deg() == tuple(15.0 * k for k in range(24))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": Draw(random=25)}, "job: views.random: expected at most 24, found 25"),
        ({"rotations": Draw(random=129)}, "job: rotations.random: expected at most 128"),
        ({"views": (1, 1)}, "job: views: expected each number once, found [1] twice"),
        ({"tiers": ("full", "full")}, "job: tiers: expected each name once"),
        ({"shapes": ("chair:9-3",)}, "job: shapes 'chair:9-3': expected a range from low to high"),
        ({"shapes": ("chiar:0",)}, "chair"),
        ({"shapes": ("../../etc/x.obj",)}, "a path inside"),
        ({"shapes": ("/etc/x.obj",)}, "a path inside"),
        ({"lights": ("../lamp.exr",)}, "a path inside"),
        ({"lights": ("nowhere.exr",)}, "nowhere.exr"),
        ({"lights": ("ctiy",)}, "city"),
        ({"materials": ("mate",)}, "did you mean matte"),
        ({"materials": ("small/brass",)}, "none of that name"),
        ({"materials": ("lambert(#c0c0c0)",)}, "a description, which only brdfactory edit takes"),
    ],
)
def test_a_job_that_names_what_is_not_there_is_refused_in_one_line(
    small_job, catalogue, tmp_path, light_file, change, message
):
    (tmp_path / "lamp.exr").write_bytes(light_file.read_bytes())
    job = msgspec.structs.replace(small_job, lights=("lamp.exr",))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        resolve(msgspec.structs.replace(job, **change), tmp_path, catalogues=[catalogue])
    assert "\n" not in str(caught.value)


def test_a_path_may_lie_below_the_jobs_folder_but_a_link_may_not_lead_out(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "out").symlink_to(tmp_path)
    assert (
        resolve_path("meshes/x.obj", tmp_path / "in", "job") == tmp_path / "in" / "meshes" / "x.obj"
    )
    for path in ("out/x.obj", "meshes/../x.obj"):
        with pytest.raises(InputError, match="--assets"):
            resolve_path(path, tmp_path / "in", "job")


def test_meshes_and_lights_of_options_are_also_looked_for_in_assets(
    catalogue, tmp_path, monkeypatch, light_file
):
    here, assets = tmp_path / "here", tmp_path / "assets"
    for folder in (here, assets / "inner"):
        folder.mkdir(parents=True)
    for place in ("inner/a.ply", "b.ply"):
        (assets / place).write_bytes(TETRAHEDRON)
    (here / "b.ply").write_bytes(TETRAHEDRON.replace(b"0 0 2", b"0 0 3"))
    (assets / "lamp.exr").write_bytes(light_file.read_bytes())
    monkeypatch.chdir(here)
    parser = argparse.ArgumentParser()
    render.register(parser.add_subparsers())
    words = "render --out x --material small --light lamp.exr --light city"
    words += " --mesh inner/a.ply?up=z --mesh b.ply --mesh cube --mesh none.ply"
    job, folder = render.choose_job(parser.parse_args([*words.split(), "--assets", str(assets)]))
    assert job.shapes == (f"{assets}/inner/a.ply?up=z", "b.ply", "cube", "none.ply")
    assert job.lights == (f"{assets}/lamp.exr", "city")
    with pytest.raises(InputError, match=r"none\.ply"):
        resolve(job, folder, catalogues=[catalogue])
    whole = msgspec.structs.replace(job, shapes=job.shapes[:3])
    assert [s.name for s in resolve(whole, folder, catalogues=[catalogue]).shapes] == [
        "a",
        "b",
        "cube",
    ]


def test_without_mixed_only_pairs_of_one_side_are_rendered(stub, job):
    shots = list(stub(msgspec.structs.replace(job, mixed=False, shapes=("chair:0-19",))))
    assert {shot.split for shot in shots} == {"train", "test"}
    assert {shot.split for shot in stub(msgspec.structs.replace(job, shapes=("chair:0-19",)))} == {
        "train",
        "test",
        "mixed",
    }


def test_a_forecast_tries_shapes_that_have_shots_and_counts_no_others(stub, job):
    job = msgspec.structs.replace(
        job, shapes=("chair:0-199",), materials=("merl/test",), mixed=False, views=(0, 3)
    )
    whole = stub(job)
    shape = next(shape for shape in whole.assets.shapes if shape.side == "test")
    others = [each for each in whole.assets.shapes if each.side == "train"]
    assets = dataclasses.replace(whole.assets, shapes=[*others[:40], shape, *others[40:80]])
    plan = dataclasses.replace(whole, assets=assets)
    probes = list(forecast.probe_shots(plan))
    assert len(probes) >= forecast.LEAST_PROBES and {s.shape for s in probes} == {shape.name}
    events = forecast.count_events(plan)
    assert (events["shape"], events["geometry"]) == (1, 2)


def test_draws_of_materials_keep_to_mixed_and_are_counted_by_their_split(stub, job):
    job = msgspec.structs.replace(
        job, shapes=("chair:0-19",), materials=("merl/paper-train",), segment_materials=2
    )
    whole, pure = stub(job), stub(msgspec.structs.replace(job, mixed=False))
    for plan in (whole, pure):
        counts = Counter(shot.split for shot in plan)
        assert split_counts(plan) == counts and counts.total() == len(plan)
    assert {shot.split for shot in whole} == {"train", "mixed"}
    assert {shot.split for shot in pure} == {"train"}
    assert list(pure) == [shot for shot in whole if shot.split == "train"]


def test_what_macos_writes_beside_files_is_neither_a_mesh_nor_a_light(tmp_path, light_file):
    (tmp_path / "a.ply").write_bytes(TETRAHEDRON)
    (tmp_path / "sky.exr").write_bytes(light_file.read_bytes())
    for name in ("._a.ply", "._sky.exr"):
        (tmp_path / name).write_bytes(b"\0\5\x16\7")
    assert [entry.name for entry in find(tmp_path)] == ["a"]
    assert list(library_maps(tmp_path)) == ["sky"]


def test_a_twin_is_left_out_with_a_note(small_job, catalogue, tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.ply").write_bytes(TETRAHEDRON)
    assets = resolve(
        msgspec.structs.replace(small_job, shapes=("a.ply", "b.ply"), lights=("city",)),
        tmp_path,
        catalogues=[catalogue],
    )
    assert [s.name for s in assets.shapes] == ["a"]
    assert assets.notes == ["shape 'b' is 'a' again, left out"]


def test_a_folder_of_meshes_is_named_by_where_they_lie_and_two_meshes_never_share_a_name(
    small_job, catalogue, tmp_path
):
    for k, folder in enumerate(("chairs/one", "chairs/two")):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "model.ply").write_bytes(
            TETRAHEDRON.replace(b"0 0 2", b"0 0 %d" % (2 + k))
        )
    job = msgspec.structs.replace(small_job, lights=("city",))
    assets = resolve(
        msgspec.structs.replace(job, shapes=("./chairs",)), tmp_path, catalogues=[catalogue]
    )
    assert [(s.name, s.category) for s in assets.shapes] == [
        ("one-model", "chair"),
        ("two-model", "chair"),
    ]
    both = msgspec.structs.replace(job, shapes=("chairs/one/model.ply", "chairs/two/model.ply"))
    with pytest.raises(InputError, match="expected one mesh under a name"):
        resolve(both, tmp_path, catalogues=[catalogue])


def test_reading_options_of_a_folder_hold_for_each_of_its_meshes(small_job, catalogue, tmp_path):
    job = msgspec.structs.replace(small_job, lights=("city",))
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.ply").write_bytes(TETRAHEDRON.replace(b"0 0 2", b"0 1 2"))

    def hash_of(spec):
        replaced = msgspec.structs.replace(job, shapes=(spec,))
        (shape,) = resolve(replaced, tmp_path, catalogues=[catalogue]).shapes
        return shape.hash

    turned = hash_of("meshes/a.ply?up=y&front=z")
    assert hash_of("./meshes?up=y&front=z") == hash_of("meshes/?up=y&front=z") == turned
    assert hash_of("meshes/") == hash_of("meshes/a.ply") != turned
    with pytest.raises(InputError, match="expected options among"):
        hash_of("meshes/?upp=y")
    with pytest.raises(InputError, match=r"meshes/#a'.*a mesh of a \.sh3f library"):
        hash_of("meshes/#a")


def test_two_light_maps_never_share_a_name(small_job, catalogue, tmp_path, light_file):
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "lamp.exr").write_bytes(light_file.read_bytes())
    ramp = np.linspace(2.0, 0.1, 8 * 16, dtype=np.float32).reshape(8, 16, 1)
    np.savez(tmp_path / "b" / "lamp.npz", L=ramp * np.ones(3, np.float32))

    def lights(*names):
        job = msgspec.structs.replace(small_job, lights=names)
        return resolve(job, tmp_path, catalogues=[catalogue]).lights

    with pytest.raises(InputError) as caught:
        lights("a/lamp.exr", "b/lamp.npz")
    assert str(caught.value) == (
        "light 'lamp': expected one map under a name, found a/lamp.exr and b/lamp.npz"
        " (rename one of the files)"
    )
    (tmp_path / "b" / "city.npz").write_bytes((tmp_path / "b" / "lamp.npz").read_bytes())
    with pytest.raises(InputError, match=r"found city and b/city\.npz"):
        lights("city", "b/city.npz")
    assert set(lights("a/lamp.exr", "c/lamp.exr")) == {"a/lamp.exr", "c/lamp.exr"}  # one map


def test_sets_and_names_of_materials_can_be_mixed(small_job, catalogue):
    def chosen(*names):
        return [
            m.name
            for m in resolve(
                msgspec.structs.replace(small_job, materials=names), catalogues=[catalogue]
            ).materials
        ]

    assert chosen("small") == ["matte", "metal", "grey"]
    assert chosen("small/test", "grey", "small/metal") == ["metal", "grey"]
    assert chosen("small/train") == ["matte", "grey"]


def test_a_plan_says_what_it_means(plan_of, small_job):
    text = "\n".join(describe(plan_of(small_job)))
    assert "12 pictures of 16×16, 1 sample, orthographic" in text
    assert "materials  3: 1 test, 2 train" in text
    assert re.search(r"split +.*(train|mixed)", text)


@pytest.mark.parametrize("line", [Record, View, Failure])
def test_a_line_repeats_every_field_of_its_shot_that_it_has_but_the_geometry(stub, job, line):
    shot = next(iter(stub(job)))
    shared = set(Shot.__struct_fields__) & set(line.__struct_fields__) - {
        "geometry",
        "geometry_hash",
    }
    assert shot.repeated_in(line) == {name: getattr(shot, name) for name in shared}
    assert {"id", "shape", "viewpoint"} <= shared
