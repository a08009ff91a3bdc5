"""Files of tensors from outside: metadata, names, shapes, types and numbers are judged before a
network is filled with them.
"""

import json
import os
import struct

import numpy as np
import pytest
import torch
from safetensors.torch import save

from learn.baselines import priors
from learn.data.framing import Framed
from learn.editing.decomposition import predict_framed
from learn.metrics import lpips as perceptual
from learn.networks import features, tensor_file, weights
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from manifests.errors import InputError

RUN = json.dumps({"name": "tiny", "parts": ["normals", "material", "light"]})


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Weights of an untrained compact network for pictures of 32 × 32."""
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    torch.manual_seed(0)
    network = Compact(Ranges(torch.zeros(108), torch.ones(108)))
    weights.save_weights(path, network, network.state_dict(), RUN, 32, 7)
    return path


@pytest.fixture
def changed(sound, tmp_path):
    """A function of change(header, body) → (header, body): writes the weights so changed, and
    returns the path.
    """

    def write(change):
        header, body = change(*parted(sound.read_bytes()))
        (tmp_path / "changed.safetensors").write_bytes(joined(header, body))
        return tmp_path / "changed.safetensors"

    return write


def parted(data):
    length = struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def joined(header, body):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + body


def test_sound_weights_are_read_with_their_size_as_a_number(sound):
    network, metadata = weights.load_full_network(sound)
    assert (metadata["size"], metadata["step"], metadata["run"]["name"]) == (32, "7", "tiny")
    assert not network.training


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("format", None, "weights of"),
        ("format", "brdfactory weights 2", "weights of"),
        ("network", None, "weights of"),
        ("network", "../compact", "weights of"),
        ("network", "separate", "this separate network"),
        ("size", None, "`size`"),
        ("size", "20000", r"size.*<= 1024.*found 20000"),
        ("size", "1" + "0" * 400, "size"),
        ("size", "33", "multiple of 16"),
        ("size", "-32", ">= 32"),
        ("size", "nan", "size"),
        ("size", "", "size"),
        ("step", "-1", ">= 0"),
        ("step", "many", "step"),
        ("run", "", "run in the metadata"),
        ("run", "[]", "run in the metadata"),
        ("run", "null", "run in the metadata"),
        ("run", "{", "run in the metadata"),
        ("run", "[" * 100_000, "run in the metadata"),
        ("run", '{"name": 5}', "run in the metadata: name"),
        ("run", '{"parts": "normals"}', "run in the metadata: parts"),
        ("run", '{"parts": []}', "run in the metadata: parts"),
        ("run", '{"parts": ["normals", "sound"]}', "run in the metadata"),
        ("run", '{"parts": ["normals"]}', "without light and material"),
        ("run", '{"about": 1e400}', "run in the metadata"),
    ],
)
def test_metadata_of_any_kind_are_refused_in_one_line(changed, key, value, words):
    def change(header, body):
        header["__metadata__"].pop(key)
        if value is not None:
            header["__metadata__"][key] = value
        return header, body

    with pytest.raises(InputError, match=words):
        weights.load_full_network(changed(change))


def filled(value, whole=True):
    """A change that puts a value into every number, or the first, of the first convolution."""

    def change(header, body):
        start, end = header["normals.weight"]["data_offsets"]
        packed = np.float16(value).tobytes()
        return (
            header,
            body[:start]
            + (packed * ((end - start) // 2) if whole else packed + body[start + 2 : end])
            + body[end:],
        )

    return change


def entry(**values):
    """A change of what the header says of a tensor."""

    def change(header, body):
        header["normals.weight"] |= values
        return header, body

    return change


def more(header, body):
    header["strange"] = {"dtype": "F32", "shape": [2], "data_offsets": [len(body), len(body) + 8]}
    return header, body + bytes(8)


def fewer(header, body):
    header["other.weight"] = header.pop("normals.weight")
    return header, body


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (filled(np.nan), r"normals\.weight: expected finite numbers"),
        (filled(np.nan, whole=False), r"normals\.weight: expected finite numbers"),
        (filled(np.inf, whole=False), r"normals\.weight: expected finite numbers"),
        (entry(dtype="I16"), "numbers as F16"),
        (entry(dtype="F7"), "F7"),
        (entry(shape=[12 * 32 * 9]), r"a tensor of shape \(12, 32, 3, 3\)"),
        (entry(shape=[1 << 60, 1 << 10]), "safetensors"),
        (entry(data_offsets=[5, 1]), "safetensors"),
        (entry(data_offsets=[1 << 60, (1 << 60) + 8]), "safetensors"),
        (more, "strange: expected only tensors of this compact network"),
        (fewer, r"normals\.weight: expected a tensor of shape"),
        (lambda header, body: (header, body[:-1000]), "safetensors"),
        (lambda header, body: (header, body + bytes(10)), "safetensors"),
        (lambda header, body: (b"\xff" * 100, body), "safetensors"),
        (lambda header, body: ({}, b""), "weights of"),
    ],
)
def test_tensors_that_are_not_the_networks_are_refused(changed, change, words):
    with pytest.raises(InputError, match=words):
        weights.load_network(changed(change))


def test_a_header_that_is_said_to_be_huge_is_not_read(sound, tmp_path):
    for length in (1 << 63, 1 << 40, 99_000_000):
        (tmp_path / "w.safetensors").write_bytes(struct.pack("<Q", length) + sound.read_bytes()[8:])
        with pytest.raises(InputError, match="no header of at most 8 MiB"):
            weights.load_network(tmp_path / "w.safetensors")


def test_other_tensors_are_refused_before_memory_is_taken_for_them(tmp_path, monkeypatch):
    """A sparse file of a gigabyte with one tensor: its name is refused by the header."""
    read = []
    monkeypatch.setattr(tensor_file.Stored, "tensor", lambda self, name: read.append(name))
    header = {"__metadata__": {"format": weights.FORMAT, "network": "compact", "size": "32"}}
    header["normals.weight"] = {"dtype": "F32", "shape": [1 << 28], "data_offsets": [0, 1 << 30]}
    whole = joined(header, b"")
    (tmp_path / "w.safetensors").write_bytes(whole)
    os.truncate(tmp_path / "w.safetensors", len(whole) + (1 << 30))
    with pytest.raises(InputError, match="a tensor of shape"):
        weights.load_network(tmp_path / "w.safetensors")
    assert not read


@pytest.mark.parametrize(
    ("centre", "half"), [(0, 1e30), (1e30, 1), (0, 0), (0, -1), (5, 1), (-90, 1)]
)
def test_ranges_that_no_material_has_are_refused(tmp_path, centre, half):
    """Labels are read from codes by them: beyond them exp is infinite, or the reflectance no
    number.
    """
    network = Compact(Ranges(torch.full((108,), float(centre)), torch.full((108,), float(half))))
    weights.save_weights(tmp_path / "w.safetensors", network, network.state_dict(), RUN, 32)
    with pytest.raises(InputError, match="label_centre, label_half: expected ranges of labels"):
        weights.load_network(tmp_path / "w.safetensors")


# of the second the squared length is infinite, and the scaled normals are 0
@pytest.mark.parametrize("value", [3e38, 1e30])
def test_weights_whose_prediction_overflows_are_told_by_it(sound, value):
    network, _ = weights.load_full_network(sound)
    with torch.no_grad():
        network.normals.weight.fill_(value)
    framed = Framed(np.full((32, 32, 3), 0.5, np.float32), np.ones((32, 32), bool), (0, 0, 32), 1.0)
    with pytest.raises(InputError, match="--weights: expected weights that predict finite"):
        predict_framed(framed, network)


@pytest.mark.parametrize(
    "make",
    [
        os.mkfifo,
        os.mkdir,
        lambda path: path.symlink_to("/dev/zero"),
        lambda path: path.symlink_to(path),
    ],
)
def test_what_is_no_file_is_refused_at_once_by_every_reader(tmp_path, make):
    make(tmp_path / "w.safetensors")
    for read in (weights.load_network, features.load, perceptual.load, priors.load):
        with pytest.raises(InputError, match=r"w\.safetensors: expected .*, found (a |too many)"):
            read(tmp_path / "w.safetensors")


# ------------------------------------------------------------------------------------------------
# the others


def random_tensors(shapes):
    return {name: 0.1 * torch.randn(shape) for name, shape in shapes.items()}


@pytest.fixture
def lpips():
    """Of LPIPS' shapes."""
    shapes = {}
    for (k, *_), shape in zip(perceptual.LAYERS, perceptual.SHAPES, strict=True):
        shapes |= {f"features.{k}.weight": shape, f"features.{k}.bias": shape[:1]}
    return random_tensors(
        shapes
        | {f"lin{i}.weight": (1, shape[0], 1, 1) for i, shape in enumerate(perceptual.SHAPES)}
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lin0.weight", torch.zeros(1, 3, 1, 1)),
        ("features.0.bias", torch.zeros(())),
        ("features.3.weight", torch.full((192, 64, 5, 5), torch.nan)),
    ],
)
def test_lpips_of_other_shapes_or_without_numbers_is_refused(tmp_path, lpips, name, value):
    (tmp_path / "lpips.safetensors").write_bytes(save(lpips | {name: value}))
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        perceptual.load(tmp_path / "lpips.safetensors")


