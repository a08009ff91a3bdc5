"""`learn evaluate-ladder`: weights on every rung of the ladder, from direct light to a photograph.

OUT/settings.json     what the figures depend on; a folder made with other settings is refused
OUT/lines.jsonl       one line per scene and rung, written as soon as it is measured
OUT/report.json, report.md, chart.png

The same command continues a stopped run, and a larger --scenes or --refined adds to it.
"""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import torch
from msgspec import to_builtins

from learn.data.records import Records
from learn.data.seen import DIGITS, label_hash, map_hash
from learn.evaluation import ladder_design, ladder_report, overlap
from learn.evaluation.ladder_design import RUNGS, Rung, Scene
from learn.evaluation.ladder_evaluator import LadderEvaluator, Line
from learn.layer.predictions import MEASURED
from learn.refinement import RefinementSettings
from manifests import files, lock, outputs, ray_tasks
from manifests.cached_store import open_store
from manifests.line_files import Lines
from manifests.progress import tqdm
from manifests.provenance import provenance
from manifests.store_paths import file_hash

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


def evaluate(options: Options) -> dict:
    """Measure what is missing, write the report and return it. Raises InputError."""
    records, out = Records(options.data), Path(options.out)
    job = ladder_design.preset(options.side)
    there = ladder_design.scenes(records.records, job, options.incomplete, options.measured_rungs)
    scenes = choose_per_group(there, options.scenes)
    to_refine = {scene.id for scene in choose_per_group(scenes, options.refined)}
    with lock.writing(out, patience=0):
        evaluator = LadderEvaluator(records, options.weights, options.device)
        seen = overlap.report_overlap(
            [options.weights], list_tested(records, scenes), options.data, options.allow_overlap
        )
        outputs.pin_settings(out / "settings.json", settings(options))
        measure(options, evaluator, scenes, to_refine)
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


def choose_per_group(scenes: Sequence[Scene], count: int | None) -> list[Scene]:
    """Return the first `count` scenes of each group in their order; None: all."""
    seen: dict[str, int] = {}
    result = []
    for scene in scenes:
        seen[scene.group] = seen.get(scene.group, 0) + 1
        if count is None or seen[scene.group] <= count:
            result.append(scene)
    return result


def list_tested(records: Records, scenes: Sequence[Scene]) -> overlap.Tested:
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


def measure(
    options: Options, evaluator: LadderEvaluator, scenes: Sequence[Scene], to_refine: set[str]
) -> None:
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
        measured = _lines(options, evaluator, todo)
        with closing(measured), tqdm(total=len(todo), unit="edit", disable=None) as bar:
            for line in measured:
                lines.append(line)
                bar.update()


def _lines(
    options: Options, evaluator: LadderEvaluator, todo: Sequence[Piece]
) -> Generator[Line, None, None]:
    """Yield the lines, in the order they are finished."""
    if options.ray is None:
        for piece in todo:
            yield evaluator.measure(*piece)
    elif todo:
        settings = {"data": options.data, "weights": options.weights, "device": options.device}
        maker = f"{__name__}:on_worker"
        with closing(ray_tasks.results(options.ray, maker, settings, todo)) as answers:
            for _, answer in answers:
                yield msgspec.json.decode(answer, type=Line)


def on_worker(settings: bytes) -> ray_tasks.Work:
    """Return what a worker of a Ray cluster does: a Piece as JSON → its Line as JSON.

    settings  of LadderEvaluator, as JSON
    """
    torch.set_num_threads(1)
    given = msgspec.json.decode(settings)
    evaluator = LadderEvaluator(Records(given.pop("data")), **given)

    def work(piece: bytes) -> bytes:
        return msgspec.json.encode(evaluator.measure(*msgspec.json.decode(piece, type=Piece)))

    return work
