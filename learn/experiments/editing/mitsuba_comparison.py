"""Compare refinement with gradient descent through Mitsuba 3, from one start on the same pictures.

Both see pictures of the direct tier and begin at the network's normals, material
and light; of Mitsuba's, the material is the principled one nearest to the predicted label. Mitsuba
descends base colour, roughness, metallic and a smooth factor on the light by Adam
(mitsuba_descent) for as many seconds of the processor as refinement took on that
picture, and for a multiple of them; compiling its kernels is not counted. Both compare all pixels
of the object; the misfit of the picture and the weight of the light's change are those of
refinement. Normals are held, so that refinement is measured with normals held, too. The edit into
the target material is rendered by the layer from each one's light and normals, so that the
decompositions alone are compared.

Needs Mitsuba (`pip install .[witness]`), which needs LLVM 19 or later: DRJIT_LIBLLVM_PATH names it.
The pictures of the ladder serve (`python -m learn evaluate-ladder --jobs DIR` names them).
rows.jsonl keeps a line per picture: the same command continues.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    import numpy as np

    from learn.data.batch import ExampleBatch
    from learn.evaluation.ladder_design import Scene
    from learn.networks.prediction import Prediction
    from shaders.principled import PrincipledMaterial

METHODS = {
    "predicted": "the start: predicted parts",
    "held": "refined, normals held",
    "refined": "refined",
    "begun": "Mitsuba's start: the principled material nearest to the predicted one",
    "mitsuba": "Mitsuba, the seconds of refinement",
    "longer": "Mitsuba, longer",
}
FIGURES = {
    "edit": "edit, display L2",
    "aligned": "one factor free",
    "irradiance": "irradiance error",
    "image": "re-rendering, display L2",
    "seconds": "processor, s",
}
MOST_SECONDS = 1800.0  # of one descent, its start included


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights, the number of scenes and the longer budget."""
    options.add_data(parser, "a data set with direct pictures of each scene in two materials")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(parser, "--scenes", 6, "number of scenes")
    parser.add_argument(
        "--longer",
        type=positive,
        default=3,
        metavar="K",
        help="the longer descent has K times the seconds of refinement (default 3)",
    )
    options.add_seed(parser, "seed by which edits are drawn")


def require_mitsuba() -> None:
    """Raise InputError, with the remedy, where Mitsuba is not installed."""
    from manifests.errors import InputError

    if importlib.util.find_spec("mitsuba") is None:
        raise InputError(
            "mitsuba-comparison", "the package mitsuba", "none", "pip install .[witness]"
        )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": [{"scene", "shape", "target", "light", METHODS: {FIGURES: value}}]}."""
    require_mitsuba()
    import torch

    from learn.data.records import Records
    from learn.evaluation import ladder, overlap
    from learn.evaluation.ladder_design import RUNGS
    from learn.evaluation.ladder_pictures import load_scene
    from learn.evaluation.methods import make_predictor
    from learn.experiments.editing import ladder_scenes
    from learn.networks import weights as checkpoint
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    weights = arguments.weights
    net, metadata = checkpoint.load_full_network(weights)
    records = Records(arguments.data)
    rung = RUNGS[0]
    pictures = {rung.name: ladder_scenes.pictures_of(records)[rung.name]}
    scenes = ladder_scenes.edits_of(pictures, arguments.scenes, arguments.seed)
    seen = overlap.report_overlap(
        [weights], ladder.list_tested(records, scenes), arguments.data, True
    )
    about = {
        "data": file_hash(arguments.data / "materials.json"),
        "weights": file_hash(weights),
        "longer": arguments.longer,
        "seed": arguments.seed,
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    predict, labels = make_predictor(net), getattr(net, "training_labels", None)

    def row(scene: Scene) -> dict[str, Any]:
        picture = load_scene(records, scene, rung, metadata["size"])
        names = {"shape": scene.shape, "light": scene.light}
        names["target"] = scene.truth[rung.name].materials[0]
        return names | compare_picture(picture, predict, labels, arguments.longer)

    todo = [({"scene": scene.id}, scene) for scene in scenes]
    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "scene")
    return {"rows": rows, "weights": weights.name, "seen": seen, "longer": arguments.longer}


