"""`learn edit`: one photograph, its object in other materials, and everything that was found on the
way.
"""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from learn.data import pairs, photographs
from learn.data.devices import array
from learn.editing import decomposition, photograph, targets
from learn.editing import predict as prediction
from learn.figures import montage
from learn.networks import weights as checkpoint
from manifests import files
from manifests.errors import InputError
from shaders import tone

TILE, BALL = 224, 128
PARTS = (
    "normals.exr",
    "normals.png",
    "light.exr",
    "light.png",
    "rendering.png",
    "material.json",
    "ball.png",
    "reflectance.png",
)


@dataclass(frozen=True)
class EditOptions:
    """weights: a file; settings: of refinement, None for none; tolerance: of the layer; detail:
    learn.editing.decomposition.Painter's.

    exposure  factor from a photograph's radiance, balanced, to the network's; None: guessed
    balance   "none", "grey", or three factors by which colours are multiplied
    device    of the network, refinement and the layer: as torch.device takes it
    """

    weights: Path
    settings: object
    tolerance: float
    detail: float
    exposure: float | None = None
    balance: object = "none"
    device: object = "cpu"

    def as_metadata(self):
        """What a result's JSON says of it."""
        refined = None if self.settings is None else asdict(self.settings)
        return {
            "weights": Path(self.weights).name,
            "tolerance": self.tolerance,
            "detail": self.detail,
            "refinement": refined,
        }


def run(path, masks, regions, materials, out, edit_options, record=None, overwrite=False):
    """Write the edits and all beside them into the folder `out`.

    materials  texts as `learn.editing.targets` reads them; "A+B" gives region 1 and 2 their own
    Returns    what edit.json holds
    Raises     InputError
    """
    out = Path(out)
    names = (
        ["edited"]
        if len(materials) == 1
        else [f"edited-{targets.file_name(text)}" for text in materials]
    )
    if len(set(materials)) < len(materials):
        raise InputError(
            "--material", "materials of different names", ", ".join(materials), "name each once"
        )
    names = [
        name if names.count(name) == 1 else f"{name}-{number}"
        for number, name in enumerate(names, 1)
    ]
    inputs = [path, *masks, *([regions] if regions else []), *materials]
    endings = (
        (".png", ".exr")
        if Path(path).is_dir() or Path(path).suffix.lower() == ".exr"
        else (".png",)
    )
    files.reserve_outputs(
        out,
        [
            *PARTS,
            "sheet.png",
            "edit.json",
            *(name + ending for name in names for ending in endings),
        ],
        overwrite,
        inputs,
    )
    network, metadata = checkpoint.load_parts(edit_options.weights, edit_options.device)
    size = metadata["size"]
    opened = photograph.opened(
        path, masks, regions, edit_options.balance, edit_options.exposure, record
    )
    known = (
        {}
        if opened.records is None
        else {name: opened.records.label(name) for name in opened.records.materials}
    )
    pick = {
        text: choices(
            text, opened.count, lambda other: material_of(other, network, size, edit_options), known
        )
        for text in materials
    }
    with tqdm(total=2 + len(materials), unit="step", desc="taking apart") as progress:
        result = decomposition.decompose(opened, network, size, edit_options.settings)
        progress.update()
        painter = decomposition.Painter(result, edit_options.tolerance, edit_options.detail)
        edits = {}
        for text in materials:
            progress.set_description(text[:24])
            edits[text] = painter.edited(pick[text])
            progress.update()
        progress.set_description("writing")
        out.mkdir(parents=True, exist_ok=True)
        with files.transaction():
            report = written(out, result, painter, edits, pick, names, metadata, edit_options)
        progress.update()
    return report


def choices(text, regions, predict, known=None):
    """Labels a region, each (108,) or None, that a text asks for; `predict`, `known` as
    learn.editing.targets.label_of has them.
    """
    parts = [targets.label_of(part, predict, known) for part in targets.parts_of(text)]
    if len(parts) == 1 and parts[0] is not None and len(parts[0]) > 1:
        parts = [part[None] for part in parts[0]]
    if len(parts) not in (1, regions):
        raise InputError(
            f"--material {text}",
            f"one material, or {regions}: one a region",
            f"{len(parts)}",
            "keep leaves a region as it is",
        )
    labels = [None if part is None else part[0] for part in parts]
    return labels if len(labels) > 1 else labels * regions


