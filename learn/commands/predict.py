"""`learn predict`: one picture taken apart into normals, light and material."""

from pathlib import Path

from learn.commands import device_option, editing_options


def register(subparsers):
    parser = subparsers.add_parser(
        "predict",
        help="normals, light and material of one masked picture",
        description="Takes a picture of one object apart, and renders it again. Writes normals, light and re-rendering as EXR "
        "and PNG, the material as JSON, and one sheet of all.",
    )
    parser.add_argument(
        "image",
        type=Path,
        metavar="IMAGE",
        help="a photograph or an EXR; PNG, JPEG, TIFF, 8 or 16 bit, of any size; or a dataset: a record held out",
    )
    parser.add_argument("--mask", type=Path, metavar="FILE", help="white where the object is; without it the picture's transparency")
    parser.add_argument("--weights", type=Path, metavar="FILE", help="weights.safetensors of a run (default: the ones that come with it)")
    parser.add_argument(
        "--exposure", type=float, metavar="X", help="radiance is the picture times X (default: from the object's brightness)"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the parts go")
    device_option.add(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace what is there")
    parser.set_defaults(run=run, continues=False)


def run(options):
    from learn.data import devices
    from learn.editing import predict

    editing_options.check_exposure(options.exposure)
    device, weights = devices.choose(options.device), options.weights or predict.WEIGHTS
    predict.write(options.image, options.mask, weights, options.out, options.exposure, options.overwrite, device)
    print(f"See {options.out / 'sheet.png'}")
