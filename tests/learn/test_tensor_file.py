"""Weights are written as the library would write them, but whole or not at all, and never twice in
memory.
"""

import os
import tracemalloc

import pytest
import safetensors.torch
import torch

from learn.networks import tensor_file


def test_the_bytes_are_those_of_the_library(tmp_path):
    """Of every type of numbers, a transposed tensor, a scalar, an empty one, and text that JSON
    writes in another way.
    """
    types = (
        torch.float64,
        torch.float32,
        torch.float16,
        torch.bfloat16,
        torch.int64,
        torch.int32,
        torch.int16,
        torch.int8,
        torch.uint8,
    )
    tensors = {f"{kind}"[6:]: torch.arange(12).reshape(3, 4).to(kind) for kind in types}
    tensors |= {
        "mask": torch.tensor([True, False]),
        "scalar": torch.tensor(3.5),
        "none": torch.zeros(0, 3),
    }
    tensors |= {
        "turned": torch.randn(4, 3).t(),
        "last": torch.randn(1, 3, 4, 4).to(memory_format=torch.channels_last),
    }
    metadata = {"name": 'a "quoted" ü\n'}
    tensor_file.write(tmp_path / "ours", tensors, metadata)
    plain = {name: tensor.contiguous() for name, tensor in tensors.items()}
    assert (tmp_path / "ours").read_bytes() == safetensors.torch.save(plain, metadata)


def test_text_is_written_in_one_order_whatever_the_order_it_is_given_in(tmp_path):
    for name, keys in (("a", "xyz"), ("b", "zyx")):
        tensor_file.write(tmp_path / name, {"t": torch.ones(2)}, {key: "1" for key in keys})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("count", [0, 7, 8, 100, 4000])
def test_a_full_disk_keeps_the_earlier_weights(tmp_path, small_files, count):
    path = tmp_path / "w.safetensors"
    tensor_file.write(path, {"t": torch.ones(2)}, {})
    with small_files(count), pytest.raises(OSError, match=r"w\.safetensors"):
        tensor_file.write(path, {"t": torch.ones(1000)}, {})
    assert os.listdir(tmp_path) == ["w.safetensors"]
    assert safetensors.torch.load_file(path)["t"].tolist() == [1, 1]


def test_numbers_that_the_format_lacks_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(
        ValueError, match=r"b: expected a type of numbers of safetensors, found torch\.complex64"
    ):
        tensor_file.write(
            tmp_path / "w", {"a": torch.ones(2), "b": torch.ones(2, dtype=torch.complex64)}, {}
        )
    assert os.listdir(tmp_path) == []


def test_no_copy_of_the_tensors_is_made_in_memory(tmp_path):
    tensors = {str(k): torch.zeros(1 << 18) for k in range(8)}
    tracemalloc.start()
    tensor_file.write(tmp_path / "w", tensors, {})
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 18  # 8 MiB of tensors, and a header of some hundred bytes
