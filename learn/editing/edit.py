"""What `learn edit` does: decompose a photograph, and render its object in other materials.

`run` does everything: `make_edits` makes the edits, learn.editing.drawing draws the contact sheet,
and learn.editing.edit_files writes the files.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from learn.data import pairs
from learn.editing import decomposition, edit_files, interactive, photograph, region_masks, targets
from learn.editing.compositor import Compositor
from learn.editing.decomposition import Decomposition
from learn.editing.photograph import Photograph
from learn.networks import weights as checkpoint
from learn.refinement import RefinementSettings
from manifests.errors import InputError
from manifests.progress import tqdm


@dataclass(frozen=True)
class EditOptions:
    """How pictures are decomposed and edited.

    weights     file of the network's weights
    refinement  its settings; None: do not refine
    tolerance   largest relative error of the rendering layer
    detail      share of the photograph's residual shading that edits keep, 0 to 1
    exposure    factor by which the photograph's radiance, after white balance, is multiplied for
                the network; None: estimated
    balance     "none", "grey", or three factors by which colours are multiplied
    device      where the network, refinement and the layer run, as torch.device takes it
    fit_mask    whether to fit the edges of masks to the photographs' colours; None: only those of
                black and white masks
    shape       of the photograph's object, one of learn.primitives.PRIMITIVES; None: predicted
    stops       by which edits are made brighter, MOST_STOPS at most
    """

    weights: Path
    refinement: RefinementSettings | None
    tolerance: float
    detail: float
    exposure: float | None = None
    balance: str | Sequence[float] = "none"
    device: str | torch.device = "cpu"
    fit_mask: bool | None = None
    shape: str | None = None
    stops: float = 0.0

    def as_metadata(self) -> dict[str, object]:
        """Return the options that edit.json and transfer.json record."""
        return {
            "weights": Path(self.weights).name,
            "tolerance": self.tolerance,
            "detail": self.detail,
            "fit_mask": self.fit_mask,
            "shape": self.shape,
            "refinement": None if self.refinement is None else asdict(self.refinement),
        }


@dataclass(frozen=True)
class Edit:
    """An edited photograph.

    text     the target material as the user named it
    labels   label (108,) of each region, or None for a region that stays as it is
    picture  (H, W, 3) linear: the edited photograph
    truth    (H, W, 3) linear: a data set's own rendering of the same edit; None if there is none
    """

    text: str
    labels: list[np.ndarray | None]
    picture: np.ndarray
    truth: np.ndarray | None


@dataclass(frozen=True)
class EditResult:
    """What `learn edit` computes.

    decomposition  the photograph's normals, light and material
    rendering      (H, W, 3) linear: the photograph with its object rendered from these
    edits          in the order of the requested materials
    metadata       what the file of the network's weights says about them
    """

    decomposition: Decomposition
    rendering: np.ndarray
    edits: list[Edit]
    metadata: dict


def run(
    path: Path,
    masks: Sequence[Path],
    regions: Path | None,
    materials: Sequence[str],
    out: Path,
    edit_options: EditOptions,
    record: str | None = None,
    overwrite: bool = False,
    with_page: bool = False,
) -> dict:
    """Edit a photograph, write all results into the folder `out`, and return edit.json.

    path       the photograph, a data set's folder, or "example:espresso-cup"
    masks      files; each of several masks is a region of its own
    regions    a file with one value for each region, or None
    materials  target materials as `learn.editing.targets` reads them; "A+B" names one per region
    record     id of the record to edit if `path` is a data set
    overwrite  whether to replace the results of an earlier run
    with_page  whether to write the page of learn.editing.interactive as well
    Raises     InputError
    """
    out = Path(out)
    parts = [part for text in materials for part in targets.split_by_region(text)]
    inputs: list[str | Path] = [path, *masks, *([regions] if regions else []), *parts]
    pages = [interactive.NAME] if with_page else []
    names = edit_files.reserve_names(path, materials, inputs, out, overwrite, pages)
    network, metadata = checkpoint.load_full_network(edit_options.weights, edit_options.device)
    opened = photograph.open_photograph(
        path,
        masks,
        regions,
        edit_options.balance,
        edit_options.exposure,
        record,
        targets=parts,
        fit_mask=edit_options.fit_mask,
    )
    labels = requested_labels(opened, materials, network, metadata["size"], edit_options)
    with tqdm(total=2 + len(materials), unit="step", desc="decomposing") as progress:
        result = make_edits(opened, labels, network, metadata, edit_options, progress)
        progress.set_description("writing")
        texts = {name: interactive.make_page(result, edit_options) for name in pages}
        report = edit_files.write(
            out, names, result, edit_options, texts, inputs if overwrite else None
        )
        progress.update()
    return report


def make_edits(
    opened: Photograph,
    labels: Mapping[str, list[np.ndarray | None]],
    network: torch.nn.Module,
    metadata: dict,
    edit_options: EditOptions,
    progress: tqdm,
) -> EditResult:
    """Decompose a photograph and return its edits.

    labels    {target material as the user named it: label (108,) or None of each region}
    progress  a bar that is advanced by one for the decomposition and for each edit
    """
    result = decomposition.decompose(
        opened, network, metadata["size"], edit_options.refinement, shape=edit_options.shape
    )
    progress.update()
    compositor = Compositor(result, edit_options.tolerance, edit_options.detail)
    edits = []
    for text, each in labels.items():
        progress.set_description(text[:24])
        read = targets.labels_from_pictures(text, each)
        edited = compositor.edit(each, read, edit_options.stops)
        edits.append(Edit(text, each, edited, find_truth(opened, text)))
        progress.update()
    return EditResult(result, compositor.render_again(), edits, metadata)


def requested_labels(
    opened: Photograph,
    materials: Sequence[str],
    network: torch.nn.Module,
    size: int,
    edit_options: EditOptions,
) -> dict[str, list[np.ndarray | None]]:
    """Return {text: label (108,) or None of each region} for the materials that a user named."""
    known = {}
    if opened.records is not None:
        known = {name: opened.records.label(name) for name in opened.records.materials}

    def of_picture(path: Path) -> np.ndarray:
        return read_label_from_picture(path, network, size, edit_options)

    return {text: labels_by_region(text, opened.count, of_picture, known) for text in materials}


def labels_by_region(
    text: str,
    regions: int,
    of_picture: Callable[[Path], np.ndarray],
    known: Mapping[str, np.ndarray] | None = None,
) -> list[np.ndarray | None]:
    """Return the label (108,) that a text requests for each region; None leaves a region alone.

    regions            number of the object's regions
    of_picture, known  see learn.editing.targets.resolve_labels
    Raises             InputError if the text names neither one material nor one for each region
    """
    parts = [
        targets.resolve_labels(part, of_picture, known) for part in targets.split_by_region(text)
    ]
    if len(parts) == 1 and parts[0] is not None and len(parts[0]) > 1:
        parts = [part[None] for part in parts[0]]
    if several := next((len(part) for part in parts if part is not None and len(part) > 1), None):
        remedy = "name such a file alone, or keep one of its labels"
        raise InputError(
            f"--material {text}", "files of one material beside +", f"{several}", remedy
        )
    if len(parts) not in (1, regions):
        rule = "one material"
        remedy = "give regions with --regions, or several --mask"
        if regions > 1:
            rule += f", or {regions}: one for each region"
            remedy = "keep leaves a region as it is"
        raise InputError(f"--material {text}", rule, f"{len(parts)}", remedy)
    labels = [None if part is None else part[0] for part in parts]
    return labels if len(labels) > 1 else labels * regions


def read_label_from_picture(
    path: Path, network: torch.nn.Module, size: int, edit_options: EditOptions
) -> np.ndarray:
    """Return the label (1, 108) of the object in another picture.

    Its mask is its transparency, or NAME.mask.png in the same folder. The exposure and the factors
    of white balance that a user gave belong to the photograph that is edited. They do not apply to
    this picture: its exposure is estimated, and its colours are left as they are. Whether its
    mask's edge is fitted, if it has a mask, is as for the photograph.
    """
    beside = region_masks.find_mask_beside(path)
    balance = "grey" if edit_options.balance == "grey" else "none"
    opened = photograph.open_photograph(
        path,
        [beside] if beside else [],
        None,
        balance,
        remedy=f"put {path.stem}.mask.png beside it",
        fit_mask=edit_options.fit_mask if beside else None,
    )
    return decomposition.decompose(opened, network, size, edit_options.refinement).label[:1]


def find_truth(opened: Photograph, text: str) -> np.ndarray | None:
    """Return a data set's rendering (H, W, 3) of an edit; None if it has none.

    It is the picture of a record that shows the same scene in the materials that the text requests.
    """
    record, records = opened.record, opened.records
    if record is None or records is None:
        return None
    names = [targets.measured_name(part) or part for part in targets.split_by_region(text)]
    names = names * len(record.materials) if len(names) == 1 else names
    # segments that the camera does not see have no part in the text
    requested = tuple(
        own if name == targets.KEEP else name
        for name, own in zip(names, record.materials, strict=False)
    )
    same = (
        other
        for other in records.records
        if pairs.scene_key(other) == pairs.scene_key(record)
        and other.materials[: len(requested)] == requested
    )
    return next((records.image(other) for other in same), None)
