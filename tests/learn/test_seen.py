"""Weights say what they saw, and an evaluation refuses pictures of it."""

import json
import shutil
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from learn.data import seen, sources
from learn.data.records import Records
from learn.data.seen import DIGITS, Seen, label_hash, map_hash
from learn.data.settings import Data
from learn.evaluation import overlap
from learn.networks import built_in_weights, tensor_file, weights
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.seen_lists import write_lists
from manifests import light_files, measured_lights
from manifests.cli import main
from manifests.errors import InputError
from manifests.schema import LightEntry
from manifests.store_paths import light_path
from shaders import envmap
from tests.support import synthetic
from tests.support.synthetic import matte

SIZE = 32
HELD_LIGHT = "0" * 64  # a hash on the test side
RUN = {
    "name": "tiny",
    "size": SIZE,
    "data": {"sharing": 1, "source": "relit"},
    "schedule": {"steps": 2, "batch": 2, "warm_up": 1},
}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Spheres of two materials under one light, and a shape, two materials and a light for tests.

    Records of the test shape are of the test side: its materials, under its light alone.
    """
    entries = [matte("dark", 0.1), matte("bright", 0.8)]
    entries += [matte("grey", 0.3, "test"), matte("white", 0.9, "test")]
    store = synthetic.write_dataset(
        tmp_path_factory.mktemp("data"),
        entries,
        np.random.default_rng(1),
        size=SIZE,
        seeds=1,
        noise=0.0,
        rotations=(2,),
    )
    synthetic.add_sides(store)
    L, scale = envmap.unit_mean(np.exp(np.random.default_rng(2).standard_normal((64, 128, 3))))
    stored = light_path("dusk", HELD_LIGHT)
    digest = store.place(stored, light_files.encode_light(L, scale), "test")
    entry = LightEntry(hash=HELD_LIGHT, file=stored, file_hash=digest, scale=scale, licence="CC0")
    dataset = store.dataset()
    lights = {**dataset.lights, "dusk": entry}
    store.write_json("dataset.json", msgspec.structs.replace(dataset, lights=lights))

    def under_its_light(record):
        if record.split != "test":
            return record
        return msgspec.structs.replace(record, light="dusk", light_hash=HELD_LIGHT)

    synthetic.rename(store, under_its_light)
    return store


def learn(*words):
    return main("learn", "", (words[0],), [str(word) for word in words])


@pytest.fixture(scope="module")
def trained(store, tmp_path_factory):
    """The folder of a run of two steps."""
    out = tmp_path_factory.mktemp("run")
    (out / "run-file.json").write_text(json.dumps(RUN))
    words = ("train", out / "run-file.json", "--data", store.folder, "--out", out, "--workers", 0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        assert learn(*words, "--threads", 1) == 0
    finally:
        torch.set_num_threads(threads)
    return out


@pytest.fixture
def evaluate(store, tmp_path):
    def run(path, *words, data=None):
        where = ("--data", data or store.folder, "--weights", path, "--out", tmp_path / "out")
        quick = ("--no-refine", "--edits", 2, "--processes", 1, "--gallery", 0)
        return learn("evaluate", *where, *quick, *words)

    return run


@pytest.fixture(scope="module")
def training_side(store, tmp_path_factory):
    """A data set of the training side's pictures alone."""
    folder = tmp_path_factory.mktemp("training") / "data"
    shutil.copytree(store.folder, folder)
    path = next((folder / "records").glob("*.jsonl"))
    lines = [line for line in path.read_text().splitlines() if json.loads(line)["split"] == "train"]
    path.write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture
def old(tmp_path):
    """Weights from before there were lists."""
    torch.manual_seed(3)
    labels = torch.tensor([matte("a", albedo).label for albedo in (0.05, 0.9)]).float()
    network = Compact(Ranges.of(labels))
    weights.save_weights(tmp_path / "old.safetensors", network, network.state_dict(), "{}", SIZE)
    return tmp_path / "old.safetensors"


def changed(path, target, change):
    """Write a file's tensors with its lists as text after `change`; return the target."""
    with tensor_file.open_tensor_file(path) as stored:
        tensors = {name: stored.tensor(name) for name in stored.shapes}
        metadata = dict(stored.metadata)
    metadata[seen.KEY] = change(metadata[seen.KEY])
    tensor_file.write(target, tensors, metadata)
    return target


