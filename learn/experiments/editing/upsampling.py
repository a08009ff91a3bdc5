"""Compare strategies that bring an edit to the photograph's own size, and levels of --detail.

Rendered pictures larger than the network's size, whose truth is known, are edited by the strategy
in use, with detail carried over, and by other strategies; with our decomposition and with the true
one. The figures are display L2 and SSIM over the object. rows.jsonl keeps a line per edit: the same
command continues, and a larger --edits adds to it.
"""

from __future__ import annotations

import argparse

from learn.commands import options
from learn.experiments import runner

ON_RAY = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of edits."""
    options.add_data(parser, "a data set of large pictures, each scene in two materials or more")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(parser, "--edits", 24, "number of edits")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"about", "parts": {"ours" | "true": {strategy: figures with intervals}}}."""
    import torch

    from learn.data.records import Records
    from learn.experiments.editing import upsampling_comparison

    torch.set_num_threads(1)
    return upsampling_comparison.compare(
        Records(arguments.data), arguments.weights, arguments.out, arguments.edits
    )


def tables(report: runner.Report) -> str:
    """Return each strategy's L2 and SSIM beside those of the strategy in use."""
    rows = [
        [
            parts,
            name,
            f"{row['l2'][0]:.0f}",
            runner.interval(row["l2_ratio"]),
            f"{row['ssim'][0]:.3f}",
            runner.interval(row["ssim_gain"]),
        ]
        for parts, strategies in report["parts"].items()
        for name, row in strategies.items()
    ]
    about = report["about"]
    head = ["decomposition", "strategy", "display L2", "ratio to the first", "SSIM", "gain"]
    return (
        "# Strategies of upsampling\n\n"
        f"{about['edits']} edits of {about['size'][0]}² pixels, network of {about['network']}²;"
        " 95 % intervals over shapes and materials. The first strategy is the one in use.\n\n"
        + runner.table(head, rows)
    )
