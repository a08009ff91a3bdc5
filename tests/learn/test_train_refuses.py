"""Training that cannot be, or not go on: one line that says what to do, and whatever was there
stays.
"""

import json
import math
import os
import struct
import zipfile

import numpy as np
import pytest
import torch

from learn.data import lights, settings, sources
from learn.data.data_split import DataSplit
from learn.data.geometry import Geometry
from learn.data.settings import Data, Losses, Run, Schedule, Stage
from learn.training import loop, processes
from learn.training.loop import Training
from manifests import measured_lights
from manifests.cli import main
from manifests.errors import InputError
from tests.support import synthetic
from tests.support.tiny_run import RUN, train, two_sided

SIZE = 32


@pytest.fixture
def store(tmp_path):
    """A dataset with a shape for each side, four pictures of each."""
    return two_sided(tmp_path / "data")


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    """Geometry of one ball, two materials, one map: the same for all sides."""
    folder = tmp_path_factory.mktemp("dataset")
    synthetic.write_dataset(
        folder, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="sphere"
    )
    geometry, rng = Geometry(folder, progress=False), np.random.default_rng(2)
    labels = {
        name: np.log(np.full(108, value, np.float32)) for name, value in (("a", 0.3), ("b", 0.5))
    }
    maps = [lights.draw_computed(rng).astype(np.float32)]
    return {
        side: DataSplit(geometry, np.arange(len(geometry)), labels, maps, side)
        for side in ("train", "validation", "test")
    }


def run(**changes):
    given = {
        "name": "tiny",
        "size": SIZE,
        "parts": ("normals",),
        "data": Data(sharing=1),
        "losses": Losses(normals=1, material=0),
    }
    return Run(**given | {"schedule": Schedule(steps=2, batch=2, warm_up=1), "seed": 3} | changes)


def line(capsys):
    """The one line on stderr that is a message."""
    result = [
        each
        for each in capsys.readouterr().err.replace("\r", "\n").splitlines()
        if each.startswith("learn:")
    ]
    assert len(result) == 1
    return result[0]


# ------------------------------------------------------------------------------------------------
# settings


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"losses": {"normals": 0, "material": 0}},
            "losses: expected a weight above 0 of a term that trains normals",
        ),
        ({"losses": {"normals": 0, "material": 1}}, "a term that trains normals"),
        (
            {"parts": ["material"], "losses": {"normals": 0, "material": 0, "target": 1}},
            "a term that trains material",
        ),
        ({"parts": ["light"]}, "a term that trains light"),
        (
            {"network": "encoder-decoder", "losses": {"normals": 1, "material": 0, "image": 1}},
            "one of material, target",
        ),
        (
            {"stages": [{"parts": ["light"], "steps": 1}]},
            r"stages\[0\]\.losses: expected a weight above 0",
        ),
        ({"schedule": {"learning_rate": 1e30}}, "learning_rate"),
        ({"schedule": {"learning_rate": 0}}, "learning_rate"),
        ({"schedule": {"rate": -1}}, "learning_rate"),
        ({"schedule": {"weight_decay": 1e30}}, "weight_decay"),
        ({"schedule": {"batch": 100_000_000}}, "batch"),
        ({"schedule": {"batch": 65_536}, "size": 1024}, "Mi pixels"),
        ({"losses": {"normals": 1e30}}, "normals"),
        (
            {"losses": {"normals": 1, "layer_light": [7, 9]}},
            "layer_light: expected rows and columns that divide 64 and 128",
        ),
        ({"size": 60}, "size"),
    ],
)
def test_a_run_that_cannot_be_trained_is_refused_before_anything_is_read(
    tmp_path, capsys, changes, words
):
    (tmp_path / "run.json").write_text(json.dumps(RUN | changes))
    words_of_command = [
        "train",
        str(tmp_path / "run.json"),
        "--data",
        str(tmp_path / "nowhere"),
        "--out",
        str(tmp_path / "out"),
    ]
    assert main("learn", "", ("train",), words_of_command) == 1
    with pytest.raises(InputError, match=words):
        settings.read_run(tmp_path / "run.json")
    assert "run.json" in line(capsys) and not (tmp_path / "out").exists()


