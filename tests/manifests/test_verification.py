"""verify finds every kind of damage and tells which side was altered; repair leaves what the same
render completes.
"""

import os
import shutil

import msgspec
import numpy as np
import pytest

from manifests import exr, ids, light_files, packed_geometry, picture_files
from manifests.errors import InputError
from manifests.files import npz_bytes
from manifests.materials import encode, read_catalogue
from manifests.schema import Camera, Dataset, Draw, Job, MaterialEntry, Record
from manifests.store import Store
from manifests.store_paths import file_hash, geometry_path, image_path
from manifests.verification import Fault, Verification, faults_of, repair, shared_between, summary
from manifests.verification.entries import most_shots
from tests.support.whole_dataset import JOB, RENDER, hash_of


@pytest.fixture
def store(whole, tmp_path):
    """A whole data set of two shapes, two materials, two views: eight records."""
    shutil.copytree(whole(), tmp_path / "data")
    return Store(tmp_path / "data")


def texts(store):
    return [fault.text for fault in faults_of(store)]


def lines(store, kind="records"):
    """Every line of a kind, decoded."""
    return list(store.records() if kind == "records" else store.views())


def rewrite(store, change, kind="records"):
    """Puts change(index, line) in the place of each line."""
    (path,) = store.record_files(kind)
    path.write_bytes(
        b"".join(
            msgspec.json.encode(change(k, line)) + b"\n"
            for k, line in enumerate(lines(store, kind))
        )
    )


def alter(store, kind="records", **changes):
    """Changes fields of the first line."""
    rewrite(
        store, lambda k, line: msgspec.structs.replace(line, **changes) if k == 0 else line, kind
    )
    return lines(store, kind)[0]


def alter_entry(store, kind, name, **changes):
    """Changes fields of an entry of dataset.json."""
    dataset = store.dataset()
    entries = getattr(dataset, kind)
    altered = {**entries, name: msgspec.structs.replace(entries[name], **changes)}
    store.write_json("dataset.json", msgspec.structs.replace(dataset, **{kind: altered}))


def replace_file(store, relative, data):
    """Another content under a file's name, and its hash in every line and entry that names it."""
    store.place(relative, data, "t")
    digest = file_hash(store.folder / relative)

    def renamed(_, line):
        for key in ("image", "geometry"):
            if getattr(line, key, None) == relative:
                line = msgspec.structs.replace(line, **{f"{key}_hash": digest})
        return line

    for kind in ("records", "views"):
        if store.record_files(kind):
            rewrite(store, renamed, kind)
    for name, entry in store.dataset().lights.items():
        if entry.file == relative:
            alter_entry(store, "lights", name, file_hash=digest)


@pytest.mark.parametrize(
    ("segments", "changes"),
    [
        (1, {}),
        (
            3,
            {
                "camera": Camera(size=(12, 18), fov_deg=50.0, pixel="centre"),
                "tiers": ("direct", "full"),
                "repeats": 2,
            },
        ),
        (
            2,
            {
                "views": Draw(random=3),
                "rotations": Draw(random=2),
                "light_resolutions": ("64x128", "full"),
            },
        ),
        (2, {"pictures": False, "views": Draw(random=5)}),
    ],
)
def test_a_whole_data_set_has_no_faults(whole, segments, changes):
    store = Store(whole(segments, **changes))
    assert texts(store) == []
    assert Verification(store, "another program").in_records() is not None


def test_ids_are_those_of_the_first_data_sets():
    """Of a record of the preset `smallest`, as it was rendered before these functions had one
    home.
    """
    shape = "cfa53937b29b7a149d69748bb2e077f37292aa0a3a63e3e5080c76b92bcca433"
    light = "9e42abcd2fa3231e5c2485ca6dd64800534d157b7194ab7fe9cc3bf5a56d0256"
    nickel = "ee53bd7346d783dd"  # of its label and its nodes then
    render, camera = "86a5152639f121a2", ids.camera_words(Camera(size=(48, 48)))
    for view, seed, id_, geometry in (
        (0, 766045821, "81c6a2ee94ad16fb1e869fd6", "4580ea429d8310542957d50d"),
        (6, 1613729961, "fd28eae35e5414257119396c", "6d1978fedb41c17fe2f36569"),
    ):
        key = ids.combination_key(shape, [nickel], light, 0)
        word, _, _ = ids.draws(JOB, key)
        assert ids.shot_seed(word, ids.shot_place(view, 0, "direct", "64x128", 0)) == seed
        shared = ids.shots_digest(render, shape, (nickel,), light, camera, 16)
        assert ids.shot_id(shared, view, 0, "direct", "64x128", seed) == id_
        assert ids.geometry_id(shape, camera, view, render) == geometry


