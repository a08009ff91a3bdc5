"""A published figure names the commit that made it, and says when the code differed from it."""

import shutil
import subprocess
from pathlib import Path

import pytest

from manifests import provenance


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout of one Python file, in which provenance lies."""
    if shutil.which("git") is None:
        pytest.skip("needs git")
    (tmp_path / "package").mkdir()
    module = tmp_path / "package" / "provenance.py"
    module.write_text("a = 1\n")
    for arguments in (
        ("init", "--quiet"),
        ("add", "."),
        ("-c", "user.name=A", "-c", "user.email=a@b.c", "commit", "--quiet", "-m", "first"),
    ):
        subprocess.run(["git", *arguments], cwd=tmp_path, check=True)
    monkeypatch.setattr(provenance, "__file__", str(module))
    return module


def test_an_unchanged_checkout_is_named_by_its_commit_alone(checkout: Path):
    head = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=checkout.parent,
        check=True,
        capture_output=True,
        text=True,
    )
    assert provenance.commit() == head.stdout.strip()
    (checkout.parent / "notes.txt").write_text("no code")
    assert "changes" not in provenance.commit()


def test_a_changed_python_file_is_said(checkout: Path):
    checkout.write_text("a = 2\n")
    assert provenance.commit().endswith(", with changes")


def test_outside_a_checkout_there_is_no_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "provenance.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.commit() == "none"


def test_a_published_command_has_no_folders_of_this_machine():
    given = ["/a/b=c/d", "x=/a/w.safetensors", "--out=/a/b", "x=a/b", "a/b", "--size"]
    expected = ["…/d", "x=…/w.safetensors", "--out=…/b", "x=a/b", "a/b", "--size"]
    assert [provenance.shorten(word) for word in given] == expected


def test_words_with_spaces_can_be_typed_as_they_are_published(monkeypatch):
    monkeypatch.setattr("sys.argv", ["main", "run", "two words=/a/b.json", "--out", "c"])
    command = provenance.own_command()
    assert command.endswith("run 'two words=…/b.json' --out c")
