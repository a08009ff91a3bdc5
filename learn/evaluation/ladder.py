"""`learn evaluate-ladder`: weights on every rung of the ladder, from direct light to a photograph.

OUT/settings.json     what the figures depend on; a folder made with other settings is refused
OUT/lines.jsonl       one line per scene and rung, written as soon as it is measured
OUT/report.json, report.md, chart.png

The same command continues a stopped run, and a larger --scenes or --refined adds to it.
"""

import functools
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np
import torch
from msgspec import Struct, to_builtins

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.records import Records
from learn.data.seen import DIGITS, label_hash, map_hash
from learn.editing.decomposition import Parts, require_parts
from learn.evaluation import ladder_design, ladder_report, methods, overlap
from learn.evaluation.ladder_design import RUNGS, Rung, Scene
from learn.evaluation.ladder_pictures import Shown, shown
from learn.evaluation.rows import Figure
from learn.layer.predictions import MEASURED
from learn.metrics.pictures import aligned, display_l2
from learn.metrics.radiometry import irradiance_error
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings, refine
from manifests import files, lock, outputs, ray_tasks
from manifests.cached_store import open_store
from manifests.line_files import Lines
from manifests.progress import tqdm
from manifests.provenance import provenance
from manifests.store import file_hash


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


# a scene, the name of a rung, and whether it is refined too
Piece = tuple[Scene, str, bool]


@dataclass(frozen=True)
class Options:
    """What is evaluated.

    data, weights, out  paths
    side                one of ladder_design.SIDES
    scenes              number of scenes per group, None: all
    refined             number of scenes per group that are refined on every rung
    rungs               names of the rungs that are measured, of those that the side has
    allow_overlap       whether pictures are measured that show what the weights saw in training
    incomplete          whether scenes are measured although others were not rendered
    ray                 address of a Ray cluster whose CPUs measure; None: this process does
    """

    data: Path
    weights: Path
    out: Path
    side: str = "development"
    scenes: int | None = None
    refined: int = 0
    device: str = "cpu"
    allow_overlap: bool = False
    incomplete: bool = False
    ray: str | None = None
    rungs: Sequence[str] = tuple(rung.name for rung in RUNGS)

    @property
    def measured_rungs(self) -> tuple[Rung, ...]:
        """The rungs that are measured, in the order of the ladder."""
        of_side = ladder_design.rungs_of(ladder_design.preset(self.side))
        return tuple(rung for rung in of_side if rung.name in self.rungs)


def write_jobs(
    side: str, folder: Path, meshes: Path | None = None, count: int = 6
) -> dict[str, Path]:
    """Write the jobs that render a side into a folder, and return {name: path}.

    meshes  a folder of outside meshes, of which `count` are used, or None
    """
    names = [] if meshes is None else ladder_design.outside_meshes(meshes, count)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    result = {}
    with files.transaction():
        for name, job in ladder_design.jobs(ladder_design.preset(side), names).items():
            result[name] = folder / f"{name}.json"
            files.write_json(result[name], to_builtins(job))
    return result


def make(options: Options) -> dict:
    """Measure what is missing, write the report and return it. Raises InputError."""
    records, out = Records(options.data), Path(options.out)
    job = ladder_design.preset(options.side)
    there = ladder_design.scenes(records.records, job, options.incomplete, options.measured_rungs)
    scenes = per_group(there, options.scenes)
    to_refine = {scene.id for scene in per_group(scenes, options.refined)}
    with lock.writing(out, patience=0):
        bench = Bench(records, options.weights, options.device)
        seen = overlap.sentences(
            [options.weights], tested(records, scenes), options.data, options.allow_overlap
        )
        outputs.pin_settings(out / "settings.json", settings(options))
        measure(options, bench, scenes, to_refine)
        used = {scene.id for scene in scenes}
        lines = [
            line
            for line in rows_of(out).values()
            if line["scene"] in used and line["rung"] in options.rungs
        ]
        about = {
            "made": provenance(),
            "side": options.side,
            "job": to_builtins(job),
            "weights": file_hash(options.weights)[:12],
            "weights_name": Path(options.weights).name,
            "seen": seen,
            "designed": ladder_design.designed_scenes(job),
            "outside": sum(scene.group == ladder_design.OUTSIDE_GROUP for scene in scenes),
        }
        return ladder_report.write(out, lines, about)


def per_group(scenes: Sequence[Scene], count: int | None) -> list[Scene]:
    """Return the first `count` scenes of each group in their order; None: all."""
    seen: dict[str, int] = {}
    result = []
    for scene in scenes:
        seen[scene.group] = seen.get(scene.group, 0) + 1
        if count is None or seen[scene.group] <= count:
            result.append(scene)
    return result


def tested(records: Records, scenes: Sequence[Scene]) -> overlap.Tested:
    """Return what the scenes show, targets included, as {kind: {hash: name}}."""
    pictures = [
        record for scene in scenes for of in (scene.source, scene.truth) for record in of.values()
    ]
    materials = {name for record in pictures for name in record.materials}
    return {
        "shapes": {record.shape_hash[:DIGITS]: record.shape for record in pictures},
        "materials": {label_hash(records.label(name)): name for name in sorted(materials)},
        "lights": {
            map_hash(records.light(name)): name
            for name in sorted({record.light for record in pictures})
        },
    }