def test_weights_and_checkpoint_hold_what_training_and_validation_drew_from(store, trained):
    records, dataset = Records(store.folder), store.dataset()
    shapes = [dataset.shapes[name].hash[:DIGITS] for name in ("sphere", synthetic.VALIDATION)]
    expected = Seen(
        shapes=tuple(sorted(shapes)),
        materials=tuple(sorted(label_hash(records.label(name)) for name in ("dark", "bright"))),
        lights=(map_hash(records.light("sky")),),
    )
    for name in ("weights", "checkpoint"):
        assert weights.seen_by(trained / f"{name}.safetensors") == expected


def test_training_side_is_refused_with_counts_names_and_the_remedy(
    trained, training_side, evaluate, capsys, tmp_path
):
    assert evaluate(trained / "weights.safetensors", data=training_side) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    for words in (
        "2 of 2 shapes (",
        "materials (",
        "1 of 1 lights (sky)",
        "--allow-overlap",
        "another data set",
    ):
        assert words in line
    assert not (tmp_path / "out" / "report.md").exists()


def test_allowed_overlap_stands_at_the_top_of_the_report(
    trained, training_side, evaluate, capsys, tmp_path
):
    path = trained / "weights.safetensors"
    assert evaluate(path, "--allow-overlap", data=training_side) == 0
    assert "Overlap: weights.safetensors saw in training" in capsys.readouterr().out
    lines = (tmp_path / "out" / "report.md").read_text().splitlines()
    assert lines[2].startswith("**Overlap: weights.safetensors saw in training 2 of 2 shapes (")
    assert "Overlap" in (tmp_path / "out" / "index.html").read_text()


def test_test_side_is_accepted_without_a_word(trained, evaluate, capsys, tmp_path):
    assert evaluate(trained / "weights.safetensors") == 0
    assert "saw" not in capsys.readouterr().out
    text = (tmp_path / "out" / "report.md").read_text()
    assert "Overlap" not in text and "Warning" not in text


def test_weights_without_lists_are_measured_with_a_warning(old, evaluate, capsys, tmp_path):
    assert evaluate(old) == 0
    warning = "these weights do not say what they saw: old.safetensors"
    assert capsys.readouterr().out.count(warning) == 1
    assert warning in (tmp_path / "out" / "report.md").read_text().splitlines()[2]


def test_network_page_refuses_a_test_side_that_was_seen(store, trained, capsys, tmp_path):
    """A run on another data set saw what this one keeps for tests."""
    records = Records(store.folder)
    labels = [label_hash(records.label(name)) for name in ("grey", "white")]
    theirs = changed(
        trained / "weights.safetensors",
        tmp_path / "w.safetensors",
        lambda text: seen.encode_seen(
            seen.make_seen(
                {"shapes": [], "materials": labels, "lights": [map_hash(records.light("dusk"))]}
            )
        ),
    )
    words = ("evaluate-network", theirs, "--data", store.folder, "--batches", 1)
    assert learn(*words, "--out", tmp_path / "out") == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "2 of 2 materials (grey, white), 1 of 1 lights (dusk)" in line
    assert learn(*words, "--out", tmp_path / "out", "--allow-overlap") == 0
    page = (tmp_path / "out" / "card.md").read_text()
    assert page.splitlines()[2].startswith("**Overlap: w.safetensors")
    assert "not all of them unseen" in page and "never seen" not in page


def test_network_page_of_the_runs_own_test_side_is_made(store, trained, capsys, tmp_path):
    words = ("evaluate-network", trained / "weights.safetensors", "--data", store.folder)
    assert learn(*words, "--batches", 1, "--out", tmp_path / "out") == 0
    assert "saw" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"shapes":["', '"shapes":["0000000000000000","'),
        lambda text: json.dumps(json.loads(text) | {"digest": "0" * 16}),
        lambda text: text.replace('"complete":true', '"complete":false'),
        lambda text: text[:-3],
        lambda text: "[]",
        lambda text: text.replace('"lights":["', '"lights":["x'),
    ],
)
def test_lists_other_than_those_written_are_refused_in_one_line(
    change, trained, evaluate, capsys, tmp_path
):
    path = changed(trained / "weights.safetensors", tmp_path / "t.safetensors", change)
    assert evaluate(path) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "t.safetensors: seen in the metadata" in line


