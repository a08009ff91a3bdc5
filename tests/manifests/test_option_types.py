"""Numbers of the command line: what is refused ends in a line that says what was expected."""

import argparse

import pytest

from manifests.help_format import HelpFormatter
from manifests.option_types import above_zero, positive, whole


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (positive, "1", 1),
        (whole, "0", 0),
        (whole, "9" * 19, 10**19 - 1),
        (above_zero, "1e-3", 1e-3),
    ],
)
def test_a_number_is_read(kind, text, value):
    assert kind(text) == value


@pytest.mark.parametrize(
    ("kind", "texts", "expected"),
    [
        (
            positive,
            ("0", "-1", "1.5", "x", "", "9" * 10, "٣", "1_0"),
            "a whole number of 1 or more",
        ),
        (whole, ("-1", "1.5", "x", "", "9" * 5000), "a whole number of 0 or more"),
        (above_zero, ("0", "-1", "nan", "inf", "x", ""), "a number above 0"),
    ],
)
def test_what_is_no_such_number_is_refused_with_the_reason(kind, texts, expected):
    for text in texts:
        with pytest.raises(argparse.ArgumentTypeError) as error:
            kind(text)
        assert str(error.value) == f"expected {expected}, found '{text}'"


def test_help_wraps_a_description_and_leaves_examples_alone():
    epilog = "examples:\n  one   two\n    three"
    parser = argparse.ArgumentParser(
        description="word " * 60, epilog=epilog, formatter_class=HelpFormatter
    )
    text = parser.format_help()
    assert epilog in text
    assert max(map(len, text.splitlines())) < 200
