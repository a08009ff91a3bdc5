"""The baselines of Section 4.5 as methods of the tables (learn.evaluation.methods.Method).

batch  of one picture; label (S, 108) natural logarithms

Networks see every picture at the size they were trained on; what they predict per pixel is
interpolated back.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional as F

from learn.baselines import FILES, posterior, priors
from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.evaluation.methods import Layered, Method, make_predictor
from learn.networks import weights
from learn.networks.encoder_decoder import EncoderDecoder, radiance
from learn.networks.prediction import Prediction
from learn.networks.separate import Separate
from manifests.errors import InputError


def load(name: str, path: Path, device: str | torch.device = "cpu") -> Method:
    """Return the method of that name from its file, on a device. Raises InputError."""
    if name == "Lombardi-like":
        return lombardi_like(path, device)
    net, metadata = weights.load_network(path, device)
    if name == "Baseline 2" and isinstance(net, Separate):
        return Layered(name, make_predictor_at_size(net, metadata["size"]))
    if name == "Baseline 1" and isinstance(net, EncoderDecoder):
        return Swapped(name, net, metadata["size"])
    expected = Separate if name == "Baseline 2" else EncoderDecoder
    raise InputError(
        path,
        f"weights of {name}: network '{expected.name}'",
        f"'{net.name}'",
        "train it: python -m learn train-baselines",
    )


def lombardi_like(
    path: Path, device: str | torch.device = "cpu", ours: Layered | None = None
) -> Layered:
    """Return the Lombardi-like method by its priors' file. Raises InputError.

    ours  a method whose normals it is given; None: the true ones, as in the paper
    """
    known = priors.load(path).to(device)

    def predict(batch: ExampleBatch) -> Prediction:
        n = batch.n if ours is None else ours.parts(batch).n
        if n is None:
            raise ValueError("Lombardi-like: expected normals, found none")
        return posterior.predict(replace(batch, n=n), known)

    return Layered(
        f"Lombardi-like, {'true normals' if ours is None else 'normals of ' + ours.name}", predict
    )


def make_predictor_at_size(net: Separate, size: int) -> Callable[[ExampleBatch], Prediction]:
    """Return ExampleBatch → Prediction of a network that was trained at `size`."""
    predict = make_predictor(net)

    def at_size(batch: ExampleBatch) -> Prediction:
        result = predict(resize_batch(batch, size))
        if result.n is None:
            raise ValueError("Baseline 2: expected predicted normals, found none")
        return result._replace(
            n=F.normalize(resize_pixels(result.n, batch.image.shape[-2:]), dim=1)
        )

    return at_size


def resize_batch(batch: ExampleBatch, size: int) -> ExampleBatch:
    """Return the batch with its picture, mask and segments at another size.

    The object's colour is averaged over the object alone; the other truth stays as it is.
    """
    if batch.image.shape[-1] == size:
        return batch
    covered = F.interpolate(batch.mask, (size, size), mode="area")
    image = F.interpolate(batch.image * batch.mask, (size, size), mode="area") / covered.clamp(
        min=1e-3
    )
    segments = F.interpolate(batch.segments[:, None].float(), (size, size), mode="nearest-exact")[
        :, 0
    ].long()
    mask = (covered >= 0.5).float()
    return replace(batch, image=image * mask, mask=mask, segments=segments)


def resize_pixels(pixels: torch.Tensor, size: tuple[int, ...]) -> torch.Tensor:
    """Return pixels (B, C, H, W) at another size (H, W)."""
    return (
        pixels
        if pixels.shape[-2:] == tuple(size)
        else F.interpolate(pixels, tuple(size), mode="bilinear")
    )


class Swapped:
    """Baseline 1: predicts a material, and draws edits without normals or light.

    A picture of several regions is drawn region by region.
    """

    def __init__(self, name: str, net: EncoderDecoder, size: int):
        self.name, self.net, self.size = name, net, size

    def parts(self, batch: ExampleBatch) -> Prediction:
        """Return a Prediction with nothing but the material."""
        seen = resize_batch(batch, self.size)
        with torch.no_grad():
            read = [
                self.net(seen.image * region, region, batch.label[:, :1])
                for region in regions(seen)
            ]
        code, label = (
            torch.cat([getattr(r, field) for r in read], 1) for field in ("code", "label")
        )
        return Prediction(None, code, label, None, None)

    def edit(self, batch: ExampleBatch, label: torch.Tensor) -> np.ndarray:
        """Return linear radiance (H, W, 3), zeros outside the mask."""
        seen, picture = resize_batch(batch, self.size), torch.zeros_like(batch.image)
        with torch.no_grad():
            for region, at_size, requested in zip(
                regions(batch), regions(seen), label.to(batch.label.device), strict=True
            ):
                drawn = radiance(
                    self.net(seen.image * at_size, at_size, requested[None, None]).picture
                )
                picture += resize_pixels(drawn, picture.shape[-2:]) * region
        return to_numpy(picture[0].movedim(0, -1))


def regions(batch: ExampleBatch) -> list[torch.Tensor]:
    """Return [(1, 1, H, W) float]: the mask, or its part in each segment."""
    count = batch.label.shape[1]
    return (
        [batch.mask]
        if count == 1
        else [batch.mask * (batch.segments == s + 1)[:, None] for s in range(count)]
    )


def present_and_missing(
    folder: Path, device: str | torch.device = "cpu", ours: Layered | None = None
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods whose files are in a folder, and {name: why it is missing} of the others.

    ours    a method whose normals the Lombardi-like one is given in a second row; None: no such row
    Raises  InputError: a file is not what its name says
    """
    if not Path(folder).is_dir():
        raise InputError(
            "--baselines",
            "a folder of weights",
            f"no folder {folder}",
            "train them: python -m learn train-baselines",
        )
    present: list[Method] = []
    missing = {}
    for name, file in FILES.items():
        path = Path(folder) / file
        if path.exists():
            present.append(load(name, path, device))
            if name == "Lombardi-like" and ours is not None:
                present.append(lombardi_like(path, device, ours))
        else:
            missing[name] = f"no {file} in {folder}: python -m learn train-baselines --out {folder}"
    return present, missing
