"""Measurements of one source picture: every method decomposes and edits it, against the truth.

A row of figures is plain JSON: {"methods": {name: {group: {figure: value}}}, …}. What a method does
not predict is left out of its row.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn import refinement
from learn.agreement import causes, surface
from learn.data import pairs
from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.pairs import EditPair
from learn.data.records import Records, Sample
from learn.evaluation import gallery, methods
from learn.layer import render
from learn.layer.predictions import MEASURED
from learn.metrics import intrinsics
from learn.metrics import lpips as lpips_metric
from learn.metrics import pictures as metrics
from learn.metrics.pictures import squared_difference, squared_net_of_noise
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction
from learn.refinement import RefinementResult, RefinementSettings
from manifests.errors import InputError
from manifests.provenance import provenance
from manifests.schema import Record
from shaders import tone
from shaders.mixture import Mixture

# pixels of a truth at which label and nodes are compared: 2 s on one thread, 9 where 65,536 sample
# directions are needed
FIT_PIXELS = causes.PIXELS
FINE = 1e-3  # tolerance of the layer's integral where the nodes' is computed from it


class EditEvaluator:
    """Measures every method on the pictures of a data set.

    Records, methods and their weights are loaded once per process.

    data, weights      paths of the data set and of the network's weights
    baselines          folder of the baselines' weights, or None
    refine             whether methods are refined
    lpips              file of LPIPS' weights, or None
    materials          whose training materials the mean material is the mean of: "dataset" or
                       "built-in"
    device             of networks, refinement and the layer
    refinement_method  of the layer, by which refinement renders
    """

    def __init__(
        self,
        data: Path,
        weights: Path,
        baselines: Path | None = None,
        refine: bool = True,
        lpips: Path | None = None,
        materials: str = "dataset",
        device: str = "cpu",
        refinement_method: str = "auto",
    ):
        self.records = Records(data)
        self.repeats = pairs.find_repeats(self.records.records)
        self._against_nodes: dict[str, dict[str, float]] = {}  # by id of the truth
        net, self.metadata = checkpoint.load_full_network(weights, device)
        self.device = torch.device(device)
        self.commit = provenance()["commit"]
        self.size, self.ranges = self.metadata["size"], net.ranges
        self.perceptual = lpips_metric.load(lpips)
        refine_all = refine_with_normals_kept = None
        if refine:
            settings = RefinementSettings().with_method(refinement_method)
            without_normals = replace(settings, order=("material", "light"))
            refine_all, refine_with_normals_kept = (
                functools.partial(refinement.refine, settings=each, labels=net.training_labels)
                for each in (settings, without_normals)
            )
        labels = methods.training_labels(self.records, materials)
        # the weights' own, or those that the row "mean material" is the mean of
        self.training_labels: np.ndarray | None = net.training_labels
        if self.training_labels is None and labels:
            self.training_labels = np.stack(labels)
        self.methods = methods.list_methods(
            net, refine_all, labels, baselines, self.device, refine_with_normals_kept
        )

    def measure_picture(
        self, first: EditPair, edits: Sequence[EditPair], parts: bool, folder: str | None = None
    ) -> tuple[dict | None, list[dict]]:
        """Return the row of a source picture, or None, and the rows of edits of it.

        first   an edit of the source picture, which is the same for all its edits
        edits   edits of it that are to be measured; may be none
        parts   whether the picture's own row is requested: the parts by every method
        folder  where pictures of the edits are written; None: no pictures
        """
        batch = pairs.make_source_batch(self.records, first).to(self.device)
        if batch.image.shape[-2:] != (self.size, self.size):
            result = f"{batch.image.shape[-1]} × {batch.image.shape[-2]}"
            raise InputError(
                self.records.folder,
                f"pictures of {self.size} × {self.size} pixels, as the weights were trained",
                result,
                "render again",
            )
        with methods.rendered_once():
            row = self._picture_row(first.source, batch) if parts else None
            return row, [self._edit_row(edit, batch, folder) for edit in edits]

    def _picture_row(self, record: Record, batch: ExampleBatch) -> dict:
        truth = to_numpy(batch.image[0].movedim(0, -1))
        row: dict = {"id": record.id, "commit": self.commit, "methods": {}} | summary_of(record)
        done: dict[tuple, dict] = {}  # many methods share a part, which is then measured once
        for method in (*self.methods.edits, *self.methods.parts):
            parts = method.parts(batch)
            if parts is None:
                continue
            row["methods"][method.name] = self._measure_parts(parts, batch, truth, done)
            if isinstance(method, methods.Refined) and method.refined is not None:
                row["methods"][method.name]["refinement"] = summarise_refinement(method.refined)
        return row

    def _measure_parts(
        self, parts: Prediction, batch: ExampleBatch, truth: np.ndarray, done: dict[tuple, dict]
    ) -> dict[str, dict]:
        """Return {group: figures} of the parts that a method predicted, not of those it was given.

        done  {figures' name and ids of their tensors: figures} of earlier methods; added to
        """
        inside = batch.segments[0] > 0
        result: dict[str, dict] = {}
        predicted: dict[str, tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = {}
        if parts.n is not None and parts.n is not batch.n:
            result["normals"] = intrinsics.normals(parts.n[0].float(), batch.n[0], inside)
            predicted["normals"] = (parts.n, batch.label, batch.light)
        if parts.label is not None and parts.label is not batch.label:
            result["material"] = intrinsics.material(
                parts.label[0].float(), batch.label[0], self.ranges
            )
            predicted["material"] = (batch.n, parts.label, batch.light)
        if parts.light is not None and parts.light is not batch.light:
            key = ("light", id(parts.light))
            if key not in done:
                done[key] = intrinsics.light(
                    parts.light[0].float(), batch.light[0], batch.elevation
                )
            result["light"] = done[key]
            predicted["light"] = (batch.n, batch.label, parts.light)
        if parts.n is not None and parts.label is not None and parts.light is not None:
            predicted["all"] = (parts.n, parts.label, parts.light)
            predicted["all_true_light"] = (parts.n, parts.label, batch.light)
        for name, three in predicted.items():
            tensors = ("rendered", *map(id, three))
            if tensors not in done:
                done[tensors] = metrics.compare(
                    methods.render_by_layer(three[0], three[1], three[2], batch),
                    truth,
                    to_numpy(inside),
                    self.perceptual,
                )
            result[f"rendered_{name}"] = done[tensors]
        return result

    def _edit_row(self, edit: EditPair, batch: ExampleBatch, folder: str | None) -> dict:
        label, truth = pairs.target_label(self.records, edit), self.records.image(edit.truth)
        mask = to_numpy(batch.segments[0] > 0)
        truth = truth * mask[..., None]
        row: dict = {
            "id": edit.id,
            "commit": self.commit,
            "source": edit.source.id,
            "truth": edit.truth.id,
            "several": edit.per_segment,
            "methods": {},
        }
        row |= summary_of(edit.source) | {"wanted": list(edit.truth.materials)}
        shown = {}
        for method in self.methods.edits:
            picture = method.edit(batch, label)
            figures = metrics.compare(picture, truth, mask, self.perceptual)
            given = measure_with_truth(method, batch, label, truth, mask, figures["l2"])
            row["methods"][method.name] = figures | given
            shown[method.name] = picture
        alone = shown[self.methods.edits[-1].name]
        row["layer"] = self._measure_layer(edit, alone, mask)
        if folder is not None:
            gallery.write(Path(folder) / f"{edit.id}.png", batch, truth, shown, mask)
        return row

    def _measure_layer(self, edit: EditPair, picture: np.ndarray, mask: np.ndarray) -> dict:
        """Return the error of the layer's edit from true parts, beside the catalogue's node fit.

        The error is over the mask and away from edges; where the truth has a second seed, the
        figures of `against_nodes` are added.
        """
        sample, camera = self.records.load(edit.truth), edit.truth.camera
        pixel = 2 * camera.half_extent / max(camera.size)
        inner = (
            surface.inner(sample.n.numpy(), sample.segments.numpy(), sample.depth.numpy(), pixel)
            & mask
        )
        truth = sample.image.numpy()
        exposure = tone.auto_exposure(truth, mask)
        error = squared_difference(tone.display(picture, exposure), tone.display(truth, exposure))
        entries = [self.records.material(name) for name in edit.truth.materials]
        fits = [entry.errors.nodes_vs_label.display_l2 for entry in entries]
        result: dict = {
            "l2": float(error[mask].mean()),
            "l2_inner": float(error[inner].mean()) if inner.any() else None,
            "node_fit": float(np.mean([np.mean(fit) for fit in fits])) if all(fits) else None,
        }
        seeds = self.repeats[pairs.scene_key(edit.truth), edit.truth.materials]
        if len(seeds) > 1 and inner.any():
            if edit.truth.id not in self._against_nodes:  # two edits may share a truth
                pictures = np.stack([self.records.image(record) for record in seeds])
                self._against_nodes[edit.truth.id] = against_nodes(
                    sample, pictures, picture, inner, [e.mixture for e in entries], exposure
                )
            result |= {"seeds": len(seeds), "samples": seeds[0].samples} | self._against_nodes[
                edit.truth.id
            ]
        return result


def against_nodes(
    sample: Sample,
    pictures: np.ndarray,
    picture: np.ndarray,
    inner: np.ndarray,
    mixtures: Sequence[Mixture],
    exposure: float,
) -> dict[str, float]:
    """Return errors of Cycles' pictures against the layer's and against the nodes' closed form.

    pictures  (seeds, H, W, 3) of Cycles; picture (H, W, 3) of the layer: radiance
    inner     (H, W) bool: the pixels that are compared
    mixtures  of each segment: the nodes that Cycles rendered
    Returns   net_inner, display L2 net of noise, and net_error, its standard error over pixels;
              coarse, L2 between picture and an integral of tolerance FINE; and at FIT_PIXELS of the
              pixels fit_here, label against nodes, and rest, Cycles against nodes net of noise
    """
    with torch.no_grad():
        fine = (
            render(**sample.for_layer(), method=MEASURED.method, tolerance=FINE)[0].double().numpy()
        )
    right, shown = tone.display(pictures, exposure), tone.display(picture, exposure)
    net = squared_net_of_noise(right - shown)[inner]
    index = causes.sampled_pixels(inner, sample.record, FIT_PIXELS)
    here = fine.reshape(-1, 3)[index]
    nodes = tone.display(
        np.maximum(here - causes.node_difference(sample, index, mixtures), 0), exposure
    )
    return {
        "net_inner": float(net.mean()),
        "net_error": float(net.std() / np.sqrt(net.size)),
        "coarse": float(squared_difference(shown, tone.display(fine, exposure))[inner].mean()),
        "fit_here": float(squared_difference(tone.display(here, exposure), nodes).mean()),
        "rest": float(
            squared_net_of_noise(right.reshape(len(right), -1, 3)[:, index] - nodes).mean()
        ),
    }


def summary_of(record: Record) -> dict[str, object]:
    """Return what a row says of its picture."""
    keys = ("shape", "category", "viewpoint", "materials", "light", "rotation_texels", "split")
    return {key: getattr(record, key) for key in keys} | {"materials": list(record.materials)}


def measure_with_truth(
    method: methods.Method,
    batch: ExampleBatch,
    label: torch.Tensor,
    truth: np.ndarray,
    mask: np.ndarray,
    l2: float | None,
) -> dict[str, float | None]:
    """Return the edit's L2 with true light and with true normals; {} for methods without parts.

    l2  of the edit itself; where the part was given anyway, this is the result
    """
    parts = method.parts(batch)
    if (
        parts is None
        or parts.n is None
        or parts.light is None
        or isinstance(method, methods.MeanMaterial)
    ):
        return {}
    result = {"l2_true_light": l2, "l2_true_normals": l2}
    given = {
        "l2_true_light": (parts.n, batch.light, parts.light is batch.light),
        "l2_true_normals": (batch.n, parts.light, parts.n is batch.n),
    }
    for name, (n, light, same) in given.items():
        if not same:
            picture = methods.render_by_layer(n, label, light, batch)
            result[name] = metrics.display_l2(picture, truth, mask)
    return result


def summarise_refinement(refined: RefinementResult) -> dict[str, float | bool]:
    """Return a refinement's energies and time, and whether all of its parts are finite."""
    p = refined.prediction
    parts = (part for part in (p.n, p.label, p.light) if part is not None)
    finite = all(bool(torch.isfinite(part).all()) for part in parts)
    return {
        "before": refined.before["total"],
        "after": refined.after["total"],
        "seconds": refined.seconds,
        "finite": finite,
    }