@pytest.mark.parametrize(
    "changes",
    [
        {"shape_hash": "6" * 64},
        {"viewpoint": 7},
        {"camera": Camera(size=(16, 16), elevation_deg=21.0)},
        {"camera": Camera(size=(16, 16), fov_deg=30.0)},
        {"camera": Camera(size=(16, 16), half_extent=1.03)},
        {"camera": Camera(size=(16, 16), pixel="centre")},
        {"materials": ("grey",)},
        {"materials": ("matte", "matte")},
        {"light_hash": "6" * 64},
        {"rotation_texels": 4},
        {"tier": "direct"},
        {"light_resolution": "full"},
        {"samples": 5},
        {"seed": 1},
        {"id": "0" * 24},
    ],
)
def test_whatever_determines_a_picture_is_held_against_its_id(store, changes):
    record = alter(store, **changes)
    result = list(Verification(store).in_records())
    assert (
        f"record {record.id}: expected id" in result[0].text
        and "the hash of what it says" in result[0].text
    )
    assert result[0].record == record.id and result[0].line == (store.record_files()[0], 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"azimuth_deg": 15.0}, "expected azimuth 0 of viewpoint 0, found 15"),
        ({"category": "chair"}, "expected shape 'ball' with category primitive, found chair"),
        ({"split": "mixed"}, "with split"),
        ({"shape": "cube"}, "expected shape 'ball' with name ball, found cube"),
        ({"light": "sun"}, "expected light 'lamp' with name lamp, found sun"),
        ({"image": "../../etc/passwd"}, ", found ../../etc/passwd"),
        ({"image": "images/ab/other.exr"}, "image at images/"),
        ({"geometry": "/etc/passwd"}, ", found /etc/passwd"),
        ({"geometry": geometry_path("9" * 24)}, "geometry at geometry/"),
        ({"image_hash": "1" * 64}, "the file was altered"),
        ({"geometry_hash": "1" * 64}, "the file was altered"),
    ],
)
def test_a_record_that_does_not_fit_is_condemned_and_no_other(store, changes, message):
    record = alter(store, **changes)
    result = faults_of(store)
    assert any(message in fault.text for fault in result), [fault.text for fault in result]
    assert {fault.record for fault in result} == {record.id}


def test_figures_of_every_record_are_held_against_its_picture_and_its_geometry(store):
    """Not only those of the first record of a geometry file."""

    def change(k, record):
        statistics = record.statistics
        changes = {
            1: {"coverage": 0.5},
            2: {"mean": statistics.mean * 1.01},
            4: {"max": statistics.max * 1.01},
        }.get(k, {})
        return msgspec.structs.replace(
            record, statistics=msgspec.structs.replace(statistics, **changes)
        )

    rewrite(store, change)
    result = [fault for fault in faults_of(store) if fault.record]
    assert [fault.line[1] for fault in result] == [2, 2, 3, 5]
    assert "expected coverage 0.500000" in result[0].text
    assert "a mean of" in result[2].text and "a largest value of" in result[3].text


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p, m: np.where(m[..., None], np.float32("nan"), p), "finite radiance"),
        (lambda p, m: -p, "finite radiance"),
        (lambda p, m: 0 * p, "a black picture"),
        (lambda p, m: 2 * p, "a largest value"),
        (lambda p, m: np.where(m[..., None], p, 0.5), "expected a black background"),
        (lambda p, m: p[:8], "expected 16 × 16 pixels"),
    ],
)
def test_a_picture_that_none_can_be_is_found_though_its_hash_was_written_again(
    whole, tmp_path, spoil, message
):
    shutil.copytree(whole(camera=Camera(size=(16, 16), pixel="centre")), tmp_path / "data")
    store = Store(tmp_path / "data")
    record = lines(store)[0]
    mask = picture_files.read_geometry(store.folder / record.geometry).mask
    picture = spoil(picture_files.read_picture(store.folder / record.image), mask).astype(
        np.float16
    )
    data = exr.encode({name: picture[..., k] for k, name in enumerate("RGB")})
    replace_file(store, record.image, data)
    assert message in "\n".join(texts(store))


