"""Requirements for pip: every Python that the project admits has its pins.

Every package says that it is typed.
"""

import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

PYTHONS = ("3.11", "3.12", "3.13")


@pytest.fixture(scope="module")
def project(root):
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_project_admits_the_pythons_it_was_tried_on_and_no_other(project):
    admitted = SpecifierSet(project["project"]["requires-python"])
    assert [f"3.{minor}" for minor in range(9, 16) if f"3.{minor}.1" in admitted] == list(PYTHONS)


@pytest.mark.parametrize("python", PYTHONS)
def test_each_python_has_one_pin_for_each_package_and_for_all_that_is_asked_for(
    root, project, python
):
    lines = (root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    here = [
        pin for pin in pins if pin.marker is None or pin.marker.evaluate({"python_version": python})
    ]
    names = [pin.name.lower() for pin in here]
    assert sorted(set(names)) == sorted(names)
    extras = project["project"]["optional-dependencies"]
    asked = [
        Requirement(text)
        for text in [*project["project"]["dependencies"], *extras["learn"], *extras["dev"]]
    ]
    for requirement in asked:
        (pin,) = [pin for pin in here if pin.name.lower() == requirement.name.lower()]
        (version,) = [specifier.version for specifier in pin.specifier]
        assert version in requirement.specifier


def test_every_package_is_marked_as_typed_and_the_mark_is_installed(root, project):
    setuptools = project["tool"]["setuptools"]
    for pattern in setuptools["packages"]["find"]["include"]:
        assert (root / pattern.rstrip("*") / "py.typed").is_file()
    assert "py.typed" in setuptools["package-data"]["*"]
