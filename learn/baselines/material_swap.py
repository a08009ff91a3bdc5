"""Training of Baseline 1: the loop of learn.training, given pictures of what is wanted. Its terms,
weighed as a run's `losses` say:

target           mean (O' − c(O))² over the mask's pixels and channels, c =
learn.networks.coding.compressed
target_features  the same two pictures compared by features (learn.networks.features): the paper's
perceptual loss
material         mean (code' − code)² of the input's material, read from f_m, and of the wanted one,
read from e(m_t)
"""

from dataclasses import replace

import msgspec
import numpy as np
import torch

from learn.data import devices
from learn.data.devices import array
from learn.data.relit import BRIGHTEST, RelitDataset
from learn.figures.montage import grid
from learn.layer import render
from learn.metrics.pictures import display_l2
from learn.networks import weights as checkpoint
from learn.networks.coding import compressed
from learn.networks.encoder_decoder import EncoderDecoder, radiance
from learn.training.loop import Training
from learn.training.losses import compared_by
from manifests.files import write_image
from shaders import tone

VALIDATION_BATCHES = 2
ROWS = 6


class Paired(RelitDataset):
    """Relit batches with the true O beside the true I: the same shape and light, rendered in the
    target material.
    """

    def __getitem__(self, k):
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
    """As learn.training.loop.Training, for learn.networks.encoder_decoder.EncoderDecoder."""

    network_name = EncoderDecoder.name

    def _source(self):
        run = self.run
        return Paired(
            self.data_splits["train"],
            run.data,
            run.schedule.batch,
            run.size,
            run.seed,
            (self.rank, self.world),
        )

    def predict(self, model, batch, parts=None):
        with devices.mixed_precision(self.device, self.run.mixed_precision):
            return model(batch.image, batch.mask, batch.target_label[:, :1])

    def _terms(self, prediction, batch, weights, rng):
        return terms(prediction, batch, weights, self.network.ranges, self.features)

    def _validate(self):
        run, network = self.run, self.averaged()
        source = Paired(self.data_splits["validation"], run.data, run.schedule.batch, run.size, 20)
        with torch.no_grad():
            batches = [source[k].to(self.device) for k in range(VALIDATION_BATCHES)]
            edits = [self._predicted(network, batch) for batch in batches]
        write_montage(self.out / f"sheet-{self.step:07d}.jpg", batches[0], edits[0])
        run_json = msgspec.json.encode(run).decode()
        checkpoint.save_weights(
            self.out / "weights.safetensors",
            self.network,
            self.average,
            run_json,
            run.size,
            self.step,
        )
        results = [
            figures(edit, batch, network.ranges) for edit, batch in zip(edits, batches, strict=True)
        ]
        return {name: float(np.mean([f[name] for f in results])) for name in results[0]}


def terms(edited, batch, weights, ranges, features=None):
    """{name: scalar}; see the module. weights: learn.data.settings.Losses; features:
    learn.networks.features.Features, if asked for.
    """
    inside = (batch.segments > 0)[:, None] * batch.mask
    truth = compressed(batch.target)
    read = ((edited.code - ranges.code(batch.label[:, :1])) ** 2).mean()
    embedded = ((edited.embedded - ranges.code(batch.target_label[:, :1])) ** 2).mean()
    result = {"material": read + embedded}
    if weights.target:
        result["target"] = ((edited.picture - truth) ** 2 * inside).sum() / (
            3 * inside.sum()
        ).clamp(min=1)
    if weights.target_features:
        result["target_features"] = compared_by(features, edited.picture, truth, inside)
    return result


def figures(edited, batch, ranges):
    """Display L2 over the mask of O' and of the input returned unchanged, against the true O;
    code_l2 of the input's material.
    """
    drawn = array(radiance(edited.picture).movedim(1, -1))
    result = {"target_l2": [], "unchanged_l2": []}
    for i, truth in enumerate(array(batch.target.movedim(1, -1))):
        mask = array(batch.segments[i] > 0)
        for name, picture in (
            ("target_l2", drawn[i]),
            ("unchanged_l2", array(batch.image[i].movedim(0, -1))),
        ):
            result[name].append(display_l2(picture, truth, mask))
    code_l2 = ((edited.code - ranges.code(batch.label[:, :1])) ** 2).mean().item()
    return {name: float(np.mean(values)) for name, values in result.items()} | {"code_l2": code_l2}


def write_montage(path, batch, edited):
    """A JPEG with a row an example: the picture as seen, O', O."""
    rows = []
    drawn = array((radiance(edited.picture) * batch.mask).movedim(1, -1))
    for i in range(min(ROWS, len(drawn))):
        truth = array(batch.target[i].movedim(0, -1))
        exposure = tone.auto_exposure(truth, array(batch.segments[i] > 0))
        cells = (array(batch.image[i].movedim(0, -1)), drawn[i], truth)
        rows.append([tone.display(cell, exposure) for cell in cells])
    write_image(path, grid(rows).astype(np.uint8), "JPEG", quality=90)
