"""Packed geometry gives back what the files hold, whatever lines name them, and knows when it is
stale.
"""

import tracemalloc

import numpy as np
import pytest
from msgspec import structs

from learn.data.geometry import Geometry
from learn.data.light_copies import without_duplicates
from learn.data.records import Records
from manifests import exr
from manifests.errors import InputError
from manifests.line_files import Lines
from shaders import envmap, frames
from tests.support import synthetic


@pytest.fixture
def store(tmp_path, rng):
    """A sphere from one view, in records."""
    return synthetic.write_dataset(
        tmp_path, [synthetic.matte()], rng, seeds=1, rotations=(0,), side="test"
    )


def append(store, view):
    lines = Lines(store.folder / "views" / "worker-00.jsonl")
    lines.append(view)
    lines.close()


def test_what_is_packed_is_what_the_files_hold(store):
    geometry, records = Geometry(store.folder, progress=False), Records(store.folder)
    n, _, segments = records.geometry(records.records[0])
    np.testing.assert_array_equal(geometry.segments(0), segments)
    # half a step of int16, and one of float32
    np.testing.assert_allclose(geometry.normals(0)[..., :2], n[..., :2], atol=1 / 32767)
    turned = np.degrees(np.arccos(np.clip((geometry.normals(0) * n).sum(-1)[segments > 0], -1, 1)))
    assert turned.max() < 0.5  # z of a square root: at the rim a step of int16 is worth this much
    assert geometry.views[0].side == "test"


def test_views_and_records_of_one_geometry_file_are_one_view(store):
    record = next(store.records())
    for path in store.record_files():
        path.unlink()
    append(store, synthetic.view_of(store, record))
    alone = Geometry(store.folder, progress=False)
    lines = Lines(store.folder / "records" / "worker-00.jsonl")
    lines.append(record)
    lines.close()
    both = Geometry(store.folder, progress=False)
    assert len(alone) == len(both) == 1 and alone.views == both.views


def test_a_new_view_makes_the_pack_anew(store):
    assert len(Geometry(store.folder, progress=False)) == 1
    append(store, synthetic.view_of(store, next(store.records()), viewpoint=3))
    geometry = Geometry(store.folder, progress=False)
    assert len(geometry) == 2
    np.testing.assert_array_equal(geometry.normals(0), geometry.normals(1))


def test_normals_in_perspective_are_those_of_each_pixels_ray(tmp_path, rng):
    """n_z is then the cosine to the viewer, as for the distant viewer that networks assume."""
    store = synthetic.write_dataset(
        tmp_path, [synthetic.matte()], rng, seeds=1, rotations=(0,), fov_deg=50.0
    )
    geometry, records = Geometry(store.folder, progress=False), Records(store.folder)
    n, _, segments = records.geometry(records.records[0])
    view = frames.view_vectors(24, 24, fov=np.radians(50.0))
    inside = segments > 0
    cosine = (n * view).sum(-1)[inside]
    np.testing.assert_allclose(geometry.normals(0)[inside][:, 2], cosine, atol=1e-2)
    assert np.abs(cosine - n[inside][:, 2]).max() > 0.1
    assert geometry.has_several_cameras


def test_several_cameras_are_given_the_preset_elevation(store):
    """The light is then given in the frame below the camera by that angle."""
    assert not Geometry(store.folder, progress=False).has_several_cameras
    record = next(store.records())
    camera = structs.replace(record.camera, elevation_deg=50.0, roll_deg=5.0)
    other = structs.replace(record, camera=camera)
    append(store, synthetic.view_of(store, other, viewpoint=3))
    geometry = Geometry(store.folder, progress=False)
    assert len(geometry) == 2 and geometry.has_several_cameras
    assert geometry.elevation == pytest.approx(np.radians(20.0))


def test_pictures_of_several_sizes_are_refused(store):
    record = next(store.records())
    camera = structs.replace(record.camera, size=(48, 48))
    other = structs.replace(record, camera=camera)
    append(store, synthetic.view_of(store, other, viewpoint=3))
    with pytest.raises(InputError, match="pictures of one size"):
        Geometry(store.folder, progress=False)


