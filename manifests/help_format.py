"""The layout of a command's help: one-line texts are wrapped, others stay as written."""

import argparse


class HelpFormatter(argparse.HelpFormatter):
    """A formatter that wraps one-line descriptions and leaves the lines of an epilog alone."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" not in text:
            return super()._fill_text(text, width, indent)
        return "".join(indent + line for line in text.splitlines(keepends=True))
