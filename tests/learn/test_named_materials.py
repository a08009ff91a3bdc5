"""Materials by name: how bright those of the catalogue are, and those that are described."""

import numpy as np
import pytest
import torch

from learn.editing import targets
from learn.editing.material_expression import fit_expression
from learn.layer.albedo import lobe_albedos
from manifests.described_materials import DESCRIBED
from manifests.errors import InputError
from manifests.materials import CALIBRATIONS, find, load_catalogue
from shaders import errors
from shaders.samples import held_out_samples
from shaders.tone import LUMINANCE

(MERL,) = CALIBRATIONS


def albedo(label):
    """The share (3,) of light that a surface reflects, seen along its normal."""
    return lobe_albedos(torch.as_tensor(np.asarray(label, np.float64).reshape(-1))).sum(-1).numpy()


def test_merls_white_materials_were_measured_at_a_third_of_others():
    whitest = {
        merl: max(
            albedo(material.label) @ LUMINANCE
            for material in load_catalogue().values()
            if (material.source == MERL) == merl
        )
        for merl in (True, False)
    }
    assert whitest[True] == pytest.approx(0.348, abs=0.001)
    assert whitest[False] == pytest.approx(0.960, abs=0.001)


def test_calibrated_materials_of_merl_are_as_bright_as_such_materials_are():
    whitest = max(
        (albedo(material.calibrated_label) @ LUMINANCE, material.name)
        for material in load_catalogue().values()
        if material.source == MERL
    )
    assert whitest == (pytest.approx(0.94, abs=0.01), "white-paint")
    # both are PTFE
    teflon, spectralon = (albedo(find(name).calibrated_label) for name in ("teflon", "spectralon"))
    assert teflon == pytest.approx(spectralon, abs=0.08)
    # its refractive index says 0.71, 0.64, 0.52
    assert albedo(find("nickel").calibrated_label) == pytest.approx([0.60, 0.53, 0.47], abs=0.01)


def test_labels_are_scaled_with_the_error_that_the_documentation_states():
    """Relative L1 of f·cos at six view angles that no fit used, the mean of them."""
    samples = held_out_samples()
    error = {
        material.name: errors.relative_l1(
            errors.label_values(material.calibrated_label, samples),
            material.calibration * errors.label_values(material.label, samples),
            samples,
        ).mean()
        for material in load_catalogue().values()
        if material.source == MERL
    }
    worst = max(error, key=error.__getitem__)
    assert np.mean([*error.values()]) == pytest.approx(0.018, abs=0.0005)
    assert (worst, error[worst]) == ("black-obsidian", pytest.approx(0.07, abs=0.005))


def test_a_material_of_another_source_is_as_it_was_measured():
    paper = find("paper_blue")
    assert paper.calibration == 1
    np.testing.assert_array_equal(paper.calibrated_label, paper.label)


def test_edits_name_the_surface_or_what_was_measured_of_it():
    brass = find("brass")
    for text, label in (
        ("brass", brass.calibrated_label),
        ("measured(brass)", brass.label),
        ("measured( brass )", brass.label),
    ):
        (resolved,) = targets.resolve_labels(text, lambda path: pytest.fail("no picture"))
        np.testing.assert_array_equal(resolved, label.reshape(-1).astype(np.float32))
    assert targets.split_by_region("measured(brass)+keep") == ["measured(brass)", "keep"]
    assert targets.file_name("measured(brass)") == "measured-brass"
    assert targets.fit_errors(["measured(brass)"]) == {}
    for text, remedy in (
        ("measured(bras)", "material 'bras'.*brass"),
        ("measured(copper)", "copper is described: name it alone"),
        ("Copper", r"did you mean copper\?"),
    ):
        with pytest.raises(InputError, match=remedy):
            targets.resolve_labels(text, lambda path: pytest.fail("no picture"))


@pytest.mark.parametrize("name", DESCRIBED)
def test_a_described_material_is_its_description(name):
    described = DESCRIBED[name]
    (label,) = targets.resolve_labels(name, lambda path: pytest.fail("no picture"))
    (same,) = targets.resolve_labels(described.text, lambda path: pytest.fail("no picture"))
    np.testing.assert_array_equal(label, same)
    assert targets.is_described(name) and not targets.is_from_picture(name)
    assert targets.fit_errors([name]) == {name: round(fit_expression(described.text).error, 4)}
    assert fit_expression(described.text).error < 0.06


def test_described_materials_have_names_and_families_that_no_measured_one_contradicts():
    assert not set(DESCRIBED) & set(load_catalogue())
    families = {material.family for material in load_catalogue().values()} | {"leather"}
    assert {material.family for material in DESCRIBED.values()} <= families


def test_a_misspelt_name_is_answered_with_described_and_measured_materials():
    for name, close in (("terracota", "terracotta"), ("Leather", "black-leather")):
        with pytest.raises(InputError, match=f"material '{name}'.*{close}"):
            targets.resolve_labels(name, lambda path: pytest.fail("no picture"))
