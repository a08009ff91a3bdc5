"""Measure the page of `learn edit --interactive`: size, errors of its maps, frames per second.

Chromium draws by software (SwiftShader), without a graphics card. Each frame changes the blend of
two sharp materials, and is read back, so that it is complete. Choosing a material is timed from the
click to the complete frame. Run it on a page that the command wrote:

PYTHONPATH=. python tests/learn/measure_interactive.py PAGE [--frames N]
"""

import argparse
import json
import re
from pathlib import Path

import numpy as np

from tests.support.browser import Browser

FRAMES = """
const {state, draw, canvas, materials} = editPage, gl = canvas.getContext("webgl2");
const index = name => Math.max(0, materials.findIndex(m => m.name === name));
const pixel = new Uint8Array(4), times = [], choices = [];
const complete = () => {
  draw();
  if (gl) gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
};
const pair = [index("chrome"), index("brass")];
for (const region of state.regions) Object.assign(region, {materials: pair, blend: 0});
complete();
for (let i = 0; i < FRAMES; i++) {
  for (const region of state.regions) region.blend = i / FRAMES;
  const start = performance.now();
  complete();
  times.push(performance.now() - start);
}
for (let m = 0; m < Math.min(materials.length, 50); m++) {
  const start = performance.now();
  for (const region of state.regions) region.materials = [m, -2];
  editPage.refresh();
  complete();
  choices.push(performance.now() - start);
}
return {size: [canvas.width, canvas.height], webgl: editPage.webgl, times, choices};
"""


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("--frames", type=int, default=60)
    arguments = parser.parse_args()
    text = arguments.page.read_text("utf-8")
    header = json.loads(re.search(r'id="header">(.*?)</script>', text, re.S)[1])
    names = [material["name"] for material in header["materials"]]
    print(f"{len(text.encode()) / 1e6:.2f} MB, {len(names)} materials")
    for light in header["lights"]:
        errors, (sides, counts) = (
            np.array(light["errors"]),
            np.unique(light["sides"], return_counts=True),
        )
        worst = [f"{names[i]} {errors[i]:.1f}" for i in np.argsort(errors)[:-4:-1]]
        print(
            f"{light['name']}: {light['data'][1] / 1e6:.2f} MB; error in grey levels: median"
            f" {np.median(errors):.2f}, above 2: {(errors > 2).sum()}, worst {', '.join(worst)};"
            f" maps by side: {dict(zip(sides.tolist(), counts.tolist(), strict=True))}"
        )
    for fragment in ("", "#canvas"):
        with Browser() as window:
            window.open(arguments.page, fragment)
            window.wait("document.documentElement.dataset.ready")
            result = window.run(
                FRAMES.replace("FRAMES", str(arguments.frames if not fragment else 5))
            )
        width, height = result["size"]
        times = np.array(result["times"])
        # a frame's work grows with its pixels
        per_512 = times * 512**2 / (width * height)
        name = "WebGL" if result["webgl"] else "JavaScript"
        print(
            f"{name} at {width} × {height}: median {np.median(times):.1f} ms per frame; at 512²"
            f" {1000 / np.median(per_512):.0f} frames per second, and"
            f" {1000 / np.percentile(per_512, 10):.0f} in the fastest tenth; a material: median"
            f" {np.median(result['choices']):.0f}, worst {max(result['choices']):.0f} ms"
        )


if __name__ == "__main__":
    main()
