"""`learn evaluate`: edits are drawn and measured by several processes, then reported.

OUT/settings.json   what the figures depend on; a folder made with other settings is refused
OUT/pictures.jsonl  one line per source picture: its parts by every method
                    (learn.evaluation.edit_evaluator)
OUT/edits.jsonl     one line per edit, written as soon as it is measured
OUT/gallery/        a PNG of each of the first edits
OUT/report.json, report.md, index.html

A kill loses the pictures in progress. The same command continues, and a larger --edits adds edits.
"""

import contextlib
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import torch

from learn.data import pairs
from learn.data.pairs import EditPair
from learn.data.records import Records
from learn.data.seen import DIGITS
from learn.evaluation import distances, overlap, report, rows
from learn.evaluation.edit_evaluator import EditEvaluator
from learn.layer.predictions import MEASURED
from learn.networks import weights as checkpoint
from learn.refinement import RefinementSettings
from manifests import lock, outputs, ray_tasks, subprocesses
from manifests.cached_store import open_store
from manifests.errors import InputError
from manifests.line_files import Lines, encode
from manifests.progress import tqdm
from manifests.schema import Record
from manifests.store_paths import file_hash
from manifests.wording import number_of

# counts up when lines gain figures, so that no table mixes lines with and without them
FIGURES = 2

# an edit of the source picture, the edits to measure, whether the picture itself is to be measured,
# and the folder for pictures of the edits, or None
Unit = tuple[EditPair, list[EditPair], bool, str | None]


@dataclass(frozen=True)
class Options:
    """What is evaluated.

    data, weights, out  paths
    edits               number of edits
    refine              whether methods are refined
    baselines           folder of their weights, or None
    gallery             number of edits shown as pictures
    lpips               file of LPIPS' weights, or None
    materials           whose training materials the row "mean material" is the mean of: "dataset"
                        or "built-in"
    device              of networks, refinement and the layer: "cpu", or "cuda:0"
    allow_overlap       whether pictures are measured that show what the weights saw in training
    lights              file of the light maps that the weights were trained with, or None
    refinement_method   of the layer, by which refinement renders; None: auto
    geometry            data set with the shapes that the weights were trained on, or None
    ray                 address of a Ray cluster whose CPUs all work, instead of `processes`;
                        "auto": this machine's, or a new one here; None: processes of this machine
    """

    data: Path
    weights: Path
    out: Path
    edits: int = 100
    refine: bool = True
    baselines: Path | None = None
    seed: int = 0
    processes: int = 1
    gallery: int = 12
    lpips: Path | None = None
    materials: str = "dataset"
    device: str = "cpu"
    allow_overlap: bool = False
    lights: Path | None = None
    refinement_method: str | None = None
    geometry: Path | None = None
    ray: str | None = None


def evaluate(options: Options) -> dict:
    """Measure the edits that are missing, write the report and return it. Raises InputError."""
    records = Records(options.data)
    used = [record for record in records.records if record.split == "test"] or records.records
    if len(used) < len(records) and not pairs.edits_between(used):
        result = f"none among its {len(used)} of {number_of(len(records), 'picture')}"
        remedy = (
            "render the test side's shapes, views and lights in two of its materials or more, or a"
            " dataset without a test side"
        )
        raise InputError(
            options.data,
            "pictures of the test side that differ in nothing but the material",
            result,
            remedy,
        )
    chosen = pairs.choose_edits(used, options.edits, options.seed)
    out = Path(options.out)
    with lock.writing(out, patience=0):
        # here first, so that unusable weights are reported before any process starts
        evaluator = EditEvaluator(**evaluator_arguments(options))
        seen = overlap.report_overlap(
            [options.weights, *overlap.baseline_files(options.baselines)],
            overlap.shown_by_edits(records, chosen),
            options.data,
            options.allow_overlap,
        )
        nearest = nearest_training_items(options, records, chosen, evaluator)
        outputs.pin_settings(out / "settings.json", settings(options))
        measure(options, list_work(out, chosen, options.gallery, evaluator.repeats), evaluator)
        pictures, edits = (
            [row for id_, row in rows_of(out / name).items() if id_ in requested]
            for name, requested in ids_of(chosen).items()
        )
        families = {entry.name: entry.family for entry in records.materials.values()}
        about = report.about(
            options, records, used, evaluator.methods.left_out, evaluator.perceptual
        )
        about["seen"] = seen
        return report.write(
            out,
            pictures,
            edits,
            [edit.id for edit in chosen[: options.gallery]],
            about,
            evaluator.methods,
            families,
            nearest,
        )


