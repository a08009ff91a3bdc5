"""A library of assets holds what Blender's asset browser shows, and renders in a scene of a user's
own to the factory's pixels.
"""

import json
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from factory.__main__ import COMMANDS
from manifests.cli import main
from manifests.files import write_json
from manifests.materials import find

pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")
pytestmark = pytest.mark.blender

NAMES = ("brass", "chrome", "green-latex", "pink-felt", "satin_white")
FRESH = Path(__file__).resolve().parents[1] / "support" / "fresh_scene.py"
# a Python that has another Blender as a module: the user's scene is rendered by that one
USERS_PYTHON = os.environ.get("BLENDER_PYTHON", sys.executable)
SAMPLES, SEED, SIZE = 16, 5, 48


def export(path, *arguments):
    chosen = [word for name in NAMES for word in ("--material", name)]
    command = ["materials", "export", "--blend", str(path), *chosen, "--size", "32", *arguments]
    return main("factory", "test", [c for c in COMMANDS if c == "materials"], command)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    path = tmp_path_factory.mktemp("assets") / "library.blend"
    assert export(path) == 0
    return path


def in_blender(code, *arguments):
    """What a program of plain Blender prints as JSON in its last line."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *map(str, arguments)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


LIST = """
import bpy, json, sys
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
def asset(each):
    data = each.asset_data
    return {"type": each.bl_rna.identifier, "name": each.name, "catalog": data.catalog_id,
            "tags": [tag.name for tag in data.tags], "text": data.description,
            "author": data.author, "license": data.license,
            "preview": [*each.preview.image_size, max(each.preview.image_pixels_float)]}