def test_pictures_for_a_run_that_uses_none_are_refused_before_any_is_read(tmp_path, capsys):
    (tmp_path / "run.json").write_text(json.dumps(RUN | {"data": {"source": "relit"}}))
    words = ["train", tmp_path / "run.json", "--data", tmp_path / "nowhere", "--out"]
    words += [tmp_path / "out", "--pictures", tmp_path / "nowhere"]
    assert main("learn", "", ("train",), list(map(str, words))) == 1
    assert '--pictures: expected a run whose data.source is "pictures" or "mix"' in line(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--steps", "0"),
        ("--seed", "-1"),
        ("--workers", "-1"),
        ("--threads", "0"),
        ("--checkpoint-every", "0"),
    ],
)
def test_counts_that_are_none_are_wrong_usage(tmp_path, capsys, option, value):
    with pytest.raises(SystemExit) as end:
        main(
            "learn",
            "",
            ("train",),
            [
                "train",
                "joint-compact",
                "--data",
                "d",
                "--out",
                str(tmp_path / "out"),
                option,
                value,
            ],
        )
    assert end.value.code == 2 and option in capsys.readouterr().err


def test_presets_can_be_trained(root):
    presets = sorted((root / "manifests" / "runs").glob("*.json"))
    assert presets and [settings.read_run(path.stem).name for path in presets]


def test_the_papers_presets_train_as_the_paper_says(root):
    """The network, Eq. 5 with the perceptual loss, its weights, and the order of its runs."""
    for name in ("joint-paper", "pretrain-paper", "multi-category-paper", "multi-material-paper"):
        preset = settings.read_run(name)
        losses = preset.losses
        assert preset.network == "paper" and preset.size == 256
        assert (losses.normals, losses.material) == (1e4, 1e3)
        assert losses.image_features == losses.target_features == 1
        assert losses.image == losses.target == losses.light_log == losses.light_rendered == 0
        alone = [stage.parts for stage in preset.stages]
        assert alone == ([("normals",), ("material",)] if name.startswith(("j", "p")) else [])


def test_start_names_the_weights_that_a_run_begins_with(tmp_path):
    assert settings.read_run("multi-category-paper").start is None
    chosen = settings.read_run("multi-category-paper", start=tmp_path / "weights.safetensors")
    assert chosen.start == str(tmp_path / "weights.safetensors")


def test_a_run_made_in_python_is_judged_as_one_from_a_file(data_splits, tmp_path):
    for wrong in (
        run(losses=Losses(normals=0, material=0)),
        run(size=60),
        run(schedule=Schedule(learning_rate=math.nan)),
    ):
        with pytest.raises(InputError, match="run 'tiny'"):
            Training(wrong, data_splits, tmp_path, workers=0)
    staged = run(stages=(Stage(("light",), 1, Losses(light_log=1)),))
    Training(staged, data_splits, tmp_path, workers=0)


# ------------------------------------------------------------------------------------------------
# lock


def test_a_second_run_into_a_folder_is_refused_and_writes_nothing(
    store, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(processes, "PATIENCE", 0.0)
    with processes.lock_run_folder(tmp_path / "out"):
        before = sorted(os.listdir(tmp_path / "out"))
        assert train(store, tmp_path / "out") == 1
        assert "a folder that no other run writes to" in line(capsys)
        assert sorted(os.listdir(tmp_path / "out")) == before
    assert train(store, tmp_path / "out") == 0  # and when the first has ended, it may


def test_the_processes_that_relight_let_the_folder_go(tmp_path):
    """A run that was killed leaves them behind for a moment; nothing waits for them."""
    with processes.lock_run_folder(tmp_path):
        child = os.fork()
        if not child:
            try:
                processes.start_worker(0)
                os.fstat(processes._LOCKS[0])
            except OSError:  # closed
                os._exit(7)
            os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        with (
            pytest.raises(InputError, match="no other run"),
            processes.lock.writing(tmp_path, patience=0),
        ):
            pass  # the run itself still holds it


# ------------------------------------------------------------------------------------------------
# checkpoint


@pytest.fixture
def half_way(data_splits, tmp_path):
    """A folder whose checkpoint is of step 1 of 2."""
    training = Training(
        run(), data_splits, tmp_path / "out", sheet_every=0, checkpoint_every=1, workers=0
    )
    save = training._save_checkpoint

    def stop():
        save()
        raise KeyboardInterrupt

    training._save_checkpoint = stop
    with pytest.raises(KeyboardInterrupt):
        training.train()
    return tmp_path / "out"


def rewritten(path, change):
    """The checkpoint with its header and body changed."""
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    header, body = change(json.loads(data[8 : 8 + length]), bytearray(data[8 + length :]))
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + bytes(body))


