"""`learn transfer`: pictures exchange their materials."""

from pathlib import Path

from learn.commands import editing_options


def register(subparsers):
    parser = subparsers.add_parser(
        "transfer",
        help="a grid of pictures that exchange their materials",
        description="Takes pictures apart and renders every one's shape under its own light in every other one's material. Writes one "
        "picture a pair, and a grid: a row for each shape and light, a column for each material.",
    )
    parser.add_argument("pictures", nargs="*", type=Path, metavar="PICTURE", help="two or more, with transparency or with masks")
    parser.add_argument("--list", type=Path, metavar="FILE", help="a text file with a picture's path a line, relative to the file")
    parser.add_argument("--mask-dir", type=Path, metavar="DIR", help="masks named as the pictures (default: NAME.mask.png beside each)")
    parser.add_argument("--per-grid", type=int, default=6, metavar="N", help="pictures a grid; more become several grids (default 6)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the pictures go")
    editing_options.add(parser)
    parser.set_defaults(run=run, continues=False)


def run(options):
    from learn.editing import transfer

    paths = transfer.listed(options.pictures, options.list)
    transfer.run(paths, options.mask_dir, options.out, editing_options.edit_options(options), options.per_grid, options.overwrite)
    print(f"See {options.out}")
