"""Measure whether refinement gains by treating clipped highlights as lower bounds.

Held-out shapes in the glossiest held-out materials are relit by the layer, exposed so that their
99th percentile of luminance is white, written in 8 bits, and read back with the exposure rule for
photographs; they are not cropped again. Each is refined twice from the same prediction: with white
taken at its value, and as "at least this bright". Edits into two other held-out materials are
compared with the truth at the photograph's exposure. rows.jsonl keeps a line per picture and
treatment: the same command continues.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np
    import torch

    from learn.data.batch import ExampleBatch
    from learn.data.data_split import DataSplit

ON_RAY = True
TREATMENTS = ("at its value", "one-sided")
FIGURES = {"edit": "edit, display L2", "angle_deg": "normals, mean angle (°)"}
GLOSSIEST, TARGETS = 8, 2


@dataclass(frozen=True)
class Case:
    """A clipped picture whose edits are known.

    batch     of one, as `learn edit` would make it, with the true normals
    factor    from the network's radiance to the photograph's
    truths    [(label (1, 108), picture (H, W, 3) in the photograph's units)]
    """

    batch: ExampleBatch
    factor: float
    truths: list[tuple[torch.Tensor, np.ndarray]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of pictures."""
    options.add_data(parser, "a data set whose held-out shapes and lights are used")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(parser, "--pictures", 24, "of pictures")
    options.add_count(parser, "--outer-iterations", 3, "of refinement")
    options.add_seed(parser, "seed by which pictures are chosen")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": [{"picture", "treatment", "clipped", "before", "after"}]}."""
    import torch

    from learn.data.settings import Data
    from learn.data.sources import load_data_splits
    from learn.evaluation.methods import make_predictor
    from learn.networks import weights as checkpoint
    from learn.refinement import RefinementSettings, refine
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    weights = arguments.weights
    net, metadata = checkpoint.load_full_network(weights)
    settings = replace(RefinementSettings(), outer_iterations=arguments.outer_iterations)
    about = {"weights": file_hash(weights), "seed": arguments.seed, "settings": asdict(settings)}
    outputs.pin_settings(arguments.out / "settings.json", about)
    split = load_data_splits(Data(), arguments.data)["test"]
    predict = make_predictor(net)
    cases = {
        k: case_of(split, k, arguments.seed, metadata["size"]) for k in range(arguments.pictures)
    }

    def row(chosen: tuple[int, str]) -> dict[str, Any]:
        number, treatment = chosen
        case = cases[number]
        assert case.batch.clipped is not None
        batch = case.batch if treatment == TREATMENTS[1] else replace(case.batch, clipped=None)
        start = predict(batch)
        parts = refine(batch, start, settings, getattr(net, "training_labels", None)).prediction
        before = figures(start, case)
        after = figures(parts, case)
        share = float(case.batch.clipped.amax(1)[case.batch.segments > 0].mean())
        return {"clipped": share, "before": before, "after": after}

    todo = [
        ({"picture": number, "treatment": treatment}, (number, treatment))
        for number in cases
        for treatment in TREATMENTS
    ]
    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "refinement")
    return {"rows": rows, "about": about}


def case_of(split: DataSplit, number: int, seed: int, size: int) -> Case:
    """Return the case of this number, a function of it and the seed."""
    import numpy as np
    import torch

    from learn.data import framing, photographs
    from learn.data.batch import collate
    from learn.data.data_split import gloss
    from learn.data.relit import RelitDataset
    from learn.data.settings import Data
    from shaders import tone

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    source = RelitDataset(split, Data(), 1, size, seed)
    names = sorted(split.labels, key=lambda name: -gloss(split.labels[name]))
    name = names[number % min(GLOSSIEST, len(names))]
    others = [other for other in names if other != name]
    view = split.views[rng.integers(len(split.views))]
    light = split.maps[rng.integers(len(split.maps))]
    n, segments = source._geometry(np.array([view]))
    targets = [others[i] for i in rng.choice(len(others), min(TARGETS, len(others)), replace=False)]
    radiance, *truths = (
        source._pictures(n, segments, split.labels[each][None], light)[0]
        for each in (name, *targets)
    )
    mask = (segments[0] > 0).numpy()
    exposure = tone.auto_exposure(radiance, mask)
    file = tone.linear_from_srgb(np.rint(tone.display(radiance, exposure)) / 255)
    file = (file * mask[..., None]).astype(np.float32)
    guessed = framing.resolve_exposure(file, mask)
    label = split.labels[name][None]
    batch = collate(
        [(file * np.float32(guessed), mask, n[0], segments[0], label, light, label, name)],
        split.geometry.elevation,
    )
    clipped = photographs.find_saturated(file) & mask[..., None]
    batch = replace(
        batch, clipped=torch.from_numpy(clipped.astype(np.float32)).movedim(-1, 0)[None]
    )
    pairs = [
        (torch.from_numpy(split.labels[each][None]), truth * exposure)
        for each, truth in zip(targets, truths, strict=True)
    ]
    return Case(batch, 1 / guessed, pairs)


def figures(parts: Any, case: Case) -> dict[str, float]:
    """Return {figure: value} of a prediction; edits are compared in the photograph's units."""
    import numpy as np

    from learn.experiments.editing.refinement_sweep import picture
    from shaders import tone

    mask = (case.batch.segments[0] > 0).numpy()
    edits = [picture(parts, label, case.batch) * case.factor for label, _ in case.truths]
    errors = [
        tone.display_l2(mine, truth, 1.0, mask)
        for mine, (_, truth) in zip(edits, case.truths, strict=True)
    ]
    cosine = (parts.n[0] * case.batch.n[0]).sum(0)[case.batch.segments[0] > 0].clamp(-1, 1)
    return {
        "edit": float(np.mean(errors)),
        "angle_deg": float(cosine.arccos().rad2deg().mean()),
    }


def tables(report: runner.Report) -> str:
    """Return both treatments' figures, and how often the one-sided one is better."""
    import numpy as np

    from learn.metrics import bootstrap

    rows = report["rows"]
    by = {t: [row for row in rows if row["treatment"] == t] for t in TREATMENTS}
    count = len(by[TREATMENTS[0]])
    lines = []
    for key, caption in FIGURES.items():
        value = {t: np.array([row["after"][key] for row in by[t]]) for t in TREATMENTS}
        before = np.array([row["before"][key] for row in by[TREATMENTS[0]]])
        change = value[TREATMENTS[1]] - value[TREATMENTS[0]]
        weights = bootstrap.draws([np.arange(count)])
        means = weights @ change / weights.sum(1)
        low, high = np.percentile(means, bootstrap.LEVELS)
        lines.append(
            [
                caption,
                f"{before.mean():.4g}",
                *(f"{value[t].mean():.4g} ({np.median(value[t]):.4g})" for t in TREATMENTS),
                f"{change.mean():+.3g} [{low:+.3g}, {high:+.3g}]",
                f"{(change < 0).sum()} of {count}",
            ]
        )
    share = np.mean([row["clipped"] for row in by[TREATMENTS[0]]])
    head = [
        "figure",
        "before refinement",
        *(f"refined, white {t}: mean (median)" for t in TREATMENTS),
        "change of the mean, 95 %",
        "better",
    ]
    return (
        "# Clipped highlights in refinement\n\n"
        f"{count} pictures; on average {100 * share:.1f} % of the object's pixels are clipped in a"
        " channel. Intervals are over pictures.\n\n" + runner.table(head, lines)
    )
