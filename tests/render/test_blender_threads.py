"""A process that renders on one thread takes no processor time while it waits."""

import os
import subprocess
import sys

import pytest

from factory.render.blender_threads import cores_of

# renders a sphere on one thread, and prints the share of a core that half a second of sleep takes
RENDER_AND_SLEEP = """
import os, time
from factory.render.blender_threads import importing_blender
with importing_blender(1):
    from factory.render.studio import Studio
from factory.shapes.catalogue import load
from manifests.schema import Camera
from shaders.mixture import Mixture
import numpy as np
studio = Studio("cpu", 1)
studio.set_camera(Camera(size=(16, 16)))
studio.set_shape(load("sphere"))
studio.set_light(np.ones((64, 128, 3), np.float32))
studio.set_materials([Mixture.lambert([0.5] * 3)])
studio.set_view(0.0)
studio.picture(1, 0, "direct")
start = time.process_time()
time.sleep(0.5)
print("share", (time.process_time() - start) / 0.5, len(os.sched_getaffinity(0)))
"""


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="Linux alone has affinities")
def test_one_thread_takes_no_time_while_it_waits_and_has_all_cores_again():
    done = subprocess.run(
        [sys.executable, "-c", RENDER_AND_SLEEP], capture_output=True, text=True, check=True
    )
    line = next(line for line in done.stdout.splitlines() if line.startswith("share"))
    _, share, cores = line.split()
    assert float(share) < 0.3  # 1.0 to 1.2 without the limit
    assert int(cores) == len(os.sched_getaffinity(0))


def test_workers_that_start_together_have_cores_of_their_own():
    cores = [2, 3, 5, 7]
    assert [cores_of(number, cores, 1) for number in range(40, 44)] == [{2}, {3}, {5}, {7}]
    assert [cores_of(number, cores, 2) for number in (40, 41)] == [{2, 3}, {5, 7}]
    assert cores_of(1, cores, 3) == {7, 2, 3}
    assert cores_of(7, cores, 9) == set(cores)