@pytest.mark.parametrize("channels", ["RGBA", "XYZ", "R"])
def test_other_channels_are_found(store, channels):
    record = lines(store)[0]
    picture = picture_files.read_picture(store.folder / record.image).astype(np.float16)
    data = exr.encode({name: picture[..., k % 3] for k, name in enumerate(channels)})
    replace_file(store, record.image, data)
    assert "channels R" in "\n".join(texts(store))


def test_a_type_that_is_not_written_is_found(store):
    record = lines(store)[0]
    picture = picture_files.read_picture(store.folder / record.image)
    replace_file(
        store,
        record.image,
        exr.encode({name: picture[..., k] for k, name in enumerate("RGB")}),
    )
    assert "channels R float16" in "\n".join(texts(store))


def encoded(normals, depth, segments):
    """A geometry file of numbers as they are, without the rounding of the contract."""
    channels = {
        f"normal.{axis}": normals[..., k].astype(np.float32) for k, axis in enumerate("XYZ")
    }
    return exr.encode(
        channels | {"depth.Z": depth.astype(np.float32), "segment": segments.astype(np.uint32)}
    )


@pytest.mark.parametrize("fov", [None, 50.0])
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda n, d, s: (n * [1, 1, -1], d, s), "turned away"),
        (lambda n, d, s: (n * 0.98, d, s), "expected unit normals"),
        (lambda n, d, s: (n * 0.5, d, s), "expected unit normals"),
        (lambda n, d, s: (n, np.where(s > 0, np.nan, 0), s), "expected finite depth"),
        (lambda n, d, s: (np.full_like(n, np.inf), d, s), "expected finite normals"),
        (lambda n, d, s: (n, 1.5 * d, s), "inside the unit sphere"),
        (lambda n, d, s: (n, np.where(s > 0, d, 0.25), s), "in the background"),
        (lambda n, d, s: (n, np.where(s > 0, d + 1e-6, 0), s), "expected depth in steps of 2^-15"),
        (lambda n, d, s: (n, np.where(s > 0, 3e38, 0), s), "inside the unit sphere"),
        (lambda n, d, s: (n * [-1, 1, 1], d, s), "expected normals that lean as the depth slopes"),
        (lambda n, d, s: (n * [1, -1, 1], d, s), "expected normals that lean as the depth slopes"),
        (lambda n, d, s: (n, -d, s), "expected normals that lean as the depth slopes"),
        (lambda n, d, s: (n, d, s * 2), "expected segments up to 1, found 2"),
        (lambda n, d, s: (n, d, s * 256), "expected segments 0 to 255"),
        (lambda n, d, s: (n, d, s * 257), "expected segments 0 to 255"),
        (lambda n, d, s: (0 * n, 0 * d, 0 * s), "an empty mask"),
        (lambda n, d, s: (n[:, ::2], d[:, ::2], s[:, ::2]), "expected 32 × 32 pixels"),
    ],
)
def test_geometry_that_none_can_be_is_found_though_its_hash_was_written_again(
    whole, tmp_path, fov, spoil, message
):
    shutil.copytree(whole(camera=Camera(size=(32, 32), fov_deg=fov)), tmp_path / "data")
    store = Store(tmp_path / "data")
    record = lines(store)[0]
    geometry = picture_files.read_geometry(store.folder / record.geometry)
    replace_file(
        store, record.geometry, encoded(*spoil(*(np.asarray(a, np.float64) for a in geometry[:3])))
    )
    assert message in "\n".join(texts(store))


