"""What is measured of a scene on a rung of the ladder: a decomposition, and the edit from it."""

import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from msgspec import Struct

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.records import Records
from learn.editing.decomposition import Parts, require_parts
from learn.evaluation import methods
from learn.evaluation.ladder_design import RUNGS, Scene
from learn.evaluation.ladder_pictures import Shown, load_scene
from learn.evaluation.rows import Figure
from learn.metrics.pictures import display_l2, l2_after_alignments
from learn.metrics.radiometry import irradiance_error
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction
from learn.refinement import refine
from manifests.provenance import provenance


class Measured(Struct, frozen=True):
    """Figures of one decomposition and the edit made from it.

    normals_mean_deg, normals_median_deg  angle to the true normals over the mask
    irradiance         relative root mean square error of the light's irradiance
    edit_l2            display L2 of the edit against its truth
    edit_l2_aligned    the same after the factor on the edit's radiance that makes it least
    edit_l2_three_factors  the same after such a factor for each channel; None in lines of before
    """

    normals_mean_deg: Figure
    normals_median_deg: Figure
    irradiance: Figure
    edit_l2: Figure
    edit_l2_aligned: Figure
    edit_l2_three_factors: Figure | None = None


class Line(Struct, frozen=True, kw_only=True):
    """A line of lines.jsonl: one scene on one rung.

    facing_deg       angle of normals that all face the viewer, mean over the mask
    constant_irradiance  irradiance error of the same light from everywhere
    unchanged_l2     display L2 of the input picture itself
    floor_l2         of the edit from true normals, light and label; None on rungs of other cameras
    metal            whether the target material is a metal
    refined          None where the scene was not refined
    """

    id: str
    scene: str
    rung: str
    group: str
    family: str
    shape: str
    light: str
    source: str
    target: str
    metal: bool
    exposure: Figure
    facing_deg: Figure
    constant_irradiance: Figure
    unchanged_l2: Figure
    floor_l2: Figure | None
    predicted: Measured
    refined: Measured | None = None
    commit: str = "none"


class LadderEvaluator:
    """Measures a network on scenes of the ladder, whose pictures are records.

    Raises  InputError for unusable weights
    """

    def __init__(self, records: Records, weights: Path, device: str = "cpu"):
        network, metadata = checkpoint.load_full_network(weights, device)
        self.records, self.size, self.device = records, metadata["size"], torch.device(device)
        self.predict = methods.make_predictor(network)
        self.refine = functools.partial(refine, labels=getattr(network, "training_labels", None))
        self.commit = provenance()["commit"]

    def measure(self, scene: Scene, name: str, refined: bool) -> Line:
        """Return the figures of a scene on a rung; refined: whether those of refinement too."""
        (rung,) = (each for each in RUNGS if each.name == name)
        picture = load_scene(self.records, scene, rung, self.size)
        batch = picture.batch.to(self.device)
        source = to_numpy((batch.image * batch.mask)[0].movedim(0, -1))
        prediction = self.predict(batch)
        facing = torch.zeros_like(batch.n)
        facing[:, 2] = 1.0
        floor = None
        if not rung.eight_bit:
            true = Parts(batch.n, batch.label, batch.light)
            floor = display_l2(_edit(true, picture, batch), picture.target, picture.mask)
        names = {key: of[rung.name].materials[0] for key, of in _sides(scene).items()}
        return Line(
            id=f"{scene.id}-{rung.name}",
            scene=scene.id,
            rung=rung.name,
            group=scene.group,
            family=scene.family,
            shape=scene.shape,
            light=scene.light,
            metal=self.records.material(names["target"]).family == "metal",
            exposure=picture.exposure,
            facing_deg=angles(facing, batch)[0],
            constant_irradiance=float(irradiance_error(torch.ones_like(batch.light), batch.light)),
            unchanged_l2=display_l2(source, picture.target, picture.mask),
            floor_l2=floor,
            predicted=measure_decomposition(require_parts(prediction), picture, batch),
            refined=(
                measure_decomposition(
                    require_parts(self.refine(batch, prediction).prediction), picture, batch
                )
                if refined
                else None
            ),
            commit=self.commit,
            **names,
        )


def _sides(scene: Scene) -> dict[str, Mapping]:
    return {"source": scene.source, "target": scene.truth}


def measure_decomposition(parts: Parts, picture: Shown, batch: ExampleBatch) -> Measured:
    """Return the figures of a decomposition of a picture; batch: the picture's, on the device."""
    mean, median = angles(parts.n, batch)
    edited = _edit(parts, picture, batch)
    forgiving = l2_after_alignments(edited, picture.target, picture.mask)
    return Measured(
        mean,
        median,
        float(irradiance_error(parts.light, batch.light)),
        display_l2(edited, picture.target, picture.mask),
        forgiving["l2_one_factor"],
        forgiving["l2_three_factors"],
    )


def error_of_rerendering(prediction: Prediction, picture: Shown) -> float:
    """Return the display L2 of the picture's re-rendering by the integral against the picture."""
    parts, batch = require_parts(prediction), picture.batch
    again = methods.render_by_layer(parts.n, parts.label, parts.light, batch)
    return display_l2(again, to_numpy((batch.image * batch.mask)[0].movedim(0, -1)), picture.mask)


def _edit(parts: Parts, picture: Shown, batch: ExampleBatch) -> np.ndarray:
    return methods.render_by_layer(parts.n, torch.from_numpy(picture.label), parts.light, batch)


def angles(n: torch.Tensor, batch: ExampleBatch) -> tuple[float, float]:
    """Return the mean and median angle in degrees of normals (1, 3, H, W) over the mask."""
    cosine = (n * batch.n).sum(1)[batch.segments > 0].double().clamp(-1, 1)
    degrees = cosine.arccos().rad2deg()
    return float(degrees.mean()), float(degrees.median())