print()
print(json.dumps({
    "assets": [asset(e) for e in (*bpy.data.materials, *bpy.data.node_groups) if e.asset_data],
    "nodes": sorted({node.bl_idname for g in bpy.data.node_groups for node in g.nodes}),
    "images": [image.name for image in bpy.data.images],
    "corrected": [m.name for m in bpy.data.materials if m.cycles.use_bump_map_correction],
}))
"""


def test_every_material_and_its_group_is_an_asset_with_picture_tags_and_licence(library):
    result = in_blender(LIST, library)
    assets = {(each["type"], each["name"]): each for each in result["assets"]}
    assert set(assets) == {(k, n) for k in ("Material", "ShaderNodeTree") for n in NAMES}
    text = (library.parent / "blender_assets.cats.txt").read_text()
    catalogues = dict(line.split(":")[:2] for line in text.splitlines() if line.count(":") == 2)
    for (kind, name), each in assets.items():
        material = find(name)
        top = "Measured materials" + ("" if kind == "Material" else ", node groups")
        assert catalogues[each["catalog"]] == f"{top}/{material.family}"
        assert {"brdfactory", material.family} <= set(each["tags"])
        assert each["author"] == material.source and each["license"] == material.licence
        assert material.source in each["text"] and material.licence in each["text"]
        assert each["preview"][:2] == [32, 32] and each["preview"][2] > 0.5
    # no file beside the library is needed, and Cycles leaves tilted normals as they are
    assert result["images"] == [] and result["corrected"] == []


# Node types of Blender 4.2, from the page "bpy.types.ShaderNode" of its Python API
IN_4_2 = {
    "NodeGroupOutput",
    "ShaderNodeAddShader",
    "ShaderNodeBsdfAnisotropic",  # Glossy, since 4.0
    "ShaderNodeBsdfDiffuse",
    "ShaderNodeBsdfSheen",
    "ShaderNodeLayerWeight",
    "ShaderNodeMath",
    "ShaderNodeNewGeometry",
    "ShaderNodeValToRGB",
    "ShaderNodeVectorMath",
}


def test_blender_4_2_has_every_node_type_and_may_open_the_file(library, tmp_path):
    assert set(in_blender(LIST, library)["nodes"]) <= IN_4_2
    plain = tmp_path / "plain.blend"
    code = (
        "import bpy, sys; bpy.ops.wm.open_mainfile(filepath=sys.argv[1]);"
        "bpy.ops.wm.save_as_mainfile(filepath=sys.argv[2], compress=False); print('\\n1')"
    )
    in_blender(code, library, plain)
    data = plain.read_bytes()
    # block GLOB: code, length, address, structure, count, then subversion as text, and three shorts
    start = data.index(b"GLOB") + 24
    _, oldest, _ = struct.unpack("<hhh", data[start + 4 : start + 10])
    assert data[:7] == b"BLENDER" and oldest <= 402


def test_five_materials_in_a_users_scene_have_the_factorys_pixels(library, studio, tmp_path):
    from factory.render import body, camera, light
    from factory.render.settings import TIERS
    from factory.render.validation import reference
    from factory.shapes.catalogue import load
    from manifests.schema import Camera

    lens, mesh, L = Camera(size=(SIZE, SIZE)), load("sphere"), reference.soft_light()
    studio.set_camera(lens)
    studio.set_shape(mesh)
    studio.set_light(L)
    expected = {}
    for name in NAMES:
        studio.set_materials([find(name).mixture])
        expected[name] = studio.render(SAMPLES, SEED), studio.render(SAMPLES, SEED + 1)
    vertices, normals, faces = body.split_by_normal(mesh.vertices, mesh.faces, mesh.corner_normals)
    away = camera.camera_from_fixed_world(lens).T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = away, camera.distance(lens) * away[:, 2]
    np.savez(
        tmp_path / "scene.npz",
        vertices=vertices,
        normals=normals,
        faces=faces,
        pixels=light.blender_pixels(light.as_seen(L, 0)),
        pose=pose,
        scale=2 * lens.half_extent,
    )
    settings = {path: held["value"] for path, held in studio.settings["picture"].items()}
    settings |= {"render.resolution_x": SIZE, "render.resolution_y": SIZE}
    settings |= {"cycles.samples": SAMPLES, "cycles.seed": SEED}
    bounces = TIERS["direct"]["bounces"]
    settings |= {f"cycles.{k}bounces": bounces for k in ("max_", "diffuse_", "glossy_")}
    write_json(tmp_path / "settings.json", settings)
    done = subprocess.run(
        [USERS_PYTHON, "-P", str(FRESH), str(tmp_path / "scene.npz"),
         str(tmp_path / "settings.json"), str(library), str(tmp_path), *NAMES],
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for name in NAMES:
        with OpenEXR.File(str(tmp_path / f"{name}.exr")) as file:
            picture = file.channels()["RGBA"].pixels[..., :3]
        own, other_seed = expected[name]
        noise = np.abs(own - other_seed).mean()
        assert noise > 0 and own.max() > 0.1
        # the noise is the same; a small remainder is largest for sharp lobes
        assert np.abs(picture - own).mean() < 0.02 * noise
        if sys.executable == USERS_PYTHON:  # another version's arithmetic differs by more
            np.testing.assert_allclose(picture.mean((0, 1)), own.mean((0, 1)), rtol=1e-4)


def test_the_program_in_the_document_renders_the_five(root, library, tmp_path):
    text = (root / "docs" / "blender.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```", text, flags=re.M | re.S)
    for full, smaller in (("= 800, 188", "= 100, 24"), ('"CYCLES", 64', '"CYCLES", 4')):
        assert code.count(full) == 1
        code = code.replace(full, smaller)
    (tmp_path / "library").symlink_to(library.parent)
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    picture = np.asarray(Image.open(tmp_path / "spheres.png")).astype(float)
    assert picture.shape[:2] == (24, 100)
    middle = picture[12, [12, 31, 50, 69, 88]]  # inside each of the spheres
    assert len(np.unique(middle, axis=0)) == 5 and (middle[:, :3].max(1) > 10).all()


def test_an_existing_library_is_kept_unless_it_may_be_replaced(library, capsys):
    before = library.read_bytes()
    assert export(library) == 1
    assert "expected no earlier result, found one" in capsys.readouterr().err
    assert library.read_bytes() == before


def test_writing_again_gives_the_same_catalogues(library, tmp_path):
    again = tmp_path / "library.blend"
    assert export(again) == 0
    name = "blender_assets.cats.txt"
    assert (again.parent / name).read_bytes() == (library.parent / name).read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == [name, "library.blend"]


def test_a_full_disk_leaves_the_earlier_library(library, tmp_path, small_files):
    path = tmp_path / "library.blend"
    path.write_bytes(b"earlier")
    with small_files(4096):
        assert export(path, "--overwrite") != 0
    assert path.read_bytes() == b"earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["library.blend"]