def test_a_bad_geometry_file_condemns_every_record_that_uses_it_and_is_read_once(
    store, monkeypatch
):
    (store.folder / lines(store)[0].geometry).write_bytes(b"other")
    calls = []
    read = picture_files.read_geometry
    monkeypatch.setattr(
        picture_files, "read_geometry", lambda *a, **k: calls.append(a[0]) or read(*a, **k)
    )
    result = faults_of(store)
    using = {record.id for record in lines(store) if record.geometry == lines(store)[0].geometry}
    assert {fault.record for fault in result} == using and len(using) == 2
    assert len(calls) == len(set(calls)) == 4


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda L, s: {"L": 2 * L, "scale": s}, "unit mean luminance"),
        (lambda L, s: {"L": -L, "scale": s}, "expected finite radiance ≥ 0"),
        (lambda L, s: {"L": L, "scale": 2 * s}, "as in dataset.json"),
        (lambda L, s: {"L": L, "scale": np.float64("nan")}, "a finite scale"),
        (lambda L, s: {"L": L}, "expected arrays L, scale alone"),
        (lambda L, s: {"L": L, "scale": s, "more": s}, "expected arrays L, scale alone"),
        (lambda L, s: {"L": L.astype(np.float64), "scale": s}, "L of float32"),
        (lambda L, s: {"L": L[:32], "scale": s}, r"(64, 128, 3)"),
    ],
)
def test_a_light_map_that_none_can_be_is_found_though_its_hash_was_written_again(
    store, spoil, message
):
    entry = store.dataset().lights["lamp"]
    L, scale = (
        light_files.read_light(store.folder / entry.file),
        np.float64(light_files.read_scale(store.folder / entry.file)),
    )
    replace_file(store, entry.file, npz_bytes(spoil(L, scale)))
    assert message in "\n".join(texts(store))


def test_a_light_that_the_program_knows_is_compared_with_it(store):
    entry = store.dataset().lights["lamp"]
    L = light_files.read_light(store.folder / entry.file)
    known = {("lamp", hash_of("lamp")): (L * (1 + 1e-6), entry.scale)}  # another machine's rounding
    assert faults_of(store, reference=lambda *key: known.get(key)) == []
    replace_file(store, entry.file, light_files.encode_light(np.roll(L, 1, axis=1), entry.scale))
    # another light, as good as the first, to whoever does not know it
    assert faults_of(store) == []
    assert "found another" in faults_of(store, reference=lambda *key: known.get(key))[0].text


@pytest.mark.parametrize("own_hash", [False, True])
@pytest.mark.parametrize("what", ["label", "mixture"])
def test_a_changed_label_or_mixture_is_found(store, what, own_hash):
    path = store.folder / "materials.json"
    catalogue = read_catalogue(path)
    matte = catalogue.materials[0]
    label = (matte.label[0] + 1e-9, *matte.label[1:])
    mixture = msgspec.structs.replace(matte.mixture, stops=(1e-9,))
    altered = msgspec.structs.replace(
        matte, **({"label": label} if what == "label" else {"mixture": mixture})
    )
    if own_hash:
        from manifests.materials import material_hash

        altered = msgspec.structs.replace(
            altered, hash=material_hash(altered.label, altered.mixture)
        )
    path.write_bytes(
        encode(msgspec.structs.replace(catalogue, materials=(altered, *catalogue.materials[1:])))
    )
    result = faults_of(store)
    assert "materials.json: 'matte'" in result[0].text and result[0].entry == ("labels", "matte")
    assert not any(fault.record for fault in result)


def test_an_altered_entry_is_told_from_altered_records_by_the_ids(store):
    """Eight records say one thing, dataset.json another: no picture is condemned."""
    for kind, name, changes, message in (
        ("shapes", "ball", {"hash": "6" * 64}, "shape 'ball': hash"),
        ("shapes", "ball", {"category": "chair"}, "category primitive expected, as 4 lines"),
        ("shapes", "ball", {"segments": 2}, "segments 1 expected, as 4 lines"),
        ("materials", "matte", {"hash": "6" * 16}, "material 'matte': hash"),
        ("lights", "lamp", {"hash": "6" * 64}, "light 'lamp': hash"),
    ):
        before = store.dataset()
        alter_entry(store, kind, name, **changes)
        result = faults_of(store)
        assert any(message in fault.text and fault.entry == (kind, name) for fault in result), (
            texts(store)
        )
        assert not any(fault.record for fault in result)
        store.write_json("dataset.json", before)


def test_a_label_that_fits_its_hash_but_no_id_leaves_nothing_that_confirms_it(store):
    """Label, its hash and dataset.json changed together: the ids are hashes of the old one."""
    from manifests.materials import material_hash

    path = store.folder / "materials.json"
    catalogue = read_catalogue(path)
    label = (0.5,) * 108
    matte = msgspec.structs.replace(catalogue.materials[0], label=label)
    matte = msgspec.structs.replace(matte, hash=material_hash(label, matte.mixture))
    path.write_bytes(
        encode(msgspec.structs.replace(catalogue, materials=(matte, catalogue.materials[1])))
    )
    alter_entry(store, "materials", "matte", hash=matte.hash)
    result = faults_of(store)
    assert {fault.record for fault in result if fault.record} == {
        r.id for r in lines(store) if "matte" in r.materials
    }
    assert ("materials", "matte") in {fault.entry for fault in result}
    repair(store, result)
    assert texts(store) == []


