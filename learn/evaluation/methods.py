"""The methods that the tables compare, under one protocol: what a picture is made of, and what it
looks like in another material.

batch   learn.data.batch.ExampleBatch of one picture; its truth (n, label, light) is for metrics,
and for methods that are said to be given it
label   (S, 108) natural logarithms of the wanted material, one a region
A method remembers the parts of the last batch it saw: the edits of one picture share its prediction
and its refinement.

Baselines come from `learn.evaluation.baseline_methods.present_and_missing(folder)`: the Methods
whose weights lie in the folder, and {name: what is missing} of the others.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from learn.data.devices import array
from learn.data.records import Records
from learn.layer import render
from learn.networks.prediction import Prediction
from manifests.materials import load_catalogue

REFINED = ("Baseline 2",)  # of the baselines, those that the paper refines too
# besides those with "true" in their name: shown a part of what the others predict
GIVEN_TRUTH = ("the layer alone", "Lombardi-like")
# the integral, not the paper's sum: of a mirror-like lobe the sum alone is 200 display L2 off
METHOD = "quadrature"
TOLERANCE = 5e-3  # at 1e-2 one of 75 true edits was 0.7 display L2 off by it, at 5e-3 none 0.1


class Method(Protocol):
    """What a row of a table is made by.

    name  as it stands in the tables
    """

    name: str

    def parts(self, batch) -> Prediction | None:
        """Normals, material and light of a batch of one; a field is None, or all of it, where the
        method does not tell them apart.
        """

    def edit(self, batch, label):
        """(H, W, 3) numpy linear radiance of the object in the material `label` (S, 108), zeros
        outside the mask.
        """


def rendered(n, label, light, batch):
    """(H, W, 3) numpy radiance by the layer of n (1, 3, H, W), label (S, 108) or (1, S, 108), light
    (1, 3, 64, 128).
    """
    label = (label if label.ndim == 3 else label[None]).to(light.device)
    several = label.shape[1] > 1
    with torch.no_grad():
        picture = render(
            n.movedim(1, -1).contiguous().float(),
            (label if several else label[:, 0]).float().exp(),
            light.movedim(1, -1).contiguous().float(),
            segments=batch.segments if several else None,
            mask=batch.segments > 0,
            method=METHOD,
            tolerance=TOLERANCE,
            elevation=batch.elevation,
        )
    return array(picture[0])


class Layered:
    """A method that takes a picture apart and renders it anew. predict: Batch → Prediction with n
    and light.
    """

    def __init__(self, name, predict):
        self.name, self.predict = name, predict
        self._seen = self._parts = None

    def parts(self, batch):
        if self._seen is not batch:
            self._parts, self._seen = self.predict(batch), batch
        return self._parts

    def edit(self, batch, label):
        result = self.parts(batch)
        return rendered(result.n, label, result.light, batch)


class Refined(Layered):
    """Another method's parts, refined to fit the picture (Eq. 6). told: the last
    learn.refinement.Refined.
    """

    def __init__(self, method, refine):
        super().__init__(f"{method.name}, refined", self._refine)
        self.start, self._work, self.refined = method, refine, None

    def _refine(self, batch):
        self.refined = self._work(batch, self.start.parts(batch))
        return self.refined.prediction


class Unchanged:
    """The input returned as it is."""

    name = "input unchanged"

    def parts(self, batch):
        return None

    def edit(self, batch, label):
        return array((batch.image * batch.mask)[0].movedim(0, -1))


class MeanMaterial(Layered):
    """The training materials' mean label whatever is asked for, in true normals and light, or in a
    method's.
    """

    def __init__(self, labels, method=None):
        """labels: (M, 108) of the training materials; method: whose normals and light are taken,
        None: the true ones.
        """
        super().__init__(
            "mean material,"
            f" {'true normals and light' if method is None else 'the rest of ' + method.name}",
            self._predict,
        )
        self.label, self.method = torch.from_numpy(np.mean(labels, 0)).float(), method

    def _predict(self, batch):
        result = (
            Prediction(batch.n, None, None, None, batch.light)
            if self.method is None
            else self.method.parts(batch)
        )
        return result._replace(
            code=None, label=self.label.to(batch.label.device).expand_as(batch.label)
        )

    def edit(self, batch, label):
        return super().edit(batch, self.parts(batch).label)


def training_labels(records: Records | None, materials: str) -> list[np.ndarray]:
    """Labels (108,) of the materials for training.

    records    of the data set; None will do for "built-in"
    materials  "dataset": those that the data set has on its training side, maybe none; "built-in":
    the built-in catalogue's
    """
    if materials == "built-in":
        return [m.label.reshape(-1) for m in load_catalogue().values() if m.split == "train"]
    return [
        records.material(name).label.reshape(-1)
        for name in records.materials
        if records.side(name) == "train"
    ]


def network(net):
    """Batch → Prediction by a network of learn.networks, over regions where the picture has
    several.
    """

    def predict(batch):
        regions = batch.label.shape[1]
        with torch.no_grad():
            return net(
                batch.image, batch.mask, batch.segments if regions > 1 else None, regions=regions
            )

    return predict


def constant_light(method=None):
    """A map of the same radiance everywhere, with true normals, or with those of a method: what
    knowing nothing of light is worth.
    """

    def predict(batch):
        n = batch.n if method is None else method.parts(batch).n
        return Prediction(n, None, None, None, torch.ones_like(batch.light))

    return Layered(
        f"constant light, {'true normals' if method is None else 'normals of ' + method.name}",
        predict,
    )


def layer_alone():
    """True normals, light and label: what the layer itself is off by, in the material that it is
    asked for as in the one that is there.
    """
    return Layered(
        "the layer alone", lambda batch: Prediction(batch.n, None, batch.label, None, batch.light)
    )


@dataclass(frozen=True)
class Entrants:
    """Who is compared.

    edits     methods that edit, the rows of the table of edits, in order; the last one is the layer
    alone
    parts     further methods, of which the parts alone are compared
    left_out  {name: why it is not there}
    """

    edits: tuple
    parts: tuple
    left_out: dict


OURS, OURS_REFINED = "ours", "ours, refined"


def entrants(net, refine, labels, baselines=None, device="cpu"):
    """The Entrants.

    net        a network of learn.networks
    refine     (Batch, Prediction) → learn.refinement.Refined, or None: nobody is refined
    labels     (M, 108) of training materials, whose mean is an entrant; none: that row is left out
    baselines  a folder of weights, or None
    device     where the baselines compute
    """
    ours, rows, left_out = Layered(OURS, network(net)), [], {}
    if baselines is None:
        left_out["baselines of Section 4.5"] = "no --baselines DIR was given"
    else:
        from learn.evaluation import baseline_methods

        result, left_out = baseline_methods.present_and_missing(baselines, device)
        for method in result:
            rows += (
                [method, Refined(method, refine)] if refine and method.name in REFINED else [method]
            )
    rows += [ours, Refined(ours, refine)] if refine else [ours]
    if not refine:
        left_out["refined rows"] = "--no-refine was given"
    mean = [MeanMaterial(labels), MeanMaterial(labels, ours)] if len(labels) else []
    if not mean:
        left_out["mean material"] = (
            "the data set has no material for training; --materials built-in takes the built-in"
            " ones"
        )
    trivial = [Unchanged(), *mean[:1], constant_light(), constant_light(ours)]
    return Entrants((*trivial, *rows, layer_alone()), tuple(mean[1:]), left_out)
