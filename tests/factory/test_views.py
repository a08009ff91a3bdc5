"""Jobs without pictures: geometry of every shape in every view once, with the same guarantees as
pictures have.
"""

import msgspec
import pytest

from factory.commands.plan import describe
from factory.commands.status import count_data_set
from manifests import ids
from manifests.cli import main
from manifests.errors import InputError
from manifests.picture_files import read_geometry
from manifests.schema import CameraRanges, Draw, View
from manifests.splits import light_side
from manifests.store import Store
from manifests.verification import faults_of, repair
from shaders.frames import pixel_grid


@pytest.fixture
def views_job(small_job):
    """Two shapes, two views."""
    return msgspec.structs.replace(small_job, pictures=False)


def faults(folder):
    return faults_of(Store(folder))


def rewrite(store, **changes):
    """Alter the first view's line."""
    path = store.record_files("views")[0]
    first, *rest = path.read_bytes().splitlines(keepends=True)
    view = msgspec.structs.replace(msgspec.json.decode(first, type=View), **changes)
    path.write_bytes(msgspec.json.encode(view) + b"\n" + b"".join(rest))


def test_every_shape_is_seen_from_every_view_once_and_nothing_is_pictured(
    render, views_job, tmp_path
):
    assert render(views_job, tmp_path).made == 4
    views = list(Store(tmp_path).views())
    assert {(v.shape, v.viewpoint) for v in views} == {
        (shape, k) for shape in ("cube", "disc") for k in (0, 6)
    }
    assert not (tmp_path / "images").exists() and not list(Store(tmp_path).records())
    for view in views:
        _, _, segments, _ = geometry = read_geometry(tmp_path / view.geometry)
        mask = geometry.mask
        assert (
            view.coverage == pytest.approx(mask.mean(), abs=1e-6)
            and segments.max() <= view.segments
        )
    assert faults(tmp_path) == []


def test_materials_and_lights_come_along_with_their_sides(render, views_job, tmp_path):
    render(views_job, tmp_path)
    dataset = Store(tmp_path).dataset()
    assert {name: entry.side for name, entry in dataset.materials.items()} == {
        "matte": "train",
        "metal": "test",
        "grey": "train",
    }
    # a fifth of all hashes, the least, are for testing: docs/dataset.md
    (light,) = dataset.lights.values()
    assert light.side == ("test" if int(light.hash, 16) < 0.2 * 2**256 else "train")


@pytest.mark.parametrize(
    ("hash_", "side"),
    [("3" + "2" * 63, "test"), ("3" + "4" * 63, "train"), ("0" * 64, "test"), ("f" * 64, "train")],
)
def test_a_light_in_the_least_fifth_of_all_hashes_is_for_testing(hash_, side):
    assert light_side(hash_) == side  # a fifth of 16⁶⁴ is 3333…


def test_views_continue_after_a_limit_and_divide_into_shards(render, views_job, tmp_path):
    assert render(views_job, tmp_path / "a", limit=3).made == 3
    outcome = render(views_job, tmp_path / "a")
    assert (outcome.made, outcome.already_there) == (1, 3)
    assert [render(views_job, tmp_path / "b", shard=(i, 3)).made for i in (1, 2, 3)] == [1, 1, 2]
    assert Store(tmp_path / "a").ids("views") == Store(tmp_path / "b").ids("views")


def test_a_torn_line_is_passed_over_and_its_view_made_again(render, views_job, tmp_path):
    render(views_job, tmp_path)
    path = Store(tmp_path).record_files("views")[0]
    path.write_bytes(path.read_bytes()[:-20])
    outcome = render(views_job, tmp_path)
    assert (outcome.made, outcome.already_there) == (1, 3)
    assert faults(tmp_path) == []


def test_pictures_of_the_same_views_share_their_geometry_files(
    render, views_job, small_job, tmp_path
):
    render(views_job, tmp_path)
    assert render(small_job, tmp_path).made == 12
    store = Store(tmp_path)
    assert {r.geometry_hash for r in store.records()} <= {v.geometry_hash for v in store.views()}
    assert len(list((tmp_path / "geometry").rglob("*.exr"))) == 4
    assert faults(tmp_path) == []
    report = count_data_set(tmp_path)
    assert (report["records"], report["views"], report["planned"]) == (12, 4, 16)
    for kind in ("records", "views"):  # lines that stand there twice, which verify finds
        (path,) = store.record_files(kind)
        path.write_bytes(path.read_bytes() + path.read_bytes().splitlines(keepends=True)[0])
    assert count_data_set(tmp_path) == report


def test_status_says_that_jobs_of_one_folder_may_share_pictures(
    render, views_job, tmp_path, capsys
):
    fewer = msgspec.structs.replace(views_job, views=views_job.views[:1])
    planned = [render(job, tmp_path).made for job in (fewer, views_job)]
    assert main("factory", "", ("status",), ["status", str(tmp_path)]) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert line.endswith(
        f"{sum(planned)} of at most {sum(planned) + planned[0]} pictures and views, 0 failed"
    )


def test_drawn_views_are_a_shapes_own_whatever_else_the_job_names(plan_of, views_job):
    job = msgspec.structs.replace(views_job, views=Draw(random=5))
    both, alone = (
        plan_of(job),
        plan_of(msgspec.structs.replace(job, shapes=("disc",), lights=job.lights * 2)),
    )
    assert len(both) == len(list(both)) == 10
    assert {shot.id for shot in alone} == {shot.id for shot in both if shot.shape == "disc"}