def material_of(path, network, size, edit_options):
    """(1, 108) of the object in another picture; its mask is its transparency, or NAME.mask.png
    beside it.

    Exposure and white balance by factors are the photograph's own; this one's exposure is guessed,
    its colours are as they are.
    """
    beside, balance = mask_beside(path), "grey" if edit_options.balance == "grey" else "none"
    opened = photograph.opened(
        path,
        [beside] if beside else [],
        None,
        balance,
        remedy=f"put {path.stem}.mask.png beside it",
    )
    return array(
        decomposition.decompose(opened, network, size, edit_options.settings)
        .parts.label[0, :1]
        .float()
    )


def mask_beside(path, folder=None):
    """The mask of a picture: NAME.mask.png beside it, or NAME.mask.png, NAME.png in a folder of
    masks; None if there is none.
    """
    path = Path(path)
    tried = [path.with_name(f"{path.stem}.mask.png")]
    if folder is not None:
        tried = [Path(folder) / f"{path.stem}{ending}" for ending in (".mask.png", ".png")]
    return next(
        (file for file in tried if file.is_file() and not (path.is_file() and file.samefile(path))),
        None,
    )


def written(out, found, painter, edits, pick, names, metadata, edit_options):
    """Writes every file; returns what edit.json holds."""
    opened, parts = found.photograph, found.parts
    mask = found.framed.mask
    n, L = array(parts.n[0].movedim(0, -1)) * mask[..., None], array(parts.light[0].movedim(0, -1))
    photographs.write_exr(out / "normals.exr", n, "XYZ")
    photographs.write_exr(out / "light.exr", L)
    save(out / "normals.png", montage.normals(n, mask))
    save(out / "light.png", montage.light(L))
    again = painter.rendered_again()
    shown = exposure_of(opened)
    save(out / "rendering.png", tone.display(again, shown))
    save(out / "ball.png", material_sphere(parts.label[0, 0], found))
    save(out / "reflectance.png", montage.rows([reflectance(found)], TILE))
    prediction.write_material(
        out / "material.json", array(parts.label[0]), found.framed, metadata, edit_options.weights
    )
    for name, edited in zip(names, edits.values(), strict=True):
        picture = tone.display(edited, shown)
        save(out / f"{name}.png", with_alpha(picture, opened))
        if opened.linear:
            photographs.write_exr(out / f"{name}.exr", edited)
    truths = {text: truth(opened, text) for text in edits} if opened.record is not None else {}
    save(out / "sheet.png", montage.rows(lines(found, again, edits, pick, truths, shown), TILE))
    report = {
        "photograph": opened.name,
        "size": opened.mask.shape,
        "materials": list(edits),
        "exposure": found.framed.exposure,
        "white_balance": [float(x) for x in opened.balance],
        "regions": opened.count,
        "refined": (
            None
            if found.refined is None
            else {"before": found.refined.before, "after": found.refined.after}
        ),
        "display_l2": {
            text: errors(edits[text], true, opened.mask)
            for text, true in truths.items()
            if true is not None
        },
    } | edit_options.as_metadata()
    files.write_json(out / "edit.json", report)
    return report


def exposure_of(opened):
    """1 for a photograph, whose values are a display's already; of radiance from a renderer the one
    that shows the object well.
    """
    scene = opened.record is not None or opened.radiance.max() > 1.001
    return tone.auto_exposure(opened.radiance, opened.mask) if scene else 1.0


def with_alpha(picture, opened):
    """Display values (H, W, 3), or (H, W, 4) where the Photograph `opened` is transparent
    somewhere.
    """
    return (
        picture
        if opened.opacity is None
        else np.concatenate([picture, 255.0 * opened.opacity[..., None]], -1)
    )


def on_ground(picture, opened):
    """Display values (H, W, 3) as a sheet shows them: what is transparent in the Photograph
    `opened` is not there.
    """
    return (
        picture
        if opened.opacity is None
        else montage.GROUND + (picture - montage.GROUND) * opened.opacity[..., None]
    )