def about(**values):
    def change(header, body):
        header["__metadata__"] |= values
        return header, body

    return change


def one_bit(header, body):
    start, _ = header["network.normals.weight"]["data_offsets"]
    body[start] ^= 1
    return header, body


def not_a_number(header, body):
    start, _ = header["average.normals.weight"]["data_offsets"]
    body[start : start + 4] = np.float32(np.nan).tobytes()
    return header, body


def without_momentum(header, body):
    name = next(name for name in header if name.endswith(".exp_avg"))
    header[f"{name}x"] = header.pop(name)
    return header, body


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(b"\x80\x04\x95" + bytes(100)),
        lambda path: rewritten(path, one_bit),
        lambda path: rewritten(path, not_a_number),
        lambda path: rewritten(path, without_momentum),
        lambda path: rewritten(path, about(step="-1")),
        lambda path: rewritten(path, about(step="1e400")),
        lambda path: rewritten(path, about(step="99")),
        lambda path: rewritten(path, about(used="nan")),
        lambda path: rewritten(path, about(run="{")),
        lambda path: (path.unlink(), path.mkdir()),
        lambda path: (path.unlink(), os.mkfifo(path)),
    ],
)
def test_a_damaged_checkpoint_is_told_and_left_as_it_is(half_way, data_splits, damage):
    path = half_way / "checkpoint.safetensors"
    damage(path)
    before = path.read_bytes() if path.is_file() else None
    log = (half_way / "log.jsonl").read_bytes()
    with pytest.raises(InputError, match=r"checkpoint\.safetensors"):
        Training(run(), data_splits, half_way, workers=0)
    assert before == (path.read_bytes() if path.is_file() else None)
    assert (half_way / "log.jsonl").read_bytes() == log


