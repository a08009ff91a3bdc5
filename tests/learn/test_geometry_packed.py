"""Packed geometry gives back what the files hold, whatever lines name them, and knows when it is stale."""

import msgspec
import numpy as np
import pytest
import synthetic

from learn.dataset import Records
from learn.geometry import Geometry
from learn.training.sources import without_twins
from manifests.problems import Problem
from manifests.schema import ShapeEntry, View
from manifests.store import Lines
from shaders import envmap


@pytest.fixture
def store(tmp_path, rng):
    """A sphere from one view, in records."""
    store = synthetic.write_dataset(tmp_path, [synthetic.matte()], rng, seeds=1, rotations=(0,))
    shape = ShapeEntry(hash="5" * 64, category="primitive", side="test", role="test", segments=1, licence="")
    store.write_json("dataset.json", msgspec.structs.replace(store.dataset(), shapes={"sphere": shape}))
    return store


def as_view(record, **changes):
    """The View of a record's geometry."""
    shared = {key: getattr(record, key) for key in View.__struct_fields__ if key not in ("side", "id")}
    return View(**{**shared, "id": "8" * 24, "side": "test", **changes})


def append(store, view):
    lines = Lines(store.folder / "views" / "worker-00.jsonl")
    lines.append(view)
    lines.close()


def test_what_is_packed_is_what_the_files_hold(store):
    geometry, records = Geometry(store.folder, progress=False), Records(store.folder)
    n, _, segments = records.geometry(records.records[0])
    np.testing.assert_array_equal(geometry.segments(0), segments)
    np.testing.assert_allclose(geometry.normals(0)[..., :2], n[..., :2], atol=1 / 32767)  # half a step of int16, and one of float32
    turned = np.degrees(np.arccos(np.clip((geometry.normals(0) * n).sum(-1)[segments > 0], -1, 1)))
    assert turned.max() < 0.5  # z of a square root: at the rim a step of int16 is worth this much
    assert geometry.views[0].side == "test"


def test_views_and_records_of_one_geometry_file_are_one_view(store):
    record = next(store.records())
    for path in store.record_files():
        path.unlink()
    append(store, as_view(record))
    alone = Geometry(store.folder, progress=False)
    lines = Lines(store.folder / "records" / "worker-00.jsonl")
    lines.append(record)
    lines.close()
    both = Geometry(store.folder, progress=False)
    assert len(alone) == len(both) == 1 and alone.views == both.views


def test_a_new_view_makes_the_pack_anew(store):
    assert len(Geometry(store.folder, progress=False)) == 1
    append(store, as_view(next(store.records()), viewpoint=3, geometry_hash="7" * 64))
    geometry = Geometry(store.folder, progress=False)
    assert len(geometry) == 2
    np.testing.assert_array_equal(geometry.normals(0), geometry.normals(1))


def truncate(path):
    path.write_bytes(path.read_bytes()[:-100])


def flip(path):
    data = bytearray(path.read_bytes())
    data[-100] ^= 1
    path.write_bytes(data)


DAMAGES = {
    "an array cut short": ("normals.npy", truncate),
    "one bit of an array": ("segments.npy", flip),
    "an empty array": ("segments.npy", lambda path: path.write_bytes(b"")),
    "no array": ("normals.npy", lambda path: path.unlink()),
    "no sums": ("sums.json", lambda path: path.unlink()),
    "sums of another kind": ("sums.json", lambda path: path.write_text("[]")),
    "an empty list": ("views.json", lambda path: path.write_bytes(b"")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_pack_is_never_used_and_is_made_again(store, damage):
    whole = Geometry(store.folder, progress=False)
    n, segments = whole.normals(0), whole.segments(0)
    name, spoil = DAMAGES[damage]
    spoil(store.folder / "packed" / name)
    again = Geometry(store.folder, progress=False)
    np.testing.assert_array_equal(again.normals(0), n)
    np.testing.assert_array_equal(again.segments(0), segments)
    before = (store.folder / "packed" / "normals.npy").stat().st_mtime_ns
    Geometry(store.folder, progress=False)  # what was made again holds
    assert (store.folder / "packed" / "normals.npy").stat().st_mtime_ns == before


@pytest.mark.parametrize("count", [0, 100, 2000])
def test_a_pack_that_the_disk_has_no_room_for_stays_in_memory(store, small_files, capsys, count):
    with small_files(count):
        geometry = Geometry(store.folder, progress=False)
    assert "packed geometry stays in memory" in capsys.readouterr().err
    assert not list((store.folder / "packed").glob(".*")) and not (store.folder / "packed" / "views.json").exists()
    np.testing.assert_array_equal(geometry.normals(0), Geometry(store.folder, progress=False).normals(0))


def test_a_pack_is_no_pack_until_all_of_it_is_there(store, monkeypatch):
    """Killed after the arrays of one list of views were replaced by another's, the list must not vouch for them."""
    Geometry(store.folder, progress=False)

    class Killed(BaseException):
        pass

    def die(path, text):
        raise Killed

    monkeypatch.setattr("learn.geometry.write_text", die)
    (store.folder / "packed" / "sums.json").unlink()
    with pytest.raises(Killed):
        Geometry(store.folder, progress=False)
    assert not (store.folder / "packed" / "views.json").exists()


def test_normals_that_are_not_unit_are_refused_with_the_file_named(store):
    path = store.folder / next(store.records()).geometry
    record = Records(store.folder).records[0]
    n, depth, segments = Records(store.folder).geometry(record)
    channels = {f"normal.{axis}": 0.5 * n[..., k] for k, axis in enumerate("XYZ")}
    path.unlink()
    synthetic.write_exr(path, channels | {"depth.Z": depth, "segment": segments.astype(np.uint32)})
    with pytest.raises(Problem, match=rf"{path.name}: unit normals expected, found lengths 0\.5"):
        Geometry(store.folder, progress=False)


def test_a_copy_of_a_held_out_map_does_not_light_training(rng):
    maps = {name: envmap.unit_mean(np.exp(rng.standard_normal((64, 128, 3))))[0].astype(np.float32) for name in "abc"}
    maps["another b"] = envmap.roll(maps["b"], 32)
    assert set(without_twins(maps, ("another b",))) == {"a", "another b", "c"}
    assert set(without_twins(maps, ())) == {"a", "b", "c"}
    with pytest.raises(Problem, match=r"'b' again|'another b' again"):
        without_twins(maps, ("b", "another b"))
