"""`learn predict`: the decomposition of one picture into normals, light and material."""

from pathlib import Path

from learn.commands import device_option, editing_options


def register(subparsers):
    parser = subparsers.add_parser(
        "predict",
        help="decompose one picture into normals, light and material",
        description=(
            "Predicts normals, light and material of the object in one picture, and renders it"
            " again from them. Writes normals, light and the rendering as EXR and PNG, the material"
            " as JSON, and one contact sheet (sheet.png). Example: python -m learn predict"
            " photo.jpg --mask mask.png --out parts"
        ),
    )
    parser.add_argument(
        "image",
        type=Path,
        metavar="IMAGE",
        help=(
            "a picture of any size (PNG, JPEG, TIFF, EXR …), or a data set's folder, of which a"
            " held-out record is taken"
        ),
    )
    parser.add_argument(
        "--mask",
        type=Path,
        metavar="FILE",
        help="a picture that is white where the object is (default: the picture's transparency)",
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
        "--exposure",
        type=float,
        metavar="X",
        help=(
            "multiply the picture by X to get radiance (default: estimated from the object's"
            " brightness)"
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the results"
    )
    device_option.add(parser)
    parser.add_argument(
        "--overwrite", action="store_true", help="replace earlier results in the folder"
    )
    parser.set_defaults(run=run, continues=False)


def run(options):
    from learn.data import devices
    from learn.editing import predict

    editing_options.check_exposure(options.exposure)
    device, weights = devices.choose(options.device), options.weights or predict.WEIGHTS
    predict.run(
        options.image,
        options.mask,
        weights,
        options.out,
        options.exposure,
        options.overwrite,
        device,
    )
    print(f"See {options.out / 'sheet.png'}")