def test_a_damaged_checkpoint_is_told_with_the_way_on(half_way, data_splits):
    (half_way / "checkpoint.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match="move it away to begin again"):
        Training(run(), data_splits, half_way, workers=0)


def test_a_checkpoint_from_before_digests_is_gone_on_from(half_way, data_splits):
    def without_digest(header, body):
        del header["__metadata__"]["digest"]
        return header, body

    rewritten(half_way / "checkpoint.safetensors", without_digest)
    assert Training(run(), data_splits, half_way, workers=0).step == 1


def test_a_run_holds_one_checkpoint_and_no_draft_of_it(half_way):
    assert sum("checkpoint" in name for name in os.listdir(half_way)) == 1


# ------------------------------------------------------------------------------------------------
# not finite


def test_a_step_that_is_not_finite_leaves_the_running_statistics_too(data_splits, tmp_path):
    """Batch normalisation follows its input in the forward pass, and NaN in a running mean stays
    for ever.
    """
    training = Training(run(), data_splits, tmp_path, sheet_every=0, workers=0)
    batch = training._source()[0]
    before = {name: tensor.clone() for name, tensor in training.network.state_dict().items()}
    batch.image[0, 0, SIZE // 2, SIZE // 2] = torch.nan
    record = training._make_step(batch)
    assert not math.isfinite(record["loss"]) and training.skipped == 1
    for name, tensor in training.network.state_dict().items():
        assert torch.equal(tensor, before[name]), name


def test_a_prediction_that_is_not_finite_is_a_skipped_step_and_no_error_of_the_layer(
    data_splits, tmp_path
):
    terms = Losses(normals=1, material=0, image=1, pixels=8, layer_light=(8, 16))
    training = Training(
        run(losses=terms, skipped_steps=0), data_splits, tmp_path, sheet_every=0, workers=0
    )
    with torch.no_grad():
        training.network.normals.weight.fill_(3e38)
    with pytest.raises(InputError, match="finite loss and gradients"):
        training.train()


def test_a_validation_that_is_not_finite_ends_in_one_line(data_splits, tmp_path):
    training = Training(run(), data_splits, tmp_path, sheet_every=1, workers=0)
    training.average["normals.weight"].fill_(3e38)
    with pytest.raises(InputError, match="validation after step 0: expected finite predictions"):
        training._validate()
    assert not (tmp_path / "weights.safetensors").exists()


# ------------------------------------------------------------------------------------------- what
# lies beside a data set


class Failing:
    """A source whose second batch cannot be made."""

    def __init__(self, error):
        self.error = error

    def __getitem__(self, k):
        if k:
            raise self.error
        return torch.zeros(2)


@pytest.mark.parametrize(
    "error",
    [
        InputError("picture.exr", "a file", "none", "render it again"),
        FileNotFoundError(2, "No such file", "picture.exr"),
    ],
)
def test_an_error_of_a_process_that_relights_is_raised_as_it_was(error):
    loader = torch.utils.data.DataLoader(
        processes.ErrorsAsValues(Failing(error)), batch_size=None, sampler=range(2), num_workers=1
    )
    batches = processes.receive_batches(loader)
    assert torch.equal(next(batches), torch.zeros(2))
    with pytest.raises(type(error)) as raised:
        next(batches)
    assert str(raised.value) == str(error)


class Dying:
    """A source whose process is killed."""

    def __getitem__(self, k):
        os.kill(os.getpid(), 9)


def test_a_process_that_relights_and_is_killed_is_told_in_one_line():
    loader = torch.utils.data.DataLoader(
        processes.ErrorsAsValues(Dying()), batch_size=None, sampler=range(2), num_workers=1
    )
    with pytest.raises(InputError, match="--workers: expected processes that live"):
        next(processes.receive_batches(loader))


@pytest.mark.parametrize("name", ["views.json", "skipped.json", "sums.json"])
@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[" * 100_000,
        b"[1, 2]",
        b"5",
        b'{"a": 1}',
        b'{"normals.npy": [], "segments.npy": {}}',
        b"\xff",
        None,
    ],
)
def test_a_damaged_cache_of_geometry_is_made_again(tmp_path, name, text):
    synthetic.write_dataset(
        tmp_path, [synthetic.matte()], np.random.default_rng(1), size=SIZE, category="sphere"
    )
    sound = Geometry(tmp_path, progress=False).normals(0)
    (tmp_path / "packed" / name).unlink()
    # nothing waits for it: it is skipped, or reported where a file has to take its place
    if text is None:
        os.mkfifo(tmp_path / "packed" / name)
        try:
            assert np.array_equal(
                Geometry(tmp_path, progress=False, skip_bad=True).normals(0), sound
            )
        except InputError as problem:
            assert f"{name}: " in str(problem) and "a pipe" in str(problem)
        return
    (tmp_path / "packed" / name).write_bytes(text)
    assert np.array_equal(Geometry(tmp_path, progress=False, skip_bad=True).normals(0), sound)


def npz(path, maps, compression=zipfile.ZIP_DEFLATED):
    """An .npz of {name: array or bytes}."""
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, array in maps.items():
            with archive.open(f"{name}.npy", "w") as member:
                if isinstance(array, bytes):
                    member.write(array)
                else:
                    np.lib.format.write_array(member, array, allow_pickle=True)


SKY = np.ones((64, 128, 3), np.float32)


@pytest.mark.parametrize(
    ("maps", "words"),
    [
        ({"a": 0 * SKY}, "a: expected light, found a black map"),
        ({"a": -SKY}, "a: expected light, found a black map"),
        ({"a": SKY * np.float32(1e37)}, "radiance up to"),
        ({"a": SKY * np.nan}, "NaN or infinity"),
        ({"a": SKY[:, :, :1]}, "shape"),
        ({"a": SKY.astype(complex)}, "complex128"),
        ({"a": np.array([SKY.tolist()], object)}, "light maps"),
        ({"a": np.zeros(1 << 20)}, "8388736 bytes"),
        ({"a": b"\x93NUMPY"}, "light maps"),
        ({f"m{k}": b"" for k in range(5000)}, "at most 4096 maps"),
    ],
)
def test_light_maps_without_light_or_beyond_measure_are_refused(tmp_path, maps, words):
    npz(tmp_path / "maps.npz", maps)
    with pytest.raises(InputError, match=words):
        lights.read_maps(tmp_path / "maps.npz")


def test_light_maps_are_read_as_numpy_writes_them(tmp_path, rng):
    maps = {"a": rng.random((64, 128, 3)), "b": rng.random((64, 128, 3)).astype(np.float32)}
    for write in (np.savez, np.savez_compressed):
        write(tmp_path / "maps.npz", **maps)
        assert set(lights.read_maps(tmp_path / "maps.npz")) == set(maps)


def test_what_macos_writes_beside_the_maps_of_a_library_is_no_map(tmp_path):
    np.savez(tmp_path / "sky.npz", light=SKY)
    (tmp_path / "._sky.npz").write_bytes(b"\0\5\x16\7 attributes of sky.npz")
    assert list(lights.read_maps(tmp_path)) == ["sky"]


def test_a_light_map_that_has_the_name_of_another_one_is_refused_unless_it_is_a_copy(
    store, tmp_path, rng
):
    (name,) = store.dataset().lights
    known, path = measured_lights.load("blender_city"), tmp_path / "maps.npz"
    for taken, data in ((name, Data()), ("blender_city", Data(measured_lights=True))):
        np.savez(path, **{taken: rng.random((64, 128, 3))})
        with pytest.raises(InputError) as caught:
            sources.load_data_splits(data, store.folder, path, progress=False)
        assert str(caught.value) == (
            f"--lights {path}: expected one map under a name, found a second, different one under"
            f" '{taken}' (rename it: the data set or the program has one of that name)"
        )
    np.savez(path, blender_city=2 * np.roll(known, 5, axis=1))
    splits = sources.load_data_splits(
        Data(measured_lights=True), store.folder, path, progress=False
    )
    assert "blender_city" in {light for side in splits.values() for light in side.map_names}


def test_light_maps_in_other_files_are_refused(tmp_path):
    npz(tmp_path / "lzma.npz", {"a": SKY}, zipfile.ZIP_LZMA)
    np.save(tmp_path / "one.npy", SKY)
    os.mkfifo(tmp_path / "pipe.npz")
    for name in ("lzma.npz", "one.npy", "pipe.npz"):
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            lights.read_maps(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        b"[1]\n",
        b"5\n",
        b"null\n",
        b"[" * 100_000 + b"\n",
        b'{"step": "one"}\n',
        b'{"step": null}\n',
        b'\xef\xbb\xbf{"step": -1}\n',
    ],
)
def test_lines_of_a_log_that_are_none_are_dropped(data_splits, tmp_path, text):
    (tmp_path / "log.jsonl").write_bytes(text)
    Training(run(), data_splits, tmp_path, sheet_every=0, workers=0).train()
    assert [
        json.loads(each)["step"] for each in (tmp_path / "log.jsonl").read_text().splitlines()
    ] == [0, 1]


@pytest.mark.parametrize("name", loop.WRITTEN)
def test_a_pipe_in_the_place_of_a_result_is_refused_before_training(data_splits, tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=rf"{name}: .* found a pipe"):
        Training(run(), data_splits, tmp_path, workers=0)