def test_a_view_that_does_not_fit_is_found_and_repair_lets_it_be_made_again(
    render, views_job, tmp_path
):
    render(views_job, tmp_path)
    store = Store(tmp_path)
    path, side = store.record_files("views")[0], next(store.views()).side
    good = path.read_bytes()
    for changes, message in (
        ({"side": "train" if side == "test" else "test"}, f"with side {side}, found"),
        ({"segments": 4}, "with segments 1, found 4"),
        ({"shape": "ball"}, ", found ball"),
        ({"viewpoint": 5}, "the hash of what it says"),
        ({"geometry": "../away.exr"}, ", found ../away.exr"),
        ({"coverage": 0.9}, "expected coverage 0.900000"),
        ({"geometry_hash": "0" * 64}, "the file was altered"),
    ):
        path.write_bytes(good)
        rewrite(store, **changes)
        result = faults_of(store)
        assert any(message in f.text for f in result), (changes, [f.text for f in result])
    assert repair(store, result) == (1, 1)
    assert render(views_job, tmp_path).made == 1
    assert faults(tmp_path) == []


def test_a_light_on_the_wrong_side_is_found(render, views_job, tmp_path):
    render(views_job, tmp_path)
    store = Store(tmp_path)
    dataset = store.dataset()
    (name, entry), *_ = dataset.lights.items()
    wrong = "train" if entry.side == "test" else "test"
    store.write_json(
        "dataset.json",
        msgspec.structs.replace(dataset, lights={name: msgspec.structs.replace(entry, side=wrong)}),
    )
    assert (
        f"light '{name}': expected side {entry.side} by its hash, found {wrong}"
        in faults(tmp_path)[0].text
    )


@pytest.fixture
def drawn_job(views_job):
    """Two shapes, two views, and a camera for each of them."""
    ranges = CameraRanges(
        elevation_deg=(-10.0, 60.0),
        roll_deg=(-15.0, 15.0),
        fov_deg=(15.0, 60.0),
        perspective_share=0.5,
    )
    return msgspec.structs.replace(views_job, camera_ranges=ranges)


def test_each_view_of_each_shape_has_the_camera_that_it_draws(render, drawn_job, tmp_path):
    """Whatever the shards and the processes; a run that was cut off continues with them."""
    assert render(drawn_job, tmp_path / "a", limit=1).made == 1
    outcome = render(drawn_job, tmp_path / "a")
    assert (outcome.made, outcome.already_there) == (3, 1)
    assert [render(drawn_job, tmp_path / "b", shard=(i, 3), workers=2).made for i in (3, 1, 2)]
    lines = {
        name: {(v.id, v.shape, v.viewpoint, v.camera) for v in Store(tmp_path / name).views()}
        for name in "ab"
    }
    assert lines["a"] == lines["b"] and len({camera for *_, camera in lines["a"]}) == 4
    angles = [camera.elevation_deg for *_, camera in lines["a"]]
    assert count_data_set(tmp_path / "a")["cameras"]["elevation_deg"] == [min(angles), max(angles)]
    x, y = pixel_grid(*drawn_job.camera.size)
    for view in Store(tmp_path / "a").views():
        assert view.camera == ids.camera_of(drawn_job, view.shape_hash, view.viewpoint)
        # the fake studio draws a sphere of radius 1, whose size in the frame is its camera's
        covered = (x**2 + y**2) * view.camera.half_extent**2 < 1
        assert view.coverage == pytest.approx(covered.mean(), abs=1e-6)


@pytest.mark.parametrize("pictures", [False, True])
def test_a_camera_that_the_job_did_not_draw_is_a_fault(render, drawn_job, tmp_path, pictures):
    """The ids fit the cameras that the lines name, so the order alone shows it."""
    job = msgspec.structs.replace(drawn_job, pictures=pictures)
    render(job, tmp_path)
    asked = [text for text in faults(tmp_path) if "order" in text.text]
    assert asked == []
    store = Store(tmp_path)
    dataset = store.dataset()
    ranges = msgspec.structs.replace(job.camera_ranges, roll_deg=(-15.0, 14.0))
    other = msgspec.structs.replace(dataset.orders[0].job, camera_ranges=ranges)
    orders = (msgspec.structs.replace(dataset.orders[0], job=other),)
    store.write_json("dataset.json", msgspec.structs.replace(dataset, orders=orders))
    assert any("orders that ask for all lines" in fault.text for fault in faults(tmp_path))


def test_a_range_upside_down_is_refused(plan_of, views_job):
    ranges = CameraRanges(elevation_deg=(60.0, -10.0))
    job = msgspec.structs.replace(views_job, camera_ranges=ranges)
    with pytest.raises(InputError, match=r"camera_ranges.elevation_deg.*\[60, -10\]"):
        plan_of(job)


def test_the_plan_says_how_cameras_are_drawn(plan_of, drawn_job):
    first = next(describe(plan_of(drawn_job)))
    assert first.endswith(
        "a camera drawn for each view: 50% of views 15° to 60° wide, the others orthographic,"
        " elevation -10° to 60°, roll -15° to 15°"
    )
