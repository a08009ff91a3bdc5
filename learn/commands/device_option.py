"""The option `--device` of commands that run a network or the layer."""

import argparse

CHOICES = ("auto", "cpu", "cuda")  # those of learn.data.devices, which needs torch to be read


def add(parser: argparse.ArgumentParser) -> None:
    """Add `--device` to a parser; options.device is then one of CHOICES."""
    parser.add_argument(
        "--device",
        choices=CHOICES,
        default="auto",
        help=(
            "where networks and the layer compute (default auto: cuda if torch sees a CUDA device,"
            " else cpu)"
        ),
    )