def test_lists_return_from_metadata_as_they_were(rng):
    hashes = {kind: [rng.bytes(32).hex() for _ in range(9)] for kind in seen.KINDS}
    lists = seen.make_seen(hashes, complete=False)
    assert seen.read_seen({seen.KEY: seen.encode_seen(lists)}, "file") == lists
    assert lists.shapes == tuple(sorted(each[:DIGITS] for each in hashes["shapes"]))
    assert seen.read_seen({}, "file") is None


def test_lists_of_thousands_stay_small_and_say_that_they_were_cut(rng):
    many = [rng.bytes(8).hex() for _ in range(seen.MOST + 1)]
    lists = seen.make_seen({"shapes": many, "materials": [], "lights": []})
    assert lists.shapes == tuple(sorted(many)[: seen.MOST]) and not lists.complete
    assert len(seen.encode_seen(lists)) < 20 * seen.MOST
    assert seen.read_seen({seen.KEY: seen.encode_seen(lists)}, "file") == lists


def test_a_run_that_began_from_weights_without_lists_does_not_claim_to_know_all():
    own = seen.make_seen({"shapes": ["a" * 16], "materials": [], "lights": []})
    theirs = seen.make_seen({"shapes": ["b" * 16], "materials": ["c" * 16], "lights": []})
    assert not own.join(None).complete
    assert own.join(theirs).shapes == ("a" * 16, "b" * 16)
    assert own.join(theirs).complete and not own.join(theirs.join(None)).complete


def test_lists_put_together_later_say_so_and_hand_it_on():
    own = seen.make_seen({"shapes": ["a" * 16], "materials": [], "lights": ["b" * 16]})
    # as in files from before lists could be put together: these must stay readable
    assert seen.encode_seen(own) == (
        '{"lists":{"version":1,"shapes":["aaaaaaaaaaaaaaaa"],"materials":[],'
        '"lights":["bbbbbbbbbbbbbbbb"],"complete":true},"digest":"3038ccef1a0f4ac1"}'
    )
    theirs = seen.make_seen(
        {kind: ["c" * 16] for kind in seen.KINDS}, reconstructed="the log alone has them"
    )
    both = own.join(theirs)
    assert both.reconstructed == own.join(theirs).join(theirs).reconstructed
    assert both.reconstructed == "the log alone has them" and both.complete
    assert seen.read_seen({seen.KEY: seen.encode_seen(both)}, "file") == both
    assert own.join(None).reconstructed is msgspec.UNSET


def test_lists_written_later_leave_every_tensor_as_it_is(old, evaluate, capsys, tmp_path):
    lists = seen.make_seen(
        {kind: ["c" * 16] for kind in seen.KINDS}, reconstructed="the log says so"
    )
    write_lists(old, lists, tmp_path / "new.safetensors")
    assert weights.seen_by(tmp_path / "new.safetensors") == lists
    with (
        tensor_file.open_tensor_file(old) as a,
        tensor_file.open_tensor_file(tmp_path / "new.safetensors") as b,
    ):
        assert a.shapes == b.shapes and a.kinds == b.kinds
        assert b.metadata == a.metadata | {seen.KEY: seen.encode_seen(lists)}
        for name in a.shapes:
            assert torch.equal(a.tensor(name), b.tensor(name))
    assert not list(tmp_path.glob("*.trial"))
    assert evaluate(tmp_path / "new.safetensors") == 0
    note = "Note: what new.safetensors saw was reconstructed: the log says so."
    assert note in capsys.readouterr().out
    assert note in (tmp_path / "out" / "report.md").read_text().splitlines()[2]


def test_lists_are_not_written_into_a_file_that_would_change(old, tmp_path, monkeypatch):
    lists = seen.make_seen({kind: [] for kind in seen.KINDS})
    write = tensor_file.write

    def damaged(path, tensors, metadata):
        name = next(iter(tensors))
        write(path, tensors | {name: tensors[name] + 1}, metadata)

    monkeypatch.setattr(tensor_file, "write", damaged)
    before = old.read_bytes()
    with pytest.raises(ValueError, match="expected tensors of digest"):
        write_lists(old, lists, old)
    assert old.read_bytes() == before and list(tmp_path.iterdir()) == [old]


