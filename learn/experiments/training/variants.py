"""Variants of a run, trained for the same processor time or the same number of steps.

All are measured on the same unseen pictures. What a variant does not predict is given its true
value, so that each part stands alone. Only networks, losses and layer are timed, not the making of
batches.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from learn.data.batch import ExampleBatch, shape_and_material
from learn.data.data_split import DataSplit
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Run
from learn.metrics import bootstrap
from learn.metrics.pictures import l2_and_ssim
from learn.networks import weights
from learn.networks.prediction import Coded
from learn.training import loop, processes, validation
from manifests.errors import InputError, closest
from manifests.files import write_text
from manifests.reading import read

TEST_SEED = 43
BATCH = 16


Result = dict[str, Any]  # of one training: steps, seconds, run, and rows of figures
Row = dict[str, Any]  # of one picture: shape, material, and figures


def requested_variants(names: Sequence[str], known: Sequence[str], reference: str) -> list[str]:
    """Return the names, if all are known and the one that others are compared with is there.

    Raises InputError.
    """
    for name in names:
        if name not in known:
            raise InputError(
                f"--variants: '{name}'", "a variant", "none of that name", closest(name, known)
            )
    if reference not in names:
        raise InputError(
            "--variants",
            f'"{reference}", which all others are compared with',
            ", ".join(names),
            "add it",
        )
    return list(names)


def held_out_batches(
    data_splits: dict[str, DataSplit], data: Data, size: int, batches: int
) -> list[ExampleBatch]:
    """Return batches of the test split; their pictures are the truth, as the layer made them."""
    source = RelitDataset(data_splits["test"], data, BATCH, size, TEST_SEED)
    return [replace(batch, picture=batch.image) for batch in (source[k] for k in range(batches))]


def train_and_measure(
    run: Run,
    data_splits: dict[str, DataSplit],
    tests: Sequence[ExampleBatch],
    folder: Path,
    workers: int = 1,
    training_of: Callable[..., loop.Training] = loop.Training,
    measured: Callable[[loop.Training, Coded, ExampleBatch], Iterable[Row]] | None = None,
) -> Result:
    """Train a run to its end and measure it; a result that is in the folder is read instead.

    folder       for the run's files; result.json is written last, then the checkpoint is removed
    training_of  makes the training, with the arguments of learn.training.loop.Training
    measured     returns a row for each picture of a batch; None: `rows`
    Returns      {"steps", "seconds", "run", "rows": [{figure: value}]}
    """
    if (folder / "result.json").exists():
        return read(folder / "result.json", dict)
    with processes.lock_run_folder(folder):
        training = training_of(run, data_splits, folder, sheet_every=0, workers=workers)
        training.train()
    weights.save_weights(
        folder / "weights.safetensors",
        training.network,
        training.average,
        "{}",
        run.size,
        seen=training.seen,
    )
    network, of_batch = training.averaged_network(), measured or rows
    result = {
        "steps": training.step,
        "seconds": training.clock.used,
        "run": msgspec.to_builtins(run),
        "rows": [row for batch in tests for row in of_batch(training, network, batch)],
    }
    text = json.dumps(result)
    write_text(folder / "result.json", text)
    (folder / "checkpoint.safetensors").unlink(missing_ok=True)
    return json.loads(text)


def rows(training: loop.Training, network: Coded, batch: ExampleBatch) -> Iterator[Row]:
    """Yield the figures of each picture, rendered from what is predicted and otherwise true."""
    with torch.no_grad():
        prediction = training.predict(network, batch)
    figures = {}
    if prediction.n is not None:
        cosine, inside = (prediction.n * batch.n).sum(1).clamp(-1, 1), batch.segments > 0
        figures["cosine"] = validation.masked_means(cosine, inside)
        figures["angle_deg"] = validation.masked_means(cosine.arccos().rad2deg(), inside)
    if prediction.code is not None:
        figures["code_l2"] = (
            ((prediction.code - network.ranges.code(batch.label)) ** 2)
            .mean((1, 2))
            .double()
            .numpy()
        )
    n = batch.n if prediction.n is None else prediction.n
    label = batch.label if prediction.label is None else prediction.label
    assert batch.picture is not None  # held_out gives one to every batch
    mine = validation.render_batch(n, label, batch.light, batch)
    truth = batch.picture.movedim(1, -1).numpy()
    for i, name in enumerate(batch.names):
        shape, material = shape_and_material(name)
        own = {key: float(value[i]) for key, value in figures.items()}
        yield (
            {"shape": shape, "material": material}
            | _compare(mine[i], truth[i], (batch.segments[i] > 0).numpy())
            | own
        )


def _compare(mine: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Display L2 over mask and frame, SSIM over the mask, at the truth's exposure."""
    figures = l2_and_ssim(mine, truth, mask)
    return {
        name: value for name in ("l2", "l2_frame", "ssim") if (value := figures[name]) is not None
    }


def figures(results: Sequence[Result]) -> dict[str, list[float]]:
    """Return {figure: [mean, low, high]} of one variant's results, one per seed.

    The 95 % interval is over shapes, materials and seeds.
    """
    keys = [key for key, value in results[0]["rows"][0].items() if not isinstance(value, str)]
    ones = np.ones_like(_values(results, keys[0]))
    return {key: bootstrap.ratio(ones, _values(results, key), _groups(results)) for key in keys}


def ratio(a: Sequence[Result], b: Sequence[Result], key: str = "l2") -> list[float]:
    """Return [mean b / mean a, low, high] of two variants on the same pictures and seeds."""
    return bootstrap.ratio(_values(a, key), _values(b, key), _groups(a))


def _values(results: Sequence[Result], key: str) -> np.ndarray:
    return np.array([[row[key] for row in result["rows"]] for result in results])


def _groups(results: Sequence[Result]) -> list:
    rows = results[0]["rows"]
    return bootstrap.groups_of([row["shape"] for row in rows], [row["material"] for row in rows])
