"""`learn.experiments refinement-ablation`: what refinement does against its weights, from bad
starts, and how long it takes.
"""

from pathlib import Path

from manifests.option_types import MATERIALS, positive, whole


def register(subparsers):
    parser = subparsers.add_parser(
        "refinement-ablation",
        help="measure refinement: against its weights, from bad starts, and its time",
        description=(
            "Refines pictures of a dataset in which scenes were rendered in several materials, so"
            " that the truth of an edit is known. Writes study.json and study.png (re-rendering,"
            " edit, normals and light against each weight, outer iterations and pixels), "
            "starts.json"
            " (bad starts) and times.json. The same command again continues the study."
        ),
    )
    parser.add_argument(
        "--data", type=Path, required=True, metavar="DIR", help="a dataset with pictures"
    )
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help=(
            "weights.safetensors of a training run (default: the weights that come with the"
            " program)"
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where the figures go"
    )
    parser.add_argument(
        "--pictures", type=positive, default=12, metavar="N", help="of the study (default 12)"
    )
    parser.add_argument(
        "--starts",
        type=whole,
        default=100,
        metavar="N",
        help="refinements from starts of five kinds, one of each a picture (default 100; 0: none)",
    )
    parser.add_argument(
        "--only",
        nargs="*",
        metavar="SETTING",
        help=(
            "default, paper, a=0.1, outer_iterations=3, pixels=600 …: these alone (default: all;"
            " none: no study)"
        ),
    )
    parser.add_argument(
        "--materials",
        choices=MATERIALS,
        default="dataset",
        help=(
            "where the bad starts' random materials come from: the data set's own, or the built-in"
            " ones (default: dataset)"
        ),
    )
    parser.add_argument("--seed", type=whole, default=0, metavar="N", help="which pictures")
    parser.set_defaults(run=run)


def run(options):
    import torch

    from learn.data.records import Records
    from learn.editing.predict import WEIGHTS
    from learn.evaluation.methods import network
    from learn.experiments import refinement_initialisations
    from learn.networks import weights as checkpoint
    from manifests import lock
    from manifests.store import file_hash

    torch.set_num_threads(1)  # times are reported for one thread
    weights = options.weights or WEIGHTS
    net, _ = checkpoint.load_parts(weights)
    predict = network(net)
    records = Records(options.data)
    about = {
        "data": options.data.resolve().name,
        "materials": file_hash(options.data / "materials.json"),
        "weights": file_hash(weights),
        "starts_of": options.materials,
    }
    labels = refinement_initialisations.labels_of(records, options.materials)
    with lock.writing(options.out, patience=0):
        _measure(options, predict, records, labels, about)


def _measure(options, predict, records, labels, about):
    """The study, its times and the starts, as far as they are asked for and not there. about: what
    the figures depend on.

    labels  of the materials that bad starts are drawn from
    """
    from learn.experiments import refinement_ablation, refinement_chart, refinement_initialisations

    refinement_ablation.pin_settings(options.out, about)
    # one start of each kind a picture
    needed = -(-options.starts // len(refinement_initialisations.STARTS))
    known = refinement_ablation.cases(records, max(options.pictures, needed), options.seed)
    if options.only is None or options.only:
        report = refinement_ablation.weights(
            predict, known[: options.pictures], options.out, options.only
        )
        refinement_chart.chart(report, options.out / "study.png")
    batch = known[0].batch
    times = {
        f"{len(b.image[0, 0])}": refinement_ablation.timed(predict, b)
        for b in (batch, refinement_ablation.doubled(batch))
    }
    refinement_ablation.write(options.out / "times.json", times)
    for size, seconds in times.items():
        print(
            f"{size}²: prediction {seconds['predict']:.2f} s, refinement {seconds['refine']:.1f} s"
        )
    if options.starts:
        report = refinement_initialisations.measured(
            predict, known[:needed], options.starts, options.out, labels
        )
        print(
            f"{report['starts']} starts: {report['above_their_start']} ended above,"
            f" {report['not_finite']} not finite, re-rendering's median display L2"
            f" {report['image_median'][0]:.0f} → {report['image_median'][1]:.0f}"
            f" ({100 * report['median_change']:+.0f} %)"
        )
