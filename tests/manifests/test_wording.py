"""Numbers and their nouns, and that commands use them."""

import ast
import itertools
import re

import pytest

from factory.commands.render import outcome_line
from factory.execution.run import Outcome
from manifests.wording import number_of

NOUNS = "pictures|records|views|materials|lights|meshes|faults|samples|tars|maps|jobs|edits|files"
PLURAL = re.compile(rf" ({NOUNS})\b")


def counts_without_nouns(path):
    """The line of each f"{count} pictures", in which the number may be 1."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        parts = node.values if isinstance(node, ast.JoinedStr) else []
        for count, text in itertools.pairwise(parts):
            if not isinstance(count, ast.FormattedValue) or not isinstance(text, ast.Constant):
                continue
            is_rule = isinstance(count.value, ast.Name) and count.value.id.isupper()
            if PLURAL.match(text.value) and not is_rule:
                yield f"{path.name}:{node.lineno}: {text.value}"


def test_one_is_singular_and_none_and_many_are_plural():
    assert number_of(1, "picture") == "1 picture"
    assert number_of(0, "picture") == "0 pictures"
    assert number_of(2, "mesh", "meshes") == "2 meshes"
    assert number_of(3000, "byte", form=",") == "3,000 bytes"


def test_a_rendering_of_one_picture_says_so():
    assert outcome_line(Outcome(1, 0, 0), "out") == "1 picture made in out"
    assert outcome_line(Outcome(0, 0, 1), "out", "view") == (
        "0 views made in out, 1 was there already"
    )
    assert outcome_line(Outcome(2, 0, 3), "out") == "2 pictures made in out, 3 were there already"


def test_a_count_beside_a_plural_is_seen(tmp_path):
    (tmp_path / "a.py").write_text('print(f"{count} pictures of {MOST} files, {n} viewsets")')
    assert list(counts_without_nouns(tmp_path / "a.py")) == ["a.py:1:  pictures of "]


@pytest.mark.parametrize("package", ["factory", "learn"])
def test_no_command_prints_a_count_that_may_be_one_beside_a_plural(package, root):
    paths = sorted((root / package / "commands").glob("*.py"))
    assert len(paths) > 8
    assert [text for path in paths for text in counts_without_nouns(path)] == []