def settings(options: Options) -> dict:
    """Return what a line's figures depend on; files count by their bytes."""
    result = {
        "data": file_hash(open_store(options.data).fetch("materials.json")),
        "weights": file_hash(options.weights),
        "side": options.side,
        "refine": asdict(RefinementSettings()),
        "tolerance": MEASURED.tolerance,
    }
    kind = torch.device(options.device).type
    return result if kind == "cpu" else result | {"device": kind}


def rows_of(out: Path) -> dict[str, dict]:
    """Return {id: line} of the measured lines; of two of one id the later one counts."""
    return {row["id"]: row for row in outputs.read_lines(Path(out) / "lines.jsonl", Line)}


def measure(options: Options, bench: "Bench", scenes: Sequence[Scene], to_refine: set[str]) -> None:
    """Measure every scene on every rung that has no line yet, or one without refinement.

    to_refine  ids of the scenes that are refined
    """
    done = rows_of(options.out)

    def finished(scene: Scene, rung: Rung) -> bool:
        line = done.get(f"{scene.id}-{rung.name}")
        return line is not None and (scene.id not in to_refine or line["refined"] is not None)

    todo = [
        (scene, rung.name, scene.id in to_refine)
        for scene in scenes
        for rung in options.measured_rungs
        if not finished(scene, rung)
    ]
    with closing(Lines(Path(options.out) / "lines.jsonl")) as lines:
        measured = _lines(options, bench, todo)
        with closing(measured), tqdm(total=len(todo), unit="edit", disable=None) as bar:
            for line in measured:
                lines.append(line)
                bar.update()


def _lines(options: Options, bench: "Bench", todo: Sequence[Piece]) -> Generator[Line, None, None]:
    """Yield the lines, in the order they are finished."""
    if options.ray is None:
        for piece in todo:
            yield bench.line(*piece)
    elif todo:
        settings = {"data": options.data, "weights": options.weights, "device": options.device}
        maker = f"{__name__}:on_worker"
        with closing(ray_tasks.results(options.ray, maker, settings, todo)) as answers:
            for _, answer in answers:
                yield msgspec.json.decode(answer, type=Line)


def on_worker(settings: bytes) -> ray_tasks.Work:
    """Return what a worker of a Ray cluster does: a Piece as JSON → its Line as JSON.

    settings  of Bench, as JSON
    """
    torch.set_num_threads(1)
    given = msgspec.json.decode(settings)
    bench = Bench(Records(given.pop("data")), **given)

    def work(piece: bytes) -> bytes:
        return msgspec.json.encode(bench.line(*msgspec.json.decode(piece, type=Piece)))

    return work


class Bench:
    """Records and a network, which measure scenes.

    Raises  InputError for unusable weights
    """

    def __init__(self, records: Records, weights: Path, device: str = "cpu"):
        network, metadata = checkpoint.load_parts(weights, device)
        self.records, self.size, self.device = records, metadata["size"], torch.device(device)
        self.predict = methods.network(network)
        self.refine = functools.partial(refine, labels=getattr(network, "training_labels", None))
        self.commit = provenance()["commit"]

    def line(self, scene: Scene, name: str, refined: bool) -> Line:
        """Return the figures of a scene on a rung; refined: whether those of refinement too."""
        (rung,) = (each for each in RUNGS if each.name == name)
        picture = shown(self.records, scene, rung, self.size)
        batch = picture.batch.to(self.device)
        source = to_numpy((batch.image * batch.mask)[0].movedim(0, -1))
        prediction = self.predict(batch)
        facing = torch.zeros_like(batch.n)
        facing[:, 2] = 1.0
        floor = None
        if not rung.eight_bit:
            true = Parts(batch.n, batch.label, batch.light)
            floor = display_l2(_edited(true, picture, batch), picture.target, picture.mask)
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
            predicted=measured(require_parts(prediction), picture, batch),
            refined=(
                measured(require_parts(self.refine(batch, prediction).prediction), picture, batch)
                if refined
                else None
            ),
            commit=self.commit,
            **names,
        )


def _sides(scene: Scene) -> dict[str, Mapping]:
    return {"source": scene.source, "target": scene.truth}


def measured(parts: Parts, picture: Shown, batch: ExampleBatch) -> Measured:
    """Return the figures of a decomposition of a picture; batch: the picture's, on the device."""
    mean, median = angles(parts.n, batch)
    edited = _edited(parts, picture, batch)
    forgiving = aligned(edited, picture.target, picture.mask)
    return Measured(
        mean,
        median,
        float(irradiance_error(parts.light, batch.light)),
        display_l2(edited, picture.target, picture.mask),
        forgiving["l2_one_factor"],
        forgiving["l2_three_factors"],
    )


def rendered_again(prediction: Prediction, picture: Shown) -> float:
    """Return the display L2 of the picture's re-rendering by the integral against the picture."""
    parts, batch = require_parts(prediction), picture.batch
    again = methods.rendered(parts.n, parts.label, parts.light, batch)
    return display_l2(again, to_numpy((batch.image * batch.mask)[0].movedim(0, -1)), picture.mask)


def _edited(parts: Parts, picture: Shown, batch: ExampleBatch) -> np.ndarray:
    return methods.rendered(parts.n, torch.from_numpy(picture.label), parts.light, batch)


def angles(n: torch.Tensor, batch: ExampleBatch) -> tuple[float, float]:
    """Return the mean and median angle in degrees of normals (1, 3, H, W) over the mask."""
    cosine = (n * batch.n).sum(1)[batch.segments > 0].double().clamp(-1, 1)
    degrees = cosine.arccos().rad2deg()
    return float(degrees.mean()), float(degrees.median())
