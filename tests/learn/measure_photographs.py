"""Edit the photographs of docs/results/photographs, and draw one sheet of them.

The pictures come from packages that are unpacked below ROOT; only their masks are in the
repository. Run it: PYTHONPATH=. python tests/learn/measure_photographs.py ROOT OUT [--no-refine]
"""

import json
import sys
import time
from pathlib import Path

import torch

from learn.editing import decomposition, drawing, photograph, targets
from learn.editing.compositor import Compositor
from learn.editing.predict import WEIGHTS
from learn.figures import html, montage
from learn.networks import weights
from learn.refinement import RefinementSettings
from manifests import files
from shaders import tone

FOLDER = Path(__file__).parents[2] / "docs" / "results" / "photographs"
MATERIALS = ("brass", "green-latex", "red-fabric")
TILE = 150


def sources(root):
    """{name: (path of the picture, path of its mask, credit)}"""
    known = json.loads((FOLDER / "sources.json").read_text())
    result = {}
    for name, (package, file) in known["photographs"].items():
        about = known["packages"][package]
        credit = f"{package} {about['version']}, {file}: {about['licence']}, {about['credit']}"
        path = Path(root) / about["folder"] / file
        result[name] = (path, FOLDER / "masks" / f"{name}.png", credit)
    return result


def row(name, path, mask, network, size, settings):
    """A row of the sheet, and seconds: all steps but reading the weights."""
    start = time.perf_counter()
    opened = photograph.opened(path, [mask], None)
    result = decomposition.decompose(opened, network, size, settings)
    compositor = Compositor(result, detail=0.25)
    n, L = (part[0].movedim(0, -1).numpy() for part in (result.parts.n, result.parts.light))
    tiles = [
        (name, drawing.cropped(tone.display(opened.radiance, 1.0), result)),
        ("normals", montage.normals_picture(n, result.framed.mask)),
        ("light", montage.light_picture(L)),
    ]
    for material in MATERIALS:
        label = targets.label_of(material, lambda picture: None)
        edited = tone.display(compositor.edited([label[0]]), 1.0)
        tiles.append((material, drawing.cropped(edited, result)))
    return tiles, time.perf_counter() - start


def main(root, out, *options):
    """Write sheet.png, index.html and seconds.json into OUT."""
    torch.set_num_threads(1)
    network, metadata = weights.load_parts(WEIGHTS, "cpu")
    settings = None if "--no-refine" in options else RefinementSettings()
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    rows, seconds, credits = [], {}, []
    for name, (path, mask, credit) in sources(root).items():
        tiles, seconds[name] = row(name, path, mask, network, metadata["size"], settings)
        rows.append(tiles)
        credits.append(f"<li>{name}: {credit}</li>")
        print(f"{name}: {seconds[name]:.1f} s", flush=True)
        files.write_image(
            out / "sheet.png", montage.eight_bit(montage.contact_sheet(rows, TILE)), "PNG"
        )
    files.write_json(out / "seconds.json", seconds)
    body = ['<img src="sheet.png" alt="photographs and edits">', "<ul>", *credits, "</ul>"]
    files.write_text(out / "index.html", html.page("Edited photographs", body))


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
