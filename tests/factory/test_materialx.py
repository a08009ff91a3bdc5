"""Approximations by MaterialX's standard_surface: the closed form, the fit, and the document."""

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from factory.__main__ import COMMANDS
from factory.materials import materialx, standard_surface
from factory.materials.standard_surface import Approximation, StandardSurface
from manifests.cli import main
from manifests.materials import find
from shaders.mixture import Mixture
from shaders.samples import Samples, held_out_samples

CHOSEN = ("green-latex", "satin_white")


def surface(**changes):
    plain = dict(
        base_color=(0.4, 0.2, 0.1),
        specular=0.6,
        specular_color=(1.0, 0.8, 0.5),
        specular_roughness=0.4,
        specular_IOR=1.5,
        coat=0.0,
        coat_roughness=0.1,
    )
    return StandardSurface(**(plain | changes))


def flux(material, theta_deg):
    """Share of the light that each channel reflects at a view angle."""
    samples = Samples(np.radians([theta_deg]), 96, 24)
    f = material.evaluate(*samples.cosines)
    return (samples.measure[..., None] * f).sum((0, 1))


def test_without_layers_it_is_lamberts():
    samples = held_out_samples()
    f = surface(specular=0.0).evaluate(*samples.cosines)
    np.testing.assert_allclose(f, np.broadcast_to(np.array([0.4, 0.2, 0.1]) / np.pi, f.shape))


def test_fresnels_equations_at_known_angles():
    cosine = np.array([1.0, np.cos(np.arctan(1.5)), 1e-9])
    # straight on ((n − 1)/(n + 1))², at Brewster's angle half of Rs, at grazing angles 1
    brewster = 0.5 * np.cos(2 * np.arctan(1.5)) ** 2
    np.testing.assert_allclose(
        standard_surface._fresnel(1.5, cosine), [0.04, brewster, 1.0], atol=1e-6
    )


@pytest.mark.parametrize("theta_deg", [5, 45, 70])
@pytest.mark.parametrize("roughness", [0.2, 0.6, 1.0])
def test_a_white_material_reflects_about_all_light(theta_deg, roughness):
    white = surface(
        base_color=(1.0,) * 3, specular=1.0, specular_color=(1.0,) * 3, specular_roughness=roughness
    )
    # a layer's albedo is that of Schlick's Fresnel term, its lobe has the equations
    np.testing.assert_allclose(flux(white, theta_deg), 1.0, atol=0.04)


@pytest.mark.parametrize("theta_deg", [5, 45, 70])
@pytest.mark.parametrize("roughness", [0.3, 0.8])
def test_a_mirrors_multiple_scattering_is_compensated(theta_deg, roughness):
    mirror = surface(
        base_color=(0.0,) * 3, specular=1.0, specular_roughness=roughness, specular_IOR=1e4
    )
    np.testing.assert_allclose(flux(mirror, theta_deg), mirror.specular_color, rtol=0.02)


def test_a_coat_takes_from_what_lies_below():
    below, above = surface(specular=0.0), surface(specular=0.0, coat=1.0)
    samples = Samples(np.radians([40.0]))
    far = samples.cos_h < np.cos(np.radians(40))  # away from the coat's highlight
    ratio = above.evaluate(*samples.cosines)[far] / below.evaluate(*samples.cosines)[far]
    lit = samples.solid_angle[far] > 0
    assert ratio[lit].min() > 0.9 and ratio[lit].max() < 1.0


def test_the_fit_gives_back_a_matte_material_and_states_what_it_misses():
    result = standard_surface.fit(Mixture.lambert([0.5, 0.2, 0.1]))
    np.testing.assert_allclose(flux(result.material, 30), [0.5, 0.2, 0.1], rtol=0.03)
    assert result.error < 0.03
    mixture = find("green-latex").mixture
    samples = held_out_samples()
    result = standard_surface.fit(mixture)
    f, reference = (each.evaluate(*samples.cosines) for each in (result.material, mixture))
    weight = samples.measure[..., None]
    own = (weight * abs(f - reference)).sum((1, 2)) / (weight * reference).sum((1, 2))
    np.testing.assert_allclose(result.views, own)
    assert result.error < 0.06


