"""One source picture at work: every method takes it apart, makes the edits asked of it, and is
compared with the truth.

A row of figures is plain JSON: {"methods": {name: {group: {figure: value}}}, …}. What a method does
not do is left out of its row.
"""

import functools
from pathlib import Path

import numpy as np
import torch

from learn.agreement import causes, surface
from learn.data import pairs
from learn.data.devices import array
from learn.data.records import Records
from learn.evaluation import gallery, methods
from learn.layer import render
from learn.metrics import intrinsics
from learn.metrics import lpips as perceptual
from learn.metrics import pictures as metrics
from learn.metrics.pictures import shared, squared
from learn.networks import weights as checkpoint
from manifests.errors import InputError
from manifests.provenance import provenance
from shaders import tone

# of a truth, at which label and nodes are compared: 2 s on one thread, 9 where 65,536 taps are
# needed
FIT_PIXELS = causes.PIXELS
FINE = 1e-3  # tolerance of the layer's own integral where the nodes' is made from it


class Bench:
    """Records, methods and their weights, once a process.

    data, weights, baselines, lpips   paths; the last two may be None
    refine                            whether refined rows are made
    materials                         whose training materials the mean material is of, "dataset" or
    "built-in"
    device                            of networks, refinement and the layer
    """

    def __init__(
        self,
        data,
        weights,
        baselines=None,
        refine=True,
        lpips=None,
        materials="dataset",
        device="cpu",
    ):
        self.records = Records(data)
        self.repeats, self._judged = pairs.repeats(self.records.records), {}
        net, metadata = checkpoint.load_parts(weights, device)
        self.device = torch.device(device)
        self.commit = provenance()["commit"]
        self.size, self.ranges, self.perceptual = (
            metadata["size"],
            net.ranges,
            perceptual.of_file(lpips),
        )
        if refine:
            from learn.refinement import refine as of_any

            work = functools.partial(of_any, labels=net.training_labels)
        labels = methods.training_labels(self.records, materials)
        self.entrants = methods.entrants(
            net, work if refine else None, labels, baselines, self.device
        )

    def work(self, first, edits, whole, folder=None):
        """(row of the source picture or None, [row of each edit]).

        first   an Edit of the source picture
        edits   Edits of it that are to be made; may be none
        whole   whether the source's own row is wanted
        folder  where pictures of the edits go, or None: no pictures
        """
        batch = pairs.shown(self.records, first).to(self.device)
        if batch.image.shape[-2:] != (self.size, self.size):
            result = f"{batch.image.shape[-1]} × {batch.image.shape[-2]}"
            raise InputError(
                self.records.folder,
                f"pictures of {self.size} × {self.size} pixels, as the weights were trained",
                result,
                "render again",
            )
        return self._decompose(first.source, batch) if whole else None, [
            self._edited(edit, batch, folder) for edit in edits
        ]

    def _decompose(self, record, batch):
        truth = array(batch.image[0].movedim(0, -1))
        row = {"id": record.id, "commit": self.commit, "methods": {}} | summary_of(record)
        done = {}  # many methods share a part: what was measured of it once is not measured again
        for method in (*self.entrants.edits, *self.entrants.parts):
            parts = method.parts(batch)
            if parts is None:
                continue
            row["methods"][method.name] = self._parts(parts, batch, truth, done)
            if isinstance(method, methods.Refined):
                row["methods"][method.name]["refinement"] = refinement(method.refined)
        return row

    def _parts(self, parts, batch, truth, done):
        """The figures of a Prediction; what was given to the method, or is not told apart by it, is
        left out.

        done  {what and of which tensors: figures} of earlier methods, added to
        """
        inside = batch.segments[0] > 0
        result, predicted = {}, {}
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
            key = ("rendered", *map(id, three))
            if key not in done:
                done[key] = metrics.compare(
                    methods.rendered(*three, batch), truth, array(inside), self.perceptual
                )
            result[f"rendered_{name}"] = done[key]
        return result

    def _edited(self, edit, batch, folder):
        label, truth = pairs.target_label(self.records, edit), self.records.image(edit.truth)
        mask = array(batch.segments[0] > 0)
        truth = truth * mask[..., None]
        row = {
            "id": edit.id,
            "commit": self.commit,
            "source": edit.source.id,
            "truth": edit.truth.id,
            "several": edit.several,
            "methods": {},
        }
        row |= summary_of(edit.source) | {"wanted": list(edit.truth.materials)}
        shown = {}
        for method in self.entrants.edits:
            picture = method.edit(batch, label)
            figures = metrics.compare(picture, truth, mask, self.perceptual)
            figures |= with_truth(method, batch, label, truth, mask, figures["l2"])
            row["methods"][method.name] = figures
            shown[method.name] = picture
        alone = shown[self.entrants.edits[-1].name]
        row["layer"] = self._layer(edit, alone, mask)
        if folder is not None:
            gallery.write(Path(folder) / f"{edit.id}.png", batch, truth, shown, mask)
        return row

    def _layer(self, edit, picture, mask):
        """How far the layer's edit from true parts is off, over the mask and away from edges, and
        what the catalogue says of its nodes.

        With a second seed of the truth: what `against_nodes` finds.
        """
        sample, camera = self.records.load(edit.truth), edit.truth.camera
        pixel = 2 * camera.half_extent / max(camera.size)
        inner = (
            surface.inner(sample.n.numpy(), sample.segments.numpy(), sample.depth.numpy(), pixel)
            & mask
        )
        truth = sample.image.numpy()
        exposure = tone.auto_exposure(truth, mask)
        error = squared(tone.display(picture, exposure), tone.display(truth, exposure))
        entries = [self.records.material(name) for name in edit.truth.materials]
        fits = [entry.errors.nodes_vs_label.display_l2 for entry in entries]
        result = {
            "l2": float(error[mask].mean()),
            "l2_inner": float(error[inner].mean()) if inner.any() else None,
            "node_fit": float(np.mean([np.mean(fit) for fit in fits])) if all(fits) else None,
        }
        seeds = self.repeats[pairs.scene(edit.truth), edit.truth.materials]
        if len(seeds) > 1 and inner.any():
            if edit.truth.id not in self._judged:  # two edits may share a truth
                pictures = np.stack([self.records.image(record) for record in seeds])
                self._judged[edit.truth.id] = against_nodes(
                    sample, pictures, picture, inner, [e.mixture for e in entries], exposure
                )
            result |= {"seeds": len(seeds), "samples": seeds[0].samples} | self._judged[
                edit.truth.id
            ]
        return result