def test_lists_are_not_written_into_what_is_no_weights(tmp_path):
    tensor_file.write(tmp_path / "other.safetensors", {"a": torch.zeros(1)}, {})
    with pytest.raises(InputError, match="weights that name their network"):
        write_lists(
            tmp_path / "other.safetensors", seen.make_seen({k: [] for k in seen.KINDS}), tmp_path
        )


@pytest.mark.parametrize(
    ("name", "digest", "shapes"),
    [
        ("joint-compact", "8bc6617e335696c8", 263),
        ("general-compact", "610c8a2ca78c51eb", 1600),
        ("general-two-encoders", "9064b87ec5e1e840", 2565),
    ],
)
def test_the_committed_weights_say_all_that_they_saw(name, digest, shapes, tmp_path):
    path = built_in_weights.FOLDER / f"{name}.safetensors"
    with tensor_file.open_tensor_file(path) as stored:
        tensors = {each: stored.tensor(each) for each in stored.shapes}
    assert weights.digest_of(tensors)[:16] == digest  # of the tensors that training left
    lists = weights.seen_by(path)
    assert lists.complete and "joint-compact wrote no lists" in lists.reconstructed
    assert len(lists.shapes) == shapes
    chairs = {"f3da34df8d933159": "chair:41", "167fd585ca641e24": "chair:29"}
    lights = {map_hash(L): each for each, L in measured_lights.load_all().items()}
    tested = {"shapes": chairs, "materials": {}, "lights": lights}
    with pytest.raises(InputError, match=rf"{name}.* found 1 of 2 shapes \(chair:41\), 20 of 26"):
        overlap.report_overlap([path], tested, tmp_path, False)
    held_out = {each: light for each, light in lights.items() if each not in lists.lights}
    blender = {"blender_city", "blender_interior"}
    others = {"pmndrs_sunset", "pmndrs_lab", "drei_forest_slope", "drei_studio_small_03"}
    assert set(held_out.values()) == blender | others


def test_a_target_material_counts_where_the_pictures_are_of_the_test_side(store):
    records = Records(store.folder)

    def edit(split):
        source, truth = (
            SimpleNamespace(materials=(name,), split=split, shape="s", shape_hash="5" * 64)
            for name in ("dark", "grey")
        )
        source.light = "sky"
        return SimpleNamespace(source=source, truth=truth)

    tested = {
        split: overlap.shown_by_edits(records, [edit(split)])["materials"]
        for split in ("test", "train")
    }
    assert set(tested["test"].values()) == {"dark", "grey"}
    assert set(tested["train"].values()) == {"dark"}


def test_validation_without_a_light_of_its_own_is_not_lit_by_one_for_tests(store):
    splits = sources.load_data_splits(Data(), store.folder, progress=False)
    assert splits["validation"].map_names == ("sky",)
    assert splits["test"].map_names == ("dusk",)


def test_baselines_priors_say_what_they_were_fitted_to(store, trained, tmp_path):
    words = ("train-baselines", "--data", store.folder, "--only", "lombardi", "--out", tmp_path)
    assert learn(*words) == 0
    seen_by_run = weights.seen_by(trained / "weights.safetensors")
    fitted = weights.seen_by(tmp_path / "lombardi.safetensors")
    assert fitted.lights == seen_by_run.lights and fitted.materials == seen_by_run.materials
    assert fitted.shapes == ()


def test_an_overlap_of_a_baseline_is_refused_too(store, trained, old, tmp_path):
    (tmp_path / "baseline-1.safetensors").write_bytes(
        (trained / "weights.safetensors").read_bytes()
    )
    records = Records(store.folder)
    tested = {"shapes": {}, "materials": {label_hash(records.label("dark")): "dark"}, "lights": {}}
    files = [old, *overlap.baseline_files(tmp_path)]
    with pytest.raises(InputError, match=r"baseline-1.safetensors never saw, found 1 of 1 mat"):
        overlap.report_overlap(files, tested, tmp_path, False)