def test_normals_that_are_not_unit_are_refused_with_the_file_named(store):
    record = Records(store.folder).records[0]
    n, depth, segments = Records(store.folder).geometry(record)
    channels = {f"normal.{axis}": 0.5 * n[..., k] for k, axis in enumerate("XYZ")}
    path, (lines,) = store.folder / record.geometry, store.record_files()
    hash_ = store.place(
        record.geometry,
        exr.encode(channels | {"depth.Z": depth, "segment": segments.astype(np.uint32)}),
        "test",
    )
    with pytest.raises(
        InputError,
        match=(
            rf"{path.name}: expected hash {record.geometry_hash[:12]}, found .* the file was"
            r" altered"
        ),
    ):
        Geometry(store.folder, progress=False)
    lines.write_text(lines.read_text().replace(record.geometry_hash, hash_))
    with pytest.raises(
        InputError, match=rf"{path.name}: expected unit normals, found lengths 0\.5"
    ):
        Geometry(store.folder, progress=False)


def test_a_copy_of_a_held_out_map_does_not_light_training(rng):
    maps = {
        name: envmap.unit_mean(np.exp(rng.standard_normal((64, 128, 3))))[0].astype(np.float32)
        for name in "abc"
    }
    maps["another b"] = envmap.roll(maps["b"], 32)
    assert set(without_duplicates(maps, ("another b",))) == {"a", "another b", "c"}
    assert set(without_duplicates(maps, ())) == {"a", "b", "c"}
    with pytest.raises(InputError, match=r"'b' again|'another b' again"):
        without_duplicates(maps, ("b", "another b"))


def test_packing_holds_a_few_views_in_memory_however_many_there_are(tmp_path, rng):
    store = synthetic.write_dataset(
        tmp_path, [synthetic.matte()], rng, size=160, seeds=1, rotations=(0,)
    )
    record = next(store.records())
    Geometry(store.folder, progress=False)  # loads what is loaded once
    peaks = []
    for viewpoints in (range(1, 2), range(2, 24)):
        for viewpoint in viewpoints:
            append(store, synthetic.view_of(store, record, viewpoint=viewpoint))
        tracemalloc.start()
        Geometry(store.folder, progress=False)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    arrays_of_22_views = 22 * 160 * 160 * 5  # bytes
    assert peaks[1] - peaks[0] < arrays_of_22_views / 4


def test_a_view_that_is_left_out_leaves_the_others_as_they_are(store):
    """The cache is written for as many views as there are, and says afterwards how many it has."""
    record = next(store.records())
    for viewpoint in (3, 7):
        append(store, synthetic.view_of(store, record, viewpoint=viewpoint))
    bad, good = sorted(store.views(), key=lambda view: view.viewpoint)
    (store.folder / bad.geometry).write_bytes(b"damaged")
    geometry = Geometry(store.folder, progress=False, skip_bad=True, depth=True)
    again = Geometry(store.folder, progress=False, skip_bad=True, depth=True)
    assert [view.viewpoint for view in geometry.views] == [record.viewpoint, 7]
    assert list(geometry.skipped) == [bad.geometry_hash]
    for packed in (geometry, again):
        for index, view in enumerate((record, good)):
            _, depth, segments = Records(store.folder).geometry(view)
            np.testing.assert_array_equal(packed.segments(index), segments)
            np.testing.assert_allclose(packed.depth(index), depth, atol=1 / 16384)


def test_a_disk_that_fills_up_leaves_the_geometry_in_memory(store, monkeypatch, capsys):
    append(store, synthetic.view_of(store, next(store.records()), viewpoint=3))
    whole = Geometry(store.folder, progress=False)
    expected = [whole.normals(index) for index in range(2)]
    append(store, synthetic.view_of(store, next(store.records()), viewpoint=5))
    monkeypatch.setattr(
        "learn.data.geometry_cache._checksum",
        lambda path: (_ for _ in ()).throw(OSError("no space left")),
    )
    geometry = Geometry(store.folder, progress=False)
    assert "stays in memory" in capsys.readouterr().err
    assert len(geometry) == 3
    for index in range(2):
        np.testing.assert_array_equal(geometry.normals(index), expected[index])