def nearest_training_items(
    options: Options, records: Records, chosen: Sequence[EditPair], evaluator: EditEvaluator
) -> dict[str, dict[str, float]]:
    """Return {"shapes", "materials", "lights": {name: distance}} of the edits' inputs."""
    materials = sorted({name for edit in chosen for name in edit.source.materials})
    lights = sorted({edit.source.light for edit in chosen})
    seen = checkpoint.seen_by(options.weights)
    maps = distances.training_maps(options.lights, evaluator.metadata, seen)
    shapes = distances.training_shapes(options.geometry, seen)
    shown = [edit.source for edit in chosen] if shapes else []
    known = set(seen.shapes) if seen is not None else set()
    same = {record.shape for record in shown if record.shape_hash[:DIGITS] in known}
    labels = {name: records.label(name) for name in materials}
    return {
        "shapes": distances.shape_distances(distances.rasters(records, shown), shapes, same),
        "materials": distances.material_distances(labels, evaluator.training_labels),
        "lights": distances.light_distances({name: records.light(name) for name in lights}, maps),
    }


def ids_of(chosen: Sequence[EditPair]) -> dict[str, set[str]]:
    """Return {file: ids of its lines}."""
    return {
        "pictures.jsonl": {edit.source.id for edit in chosen},
        "edits.jsonl": {edit.id for edit in chosen},
    }


def evaluator_arguments(options: Options) -> dict:
    """Return the arguments of EditEvaluator in every process."""
    return {
        "data": options.data,
        "weights": options.weights,
        "baselines": options.baselines,
        "refine": options.refine,
        "lpips": options.lpips,
        "materials": options.materials,
        "device": options.device,
        "refinement_method": options.refinement_method or "auto",
    }


def settings(options: Options) -> dict:
    """Return what a line's figures depend on; files count by their bytes."""
    folder = options.baselines
    of_baselines = (
        {}
        if folder is None
        else {
            p.name: file_hash(p) for p in sorted(Path(folder).glob("*.safetensors")) if p.is_file()
        }
    )
    method = options.refinement_method or "auto"
    result = {
        "data": Path(options.data).resolve().name,
        "materials": file_hash(open_store(options.data).fetch("materials.json")),
        "weights": file_hash(options.weights) if Path(options.weights).is_file() else "none",
        "baselines": of_baselines,
        "refine": asdict(RefinementSettings().with_method(method)) if options.refine else False,
        "tolerance": MEASURED.tolerance,
        "seed": options.seed,
        "lpips": None if options.lpips is None else file_hash(options.lpips),
        "mean_material_of": options.materials,
        "figures": FIGURES,
    }
    return (
        result
        if options.device == "cpu"
        else result | {"device": torch.device(options.device).type}
    )


def list_work(
    out: Path, chosen: Sequence[EditPair], gallery: int, repeats: dict[tuple, list[Record]]
) -> list[Unit]:
    """Return the units of work that are still to do, one per source picture.

    An edit is measured again if it is to be shown and its picture is missing, or if its truth has
    more seeds than before; of two lines the later one counts.

    repeats  learn.data.pairs.find_repeats of the records
    """
    pictures, done = rows_of(out / "pictures.jsonl"), rows_of(out / "edits.jsonl")
    shown = {edit.id for edit in chosen[:gallery]}

    def finished(edit: EditPair) -> bool:
        drawn = edit.id not in shown or (out / "gallery" / f"{edit.id}.png").exists()
        seeds = len(repeats[pairs.scene_key(edit.truth), edit.truth.materials])
        judged = edit.id in done and (
            done[edit.id]["layer"].get("seeds", 1) == seeds
            or done[edit.id]["layer"]["l2_inner"] is None
        )
        return drawn and judged

    grouped: dict[str, list[EditPair]] = {}
    for edit in chosen:
        grouped.setdefault(edit.source.id, []).append(edit)
    work: list[Unit] = []
    for source, edits in grouped.items():
        todo = [edit for edit in edits if not finished(edit)]
        is_missing = source not in pictures
        if todo or is_missing:
            folder = str(out / "gallery") if any(edit.id in shown for edit in todo) else None
            work.append((edits[0], todo, is_missing, folder))
    return work