def save(path, picture):
    """A PNG of display values (H, W, 3 or 4). Raises InputError for what is not finite."""
    photographs.require_finite(path, picture)
    files.write_image(path, np.clip(np.rint(picture), 0, 255).astype(np.uint8), "PNG")


def material_sphere(label, found, size=BALL):
    """Display picture (size, size, 3) of a sphere in the material `label` (108,), under a plain
    light.

    found  Decomposition whose camera it is seen by
    """
    return montage.material_sphere(
        label, montage.preview_lighting(), size, found.batch.elevation, 0.8
    )


def reflectance(found):
    """Captions and spheres of the first region: what the picture shows, what was predicted, what
    refinement made of it.
    """
    first, elevation = array(found.batch.segments[0]) == 1, found.batch.elevation
    mask = first if first.any() else found.framed.mask  # too small to be seen at the network's size
    bright = tone.auto_exposure(found.framed.radiance, mask)
    n = array(found.parts.n[0].movedim(0, -1))
    what = "reflectance map" if found.photograph.count == 1 else "reflectance map 1"
    tiles = [(f"{what}, observed", montage.observed(found.framed.radiance, n, mask, TILE, bright))]
    stages = [("predicted", found.start)] + (
        [("refined", found.refined.prediction)] if found.refined else []
    )
    for name, p in stages:
        light = p.light[0].movedim(0, -1)
        tiles.append(
            (
                f"{what}, {name}",
                montage.material_sphere(p.label[0, 0], light, BALL, elevation, bright),
            )
        )
    return tiles


def lines(found, again, edits, pick, truths, shown):
    """The sheet's rows: before and after, the parts, the reflectance map; and edits beside their
    truth where there is one.
    """
    opened, parts = found.photograph, found.parts
    mask = found.framed.mask
    n = array(parts.n[0].movedim(0, -1))

    def display(picture, level):
        return on_ground(tone.display(picture, level), opened)

    first = [
        ("photograph", display(opened.radiance, shown)),
        ("rendered again", display(again, shown)),
    ]
    first += [
        ("normals", montage.normals(n, mask)),
        ("light", montage.light(array(parts.light[0].movedim(0, -1)))),
    ]
    several = opened.count > 1
    first += [
        (f"material {s}" if several else "material", material_sphere(label, found))
        for s, label in enumerate(parts.label[0], 1)
    ]
    out = [first, reflectance(found)]
    for text, edited in edits.items():
        names = (
            targets.parts_of(text)
            if len(targets.parts_of(text)) == len(pick[text])
            else [text] * len(pick[text])
        )
        balls = {
            targets.caption_of(name): material_sphere(label, found)
            for name, label in zip(names, pick[text], strict=True)
            if label is not None
        }
        line = [
            ("photograph", first[0][1]),
            (targets.caption_of(text), display(edited, shown)),
            *balls.items(),
        ]
        true = truths.get(text)
        if true is not None:
            level = tone.auto_exposure(true, opened.mask)
            line[1] = (line[1][0], display(edited, level))
            line += [
                ("truth", display(true, level)),
                ("|difference|", abs(tone.display(edited, level) - tone.display(true, level))),
            ]
        out.append(line)
    return out


def truth(opened, text):
    """(H, W, 3) of the record of the same scene in the materials that a text asks for, or None
    where the dataset has none.
    """
    record, names = opened.record, targets.parts_of(text)
    names = names * len(record.materials) if len(names) == 1 else names
    # hidden ones unasked
    asked = tuple(
        own if name == targets.KEEP else name
        for name, own in zip(names, record.materials, strict=False)
    )
    same = (
        r
        for r in opened.records.records
        if pairs.scene(r) == pairs.scene(record) and r.materials[: len(asked)] == asked
    )
    return next((opened.records.image(other) for other in same), None)


def errors(edited, true, mask):
    """The paper's L2 over mask and full frame."""
    level = tone.auto_exposure(true, mask)
    return {
        "mask": float(tone.display_l2(edited, true, level, mask)),
        "frame": float(tone.display_l2(edited, true, level)),
    }
