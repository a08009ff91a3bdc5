"""Training of Baseline 1: the loop of learn.training, with pictures of the target material.

The terms, weighed as a run's `losses` say:
target           mean (O' − c(O))² over the mask's pixels and channels,
                 c = learn.networks.coding.compress
target_features  the same two pictures compared by features (learn.networks.features): the paper's
                 perceptual loss
material         mean (code' − code)² of the input's material, read from f_m, and of the target's,
                 read from e(m_t)
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn.data import devices
from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.relit import BRIGHTEST, RelitDataset
from learn.data.settings import Losses
from learn.figures.montage import grid
from learn.layer import render
from learn.metrics.pictures import display_l2
from learn.networks.coding import Ranges, compress
from learn.networks.encoder_decoder import Edited, EncoderDecoder, radiance
from learn.networks.features import Features
from learn.networks.prediction import require_part
from learn.training.loop import VALIDATION_BATCHES, Training
from learn.training.losses import feature_difference
from manifests.files import write_image
from shaders import tone

ROWS = 6  # of a contact sheet


class PairedDataset(RelitDataset):
    """Relit batches that hold the true O: the same shapes and light in the target material."""

    def __getitem__(self, k: int) -> ExampleBatch:
        batch = super().__getitem__(k)
        pictures = []
        # a group shares material and light, so its map too
        for i in range(0, len(batch.n), self.data.sharing):
            n, light = (
                batch.n[i : i + self.data.sharing].movedim(1, -1).contiguous(),
                batch.light[i].movedim(0, -1).contiguous(),
            )
            material = batch.target_label[i, :1].exp().expand(len(n), -1)
            with torch.no_grad():
                picture = render(
                    n,
                    material,
                    light.expand(len(n), -1, -1, -1),
                    tolerance=self.data.tolerance,
                    elevation=batch.elevation,
                )
            pictures.append(picture.clamp(0, BRIGHTEST).movedim(-1, 1))
        return replace(batch, target=torch.cat(pictures).contiguous())


class SwapTraining(Training):
    """Training of learn.networks.encoder_decoder.EncoderDecoder."""

    network_name = EncoderDecoder.name

    def _source_of_examples(self) -> str:
        return "relit"

    def _source(self) -> PairedDataset:
        run = self.run
        return PairedDataset(
            self.data_splits["train"],
            run.data,
            run.schedule.batch,
            run.size,
            run.seed,
            (self.rank, self.world),
        )

    def predict(
        self,
        model: torch.nn.Module,
        batch: ExampleBatch,
        parts: tuple[str, ...] | None = None,
    ) -> Edited:
        """Return what the model reads and draws; it has no parts to choose from."""
        with devices.mixed_precision(self.device, self.run.mixed_precision):
            return model(batch.image, batch.mask, batch.target_label[:, :1])

    def _terms(
        self, prediction: Edited, batch: ExampleBatch, loss_weights: Losses, rng: torch.Generator
    ) -> dict[str, torch.Tensor]:
        return terms(prediction, batch, loss_weights, self.network.ranges, self.features)

    def _validate(self) -> dict[str, float]:
        run, network = self.run, self.averaged_network()
        data_split = self.data_splits["validation"]
        source = PairedDataset(data_split, run.data, run.schedule.batch, run.size, 20)
        with torch.no_grad():
            batches = [source[k].to(self.device) for k in range(VALIDATION_BATCHES)]
            edits = [self._predict_finite(network, batch) for batch in batches]
        write_contact_sheet(self._sheet_path(), batches[0], edits[0])
        self._save_weights()
        results = [
            figures(edit, batch, network.ranges) for edit, batch in zip(edits, batches, strict=True)
        ]
        return {name: float(np.mean([f[name] for f in results])) for name in results[0]}


def terms(
    edited: Edited,
    batch: ExampleBatch,
    weights: Losses,
    ranges: Ranges,
    features: Features | None = None,
) -> dict[str, torch.Tensor]:
    """Return {term: scalar}, as the module's text defines them.

    features  needed where target_features has a weight
    """
    inside = (batch.segments > 0)[:, None] * batch.mask
    truth = compress(require_part(batch.target))
    read = ((edited.code - ranges.code(batch.label[:, :1])) ** 2).mean()
    embedded = ((edited.embedded - ranges.code(batch.target_label[:, :1])) ** 2).mean()
    result = {"material": read + embedded}
    if weights.target:
        result["target"] = ((edited.picture - truth) ** 2 * inside).sum() / (
            3 * inside.sum()
        ).clamp(min=1)
    if weights.target_features:
        result["target_features"] = feature_difference(features, edited.picture, truth, inside)
    return result


def figures(edited: Edited, batch: ExampleBatch, ranges: Ranges) -> dict[str, float]:
    """Return {"target_l2", "unchanged_l2", "code_l2"} as means over a batch.

    The first two are display L2 over the mask against the true O, of O' and of the input returned
    unchanged; code_l2 is of the input's material.
    """
    drawn = to_numpy(radiance(edited.picture).movedim(1, -1))
    result: dict[str, list[float]] = {"target_l2": [], "unchanged_l2": []}
    for i, truth in enumerate(to_numpy(require_part(batch.target).movedim(1, -1))):
        mask = to_numpy(batch.segments[i] > 0)
        for name, picture in (
            ("target_l2", drawn[i]),
            ("unchanged_l2", to_numpy(batch.image[i].movedim(0, -1))),
        ):
            result[name].append(display_l2(picture, truth, mask))
    code_l2 = ((edited.code - ranges.code(batch.label[:, :1])) ** 2).mean().item()
    return {name: float(np.mean(values)) for name, values in result.items()} | {"code_l2": code_l2}


def write_contact_sheet(path: Path, batch: ExampleBatch, edited: Edited) -> None:
    """Write a JPEG with one row per example: the picture as seen, O' and O."""
    rows = []
    drawn = to_numpy((radiance(edited.picture) * batch.mask).movedim(1, -1))
    for i in range(min(ROWS, len(drawn))):
        truth = to_numpy(require_part(batch.target)[i].movedim(0, -1))
        exposure = tone.auto_exposure(truth, to_numpy(batch.segments[i] > 0))
        cells = (to_numpy(batch.image[i].movedim(0, -1)), drawn[i], truth)
        rows.append([tone.display(cell, exposure) for cell in cells])
    write_image(path, grid(rows).astype(np.uint8), "JPEG", quality=90)
