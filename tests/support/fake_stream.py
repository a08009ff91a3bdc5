"""Carry a job out with the fake studio, as a process that can be killed; all of its shapes are read
by processes of their own.

python -m tests.support.fake_stream JOB OUT CATALOGUE [I/N]

I/N is the part of a job array.
"""

import sys

from factory.execution.run import RunOptions, carry_out, make_plan, parse_shard
from factory.planning import jobs, reading
from factory.planning.assets import resolve_unread
from tests.support.tetrahedron import FAKE

if __name__ == "__main__":
    reading.HERE = 0.0
    job, folder = jobs.load(sys.argv[1])
    assets = resolve_unread(job, folder, catalogues=[sys.argv[3]])
    shard = parse_shard(sys.argv[4]) if len(sys.argv) > 4 else None
    run_options = RunOptions(workers=2, studio=FAKE, shard=shard)
    carry_out(make_plan(job, assets), sys.argv[2], run_options)
