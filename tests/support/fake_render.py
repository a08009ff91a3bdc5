"""Carry a job out with the fake studio, as a process that can be killed.

python -m tests.support.fake_render JOB OUT CATALOGUE [SECONDS]

SECONDS are those between two parts, where OUT is a URL.
"""

import sys

from factory.execution import leases, uploads
from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning import jobs
from factory.planning.assets import resolve
from tests.support.tetrahedron import FAKE

if __name__ == "__main__":
    if len(sys.argv) > 4:
        uploads.SECONDS = float(sys.argv[4])
        leases.RENEWED, leases.EXPIRED, leases.PAUSE = 0.05, 1.0, 0.05
    job, folder = jobs.load(sys.argv[1])
    assets = resolve(job, folder, catalogues=[sys.argv[3]])
    carry_out(make_plan(job, assets), sys.argv[2], RunOptions(workers=2, studio=FAKE))