@pytest.mark.parametrize(
    ("kind", "name", "changes", "message"),
    [
        ("shapes", "ball", {"side": "test"}, "side train of its role"),
        ("shapes", "ball", {"side": "test", "role": "test"}, "role"),
        ("materials", "matte", {"side": "test"}, "expected side train, found test"),
        ("materials", "matte", {"licence": "mine"}, "licence 'CC0', as in materials.json,"),
        ("lights", "lamp", {"side": "test"}, "by its hash"),
        ("lights", "lamp", {"scale": 9.0}, "as in dataset.json"),
        ("lights", "lamp", {"file": "lights/other.npz"}, "its map at lights/lamp-"),
        ("lights", "lamp", {"file": "../../etc/passwd"}, "its map at lights/lamp-"),
        ("lights", "lamp", {"file": "lights/a\0b.npz"}, r"found lights/a\x00b.npz"),
    ],
)
def test_entries_follow_the_rules(store, kind, name, changes, message):
    if kind == "lights" and "side" in changes and store.dataset().lights["lamp"].side == "test":
        changes = {"side": "train"}
    if store.dataset().shapes["ball"].side == "test":
        pytest.fail("the cases are written for a training shape")
    alter_entry(store, kind, name, **changes)
    assert message in "\n".join(texts(store))
    assert all("\n" not in text and text.isprintable() for text in texts(store))


def test_what_nothing_names_is_found(store):
    dataset = store.dataset()
    lights = {**dataset.lights, "sun": dataset.lights["lamp"]}
    store.write_json("dataset.json", msgspec.structs.replace(dataset, lights=lights))
    path = store.folder / "materials.json"
    catalogue = read_catalogue(path)
    more = msgspec.structs.replace(catalogue.materials[0], name="felt")
    path.write_bytes(
        encode(msgspec.structs.replace(catalogue, materials=(*catalogue.materials, more)))
    )
    result = "\n".join(texts(store))
    assert "light 'sun': expected a light that an order names" in result
    assert "materials.json: expected a material that dataset.json names, found 'felt'" in result


def test_records_that_no_order_asks_for_are_found(store):
    """By a forger who knows how ids are made: id, name of the picture and seed fit each other."""
    first = lines(store)[0]
    dataset = store.dataset()
    hashes = tuple(dataset.materials[name].hash for name in first.materials)
    shared = ids.shots_digest(
        RENDER, first.shape_hash, hashes, first.light_hash, ids.camera_words(first.camera), 4
    )
    id_ = ids.shot_id(shared, first.viewpoint, 77, first.tier, first.light_resolution, first.seed)
    (store.folder / image_path(id_)).parent.mkdir(exist_ok=True)
    (store.folder / first.image).rename(store.folder / image_path(id_))
    alter(store, id=id_, image=image_path(id_), rotation_texels=77)
    assert list(Verification(store).in_records()) == []
    assert texts(store) == [
        f"record {id_}: expected an order in dataset.json that asks for it, found none"
    ]


def test_an_altered_order_condemns_no_picture(store):
    dataset = store.dataset()
    job = msgspec.structs.replace(dataset.orders[0].job, seed=1)
    order = msgspec.structs.replace(dataset.orders[0], job=job)
    store.write_json("dataset.json", msgspec.structs.replace(dataset, orders=(order,)))
    (fault,) = faults_of(store)
    assert (
        "expected orders that ask for all lines, found none for 8" in fault.text
        and not fault.mendable
    )


def test_more_shots_than_an_order_can_mean_are_found(store):
    dataset = store.dataset()
    order = msgspec.structs.replace(dataset.orders[0], shots=9)
    store.write_json("dataset.json", msgspec.structs.replace(dataset, orders=(order,)))
    assert "expected at most 8 shots of its job, found 9" in texts(store)[0]


