"""Measure how fast the page of `brdfactory app` shows a change, in headless Chromium.

The photograph is the example at 512². Each change is timed in the page, from the event until the
browser has decoded the new picture: materials from the gallery, blends, turned and other lights.
What was shown before is not shown again, so that no kept map helps. Each change waits until the
exact view of the one before is there, unless --hurry.

--first times the first edit instead, without a browser: from the button of step 1 to the exact view
of a first material, without and with refinement, in turn, and states the processor's seconds too.

PYTHONPATH=. python tests/learn/measure_app.py [--count N] [--hurry] [--picture FILE.jpg]
    [--clicks | --first]
"""

import argparse
import io
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt

from learn.app import choices, gallery, page
from learn.app.background_decomposition import Network
from learn.app.choices import Painted
from learn.app.sessions import Sessions
from learn.commands.options import EDITING_WEIGHTS
from learn.data import photographs
from learn.editing import photograph
from learn.selection.marks import Selection
from tests.support.browser import Browser

# runs ACT and returns the milliseconds until the new result is decoded
TIMED = """
const images = () => [...document.querySelectorAll('#editor img')];
const shown = () => images().find(i => i.src.includes('view-'));
const before = shown()?.src, start = performance.now();
ACT
while (!(shown() && shown().src !== before)) await new Promise(r => setTimeout(r, 4));
await shown().decode().catch(() => null);
return performance.now() - start;
"""
SET = """
const i = document.querySelector('SELECTOR input[type=range]');
Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(i, VALUE);
i.dispatchEvent(new Event('input', {bubbles: true}));
"""
PICK = "document.querySelectorAll('#materials button')[NUMBER].click();"


def changes(count: int) -> list[tuple[str, str]]:
    """Return (kind, JavaScript) of the changes."""
    rng = np.random.default_rng(0)
    materials = rng.permutation(len(gallery.search("")))
    result = []
    for number in range(count):
        kind = ("material", "blend", "light")[number % 3]
        if kind == "material":
            act = PICK.replace("NUMBER", str(materials[number]))
        elif kind == "blend":
            value = 5 + (37 * number) % 90
            act = SET.replace("SELECTOR", "#share").replace("VALUE", str(value))
        else:
            value = -170 + (67 * number) % 340
            act = SET.replace("SELECTOR", "#rotation").replace("VALUE", str(value))
        result.append((kind, act))
    return result


def selection_by_clicks(count: int = 14) -> None:
    """Print how well a simulated user marks the example, who clicks into the largest error."""
    path, regions = photograph.resolve_example("example:espresso-cup", [], None)
    assert regions is not None
    with Image.open(path) as picture:
        display = np.asarray(picture.convert("RGB"))
    truth = photographs.read_labels(regions, display.shape[:2])
    selection, labels = Selection(display), np.zeros_like(truth)
    for number in range(count):
        depth = distance_transform_edt(np.pad(labels != truth, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        selection.click(int(column), int(row), int(truth[row, column]))
        start = time.perf_counter()
        labels = selection.labels()
        seconds = time.perf_counter() - start
        pairs = [(labels > 0, truth > 0), *((labels == k, truth == k) for k in (1, 2))]
        shares = [(a & b).sum() / (a | b).sum() for a, b in pairs]
        print(
            f"click {number + 1}: intersection over union {shares[0]:.2f}, cup {shares[1]:.2f},"
            f" saucer {shares[2]:.2f}; {1000 * seconds:.0f} ms"
        )


def first_edits(count: int = 2) -> None:
    """Print how long a first edit of the example takes, without and with refinement."""
    seconds: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as name:
        sessions = Sessions(Path(name), Network(EDITING_WEIGHTS))
        sessions.network.loaded()
        for number in range(count + 1):
            for refine, times in seconds.items():
                if not number and refine:
                    continue
                session = sessions.begin(f"{number} {refine}")
                session.load_example()
                start = time.perf_counter(), time.process_time()
                for _ in session.decompose(refine):
                    pass
                brass = Painted(choices.named_material("brass"))
                session.choose(lambda edit, brass=brass: edit.with_region(0, brass))
                viewer, edit = session.decomposed()
                viewer.view(edit, exact=True)
                if number:  # the first one compiles
                    times.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    for refine, each in seconds.items():
        words = "with refinement" if refine else "without refinement"
        for title, times in zip(
            ("elapsed", "of the processor"), zip(*each, strict=True), strict=True
        ):
            every = ", ".join(f"{value:.1f}" for value in times)
            print(f"first edit {words}: median {np.median(times):.1f} s ({every}), {title}")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--hurry", action="store_true", help="do not wait for exact views")
    parser.add_argument("--picture", type=Path, help="write a screenshot")
    parser.add_argument("--clicks", action="store_true", help="measure the selection alone")
    parser.add_argument("--first", action="store_true", help="measure the first edit alone")
    arguments = parser.parse_args()
    if arguments.first:
        first_edits()
        return
    if arguments.clicks:
        selection_by_clicks()
        return
    path, regions = photograph.resolve_example("example:espresso-cup", [], None)
    assert regions is not None
    address, end = page.serve(EDITING_WEIGHTS, wait=False)
    exact = "document.querySelector('#shown').innerText.includes('Exact view')"
    try:
        with tempfile.TemporaryDirectory() as name, Browser(1300, 1300) as window:
            photo, mask = Path(name) / "cup.png", Path(name) / "regions.png"
            with Image.open(path) as picture:
                picture.convert("RGB").crop((100, 0, 500, 400)).resize((512, 512)).save(photo)
            with Image.open(regions) as picture:
                cut = picture.crop((100, 0, 500, 400))
                cut.resize((512, 512), Image.Resampling.NEAREST).save(mask)
            window.visit(address)
            for label, file in (("Choose a photograph", photo), ("File of parts", mask)):
                selector = f'input[data-testid="{label}-upload-button"]'
                window.wait(f"document.querySelector('{selector}')")
                window.type(selector, str(file))
                said = "click on the object" if file == photo else "from the file"
                window.wait(f"document.querySelector('#status').innerText.includes('{said}')")
            window.click("#decompose")
            window.wait("document.querySelector('#editor img')")
            time.sleep(2)
            # a first and a second material
            for number, slot in ((140, 0), (60, 1)):
                window.run(f"document.querySelectorAll('#slot input')[{slot}].click()")
                window.run(TIMED.replace("ACT", PICK.replace("NUMBER", str(number))))
                window.wait(exact)
            window.run("document.querySelectorAll('#slot input')[0].click()")
            times: dict[str, list[float]] = {}
            for kind, act in changes(arguments.count):
                times.setdefault(kind, []).append(window.run(TIMED.replace("ACT", act)))
                if not arguments.hurry:
                    window.wait(exact)
            if arguments.picture:
                shot = Image.open(io.BytesIO(window.screenshot())).convert("RGB")
                shot.save(arguments.picture, quality=80)
    finally:
        end()
    every = np.concatenate([np.array(each) for each in times.values()])
    for kind, each in [("all", every), *times.items()]:
        print(
            f"{kind}: {len(each)} changes, median {np.median(each):.0f} ms, 9 of 10 within"
            f" {np.percentile(each, 90):.0f} ms, worst {np.max(each):.0f} ms"
        )


if __name__ == "__main__":
    main()