@pytest.fixture
def known(rng):
    """Priors of a few labels and maps."""
    labels = [rng.normal(-3, 1, 108) for _ in range(4)]
    return priors.fit(labels, [np.exp(rng.normal(size=(64, 128, 3))) for _ in range(3)])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mean", torch.zeros(5)),
        ("directions", torch.zeros(200, 108)),
        ("directions", torch.zeros(())),
        ("medoids", torch.zeros(3, 1)),
        ("light_mean", torch.full((121, 3), torch.nan)),
        ("light_spread", torch.zeros(7, 3)),
    ],
)
def test_priors_of_other_shapes_or_without_numbers_are_refused(tmp_path, known, name, value):
    weights.save(tmp_path / "p.safetensors", vars(known) | {name: value}, {"format": priors.FORMAT})
    with pytest.raises(InputError, match=r"p\.safetensors: "):
        priors.load(tmp_path / "p.safetensors")


def test_vgg16_without_numbers_is_refused(tmp_path):
    shapes, before = {}, 3
    for number, width in zip(
        features.NUMBERS, (w for block in features.WIDTHS for w in block), strict=True
    ):
        shapes |= {
            f"features.{number}.weight": (width, before, 3, 3),
            f"features.{number}.bias": (width,),
        }
        before = width
    tensors = random_tensors(shapes)
    tensors["features.5.bias"][3] = torch.inf
    (tmp_path / "vgg.safetensors").write_bytes(save(tensors))
    with pytest.raises(InputError, match=r"features\.5\.bias: expected finite numbers"):
        features.load(tmp_path / "vgg.safetensors")