@pytest.mark.parametrize(
    ("shapes", "materials", "count"),
    [
        ("sphere:10000000000-10000000003", ("brass",), 4),
        ("chair:0-3", ("felt",), 8),  # a user's set of two, one of which has its name
        ("chair:0-3", ("felt", "felt-red"), 8),
        ("chair:0-3", ("brass",), 4),
        ("chair:0-3", ("merl/brass", "brass"), 8),
    ],
)
def test_most_shots_are_never_fewer_than_a_job_can_mean(shapes, materials, count):
    job = Job(shapes=(shapes,), materials=materials, lights=("city",))
    entry = MaterialEntry(hash="0" * 16, side="train", licence="")
    known = {name: entry for name in ("brass", "felt", "felt-red")}
    assert most_shots(job, Dataset(materials=known)) == count


def test_another_render_version_in_dataset_json_condemns_no_picture(store):
    dataset = store.dataset()
    store.write_json("dataset.json", msgspec.structs.replace(dataset, settings={"f" * 16: {}}))
    (fault,) = faults_of(store)
    assert "none that gives the ids of its 8 lines" in fault.text and not fault.mendable
    assert faults_of(store, render=RENDER) == []  # the program's own settings are the ones


def test_missing_altered_and_stray_files_are_found(store):
    first, second, *_ = lines(store)
    (store.folder / first.image).unlink()
    (store.folder / second.image).write_bytes(b"other")
    (store.folder / "images" / "00").mkdir(exist_ok=True)
    (store.folder / "images" / "00" / "stray.exr").write_bytes(b"")
    (store.folder / store.dataset().lights["lamp"].file).write_bytes(b"")
    (store.folder / "partial" / "worker-00-x.exr").write_bytes(b"")
    (store.folder / "records" / "notes.txt").write_bytes(b"")
    result = "\n".join(texts(store))
    assert f"{first.image}: expected an OpenEXR file, found no such file" in result
    assert f"{second.image}: expected a whole OpenEXR file" in result
    assert "stray.exr: expected a record that names it" in result
    assert ".npz: expected a stored light map" in result
    assert "half-written" in result
    assert "records/notes.txt: expected files *.jsonl" in result
    assert summary(faults_of(store)) == (2, 3, 1)


def test_duplicates_torn_and_foreign_lines_are_found(store):
    (path,) = store.record_files()
    whole = path.read_bytes()
    path.write_bytes(whole + whole.splitlines(keepends=True)[0] + b'{"id": 3}\n' + b'{"id": "abc')
    result = "\n".join(fault.text for fault in Verification(store).in_records())
    assert "expected once, found again" in result
    assert "worker-00.jsonl:10: expected a record" in result
    assert "worker-00.jsonl:11: expected a whole line" in result
    assert repair(store, faults_of(store)) == (3, 0)
    assert path.read_bytes() == whole


def spoiled_places(store):
    """name → a function that puts something in the place of a file or a folder."""
    record = lines(store)[0]

    def replaced(relative, put):
        def spoil():
            path = store.folder / relative
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
            put(path)

        return spoil

    loop = lambda path: path.symlink_to(path.name)  # noqa: E731 -- one of a row
    outside = lambda path: path.symlink_to(store.folder.parent / "outside")  # noqa: E731
    light = store.dataset().lights["lamp"].file
    return {
        "picture loop": replaced(record.image, loop),
        "picture link": replaced(record.image, outside),
        "picture pipe": replaced(record.image, os.mkfifo),
        "picture folder": replaced(record.image, os.mkdir),
        "picture folder's folder": replaced(os.path.dirname(record.image), loop),
        "picture folder's folder outside": replaced(os.path.dirname(record.image), outside),
        "geometry pipe": replaced(record.geometry, os.mkfifo),
        "geometry loop": replaced(record.geometry, loop),
        "light pipe": replaced(light, os.mkfifo),
        "light loop": replaced(light, loop),
        "images loop": replaced("images", loop),
        "images file": replaced("images", lambda path: path.write_bytes(b"")),
        "images outside": replaced("images", outside),
        "geometry outside": replaced("geometry", outside),
        "lights pipe": replaced("lights", os.mkfifo),
        "records loop": replaced("records", loop),
        "records outside": replaced("records", outside),
        "lines pipe": replaced("records/worker-09.jsonl", os.mkfifo),
        "lines loop": replaced("records/worker-09.jsonl", loop),
        "lines folder": replaced("records/worker-09.jsonl", os.mkdir),
        "views file": replaced("views", lambda path: path.write_bytes(b"")),
        "failures pipe": replaced("failures.jsonl", os.mkfifo),
        "stray loop": replaced("images/loop", loop),
        "stray pipe": replaced("geometry/pipe", os.mkfifo),
        "loop at the top": replaced("loop", loop),
        "pipe at the top": replaced("pipe", os.mkfifo),
        "lock loop": replaced(".lock", loop),
        "draft pipe": replaced("partial/pipe", os.mkfifo),
    }