def compare_picture(
    picture: Any,
    predict: Callable[[ExampleBatch], Prediction],
    labels: np.ndarray | None,
    longer: int,
) -> dict[str, Any]:
    """Return {METHODS: {FIGURES: value}} of one picture (learn.evaluation.ladder_pictures.Shown).

    predict  of a network; labels: as learn.refinement.refine takes them
    """
    import time

    import torch

    from learn.editing.decomposition import require_parts
    from learn.evaluation import methods
    from learn.metrics.pictures import display_l2
    from learn.refinement import RefinementSettings, refine

    batch = picture.batch
    start = predict(batch)
    settings = {
        "held": RefinementSettings(order=("material", "light")),
        "refined": RefinementSettings(),
    }
    parts, seconds = {"predicted": require_parts(start)}, {"predicted": 0.0}
    for name, chosen in settings.items():
        began = time.process_time()
        parts[name] = require_parts(refine(batch, start, chosen, labels).prediction)
        seconds[name] = time.process_time() - began
    image = batch.image[0].movedim(0, -1).numpy()
    result: dict[str, Any] = {}
    for name, each in parts.items():
        again = methods.render_by_layer(each.n, each.label, each.light, batch)
        result[name] = edit_figures(each.n, each.light, picture) | {
            "image": display_l2(again, image, picture.mask),
            "seconds": seconds[name],
        }
    material = nearest(parts["predicted"].label[0, 0].double().numpy())
    budgets = [seconds["refined"], longer * seconds["refined"]]
    out = run_descent(problem(picture, start, material, budgets))
    n = parts["predicted"].n
    for name, of in (("begun", "start"), ("mitsuba", "budget0"), ("longer", "budget1")):
        light = torch.from_numpy(out[f"{of}_light"]).float().movedim(-1, 0)[None]
        again = image * 0
        again[picture.mask] = out[f"{of}_picture"]
        result[name] = edit_figures(n, light, picture) | {
            "image": display_l2(again, image, picture.mask),
            "seconds": float(out[f"{of}_seconds"]),
            "steps": int(out[f"{of}_steps"]),
        }
    return result


def edit_figures(n: Any, light: Any, picture: Any) -> dict[str, float]:
    """Return the figures of the edit from normals and a light, rendered by the layer."""
    import torch

    from learn.evaluation import methods
    from learn.metrics.pictures import display_l2, l2_after_alignments
    from learn.metrics.radiometry import irradiance_error

    edited = methods.render_by_layer(n, torch.from_numpy(picture.label), light, picture.batch)
    return {
        "edit": display_l2(edited, picture.target, picture.mask),
        "aligned": l2_after_alignments(edited, picture.target, picture.mask)["l2_one_factor"],
        "irradiance": float(irradiance_error(light, picture.batch.light)),
    }


def nearest(label: np.ndarray) -> PrincipledMaterial:
    """Return the principled material of base colour, roughness, metallic and specular nearest to a
    label (108,).

    Least squares of the square root of f · cos over lit samples, from four initial materials.
    """
    import numpy as np
    from scipy.optimize import least_squares

    from shaders import label_model
    from shaders.principled import PrincipledMaterial
    from shaders.samples import Samples

    samples = Samples(np.radians([10.0, 35.0, 60.0]), 24, 6)
    measure = samples.measure[..., None]
    target = np.sqrt(label_model.values(label.reshape(3, 3, 2, 6), *samples.spline()) * measure)

    def material(x: np.ndarray) -> PrincipledMaterial:
        r, g, b, *rest = (float(value) for value in np.clip(x, 0, 1))
        return PrincipledMaterial((r, g, b), *rest)

    def residual(x: np.ndarray) -> np.ndarray:
        f = material(x).evaluate(*samples.cosines)
        return (np.sqrt(np.maximum(f, 0) * measure) - target).ravel()

    fits = [
        least_squares(residual, [0.4, 0.4, 0.4, rough, metal, 0.5], bounds=(0, 1), max_nfev=20)
        for rough in (0.3, 0.7)
        for metal in (0.1, 0.9)
    ]
    return material(min(fits, key=lambda fit: fit.cost).x)


