"""`learn likely`: what a network's mistakes look like, which refinement is held by."""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "likely",
        help="measure the mistakes that refinement expects of a network",
        description="Relights shapes, materials and lights of the training side, predicts them, and writes how predictions differ from the "
        "truth: what refinement holds material, light and normals by. Run it again when the network is another one. Some minutes.",
    )
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="a dataset that `python -m factory render` wrote")
    parser.add_argument("--lights", type=Path, metavar="FILE.npz", help="further light maps, each a (64, 128, 3) array")
    parser.add_argument("--weights", type=Path, metavar="FILE", help="weights.safetensors of a run (default: the ones that come with it)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: where refinement reads it")
    parser.add_argument("--pictures", type=int, default=1600, metavar="N", help="how many (default 1600)")
    parser.add_argument("--seed", type=int, default=6, metavar="N", help="which pictures")
    parser.set_defaults(run=run)


def run(options):
    from learn.prediction import WEIGHTS
    from learn.refinement import likely, measuring

    weights, out = options.weights or WEIGHTS, options.out or likely.FILE
    found, told = measuring.measured(weights, options.data, options.lights, options.pictures, options.seed)
    likely.save(out, found, told | {"weights": Path(weights).name})
    spreads = ", ".join(f"{s:.3f}" for s in found.normals_spread.tolist())
    print(f"{out}: {told['pictures']} pictures of {len(told['materials'])} materials and {told['maps']} maps; normals' grids {spreads}")