def measure(options: Options, todo: Sequence[Unit], evaluator: EditEvaluator) -> None:
    """Measure the units, and append their lines as they are finished."""
    lines = {name: Lines(Path(options.out) / name) for name in ("pictures.jsonl", "edits.jsonl")}
    total = sum(len(edits) for _, edits, _, _ in todo)
    try:
        with tqdm(total=total, desc="edits", unit="edit", smoothing=0.1) as bar:
            for picture, edits in results(options, todo, evaluator):
                for edit in edits:
                    lines["edits.jsonl"].append(edit)
                if picture is not None:
                    lines["pictures.jsonl"].append(picture)
                bar.update(len(edits))
    finally:
        for each in lines.values():
            each.close()


def results(
    options: Options, todo: Sequence[Unit], evaluator: EditEvaluator
) -> Iterator[tuple[dict | None, list[dict]]]:
    """Yield (row of the picture or None, rows of its edits), in the order they are finished."""
    if options.ray is not None:
        yield from _results_of_cluster(options, todo)
        return
    processes = max(1, min(options.processes, len(todo)))
    if processes == 1:
        for unit in todo:
            yield evaluator.measure_picture(*unit)
        return
    threads = max(1, subprocesses.processors() // processes)
    # a fork of a process with running threads may hang
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, _begin, (evaluator_arguments(options), threads))
    remedy = "run the same command again with fewer --processes: what was done stays"
    for _, finished in subprocesses.results_of(pool, _work, todo, "evaluation", remedy):
        yield finished


def _results_of_cluster(
    options: Options, todo: Sequence[Unit]
) -> Iterator[tuple[dict | None, list[dict]]]:
    """Yield what `results` does, from a Ray cluster whose nodes share the folders."""
    if not todo:
        return
    pieces = [
        (*unit[:3], None if unit[3] is None else Path(unit[3]))  # made absolute for the workers
        for unit in todo
    ]
    maker = f"{__name__}:on_worker"
    with contextlib.closing(
        ray_tasks.results(options.ray or "auto", maker, evaluator_arguments(options), pieces)
    ) as answers:
        for _, answer in answers:
            yield msgspec.json.decode(answer, type=tuple[dict | None, list[dict]])


def on_worker(settings: bytes) -> ray_tasks.Work:
    """Return what a worker of a Ray cluster does: a Unit as JSON → its rows as JSON.

    settings  of EditEvaluator, as JSON
    """
    torch.set_num_threads(1)
    evaluator = EditEvaluator(**msgspec.json.decode(settings))

    def work(piece: bytes) -> bytes:
        return encode(evaluator.measure_picture(*msgspec.json.decode(piece, type=Unit)))

    return work


_evaluator: EditEvaluator  # of a worker process


def _begin(options: dict, threads: int) -> None:
    global _evaluator
    subprocesses.end_with_parent()
    torch.set_num_threads(threads)
    _evaluator = EditEvaluator(**options)


def _work(unit: Unit) -> tuple[dict | None, list[dict]]:
    return _evaluator.measure_picture(*unit)


def rows_of(path: Path) -> dict[str, dict]:
    """Return {id: row} of a file of lines; of two lines of one id the later one counts.

    Raises  InputError for a damaged line
    """
    return {row["id"]: row for row in outputs.read_lines(path, rows.TYPES[path.name])}