def problem(
    picture: Any, start: Prediction, material: PrincipledMaterial, budgets: list[float]
) -> dict[str, Any]:
    """Return what learn.experiments.editing.mitsuba_descent reads.

    n (P, 3)      predicted normals of the object's pixels, camera frame
    seen (P, 3)   the picture as refinement's energy compares it, under `exposure`
    light         (64, 128, 3) predicted; held: the weight of its change
    elevation     of the camera, radians; budgets: seconds
    base_color, roughness, metallic, specular  the start
    """
    import numpy as np

    from learn.editing.decomposition import require_parts
    from learn.refinement import RefinementSettings
    from shaders import tone

    mask, parts = picture.mask, require_parts(start)
    image = picture.batch.image[0].movedim(0, -1).numpy()[mask]
    exposure = tone.auto_exposure(image, np.ones(len(image), bool))
    return {
        "n": parts.n[0].movedim(0, -1).numpy()[mask].astype(np.float64),
        "seen": np.log1p(8 * exposure * image) / np.log(9),
        "exposure": exposure,
        "light": parts.light[0].movedim(0, -1).numpy(),
        "held": RefinementSettings().b,
        "elevation": picture.batch.elevation,
        "budgets": np.array(budgets),
        "base_color": np.array(material.base_color),
        "roughness": material.roughness,
        "metallic": material.metallic,
        "specular": material.specular,
    }


def run_descent(given: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return what the program learn.experiments.editing.mitsuba_descent makes of a problem.

    Raises InputError where it fails, with the last line of what it wrote.
    """
    import numpy as np

    from manifests.errors import InputError

    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "in.npz", Path(folder) / "out.npz"]
        np.savez(paths[0], **given)
        program = Path(__file__).with_name("mitsuba_descent.py")
        done = subprocess.run(
            [sys.executable, program, *paths],
            capture_output=True,
            text=True,
            timeout=MOST_SECONDS,
            check=False,
        )
        if done.returncode:
            if "LLVM" in done.stderr:
                remedy = "point DRJIT_LIBLLVM_PATH to libLLVM 19 or later"
                raise InputError("mitsuba", "an LLVM for this processor", "an older one", remedy)
            last = (done.stderr.strip().splitlines() or ["no message"])[-1][:200]
            raise InputError("mitsuba", "a descent to its end", last, "see constraints.txt")
        with np.load(paths[1], allow_pickle=False) as file:
            return dict(file)


def tables(report: runner.Report) -> str:
    """Return every method's figures, and the ratio of its edits' error to refinement's."""
    import numpy as np

    from learn.metrics import bootstrap

    rows = report["rows"]
    weights = bootstrap.draws_of_rows(rows, ("shape", "target", "light"))
    lines = []
    for name, title in METHODS.items():
        values = {key: np.array([row[name][key] for row in rows]) for key in FIGURES}
        ours = np.array([row["refined"]["edit"] for row in rows])
        steps = [row[name].get("steps") for row in rows]
        lines.append(
            [
                f"{title} ({report['longer']} times)" if name == "longer" else title,
                runner.mean_interval(values["edit"], weights, 0),
                runner.ratio_interval(ours, values["edit"], weights, 2),
                runner.mean_interval(values["aligned"], weights, 0),
                runner.mean_interval(values["irradiance"], weights, 3),
                f"{values['image'].mean():.0f}",
                f"{values['seconds'].mean():.1f}",
                "" if None in steps else f"{np.mean([s for s in steps if s is not None]):.0f}",
            ]
        )
    edit, *rest = FIGURES.values()
    head = ["method", edit, "ratio to refined", *rest, "steps"]
    parts = ["# Refinement and descent through Mitsuba 3"]
    parts += [f"**{sentence}**" for sentence in report["seen"]]
    parts.append(
        f"{len(rows)} scenes of {len({row['shape'] for row in rows})} shapes, direct tier; weights"
        f" {report['weights']}. Both begin at the same prediction and use one thread. Edits are"
        " rendered by the layer from each one's light and normals; the re-rendering is each one's"
        " own, by Mitsuba or the layer. Seconds are of the processor; Mitsuba's kernels are"
        " compiled before they are counted. Intervals are 95 %; whole shapes, target materials and"
        " lights are drawn.\n\n" + runner.table(head, lines)
    )
    return "\n\n".join(parts)
