"""Refine photographs of the gallery by the sum and by the integral, and compare the results.

The photographs are those of docs/results/photographs, unpacked below ROOT (measure_photographs.py
downloads them). There is no truth: the report says how far each refined re-rendering is from the
photograph, how far both edits into each material are from each other, and whether the material that
was read has lobes narrower than a texel. OUT gets report.json, report.md and sheet.jpg: a row for
each photograph and method.

PYTHONPATH=. python tests/learn/measure_refined_photographs.py ROOT OUT NAME [NAME …]
    [--weights FILE]
"""

import argparse
import sys
import time
from pathlib import Path

import torch

from learn.commands.options import EDITING_WEIGHTS
from learn.editing import DETAIL, decomposition, drawing, photograph, targets
from learn.editing.compositor import Compositor
from learn.figures import montage
from learn.layer.display_method import method_for
from learn.networks import weights
from learn.refinement import PHOTOGRAPHS
from manifests import files
from manifests.provenance import provenance, shorten
from manifests.training_runs import LAYER_METHODS
from shaders import tone
from tests.learn.measure_photographs import MATERIALS, TILE, sources

TITLES = {"auto": "sum", "quadrature": "integral"}  # of LAYER_METHODS


def by_method(path, mask, network, size):
    """{method: figures}, {method: tiles} and {material: display L2 between both methods' edits}."""
    opened = photograph.open_photograph(path, [mask], None)
    figures, tiles, edits = {}, {}, {}
    for method in LAYER_METHODS:
        began = time.process_time()
        result = decomposition.decompose(opened, network, size, PHOTOGRAPHS.with_method(method))
        seconds = time.process_time() - began
        compositor = Compositor(result, detail=DETAIL)
        again = compositor.render_again()
        edits[method] = {
            material: compositor.edit([targets.resolve_labels(material, lambda picture: None)[0]])
            for material in MATERIALS
        }
        n, L = (part[0].movedim(0, -1).numpy() for part in (result.parts.n, result.parts.light))
        figures[method] = {
            "again": float(tone.display_l2(again, opened.radiance, 1.0, opened.mask)),
            "narrow": method_for(torch.from_numpy(result.label)) == "quadrature",
            "seconds": seconds,
        }
        shown = {"photograph": opened.radiance, "rendered again": again} | edits[method]
        tiles[method] = [
            (
                TITLES[method] if title == "photograph" else title,
                drawing.crop_to_object(tone.display(picture, 1.0), result),
            )
            for title, picture in shown.items()
        ]
        tiles[method][2:2] = [
            ("normals", montage.normals_picture(n, result.framed.mask)),
            ("light", montage.light_picture(L)),
        ]
    first, second = edits.values()
    between = {
        material: float(tone.display_l2(first[material], second[material], 1.0, opened.mask))
        for material in MATERIALS
    }
    return figures, tiles, between


def tables(rows, made, weights_name):
    """The report in Markdown; rows: {name: (figures, between)} of `by_method`."""
    lines = [
        "# Photographs refined by the sum and by the integral",
        "",
        f"`{made['command']}`, commit {made['commit']}, {made['date']}; {made['machine']}; weights"
        f" {weights_name}.",
        "",
        "Display L2 over the object. *Narrow*: whether the material that was read has visible lobes"
        " that are narrower than a texel. *Between*: of the same edit by both methods.",
        "",
        "| photograph | method | re-rendering | narrow | processor, s |"
        + "".join(f" {material}, between |" for material in MATERIALS),
        "|---|---|---|---|---|" + "---|" * len(MATERIALS),
    ]
    for name, (figures, between) in rows.items():
        for k, (method, of) in enumerate(figures.items()):
            cells = [f"{value:.2g}" if k == 0 else "" for value in between.values()]
            lines.append(
                f"| {name} | {TITLES[method]} | {of['again']:.1f} |"
                f" {'yes' if of['narrow'] else 'no'} | {of['seconds']:.1f} | "
                + " | ".join(cells)
                + " |"
            )
    return "\n".join(lines) + "\n"


def main(arguments):
    """Write the report and the sheet into the folder OUT."""
    torch.set_num_threads(1)
    network, metadata = weights.load_full_network(arguments.weights, "cpu")
    known = sources(arguments.root)
    if unknown := [name for name in arguments.names if name not in known]:
        sys.exit(f"expected names of {', '.join(known)}, found {', '.join(unknown)}")
    words = " ".join(shorten(word) for word in sys.argv[1:])
    made = provenance(f"python tests/learn/measure_refined_photographs.py {words}")
    rows, sheet = {}, []
    for name in arguments.names:
        path, mask, _ = known[name]
        figures, tiles, between = by_method(path, mask, network, metadata["size"])
        rows[name] = figures, between
        sheet += tiles.values()
    arguments.out.mkdir(parents=True, exist_ok=True)
    picture = montage.eight_bit(montage.contact_sheet(sheet, TILE))
    files.write_image(arguments.out / "sheet.jpg", picture, "JPEG")
    report = {
        "made_by": made,
        "weights": arguments.weights.name,
        "rows": {
            name: {"methods": figures, "between": between}
            for name, (figures, between) in rows.items()
        },
    }
    files.write_json(arguments.out / "report.json", report)
    page = tables(rows, made, arguments.weights.name)
    files.write_text(arguments.out / "report.md", page)
    print(page)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path, metavar="ROOT")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("names", nargs="+", metavar="NAME")
    parser.add_argument("--weights", type=Path, default=EDITING_WEIGHTS, metavar="FILE")
    main(parser.parse_args())
