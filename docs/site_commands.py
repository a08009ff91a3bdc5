"""The site's pages of commands, made from the argument parsers."""

import argparse
import html
import textwrap
from collections.abc import Callable, Iterator

from site_cells import COLUMNS, cell

from brdfactory import command_line
from learn.experiments import __main__ as experiments

WIDTH = 88


def command_page() -> str:
    """Return the page of `brdfactory`'s commands, in the groups of its help."""
    parsers = _parsers(command_line.parser())
    page = [
        "# Command line",
        f"{command_line.DESCRIPTION} `python -m factory COMMAND` and `python -m learn COMMAND` are"
        " the same commands. Every command has `--help`. The exit status is 0 for success, 1 for"
        " bad input, which ends in one line with the remedy, and 2 for wrong usage, unless the"
        " command says otherwise.",
        "This page is made from the argument parsers.",
    ]
    for title, commands in command_line.GROUPS.items():
        page.append(f"## {title[:1].upper()}{title[1:]}")
        for command in commands:
            page += _command(parsers[command], f"brdfactory {command}", 3)
    return "\n\n".join(page) + "\n"


def experiments_page() -> str:
    """Return the page of the commands that measure what docs/results holds."""
    parser = argparse.ArgumentParser(prog="python -m learn.experiments")
    subparsers = parser.add_subparsers()
    page = [
        "# Command line of the experiments",
        "These commands make the figures of [the reports](../results/index.md). This page is made"
        " from the argument parsers.",
    ]
    for register in experiments.COMMANDS.values():
        register(subparsers)
    for title, commands in experiments.GROUPS.items():
        page.append(f"## {title}")
        for command in commands:
            name = f"python -m learn.experiments {command}"
            page += _command(subparsers.choices[command], name, 3, command)
    return "\n\n".join(page) + "\n"


def _parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return {name: each for action in _subcommands(parser) for name, each in action.choices.items()}


def _subcommands(parser: argparse.ArgumentParser) -> list[argparse._SubParsersAction]:
    return [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]


def _command(
    parser: argparse.ArgumentParser, name: str, level: int, title: str = ""
) -> Iterator[str]:
    """Yield the paragraphs of one command and of its actions."""

    def formatter(prog: str) -> argparse.HelpFormatter:
        return argparse.HelpFormatter(prog, width=WIDTH)

    parser.formatter_class = formatter
    shown = formatter(parser.prog)
    title = title or name.removeprefix("brdfactory ")
    yield f"{'#' * level} {title}"
    described, _, example = (parser.description or "").partition("Example: ")
    yield html.escape(described.strip(), quote=False).replace("*", r"\*")
    usage = parser.format_usage().removeprefix("usage: ").replace("\n       ", "\n")
    yield f"```text\n{usage.rstrip()}\n```"
    for group in parser._action_groups:
        actions = [
            action
            for action in group._group_actions
            if not isinstance(action, argparse._HelpAction | argparse._SubParsersAction)
        ]
        if actions:
            rows = [_option(shown, action) for action in actions]
            if group.title not in ("positional arguments", "options"):
                yield f"{str(group.title).capitalize()}:"
            yield "\n".join([COLUMNS, *rows])
    if parser.epilog:
        yield f"```text\n{textwrap.dedent(parser.epilog).strip()}\n```"
    if example:
        yield f"```text\n{example.strip()}\n```"
    for action in _subcommands(parser):
        for word, each in action.choices.items():
            yield from _command(each, f"{name} {word}", level + 1, f"{title} {word}")


def _option(shown: argparse.HelpFormatter, action: argparse.Action) -> str:
    """Return the row of one argument; of two spellings, the metavar follows the last."""
    words = ", ".join(action.option_strings)
    value = "" if action.nargs == 0 else shown._format_args(action, _metavar(shown, action))
    name = f"{words} {value}".strip()
    return f"| `{name}` | {cell(shown._expand_help(action))} |"


def _metavar(shown: argparse.HelpFormatter, action: argparse.Action) -> str:
    is_option = bool(action.option_strings)
    get: Callable[[argparse.Action], str] = (
        shown._get_default_metavar_for_optional
        if is_option
        else shown._get_default_metavar_for_positional
    )
    return get(action)
