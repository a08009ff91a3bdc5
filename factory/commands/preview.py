"""`preview DIR`: a contact sheet of a dataset, as a picture and as a page."""


def register(subparsers):
    """Add the parser of `preview`."""
    from pathlib import Path

    parser = subparsers.add_parser(
        "preview",
        help="a contact sheet: image, normals, mask, light, label, difference",
        description=(
            "A contact sheet of records spread evenly over a dataset: image, normals, mask"
            " (segments in greys), the light as a mirror ball, the picture that the label alone"
            " gives (no shadow, no interreflection), and the difference, four times as bright."
        ),
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the dataset's folder")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR2",
        help="where sheet.png and index.html go (default: DIR-preview)",
    )
    parser.add_argument(
        "--count", type=int, default=24, metavar="N", help="how many records (default 24)"
    )
    parser.add_argument(
        "--size", type=int, default=128, metavar="PIXELS", help="of each picture (default 128)"
    )
    parser.add_argument("--material", metavar="NAME", help="only records with this material")
    parser.add_argument(
        "--tier", choices=("direct", "shadow", "full"), help="only records of this tier"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace what is there")
    parser.set_defaults(run=run)


def run(options):
    """Write sheet.png and index.html; 0."""
    from tqdm import tqdm

    from factory.preview.contact_sheet import caption, draw, page, row
    from manifests import files
    from manifests.errors import InputError
    from manifests.materials import load_catalogue
    from manifests.store import Store

    store = Store(options.folder)
    dataset = store.dataset()
    materials = load_catalogue(options.folder / "materials.json")
    if not (1 <= options.count <= 1000 and 16 <= options.size <= 2048):
        raise InputError(
            "preview",
            "--count 1 to 1000 and --size 16 to 2048",
            f"{options.count} and {options.size}",
            "choose smaller ones",
        )
    out = options.out or options.folder.with_name(options.folder.name + "-preview")
    files.reserve_outputs(out, ("sheet.png", "index.html"), options.overwrite)
    chosen = spread(store, options)
    if not chosen:
        raise InputError(
            options.folder, "records", "none that fit", "render some, or drop --material and --tier"
        )
    rows = [
        row(store, dataset, materials, record, options.size)
        for record in tqdm(chosen, desc="preview", unit="record", delay=1.0)
    ]
    captions = [caption(record) for record in chosen]
    out.mkdir(parents=True, exist_ok=True)
    with files.transaction():
        files.write_image(out / "sheet.png", draw(rows, captions, options.size))
        files.write_text(
            out / "index.html", page(options.folder.name, rows, captions, [r.id for r in chosen])
        )
    print(f"{out / 'index.html'}: {len(chosen)} records")
    return 0


def spread(store, options):
    """Records that fit, at most --count: one of each of so many equal strata of their order, at the
    golden ratio's places within it.
    """
    fits = [
        r
        for r in store.records()
        if options.material in (None, *r.materials) and options.tier in (None, r.tier)
    ]
    fits.sort(
        key=lambda r: (r.shape, r.materials, r.light, r.tier, r.light_resolution, r.viewpoint, r.id)
    )
    count = min(options.count, len(fits))
    return [fits[int((k + 0.618034 * k % 1) * len(fits) / count)] for k in range(count)]
