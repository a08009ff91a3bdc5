"""Times the stages of one edit, and compares looked-up radiance with radiance rendered per pixel.

OMP_NUM_THREADS=1 PYTHONPATH=. python tests/learn/measure_edit_time.py PHOTO MASK

Pixels are rendered with all lobes of a material at once, which is slower than what an edit does.
Seconds are processor seconds, so that other programs disturb little; with one thread they are what
an idle machine's clock would show. Differences are in grey levels over the frame.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

MATERIALS = ("brass", "chrome", "gold-metallic-paint3", "red-specular-plastic", "white-fabric")


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return a call's result and its processor seconds."""
    start = time.process_time()
    return call(), time.process_time() - start


def main() -> None:
    """Print the stages' seconds, then a row for each material."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("photo", type=Path)
    parser.add_argument("mask", type=Path)
    parser.add_argument("--material", nargs="+", default=list(MATERIALS))
    options = parser.parse_args()
    start = time.process_time()
    import numpy as np

    import learn.__main__ as program
    from learn.commands.options import EDITING_WEIGHTS
    from learn.editing import (
        DETAIL,
        decomposition,
        drawing,
        photograph,
        reflectance_store,
        targets,
    )
    from learn.editing.compositor import Compositor
    from learn.networks import weights
    from learn.refinement import PHOTOGRAPHS
    from shaders import tone

    imports = time.process_time() - start
    program.prepare()
    (parts, _), loading = timed(lambda: weights.load_full_network(EDITING_WEIGHTS))
    opened, reading = timed(lambda: photograph.open_photograph(str(options.photo), [options.mask]))
    print(
        f"{'imports':24}{imports:7.2f}\n{'weights':24}{loading:7.2f}\n{'reading':24}{reading:7.2f}"
    )
    _, seconds = timed(lambda: decomposition.decompose(opened, parts, 128, None))
    print(f"{'prediction':24}{seconds:7.2f}")
    result, both = timed(lambda: decomposition.decompose(opened, parts, 128, PHOTOGRAPHS))
    print(f"{'refinement':24}{both - seconds:7.2f}")
    painter = Compositor(result, detail=DETAIL)

    def measure_rendered(stage: Callable[[], Any]) -> tuple[Any, float]:
        """Return as `timed`, of a stage that renders each pixel with all lobes at once."""
        always = reflectance_store.LOOKED_UP, reflectance_store.separate_lobes
        reflectance_store.LOOKED_UP = ()
        reflectance_store.separate_lobes = lambda label: [(label, "")]
        try:
            return timed(stage)
        finally:
            reflectance_store.LOOKED_UP, reflectance_store.separate_lobes = always

    print(f"\n{'':24}{'looked up':>12}{'rendered':>12}{'difference':>12}")
    stages = {
        "own material": lambda: painter.radiance(painter.own_labels),
        "reflectance maps": lambda: drawing.reflectance_maps(result),
    }
    for name, stage in stages.items():
        print(f"{name:24}{timed(stage)[1]:12.2f}{measure_rendered(stage)[1]:12.2f}")
    painter.own_radiance()
    for name in options.material:
        label = targets.resolve_labels(name, None)[0]

        def edit(label: np.ndarray = label) -> np.ndarray:
            return painter.edit([label])

        (fast, short), (slow, long) = timed(edit), measure_rendered(edit)
        error = tone.display(fast, 1.0) - tone.display(slow, 1.0)
        print(f"{name:24}{short:12.2f}{long:12.2f}{np.sqrt((error**2).mean()):12.3f}")


if __name__ == "__main__":
    main()
