"""The help of `python -m factory`: each command and action has an example that can be given so."""

import argparse
import importlib
import re
import shlex

import pytest

from factory.__main__ import COMMANDS


def parsers():
    """{words: parser} of every command and of every action of a command, and the whole parser."""
    whole = argparse.ArgumentParser(prog="python -m factory")
    subparsers = whole.add_subparsers(required=True)
    for name in COMMANDS:
        importlib.import_module(f"factory.commands.{name}").register(subparsers)
    result = {}

    def walk(parser, words):
        result[words] = parser
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for name, inner in action.choices.items():
                    walk(inner, (*words, name))

    for name, parser in subparsers.choices.items():
        walk(parser, (name,))
    return whole, result


WHOLE, PARSERS = parsers()


@pytest.mark.parametrize("words", PARSERS, ids=" ".join)
def test_help_has_examples_that_can_be_given(words):
    lines = re.findall(r"^ +python -m factory (.*?)(?:  .*)?$", PARSERS[words].format_help(), re.M)
    assert lines
    for line in lines:
        given = shlex.split(line)
        assert tuple(given[: len(words)]) == words
        WHOLE.parse_args(given)  # ends the process where it is wrong usage


@pytest.mark.parametrize("words", PARSERS, ids=" ".join)
def test_every_option_says_what_it_means(words):
    parser = PARSERS[words]
    assert parser.description.endswith(".")
    silent = [a for a in parser._actions if not a.help]
    assert all(isinstance(a, argparse._SubParsersAction) for a in silent)