def against_nodes(sample, pictures, picture, inner, mixtures, exposure):
    """Cycles' pictures of several seeds against the layer's, and against the nodes that Cycles was
    given, inside and net of noise.

    pictures (seeds, H, W, 3) of Cycles, picture (H, W, 3) of the layer: radiance; inner (H, W)
    bool; mixtures: of each segment Returns net_inner, display L2 less noise, and its standard error
    over pixels; coarse, L2 between picture and an integral of tolerance
            FINE; at FIT_PIXELS of them fit_here, label against nodes, and rest, Cycles against
            nodes less noise
    """
    with torch.no_grad():
        fine = (
            render(**sample.for_layer(), method=methods.METHOD, tolerance=FINE)[0].double().numpy()
        )
    right, shown = tone.display(pictures, exposure), tone.display(picture, exposure)
    net = shared(right - shown)[inner]
    index = causes.drawn(inner, sample.record, FIT_PIXELS)
    here = fine.reshape(-1, 3)[index]
    nodes = tone.display(
        np.maximum(here - causes.node_difference(sample, index, mixtures), 0), exposure
    )
    return {
        "net_inner": float(net.mean()),
        "net_error": float(net.std() / np.sqrt(net.size)),
        "coarse": float(squared(shown, tone.display(fine, exposure))[inner].mean()),
        "fit_here": float(squared(tone.display(here, exposure), nodes).mean()),
        "rest": float(shared(right.reshape(len(right), -1, 3)[:, index] - nodes).mean()),
    }


def summary_of(record):
    """What a row says of its picture."""
    r = record
    return {
        "shape": r.shape,
        "category": r.category,
        "viewpoint": r.viewpoint,
        "materials": list(r.materials),
        "light": r.light,
        "rotation_texels": r.rotation_texels,
        "split": r.split,
    }


def with_truth(method, batch, label, truth, mask, l2):
    """{"l2_true_light", "l2_true_normals"}: the edit's L2 were one of the two not predicted but
    given; {} for methods without parts.

    l2  of the edit itself, which it is where the part was given anyway
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
    if parts.light is not batch.light:
        result["l2_true_light"] = metrics.display_l2(
            methods.rendered(parts.n, label, batch.light, batch), truth, mask
        )
    if parts.n is not batch.n:
        result["l2_true_normals"] = metrics.display_l2(
            methods.rendered(batch.n, label, parts.light, batch), truth, mask
        )
    return result


def refinement(refined):
    """Energies, time, and whether all that came out is finite."""
    p = refined.prediction
    finite = all(bool(torch.isfinite(x).all()) for x in (p.n, p.label, p.light))
    return {
        "before": refined.before["total"],
        "after": refined.after["total"],
        "seconds": refined.seconds,
        "finite": finite,
    }