SPOILED = (
    "picture loop",
    "picture link",
    "picture pipe",
    "picture folder",
    "picture folder's folder",
    "geometry pipe",
    "geometry loop",
    "picture folder's folder outside",
    "light pipe",
    "light loop",
    "images loop",
    "images file",
    "images outside",
    "geometry outside",
    "lights pipe",
    "records loop",
    "records outside",
    "lines pipe",
    "lines loop",
    "lines folder",
    "views file",
    "failures pipe",
    "stray loop",
    "stray pipe",
    "loop at the top",
    "pipe at the top",
    "lock loop",
    "draft pipe",
)


@pytest.mark.parametrize("name", SPOILED)
def test_links_pipes_and_folders_in_the_place_of_files_are_lines_and_repair_touches_nothing_outside(
    store, name
):
    outside = store.folder.parent / "outside"
    outside.mkdir()
    record = lines(store)[0]
    names = [record.image.rpartition("/")[2], "worker-00.jsonl", "keep"]
    for each in names:
        (outside / each).write_bytes(b"mine")
    spoiled_places(store)[name]()
    result = faults_of(store)
    assert result and all("\n" not in fault.text for fault in result)
    repair(store, result)
    assert {path.name: path.read_bytes() for path in outside.iterdir()} == dict.fromkeys(
        names, b"mine"
    )
    left = faults_of(store)
    assert all(
        ".npz: expected a stored light map, found no such file" in fault.text for fault in left
    ), left


def test_the_list_of_places_is_the_one_that_is_tested(store):
    assert set(SPOILED) == set(spoiled_places(store))


def test_a_line_beyond_all_measure_is_a_fault_and_takes_no_memory(store):
    (path,) = store.record_files()
    with open(path, "ab") as file:
        file.truncate(path.stat().st_size + (3 << 20))
    assert "expected a line of at most 1048576 bytes" in "\n".join(texts(store))


def test_repair_takes_away_a_line_beyond_all_measure(store):
    (path,) = store.record_files()
    whole = path.read_bytes()
    path.write_bytes(whole + b" " * (3 << 20))
    failures = store.folder / "failures.jsonl"
    failures.write_bytes(b" " * (3 << 20))
    faults = faults_of(store)
    assert len(faults) == 2 and all(
        fault.mendable and "verify DIR --repair takes it away" in fault.text for fault in faults
    )
    assert repair(store, faults) == (2, 0)
    assert path.read_bytes() == whole and not failures.exists()
    assert texts(store) == []


def test_lines_and_files_after_a_line_beyond_all_measure_stay(store):
    (path,) = store.record_files()
    whole = path.read_bytes()
    first, *others = whole.splitlines(keepends=True)
    assert others
    path.write_bytes(first + b" " * (3 << 20) + b"\n" + b"".join(others))
    faults = faults_of(store)
    assert [fault.line for fault in faults] == [(path, 2)]
    assert repair(store, faults) == (1, 0)
    assert path.read_bytes() == whole
    assert texts(store) == []


def test_repair_takes_away_what_is_broken_and_nothing_else(store):
    first, *others = lines(store)
    (store.folder / first.image).unlink()
    (store.folder / "images" / "stray.exr").write_bytes(b"")
    assert repair(store, faults_of(store)) == (1, 1)
    assert texts(store) == []
    assert lines(store) == others


def test_a_picture_goes_with_its_record_and_geometry_with_the_last_that_names_it(store):
    first = lines(store)[0]
    alter(store, seed=1)
    repair(store, list(Verification(store).in_records()))
    assert not (store.folder / first.image).exists() and (store.folder / first.geometry).exists()
    using = [k for k, record in enumerate(lines(store)) if record.geometry == first.geometry]
    rewrite(
        store,
        lambda k, record: msgspec.structs.replace(record, samples=9) if k in using else record,
    )
    repair(store, list(Verification(store).in_records()))
    assert not (store.folder / first.geometry).exists()
    assert texts(store) == []


