"""--weights takes a file, or the name of weights that come with the program."""

import argparse
from pathlib import Path

import pytest

from learn.commands import options
from learn.networks import weights


@pytest.mark.parametrize("path", sorted(options.WEIGHTS_FOLDER.glob("*.safetensors")))
def test_the_programs_own_weights_are_named_by_their_stem(path: Path) -> None:
    parser = argparse.ArgumentParser()
    options.add_weights(parser)
    assert parser.parse_args(["--weights", path.stem]).weights == path
    assert parser.parse_args(["--weights", str(path)]).weights == path
    help_text = " ".join(parser.format_help().split()).replace("- ", "-")
    assert path.stem in help_text


def test_any_other_text_is_a_file() -> None:
    for text in (
        "run/joint-compact",
        "../weights/joint-compact",
        "weights.safetensors",
        "no-such-weights",
    ):
        assert options.weights_file(text) == Path(text)


@pytest.mark.parametrize("default", [options.EDITING_WEIGHTS, options.TABLE_WEIGHTS])
def test_the_default_weights_come_with_the_program(default: Path) -> None:
    parser = argparse.ArgumentParser()
    options.add_weights(parser, default)
    assert parser.parse_args([]).weights == default and default.exists()
    assert f"(default: {default.stem})" in " ".join(parser.format_help().split()).replace("- ", "-")


def test_each_of_the_programs_weights_is_read_with_its_own_light_head() -> None:
    wraps = {
        path.stem: weights.load_network(path)[0].wraps
        for path in options.WEIGHTS_FOLDER.glob("*.safetensors")
    }
    assert wraps == {
        "joint-compact": False,
        "general-compact": True,
        "general-two-encoders": True,
    }
