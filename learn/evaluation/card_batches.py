"""The batches that `learn evaluate-network` measures, in this process or on a Ray cluster.

A piece of work is one batch of one kind of pictures, on which all networks are measured:

relit    pictures of the test split, relit by the layer
cycles   pictures of it that Cycles rendered
plain    the relit pictures again, of which only normals are measured, by the first network
printed  the same with printed patterns over their materials
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from learn.data import devices, sources
from learn.data.batch import ExampleBatch
from learn.data.data_split import DataSplit
from learn.data.relit import RelitDataset
from learn.data.rendered import RenderedDataset
from learn.data.settings import Run, decode_run
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction, require_part
from learn.training import validation
from manifests import ray_tasks
from manifests.line_files import encode

BATCH, SEED = 16, 77
PATTERNS = {"plain": 0.0, "printed": 1.0}  # share of the pictures that have one

Measured = tuple[dict[str, np.ndarray], Sequence[str]]  # {figure: (P,)} and names (P,) of pictures


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster, and the files that its workers read; they use the CPU.

    address   of the cluster, as ray.init takes it
    weights   of all networks
    data      the data set of the split; lights, pictures: as sources.load_data_splits takes them
    """

    address: str
    weights: Sequence[Path]
    data: Path
    lights: Path | None
    pictures: Path | None


@dataclass(frozen=True)
class CardEvaluator:
    """Measures networks of one run on the batches of one split.

    constant  learn.training.validation.mean_albedo of the training split
    """

    networks: Sequence[Any]
    run: Run
    test: DataSplit
    constant: Any
    _sources: dict[str, RelitDataset | RenderedDataset] = field(default_factory=dict)

    def batch(self, kind: str, k: int) -> ExampleBatch:
        """Return the k-th batch of a kind."""
        if kind not in self._sources:
            if kind == "cycles":
                self._sources[kind] = RenderedDataset(
                    self.test, self.run.data, 1, self.run.size, SEED
                )
            else:
                self._sources[kind] = RelitDataset(
                    self.test, self.run.data, BATCH, self.run.size, SEED, printed=PATTERNS.get(kind)
                )
        return self._sources[kind][k]

    def predict(
        self, network: Any, batch: ExampleBatch, parts: Sequence[str]
    ) -> tuple[ExampleBatch, Prediction]:
        """Return a batch on the network's device, and the network's prediction of these parts."""
        batch = batch.to(devices.device_of(network))
        with torch.no_grad():
            segments = batch.segments if self.run.data.regions > 1 else None
            prediction = network(
                batch.image, batch.mask, segments, parts, regions=self.run.data.regions
            )
        return batch, prediction

    def measure(self, kind: str, k: int) -> list[Measured]:
        """Return the figures of the k-th batch of a kind, by each network.

        Under patterns and without, they are {"angle_deg"} by the first network alone.
        """
        own = self.batch(kind, k)
        if kind in PATTERNS:
            batch, prediction = self.predict(self.networks[0], own, ("normals",))
            cosine = (require_part(prediction.n) * batch.n).sum(1).clamp(-1, 1)
            angle = validation.masked_means(cosine.arccos().rad2deg(), batch.segments > 0)
            return [({"angle_deg": angle}, batch.names)]
        result: list[Measured] = []
        for network in self.networks:
            batch, prediction = self.predict(network, own, self.run.parts)
            result.append((validation.measure_batch(prediction, batch, self.constant), batch.names))
        return result


def measure_batches(
    evaluator: CardEvaluator, counts: Mapping[str, int], cluster: Cluster | None = None
) -> dict[str, list[Measured]]:
    """Return {kind: figures of all its batches, by each network}.

    counts   {kind: number of batches}
    cluster  that measures; None: this process does
    Raises   InputError or RuntimeError if a piece of work fails on a cluster; OSError if workers
             are lost again and again
    """
    pieces = [(kind, k) for kind, count in counts.items() for k in range(count)]
    answers: dict[tuple[str, int], list[Measured]] = {}
    for number, each in (
        _measure_here(evaluator, pieces)
        if cluster is None
        else _measure_on_cluster(cluster, pieces)
    ):
        answers[pieces[number]] = each
    return {
        kind: [_join(each) for each in zip(*(answers[kind, k] for k in range(count)), strict=True)]
        for kind, count in counts.items()
    }


def _join(batches: Sequence[Measured]) -> Measured:
    """Return the figures of several batches as those of one."""
    values = {
        key: np.concatenate([figures[key] for figures, _ in batches]) for key in batches[0][0]
    }
    return values, [name for _, names in batches for name in names]


Answers = Generator[tuple[int, list[Measured]], None, None]


def _measure_here(evaluator: CardEvaluator, pieces: Sequence[tuple[str, int]]) -> Answers:
    for number, piece in enumerate(pieces):
        yield number, evaluator.measure(*piece)


def _measure_on_cluster(cluster: Cluster, pieces: Sequence[tuple[str, int]]) -> Answers:
    settings = {
        "weights": list(cluster.weights),
        "data": cluster.data,
        "lights": cluster.lights,
        "pictures": cluster.pictures,
    }
    with contextlib.closing(
        ray_tasks.results(cluster.address, f"{__name__}:on_worker", settings, pieces)
    ) as answers:
        for number, answer in answers:
            yield number, [_unpack(each) for each in msgspec.json.decode(answer)]


def on_worker(settings: bytes) -> ray_tasks.Work:
    """Return what a worker of a Ray cluster does: a kind and a number as JSON → figures as JSON."""
    torch.set_num_threads(1)
    given = msgspec.json.decode(settings)
    weights = [Path(each) for each in given["weights"]]
    loaded = [load_with_run(each) for each in weights]
    networks, run = [network for network, _, _ in loaded], loaded[0][2]
    data_splits = sources.load_data_splits(
        run.data, given["data"], given["lights"], pictures=given["pictures"]
    )
    evaluator = CardEvaluator(
        networks, run, data_splits["test"], validation.mean_albedo(data_splits["train"])
    )

    def work(piece: bytes) -> bytes:
        return encode([_pack(each) for each in evaluator.measure(*msgspec.json.decode(piece))])

    return work


def load_with_run(
    weights: Path, device: str | torch.device = "cpu"
) -> tuple[Any, dict[str, Any], Run]:
    """Return (network, metadata, the run that made it) of a weights file. Raises InputError."""
    network, metadata = checkpoint.load_network(weights, device)
    return network, metadata, decode_run(json.dumps(metadata["run"]).encode(), weights)


def _pack(measured: Measured) -> list[Any]:
    """Return figures as what JSON can hold; what is not finite becomes null."""
    values, names = measured
    return [{key: [str(each.dtype), each.tolist()] for key, each in values.items()}, names]


def _unpack(packed: Sequence[Any]) -> Measured:
    values, names = packed
    return {
        key: np.array([np.nan if each is None else each for each in numbers], dtype)
        for key, (dtype, numbers) in values.items()
    }, list(names)
