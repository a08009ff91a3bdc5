"""The methods that the tables compare: each decomposes a picture and shows it in other materials.

batch   of one picture; its truth (n, label, light) is for metrics, and for methods that are said to
        be given it
label   (S, 108) natural logarithms of the target material of each region

A method remembers the parts of its last batch, so that the edits of one picture share its
prediction and its refinement. The baselines are in learn.evaluation.baseline_methods.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.records import Records
from learn.editing import mirror_correction
from learn.editing.decomposition import require_parts
from learn.editing.light_colour import remove_green
from learn.layer import predictions
from learn.networks.prediction import Prediction
from learn.refinement import RefinementResult
from manifests.materials import load_catalogue

REFINED = ("Baseline 2",)  # of the baselines, those that the paper refines too
# besides those with "true" in their name: they are given a part of what the others predict
GIVEN_TRUTH = ("the layer alone",)

# {scene: its picture} of the block rendered_once; None outside of it
_kept: ContextVar[dict[tuple, np.ndarray] | None] = ContextVar("_kept", default=None)

Refine = Callable[[ExampleBatch, Prediction | None], RefinementResult]


class Method(Protocol):
    """A row of a table. name: its caption there."""

    name: str

    def parts(self, batch: ExampleBatch) -> Prediction | None:
        """Return normals, material and light of a batch of one.

        A field is None, or the whole result, where the method does not predict it.
        """

    def edit(self, batch: ExampleBatch, label: torch.Tensor) -> np.ndarray:
        """Return radiance (H, W, 3) of the object in other materials, zeros outside the mask.

        label  (S, 108)
        """


def render_by_layer(
    n: torch.Tensor, label: torch.Tensor, light: torch.Tensor, batch: ExampleBatch
) -> np.ndarray:
    """Return radiance (H, W, 3) by the layer, rendered by learn.layer.predictions.MEASURED.

    n (1, 3, H, W), label (S, 108) or (1, S, 108), light (1, 3, 64, 128)
    """
    scene = (n, (label if label.ndim == 3 else label[None]).to(light.device), light, batch.segments)
    kept = _kept.get()
    if kept is None:
        return to_numpy(predictions.picture(*scene, batch.elevation)[0])
    key = (batch.elevation, *((to_numpy(x).tobytes(), x.dtype, x.shape) for x in scene))
    if key not in kept:
        kept[key] = to_numpy(predictions.picture(*scene, batch.elevation)[0])
        kept[key].setflags(write=False)
    return kept[key]


@contextlib.contextmanager
def rendered_once() -> Iterator[None]:
    """A block in which render_by_layer renders no scene twice; not where its seconds are measured.

    The methods of an evaluation share normals, lights and labels, so that they would render many
    scenes several times.
    """
    token = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(token)


class Layered:
    """A method that decomposes a picture and renders it with the layer.

    predict  returns a Prediction with n and light at least
    """

    def __init__(self, name: str, predict: Callable[[ExampleBatch], Prediction]):
        self.name, self.predict = name, predict
        self._last: tuple[ExampleBatch, Prediction] | None = None

    def parts(self, batch: ExampleBatch) -> Prediction:
        """Return the prediction of a batch of one, the same object for the same batch."""
        if self._last is None or self._last[0] is not batch:
            self._last = batch, self.predict(batch)
        return self._last[1]

    def edit(self, batch: ExampleBatch, label: torch.Tensor) -> np.ndarray:
        """Return the layer's radiance (H, W, 3) of the predicted parts in materials (S, 108)."""
        n, light = self.parts(batch).n, self.parts(batch).light
        if n is None or light is None:
            raise ValueError(f"{self.name}: expected predicted normals and light, found fewer")
        return render_by_layer(n, label, light, batch)


class Refined(Layered):
    """Another method's parts, refined to fit the picture (Eq. 6). refined: the last result."""

    def __init__(self, method: Method, refine: Refine):
        super().__init__(f"{method.name}, refined", self._refine)
        self.start, self._work = method, refine
        self.refined: RefinementResult | None = None

    def _refine(self, batch: ExampleBatch) -> Prediction:
        self.refined = self._work(batch, self.start.parts(batch))
        return self.refined.prediction


class AsEdited(Layered):
    """Another method's parts with the corrections by which `edit` shows them.

    The light's green is taken back, and mirror-like targets are darkened.
    """

    def __init__(self, method: Layered):
        super().__init__(f"{method.name}, as edited", self._correct)
        self.method = method

    def _correct(self, batch: ExampleBatch) -> Prediction:
        prediction = self.method.parts(batch)
        parts = remove_green(require_parts(prediction))
        return prediction._replace(label=parts.label, light=parts.light)

    def edit(self, batch: ExampleBatch, label: torch.Tensor) -> np.ndarray:
        """Return radiance (H, W, 3) of the object in other materials (S, 108)."""
        factors = np.array([1.0, *(mirror_correction.factor(to_numpy(row)) for row in label)])
        segments = to_numpy(batch.segments[0]).clip(0, len(factors) - 1)
        return super().edit(batch, label) * factors[segments][..., None].astype(np.float32)


class Unchanged:
    """The input picture, whatever the target material is."""

    name = "input unchanged"

    def parts(self, batch: ExampleBatch) -> None:
        """Return None: nothing is predicted."""

    def edit(self, batch: ExampleBatch, label: torch.Tensor) -> np.ndarray:
        """Return the input's radiance (H, W, 3), zeros outside the mask."""
        return to_numpy((batch.image * batch.mask)[0].movedim(0, -1))


