"""Batches that are made once and kept in a folder, for several runs that learn from the same ones.

A batch is a function of a run's seed and its number alone. Relighting takes longer than a step of a
small network, so that runs which differ in losses or network alone share what the first one made.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import torch

from learn.data.batch import ExampleBatch
from learn.networks import tensor_file
from learn.training.processes import BatchSource

REMEDY = "remove the folder with the batches; they are made again"


class KeptBatches:
    """Batches of a source by their number; each is made when it is first asked for.

    source  makes them
    folder  holds a file for each; they must be of this source
    """

    def __init__(self, source: BatchSource, folder: Path):
        self.source, self.folder = source, folder

    def __getitem__(self, k: int) -> ExampleBatch:
        """Return the k-th batch, bit by bit as the source makes it. Raises InputError."""
        path = self.folder / f"{k:07d}.safetensors"
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            write(path, self.source[k])
        return read(path)


def write(path: Path, batch: ExampleBatch) -> None:
    """Write a batch into a file."""
    values = vars(batch)
    tensors = {
        name: value.contiguous()
        for name, value in values.items()
        if isinstance(value, torch.Tensor)
    }
    about = {"names": json.dumps(list(batch.names)), "elevation": json.dumps(batch.elevation)}
    tensor_file.write(path, tensors, about)


def read(path: Path) -> ExampleBatch:
    """Return the batch of a file that `write` wrote. Raises InputError."""
    known = {field.name for field in fields(ExampleBatch)} - {"names", "elevation"}
    with tensor_file.open_tensor_file(path, "a batch in a .safetensors file", REMEDY) as stored:
        return ExampleBatch(
            **{name: stored.tensor(name) for name in stored.shapes if name in known},
            names=json.loads(stored.metadata["names"]),
            elevation=json.loads(stored.metadata["elevation"]),
        )