def export(path, *arguments):
    chosen = [word for name in CHOSEN for word in ("--material", name)]
    command = ["materials", "export", "--materialx", str(path), *chosen, *arguments]
    return main("factory", "test", [c for c in COMMANDS if c == "materials"], command)


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    path = tmp_path_factory.mktemp("materialx") / "materials.mtlx"
    assert export(path) == 0
    return path


def test_each_material_has_its_numbers_its_error_and_its_licence(document):
    root = ElementTree.parse(document).getroot()
    assert root.get("colorspace") == "lin_rec709"
    for name in CHOSEN:
        element = root.find(f"standard_surface[@name='SR_{name.replace('-', '_')}']")
        assert element is not None
        result = standard_surface.fit(find(name).mixture)
        values = {each.get("name"): each.get("value") for each in element.findall("input")}
        read = StandardSurface(
            **{
                key: tuple(map(float, value.split(","))) if "," in value else float(value)
                for key, value in values.items()
                if key != "base"
            }
        )
        assert values["base"] == "1"
        # what is in the file has the error that the file states
        own = standard_surface.distances(read, find(name).mixture)
        np.testing.assert_allclose(own, result.views, atol=1e-6)
        text, table = element.get("doc"), document.with_name("materials-errors.md").read_text()
        assert f"| {name} | {find(name).family} | {own.mean():.3f} | {own.max():.3f} |" in table
        assert f"{own.mean():.3f}" in text
        assert find(name).licence in text and find(name).source in text


def test_an_existing_document_is_kept_and_a_wrong_ending_refused(document, tmp_path, capsys):
    before = document.read_bytes()
    assert export(document) == 1 and document.read_bytes() == before
    assert export(tmp_path / "materials.xml") == 1
    assert "a name that ends in .mtlx" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_without_a_file_to_write_the_command_says_so(capsys):
    assert main("factory", "test", ["materials"], ["materials", "export"]) == 1
    assert "--blend FILE or --materialx FILE" in capsys.readouterr().err


def test_names_become_letters_that_materialx_allows():
    material = find("satin_white")
    approximation = Approximation(surface(), np.zeros(6))
    text = materialx.document([material], {material.name: approximation})
    assert '<surfacematerial name="satin_white" type="material">' in text
    assert materialx.identifier("über-215 b") == "_ber_215_b"


CHECK = """
import sys
sys.path.insert(0, sys.argv[2])
import MaterialX
document, library = MaterialX.createDocument(), MaterialX.createDocument()
MaterialX.loadLibraries(["libraries"], MaterialX.FileSearchPath(sys.argv[3]), library)
MaterialX.readFromXmlFile(document, sys.argv[1])
document.importLibrary(library)
valid, text = document.validate()
materials = [each.getName() for each in document.getMaterialNodes()]
shaders = [MaterialX.getShaderNodes(each)[0] for each in document.getMaterialNodes()]
assert all(shader.getNodeDef() is not None for shader in shaders)
inputs = {i.getName() for s in shaders for i in s.getInputs()}
definition = library.getNodeDef("ND_standard_surface_surfaceshader")
known = {i.getName() for i in definition.getActiveInputs()}
print()
print(valid, text, sorted(materials), inputs <= known)
"""


@pytest.mark.blender
def test_materialxs_own_library_finds_the_document_valid(document):
    """Blender brings MaterialX with its definitions of nodes."""
    if (spec := find_spec("bpy")) is None:
        pytest.skip("needs Blender as a module (pip install .[factory])")
    folder = Path(spec.origin).parent
    (modules,) = folder.glob("*/python/lib/python3*/site-packages/MaterialX")
    libraries = next(folder.glob("*/datafiles/materialx"), None) or modules
    done = subprocess.run(
        [sys.executable, "-c", CHECK, str(document), str(modules.parent), str(libraries)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    names = sorted(map(materialx.identifier, CHOSEN))
    assert done.stdout.splitlines()[-1] == f"True  {names} True"