def test_a_geometry_file_that_one_record_finds_good_stays(store):
    first = lines(store)[0]
    alter(store, geometry_hash="1" * 64)
    repair(store, faults_of(store))
    assert (store.folder / first.geometry).exists() and texts(store) == []


def test_views_are_held_against_their_ids_and_their_shape(whole, tmp_path):
    shutil.copytree(whole(2, pictures=False), tmp_path / "data")
    store = Store(tmp_path / "data")
    side = lines(store, "views")[0].side
    whole_lines = store.record_files("views")[0].read_bytes()
    for changes, message in (
        ({"viewpoint": 3}, "the hash of what it says"),
        ({"shape_hash": "6" * 64}, "the hash of what it says"),
        ({"camera": Camera(size=(16, 16), elevation_deg=30.0)}, "the hash of what it says"),
        ({"azimuth_deg": 1.0}, "azimuth 0 of viewpoint 0"),
        ({"segments": 3}, "segments 2, found 3"),
        ({"side": "train" if side == "test" else "test"}, f"with side {side}"),
        ({"category": "chair"}, "with category primitive"),
        ({"coverage": 0.1}, "coverage 0.1"),
        ({"geometry": "geometry/../x.exr"}, ", found geometry/../x.exr"),
        ({"geometry_hash": "0" * 64}, "the file was altered"),
    ):
        alter(store, "views", **changes)
        assert message in "\n".join(texts(store)), changes
        store.record_files("views")[0].write_bytes(whole_lines)
    assert texts(store) == []


def test_the_cache_of_packed_geometry_is_compared_with_the_files(store):
    folder = store.folder / "packed"
    folder.mkdir()
    files = {record.geometry_hash: record.geometry for record in lines(store)}
    geometry = [picture_files.read_geometry(store.folder / path) for path in files.values()]
    normals = np.stack([packed_geometry.pack_normals(each.normals) for each in geometry])
    segments = np.stack([each.segments for each in geometry])

    def pack(normals, segments, skipped=()):
        np.save(folder / "normals.npy", normals)
        np.save(folder / "segments.npy", segments)
        (folder / "views.json").write_bytes(msgspec.json.encode(list(files)))
        (folder / "skipped.json").write_bytes(msgspec.json.encode(dict.fromkeys(skipped, "bad")))

    pack(normals, segments)
    assert texts(store) == []
    pack(normals + (np.arange(normals.size) == 999).reshape(normals.shape), segments)
    assert "found other normals or segments" in texts(store)[0]
    pack(normals, segments, skipped=list(files)[:1])
    assert "found it left out" in texts(store)[0]
    pack(normals[1:], segments)
    assert "expected a whole cache of geometry" in texts(store)[0]
    pack(normals, segments)
    (folder / "sums.json").mkdir()  # training could not make the cache again
    assert "expected a whole cache of geometry" in texts(store)[0]
    repair(store, faults_of(store))
    assert not folder.exists() and texts(store) == []


def test_what_trains_here_and_tests_there_is_found(store):
    ours = store.dataset()
    side = "train" if ours.shapes["ball"].side == "test" else "test"
    other = {"sphere": msgspec.structs.replace(ours.shapes["ball"], side=side, role=side)}
    theirs = msgspec.structs.replace(ours, shapes=other, materials={}, lights={})
    assert shared_between({"a": ours, "b": theirs}) == [("shape", "ball", "a", "sphere", "b")]
    assert shared_between({"a": ours, "b": ours}) == []


def test_a_fault_is_one_line_whatever_names_it_holds():
    assert Fault("shape 'a\nb\0\x1b[2J\udc80'").text == r"shape 'a\nb\x00\x1b[2J\udc80'"


@pytest.mark.parametrize(
    "id_",
    ["../../x", "A" * 24, "0" * 23, "0" * 25, "0" * 24 + "\n", "0" * 23 + "g", "0" * 23 + "\0"],
)
def test_an_id_that_is_none_is_refused_where_it_is_read(store, id_):
    value = msgspec.to_builtins(lines(store)[0]) | {"id": id_}
    with pytest.raises(msgspec.ValidationError, match=r"\$\.id"):
        msgspec.json.decode(msgspec.json.encode(value), type=Record)
    (path,) = store.record_files()
    path.write_bytes(msgspec.json.encode(value) + b"\n")
    with pytest.raises(InputError, match="id: expected str"):
        list(store.records())
