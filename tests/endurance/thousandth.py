"""A thousandth of the paper's 720,000 pictures is rendered: does it take as long as planned?

    PYTHONPATH=. python tests/endurance/thousandth.py --out DIR [--size PIXELS] [--presets NAME …]
    [--minutes M]

For each preset, pictures are timed as `brdfactory plan` does; then a thousandth of the job
is rendered with one worker of one thread, and pictures are timed again, since other work on
the machine may have changed. DIR/report.json has, for each preset,

kinds     seconds of each kind of work, once: as the plan has it before and after, and measured
sample    seconds of the whole sample: those kinds times how often each occurred in it, and measured
hours     of one core for the whole job, by the plan and by what the sample measured
processor the same two in seconds of a processor, of all kinds together, as the plan has them and
          measured: on a machine that other programs use, these are what can be compared

The sample has runs of RUN successive pictures, each of another shape and light, because successive
pictures share what is expensive to change. The same command continues a stopped run; --minutes ends
it early, and what was made is reported.
"""

import argparse
import os
import sys
import time
from collections import defaultdict
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import msgspec

from factory.execution.forecast import count_events, probe
from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning import jobs
from factory.planning.assets import resolve
from factory.planning.plan import Plan
from manifests import files, outputs
from manifests.line_files import Lines
from manifests.provenance import provenance, shorten
from manifests.subprocesses import processors

RUN = 30
ONE_WORKER = RunOptions(workers=1, threads=1)


@dataclass(frozen=True)
class Sample(Plan):
    """A plan of which only runs of RUN pictures are made, about `share` of all."""

    share: float = 1 / 1000

    def __len__(self):
        return RUN * self.runs

    @property
    def runs(self):
        """How many runs there are."""
        return max(1, round(Plan.__len__(self) * self.share / RUN))

    def __iter__(self):
        """Yield the shots: run k is of another shape and light than run k − 1."""
        shapes = self.assets.shapes
        for k in range(self.runs):
            light = self.lights[k % len(self.lights)]
            group = self.shots_under(shapes[k * len(shapes) // self.runs], *light)
            start = (k * len(group) // self.runs) // RUN * RUN
            start = min(start, len(group) - RUN)
            yield from group[start : start + RUN]


class Late(Exception):
    """The minutes are over."""


def costs(plan):
    """{kind of work: seconds, once} as `plan` measures it, and the job's seconds of a processor."""
    forecast, events = probe(plan, ONE_WORKER), count_events(plan)
    return {kind: s / events[kind] for kind, s in forecast.seconds.items()}, forecast.computed


def rendered(sample, folder, rows, end):
    """Make what is missing of a sample, a row for each picture; nothing after `end`."""
    with closing(Lines(rows)) as lines:

        def watch(event, value):
            if event == "made":
                row = {"id": value.made, "seconds": value.seconds, "spent": value.spent}
                lines.append(row | {"computed": value.computed, "load": os.getloadavg()[0]})
            if event == "failed":
                print(value, flush=True)
            if time.monotonic() > end:
                raise Late

        try:
            carry_out(sample, folder, ONE_WORKER, watch)
        except Late:
            print("the minutes are over", flush=True)


def summary(plan, rows, before, after):
    """The figures of a preset, from its rows and both plans."""
    (before, computed_before), (after, computed_after) = before, after
    spent, computed, times = defaultdict(float), defaultdict(float), defaultdict(int)
    for row in rows:
        for kind, seconds in row["spent"].items():
            spent[kind] += seconds
            computed[kind] += row["computed"][kind]
            times[kind] += 1
    events = count_events(plan)
    measured = {kind: spent[kind] / times[kind] for kind in spent}
    middle = {kind: (before[kind] + after.get(kind, before[kind])) / 2 for kind in before}
    of_sample = sum(middle.get(kind, 0.0) * times[kind] for kind in times)
    return {
        "pictures": len(rows),
        "of": len(plan),
        "size": plan.job.camera.size[0],
        "kinds": {
            kind: {
                "before": before.get(kind),
                "after": after.get(kind),
                "measured": measured[kind],
                "times": times[kind],
            }
            for kind in measured
        },
        "load": [min(row["load"] for row in rows), max(row["load"] for row in rows)],
        "processor": {
            "hours_before": computed_before / 3600,
            "hours_after": computed_after / 3600,
            "hours_measured": sum(computed[k] / times[k] * events[k] for k in times) / 3600,
            "kinds": {kind: computed[kind] / times[kind] for kind in times},
        },
        "sample": {"planned": of_sample, "measured": sum(row["seconds"] for row in rows)},
        "hours": {
            name: sum(each.get(kind, 0.0) * events[kind] for kind in events) / 3600
            for name, each in (("before", before), ("after", after), ("measured", measured))
        },
    }


def main():
    """Render and report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--presets", nargs="+", default=["pretrain", "finetune"])
    parser.add_argument("--size", type=int, default=256, help="of the pictures (default 256)")
    parser.add_argument("--share", type=float, default=1 / 1000, help="of the job (default 1/1000)")
    parser.add_argument("--minutes", type=float, default=1e6, help="end after so many")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/thousandth.py {words}")
    report = {"made_by": made_by, "presets": {}}
    end = time.monotonic() + 60 * options.minutes
    for name in options.presets:
        job, folder = jobs.load(jobs.presets()[name])
        camera = msgspec.structs.replace(job.camera, size=(options.size, options.size))
        job = msgspec.structs.replace(job, camera=camera)
        plan = make_plan(job, resolve(job, folder, processes=processors()))
        sample = Sample(plan.job, plan.assets, plan.fingerprint, options.share)
        before, rows = costs(plan), options.out / f"{name}.jsonl"
        rendered(sample, options.out / name, rows, end)
        made = list(outputs.read_lines(rows))
        report["presets"][name] = summary(plan, made, before, costs(plan))
        files.write_json(options.out / "report.json", report)
        print(msgspec.json.format(msgspec.json.encode(report["presets"][name])).decode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
