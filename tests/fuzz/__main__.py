"""`python -m tests.fuzz [GENERATOR …]`: fuzz for some minutes, or one case again. Exit status 1 if
there was a fault.
"""

import argparse
import itertools
import json
import re
import shlex
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

from . import Outcome, driver

KEPT = 3  # faults of one kind whose files are kept


def main(arguments: list[str] | None = None) -> int:
    """Fuzz, and say what was found; 0 without a fault, 1 with one."""
    options = parsed(arguments)
    limits = driver.Limits(options.seconds, options.memory_mb)
    result = driver.generators(options.generators)
    driver.warm_up()
    with driver.Driver(result, options.seed, options.out, limits, options.jobs) as fuzzing:
        fuzzing.prepare()
        if options.case is not None:
            return _again(fuzzing, options)
        return _many(fuzzing, options)


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """The options; wrong ones end with status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description="Fuzz every format that is read, and the layer."
    )
    parser.add_argument(
        "generators",
        nargs="*",
        metavar="GENERATOR",
        help="modules of tests/fuzz; all if none is given",
    )
    parser.add_argument(
        "--minutes", type=float, default=10.0, metavar="M", help="for how long (default 10)"
    )
    parser.add_argument(
        "--cases",
        type=int,
        metavar="N",
        help="so many cases instead, shared out among the generators",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="of everything left to chance (default 0)"
    )
    parser.add_argument(
        "--case", type=int, metavar="I", help="only this case of one generator, with its output"
    )
    parser.add_argument(
        "--first",
        type=int,
        default=0,
        metavar="I",
        help="the case of each generator to begin with (default 0)",
    )
    parser.add_argument(
        "--jobs", type=int, default=2, metavar="N", help="cases side by side (default 2)"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        metavar="T",
        help="after which a case hangs (default 60)",
    )
    parser.add_argument(
        "--memory-mb",
        type=int,
        default=1024,
        metavar="MIB",
        help="beyond which it is too much (default 1024)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/fuzz"),
        metavar="DIR",
        help="where faults are kept (default out/fuzz)",
    )
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="write a line of JSON for each case"
    )
    options = parser.parse_args(arguments)
    options.out = options.out.resolve()
    if options.case is not None and len(options.generators) != 1:
        parser.error("--case needs the name of one generator")
    return options


def order(result: dict, options: argparse.Namespace, spent: Counter) -> Iterator[tuple[str, int]]:
    """(generator, index): shared out by count with --cases, by the time they take with
    --minutes.
    """
    following = dict.fromkeys(result, options.first)
    end = time.monotonic() + 60 * options.minutes
    for number in itertools.count():
        if options.cases is not None:
            if number >= options.cases:
                return
            name = list(result)[number % len(result)]
        else:
            if time.monotonic() >= end:
                return
            name = min(result, key=lambda each: (spent[each], following[each]))
            spent[name] += 0.01  # so that several begun at once are not of one generator
        yield name, following[name]
        following[name] += 1


def _many(fuzzing: driver.Driver, options: argparse.Namespace) -> int:
    """Run cases with a progress bar; each kind of fault is reported once, with its repetition."""
    kinds, counts, spent, begun = {}, Counter(), Counter(), time.monotonic()
    total = options.cases or round(60 * options.minutes)
    unit = "case" if options.cases else "s"
    with tqdm(
        total=total, desc="fuzzing", unit=unit, mininterval=0.1 if sys.stderr.isatty() else 10.0
    ) as bar:
        for outcome in fuzzing.run(order(fuzzing.found, options, spent)):
            counts[outcome.module] += 1
            if options.log:
                with open(options.log, "a") as log:
                    log.write(json.dumps(asdict(outcome)) + "\n")
            spent[outcome.module] += outcome.seconds
            if outcome.fault:
                kind = (outcome.module, kind_of(outcome.fault))
                kinds.setdefault(kind, []).append(outcome)
                if len(kinds[kind]) == 1:
                    bar.write(message(outcome, options.seed), file=sys.stdout)
                elif len(kinds[kind]) > KEPT:
                    driver._remove(
                        fuzzing.kept / f"{outcome.module}-{options.seed}-{outcome.index}"
                    )
            faults = sum(map(len, kinds.values()))
            bar.set_postfix_str(f"{counts.total()} cases, {faults} faults", refresh=False)
            bar.update(1 if options.cases else min(total, time.monotonic() - begun) - bar.n)
    faults = sum(map(len, kinds.values()))
    if changed := fuzzing.changed_seeds():
        faults += 1
        print(f"seeds were changed, so cases may depend on earlier ones: {', '.join(changed[:5])}")
    for (module, kind), outcomes in sorted(kinds.items(), key=lambda item: -len(item[1])):
        print(
            f"{len(outcomes):5} × {module}: {kind}: {', '.join(str(o.index) for o in outcomes[:8])}"
        )
    print(
        f"{counts.total()} cases of {len(fuzzing.found)} generators, seed {options.seed}: {faults}"
        f" faults of {len(kinds)} kinds"
    )
    print(
        "  " + ", ".join(f"{name} {counts[name]} in {spent[name]:.0f} s" for name in fuzzing.found)
    )
    if faults:
        print(f"Their files are in {fuzzing.kept}: fault.json says what was run.")
    return 1 if faults else 0


def kind_of(fault: str) -> str:
    """A fault without what differs from case to case: paths, numbers, quoted values."""
    line = fault.splitlines()[0]
    if match := re.match(r"traceback: (\w+ at [^ ]+:\d+)", line):
        return match[1]
    return re.sub(r"'[^']*'|\"[^\"]*\"|(/[\w.-]+)+|[-+]?\d[\d.e+-]*", "…", line)[:120]


def message(outcome: Outcome, seed: int) -> str:
    """A fault for people, with the command that shows it again."""
    again = f"python -m tests.fuzz {outcome.module} --seed {seed} --case {outcome.index}"
    return f"{outcome.module} {outcome.index}: {outcome.label}\n    {outcome.fault}\n    {again}"


def _again(fuzzing: driver.Driver, options: argparse.Namespace) -> int:
    """One case, with all it printed; its files are kept in any case."""
    name = options.generators[0]
    keep = fuzzing.kept / f"{name}-{options.seed}-{options.case}"
    fuzzing.keep_all = True
    (outcome,) = fuzzing.run([(name, options.case)])
    verdict = json.loads((keep / "fault.json").read_text())
    print(f"{outcome.label}")
    if verdict.get("command"):
        print("python -m " + shlex.join(verdict["command"]))
    for stream in ("stdout", "stderr"):
        if text := driver._text(keep / stream).strip():
            print(f"--- {stream}\n{text}")
    print(
        f"--- status {outcome.status}, {outcome.seconds:.2f} s, {outcome.memory >> 20} MiB; files"
        f" in {keep / 'room'}"
    )
    print(outcome.fault or "no fault")
    return 1 if outcome.fault else 0


if __name__ == "__main__":
    sys.exit(main())