class MeanMaterial(Layered):
    """The training materials' mean label, whatever the target material is.

    labels  (M, 108) of the training materials
    method  whose normals and light are used; None: the true ones
    """

    def __init__(self, labels: Sequence[np.ndarray], method: Layered | None = None):
        super().__init__(
            "mean material,"
            f" {'true normals and light' if method is None else 'the rest of ' + method.name}",
            self._predict,
        )
        self.label, self.method = torch.from_numpy(np.mean(labels, 0)).float(), method

    def _predict(self, batch: ExampleBatch) -> Prediction:
        result = (
            Prediction(batch.n, None, None, None, batch.light)
            if self.method is None
            else self.method.parts(batch)
        )
        return result._replace(code=None, label=self._label(batch))

    def _label(self, batch: ExampleBatch) -> torch.Tensor:
        return self.label.to(batch.label.device).expand_as(batch.label)

    def edit(self, batch: ExampleBatch, label: torch.Tensor) -> np.ndarray:
        """Return radiance (H, W, 3) of the object in the mean material."""
        return super().edit(batch, self._label(batch))


def training_labels(records: Records | None, materials: str) -> list[np.ndarray]:
    """Return the labels (108,) of the materials for training.

    records    of the dataset; may be None for "built-in"
    materials  "dataset": those of the dataset's training split, maybe none; "built-in": those of
               the built-in catalogue's
    """
    if materials == "built-in":
        return [m.label.reshape(-1) for m in load_catalogue().values() if m.split == "train"]
    if records is None:
        raise ValueError("records: expected those of a dataset, found None")
    return [
        records.material(name).label.reshape(-1)
        for name in records.materials
        if records.side(name) == "train"
    ]


def make_predictor(net: torch.nn.Module) -> Callable[[ExampleBatch], Prediction]:
    """Return ExampleBatch → Prediction by a network, over regions where the picture has several."""

    def predict(batch: ExampleBatch) -> Prediction:
        regions = batch.label.shape[1]
        with torch.no_grad():
            return net(
                batch.image, batch.mask, batch.segments if regions > 1 else None, regions=regions
            )

    return predict


def constant_light(method: Layered | None = None) -> Layered:
    """Return a method with the same light from everywhere: the control for predicted light.

    Its normals are the true ones, or those of another method.
    """

    def predict(batch: ExampleBatch) -> Prediction:
        n = batch.n if method is None else method.parts(batch).n
        return Prediction(n, None, None, None, torch.ones_like(batch.light))

    return Layered(
        f"constant light, {'true normals' if method is None else 'normals of ' + method.name}",
        predict,
    )


def facing_viewer() -> Layered:
    """Return a method of which all normals face the viewer: the control for predicted normals."""

    def predict(batch: ExampleBatch) -> Prediction:
        n = torch.zeros_like(batch.n)
        n[:, 2] = batch.n.square().sum(1) > 0
        return Prediction(n, None, None, None, None)

    return Layered("all normals facing the viewer", predict)


def with_true_normals(method: Layered) -> Layered:
    """Return a method with its material and light, and the true normals."""
    return Layered(
        f"{method.name}, true normals", lambda batch: method.parts(batch)._replace(n=batch.n)
    )


def layer_alone() -> Layered:
    """Return a method with true normals, light and label: its error is the layer's own."""
    return Layered(
        "the layer alone", lambda batch: Prediction(batch.n, None, batch.label, None, batch.light)
    )


@dataclass(frozen=True)
class ComparedMethods:
    """The methods that are compared.

    edits     methods that edit: the rows of the table of edits, in order; the last one is the layer
              alone
    parts     further methods, of which the parts alone are compared
    left_out  {name: why it is missing}
    """

    edits: tuple[Method, ...]
    parts: tuple[Method, ...]
    left_out: dict[str, str]


OURS, OURS_REFINED = "ours", "ours, refined"


def list_methods(
    net: torch.nn.Module,
    refine: Refine | None,
    labels: Sequence[np.ndarray],
    baselines: Path | None = None,
    device: str | torch.device = "cpu",
    refine_with_normals_kept: Refine | None = None,
) -> ComparedMethods:
    """Return the ComparedMethods.

    net        a network of learn.networks
    refine     None: no method is refined
    refine_with_normals_kept
               refines material and light alone: for the row with true normals
    labels     (M, 108) of training materials, whose mean is a method; none: that row is left out
    baselines  a folder of weights, or None
    device     where the baselines compute
    """
    ours = Layered(OURS, make_predictor(net))
    rows: list[Method] = []
    left_out: dict[str, str] = {}
    if baselines is None:
        left_out["baselines of Section 4.5"] = "no --baselines DIR was given"
    else:
        from learn.evaluation import baseline_methods

        result, left_out = baseline_methods.present_and_missing(baselines, device, ours)
        for method in result:
            rows += (
                [method, Refined(method, refine)] if refine and method.name in REFINED else [method]
            )
    best: Layered = Refined(ours, refine) if refine else ours
    rows += [ours, best] if refine else [ours]
    rows.append(AsEdited(best))
    rows.append(with_true_normals(ours))
    if refine_with_normals_kept:
        rows.append(Refined(rows[-1], refine_with_normals_kept))
    if not refine:
        left_out["refined rows"] = "--no-refine was given"
    mean = [MeanMaterial(labels), MeanMaterial(labels, ours)] if len(labels) else []
    if not mean:
        left_out["mean material"] = (
            "the data set has no material for training; --materials built-in takes the built-in"
            " ones"
        )
    trivial: list[Method] = [Unchanged(), *mean[:1], constant_light(), constant_light(ours)]
    parts = (*mean[1:], facing_viewer())
    return ComparedMethods((*trivial, *rows, layer_alone()), parts, left_out)
