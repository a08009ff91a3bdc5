"""The page to edit in, `learn edit --interactive`: its pictures are the compositor's, its data can
be read back, and it asks for nothing outside itself.
"""

import base64
import dataclasses
import io
import json
import re
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter

from learn.commands.options import EDITING_WEIGHTS, weights_file
from learn.editing import (
    decomposition,
    edit,
    edit_files,
    interactive,
    interactive_maps,
    material_list,
    mirror_correction,
    photograph,
)
from learn.editing import reflectance_store as store
from learn.editing.chunks import Chunks
from learn.editing.compositor import Compositor
from learn.figures import spheres
from manifests.errors import InputError
from manifests.materials import load_catalogue
from shaders import envmap, tone
from tests.support import browser, firefox
from tests.support.known_ball import Knowing, ball, label_of

CHOSEN = ("brass", "chrome", "green-fabric", "red-plastic")
SIDE, RADIUS = 288, 120
LIMIT = 2.0  # grey levels, root mean square


class KnowingLight(Knowing):
    """As Knowing, with a window in the light."""

    def forward(self, image, mask, segments=None, regions=None):
        light = envmap.unit_mean(envmap.resize(spheres.preview_lighting(), 64, 128))[0]
        predicted = super().forward(image, mask, segments, regions)
        return predicted._replace(light=torch.from_numpy(light).movedim(-1, 0)[None].contiguous())


def result_of(cut_out=False, alpha=None):
    """A ball of two regions with a soft edge before a gradient, and one edit of it.

    alpha  (SIDE, SIDE) of the photograph, which then hides a glaring colour where it is 0
    """
    rng = np.random.default_rng(0)
    _, inside = ball(SIDE, RADIUS)
    regions = inside.astype(np.int64)
    regions[:, : SIDE // 2] *= 2
    coverage = gaussian_filter(inside.astype(np.float32), 1.2)
    regions[coverage < 0.5] = 0
    ground = np.linspace(0.1, 0.4, SIDE, dtype=np.float32)[:, None, None] * [1.0, 0.8, 0.6]
    seen = np.where(inside[..., None], rng.uniform(0.2, 0.5, (SIDE, SIDE, 1)), ground)
    if alpha is not None:
        seen = np.where(alpha[..., None] > 0, seen, [1.0, 0.0, 1.0])
    picture = tone.linear_from_srgb(np.rint(tone.display(seen, 1.0)) / 255).astype(np.float32)
    opened = photograph.Photograph(
        "ball", picture, coverage, regions, np.ones(3, np.float32), 1.5, cut_out, alpha=alpha
    )
    label = label_of("blue-rubber")
    decomposed = decomposition.decompose(opened, KnowingLight(label), 64)
    labels = [label_of("brass")[0], None]
    compositor = Compositor(decomposed, 1e-2, 0.25)
    return edit.EditResult(
        decomposed,
        compositor.render_again(),
        [edit.Edit("brass+keep", labels, compositor.edit(labels), None)],
        {},
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The result, its page's text and file, and a compositor like the page's own."""
    catalogue = load_catalogue()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(material_list, "load_catalogue", lambda: {k: catalogue[k] for k in CHOSEN})
        patch.setattr(material_list, "DESCRIBED", {})
        patch.setattr(interactive, "MEASURED", {})
        result = result_of()
        options = SimpleNamespace(tolerance=1e-2, detail=0.25, stops=0.0)
        text = interactive.make_page(result, options)
    path = tmp_path_factory.mktemp("page") / interactive.NAME
    path.write_text(text, "utf-8")
    compositor = Compositor(result.decomposition, 1e-2, 0.25)
    return SimpleNamespace(result=result, text=text, path=path, compositor=compositor)


class Page:
    """The data of a page, read as its script reads them."""

    def __init__(self, text):
        def inside(key):
            return re.search(rf'id="{key}">(.*?)</script>', text, re.S)[1]

        self.header, self.data = json.loads(inside("header")), base64.b64decode(inside("data"))
        self.names = [material["name"] for material in self.header["materials"]]
        H, W = self.header["height"], self.header["width"]
        raw, self.planes = self.chunk(self.header["pictureData"]), []
        for channels in self.header["planes"]:
            plane = np.frombuffer(raw[: H * W * channels], np.uint8).reshape(H, W, channels)
            self.planes.append(np.cumsum(plane, 1, dtype=np.uint8))
            raw = raw[H * W * channels :]
        N = self.header["normalsSize"]
        codes = whole(self.chunk(self.header["normalsData"]), N * N * 3, (N, N, 3))
        self.n = codes.view(np.int16) / 32767

    def chunk(self, place):
        return zlib.decompress(self.data[place[0] : place[0] + place[1]])

    def values(self, light, name):
        entry, material = self.header["lights"][light], self.names.index(name)
        sizes = [3 * (side + 5) ** 2 for side in entry["sides"]]
        size, first = entry["sides"][material] + 5, sum(sizes[:material])
        codes = whole(self.chunk(entry["data"]), sum(sizes), (size, size, 3), first)
        bend = self.header["bend"]
        return np.expm1(codes * np.log1p(bend) / self.header["steps"]).astype(np.float32) / bend


def whole(data, count, shape, first=0):
    """Values of a shape from their differences, two bytes each."""
    low, high = np.frombuffer(data, np.uint8).reshape(2, count).astype(np.int32)
    zigzag = (low | high << 8)[first : first + int(np.prod(shape))]
    signed = ((zigzag >> 1) ^ -(zigzag & 1)).astype(np.int16).reshape(shape)
    return np.cumsum(np.cumsum(signed, 1, dtype=np.int16), 0, dtype=np.int16).view(np.uint16)


def edited(made, *names):
    """The compositor's display picture of the regions in materials, None as photographed."""
    labels = [None if name is None else label_of(name)[0] for name in names]
    return tone.display(made.compositor.edit(labels), 1.0)


def distance(a, b, mask):
    return float(np.sqrt(np.mean((a.astype(float) - b)[mask] ** 2)))


def test_the_photograph_is_stored_exactly_and_coverage_in_256_steps(made):
    page, opened = Page(made.text), made.result.decomposition.photograph
    photo, behind, coverage, region, _ = page.planes
    np.testing.assert_array_equal(photo, np.rint(tone.display(opened.radiance, 1.0)))
    assert abs(coverage[..., 0] / 255 - opened.coverage).max() < 0.5001 / 255
    solid = opened.regions > 0
    np.testing.assert_array_equal(region[..., 0][solid], opened.regions[solid])
    assert (behind != 0).any() and not behind[opened.coverage == 0].any()


@pytest.mark.parametrize("name", CHOSEN)
def test_radiance_from_the_stored_maps_is_the_layers(made, name):
    page, compositor = Page(made.text), made.compositor
    n = compositor.n.reshape(-1, 3).numpy()
    mask = made.result.decomposition.photograph.regions > 0
    top, left, side = made.result.decomposition.framed.box
    assert top >= 0 and left >= 0 and compositor.grid == side, "one normal for each pixel"
    mask = mask[top : top + side, left : left + side]
    picture = store.interpolate(page.values(0, name), n).reshape(side, side, 3)
    truth = compositor.radiance(label_of(name))
    a, b = (tone.display(x, 1.0) for x in (picture, truth))
    assert b[mask].std() > 5 and distance(a, b, mask) < LIMIT


def test_a_material_that_was_read_from_a_file_is_not_darkened(tmp_path, monkeypatch):
    label = label_of("nickel")[0]
    file = tmp_path / "material.json"
    file.write_text(json.dumps({"label": [float(x) for x in label]}))
    catalogue = load_catalogue()
    monkeypatch.setattr(material_list, "load_catalogue", lambda: {"nickel": catalogue["nickel"]})
    monkeypatch.setattr(material_list, "DESCRIBED", {})
    monkeypatch.setattr(interactive, "MEASURED", {})
    monkeypatch.setattr(interactive.spheres, "preview_lighting", lambda: np.ones((64, 128, 3)))
    result = result_of()
    # a label that differs by nothing that shows, because equal ones are one material
    read = label + np.float32(1e-4)
    result.edits[:] = [edit.Edit(str(file), [read, None], result.edits[0].picture, None)]
    page = Page(
        interactive.make_page(result, SimpleNamespace(tolerance=1e-2, detail=0.25, stops=0.0))
    )
    for light in range(len(page.header["lights"])):
        named, own = (np.median(page.values(light, name)) for name in ("nickel", "material.json"))
        assert named / own == pytest.approx(mirror_correction.factor(label), rel=0.05)


def test_the_page_begins_with_the_edits_brightness(made, monkeypatch):
    catalogue = load_catalogue()
    monkeypatch.setattr(material_list, "load_catalogue", lambda: {"nickel": catalogue["nickel"]})
    monkeypatch.setattr(material_list, "DESCRIBED", {})
    monkeypatch.setattr(interactive, "MEASURED", {})
    options = SimpleNamespace(tolerance=1e-2, detail=0.25, stops=-0.5)
    page = Page(interactive.make_page(made.result, options))
    assert page.header["stops"] == -0.5 and Page(made.text).header["stops"] == 0


def test_a_matte_material_takes_fewer_nodes_than_a_sharp_one(made):
    header = Page(made.text).header
    names = [material["name"] for material in header["materials"]]
    sides = dict(zip(names, header["lights"][0]["sides"], strict=True))
    assert sides["green-fabric"] < sides["chrome"]


def test_names_words_and_the_first_choice_are_in_the_header(made):
    header = Page(made.text).header
    names = [material["name"] for material in header["materials"]]
    assert names == ["own material 1", "own material 2", *CHOSEN]
    assert header["chosen"] == [names.index("brass"), -1]
    assert "copper" in header["materials"][names.index("brass")]["words"]
    assert "car" not in header["materials"][names.index("brass")]["words"].split()


def test_a_data_sets_own_material_is_no_other_on_the_page(made):
    own = load_catalogue()["brass"].label.reshape(-1).astype(np.float32)
    result = dataclasses.replace(
        made.result,
        edits=[edit.Edit("brass+keep", [own, None], made.result.edits[0].picture, None)],
    )
    materials = material_list.list_materials(result)
    first, second = material_list.chosen_materials(result, materials)
    assert materials[first]["name"] == "brass of the data set" and second == -1
    np.testing.assert_array_equal(materials[first]["label"], own)


def test_the_page_asks_for_nothing_outside_itself(made):
    text = re.sub(r'(?s)<script type="application/octet-stream".*?</script>', "", made.text)
    assert not re.search(r"https?://|\bimport\s*\(|<link[^>]+stylesheet|fetch\(", text)
    assert set(re.findall(r'(?:src|href)="([a-z]+:)', text)) <= {"data:"}
    assert "{{" not in re.sub(r"(?s)<script>.*</script>", "", text)
    assert "default-src 'none'" in text


def test_a_page_that_would_be_too_large_is_refused(made, monkeypatch):
    monkeypatch.setattr(interactive, "LARGEST_FILE", 1000)
    monkeypatch.setattr(material_list, "load_catalogue", dict)
    monkeypatch.setattr(material_list, "DESCRIBED", {})
    monkeypatch.setattr(interactive, "MEASURED", {})
    with pytest.raises(InputError, match=r"at most 0\.001 MB"):
        interactive.make_page(made.result, SimpleNamespace(tolerance=1e-2, detail=0.25, stops=0.0))


def test_a_page_that_is_there_is_not_replaced(tmp_path):
    (tmp_path / interactive.NAME).write_text("earlier")
    edit_files.reserve_names(tmp_path / "a.png", ["brass"], [], tmp_path, False)
    with pytest.raises(InputError, match=re.escape(interactive.NAME)):
        edit_files.reserve_names(
            tmp_path / "a.png", ["brass"], [], tmp_path, False, [interactive.NAME]
        )


def test_the_page_is_written_where_it_is_requested(tmp_path, monkeypatch):
    monkeypatch.setattr(interactive, "make_page", lambda result, options: result.edits[0].text)
    options = edit.EditOptions(weights_file(EDITING_WEIGHTS), None, 1e-2, 0.25)
    cup = "example:espresso-cup"
    for name, with_page in (("with", True), ("without", False)):
        edit.run(cup, [], None, ["green-fabric"], tmp_path / name, options, None, False, with_page)
    assert (tmp_path / "with" / interactive.NAME).read_text() == "green-fabric"
    assert not (tmp_path / "without" / interactive.NAME).exists()


needs_browser = pytest.mark.skipif(
    not browser.is_available(), reason="needs Debian's packages chromium and chromium-driver"
)
PIXELS = """
  editPage.refresh(); editPage.draw();
  const out = document.createElement("canvas"), c = editPage.canvas;
  out.width = c.width; out.height = c.height;
  out.getContext("2d").drawImage(c, 0, 0);
  return out.toDataURL("image/png").split(",")[1];
"""


def pixels(window, setting, mode="RGB"):
    """The page's canvas (H, W, 3 or 4) after a JavaScript statement."""
    png = base64.b64decode(window.run(f"await (async () => {{{setting}}})();" + PIXELS))
    return np.asarray(Image.open(io.BytesIO(png)).convert(mode))


def choice(made, *names, blend=0.5, second=-2):
    index = Page(made.text).names.index
    return "".join(
        f"Object.assign(editPage.state.regions[{r}],"
        f" {{materials: [{-1 if name is None else index(name)}, {second}], blend: {blend}}});"
        for r, name in enumerate(names)
    )


@needs_browser
@pytest.mark.long
@pytest.mark.parametrize("address", ["", "#canvas"])
def test_a_browser_shows_the_compositors_pictures(made, address):
    """With WebGL, and without."""
    mask = made.result.decomposition.photograph.regions > 0
    soft = (made.compositor.coverage > 0) & (made.compositor.coverage < 1)
    assert soft.any()
    with browser.Browser() as window:
        window.open(made.path, address)
        window.wait("document.documentElement.dataset.ready")
        assert window.run("return editPage.webgl") == (address == "")
        for names in [("brass", None), ("chrome", "green-fabric"), ("red-plastic", "red-plastic")]:
            shown = pixels(window, choice(made, *names))
            assert distance(shown, edited(made, *names), mask) < LIMIT, names
            assert distance(shown, edited(made, *names), mask | ~mask) < LIMIT, names
        # a blend: of radiance, not of display values
        brass = Page(made.text).names.index("brass")
        shown = pixels(window, choice(made, "green-fabric", None, blend=0.25, second=brass))
        parts = [made.compositor.edit([label_of(n)[0], None]) for n in ("green-fabric", "brass")]
        assert distance(shown, tone.display(0.75 * parts[0] + 0.25 * parts[1], 1.0), mask) < LIMIT
        before = pixels(window, "editPage.state.split = 0")
        np.testing.assert_array_equal(before, Page(made.text).planes[0])
        assert window.console() == []


@needs_browser
@pytest.mark.long
@pytest.mark.parametrize("address", ["", "#canvas"])
def test_a_browser_shows_the_largest_maps(made, monkeypatch, tmp_path, address):
    catalogue = load_catalogue()
    monkeypatch.setattr(material_list, "load_catalogue", lambda: {"chrome": catalogue["chrome"]})
    monkeypatch.setattr(material_list, "DESCRIBED", {})
    monkeypatch.setattr(interactive, "lights_of", lambda own: {"own": own})
    monkeypatch.setattr(store, "LIMIT", 0.0)
    monkeypatch.setattr(store, "LIMIT_OF_FINEST", 0.0)
    text = interactive.make_page(
        made.result, SimpleNamespace(tolerance=1e-2, detail=0.25, stops=0.0)
    )
    page, path = Page(text), tmp_path / interactive.NAME
    assert page.header["lights"][0]["sides"][page.names.index("chrome")] == store.SIDES[-1]
    path.write_text(text, "utf-8")
    mask = made.result.decomposition.photograph.regions > 0
    with browser.Browser() as window:
        window.open(path, address)
        window.wait("document.documentElement.dataset.ready")
        shown = pixels(window, choice(SimpleNamespace(text=text), "chrome", "chrome"))
        assert distance(shown, edited(made, "chrome", "chrome"), mask) < LIMIT
        assert window.console() == []


@pytest.mark.skipif(
    not firefox.is_available(), reason="needs Debian's packages firefox-esr and xvfb"
)
@pytest.mark.long
@pytest.mark.parametrize("screen", [True, False])
def test_firefox_shows_the_compositors_pictures(made, screen, tmp_path):
    """On a screen with WebGL, and without a screen, where it has none."""
    mask = made.result.decomposition.photograph.regions > 0
    with firefox.Firefox(screen=screen) as window:
        window.open(made.path)
        window.wait("document.documentElement.dataset.ready")
        assert window.run("return editPage.webgl") == screen
        for names in [("brass", None), ("chrome", "green-fabric")]:
            shown = pixels(window, choice(made, *names))
            assert distance(shown, edited(made, *names), mask | ~mask) < LIMIT, names
        asked = window.run("return performance.getEntriesByType('resource').map(e => e.name)")
        assert not [name for name in asked if not name.startswith(("data:", "blob:"))]
        (tmp_path / "firefox.png").write_bytes(window.screenshot())


@needs_browser
@pytest.mark.long
def test_a_cut_out_object_stays_transparent_and_can_stand_before_a_plain_ground(
    made, monkeypatch, tmp_path
):
    """Without WebGL the same: drawn twice, once each."""
    monkeypatch.setattr(material_list, "load_catalogue", dict)
    monkeypatch.setattr(material_list, "DESCRIBED", {})
    monkeypatch.setattr(interactive, "MEASURED", {})
    result = result_of(cut_out=True)
    path = tmp_path / interactive.NAME
    path.write_text(
        interactive.make_page(result, SimpleNamespace(tolerance=1e-2, detail=0.25, stops=0.0)),
        "utf-8",
    )
    compositor = Compositor(result.decomposition, 1e-2, 0.25)
    opened, own = result.decomposition.photograph, result.decomposition.label
    truth = tone.display(compositor.edit([own[0], own[1]]), 1.0)
    show = choice(SimpleNamespace(text=path.read_text("utf-8")), "own material 1", "own material 2")
    for address in ("", "#canvas"):
        with browser.Browser() as window:
            window.open(path, address)
            window.wait("document.documentElement.dataset.ready")
            shown = pixels(window, show, "RGBA")
            assert abs(shown[..., 3] - 255 * opened.coverage).max() < 1.01
            darker = pixels(window, "editPage.state.stops = -1", "RGBA")
            inside = opened.coverage > 0.99
            half = tone.display(tone.linear_from_srgb(shown[inside][:, :3] / 255.0) / 2, 1.0)
            assert abs(darker[inside][:, :3] - half).max() < 2.01
            pixels(window, "editPage.state.stops = 0", "RGBA")
            assert distance(shown[..., :3], truth, opened.coverage > 0.9) < LIMIT
            ground = pixels(window, "editPage.state.ground = true", "RGBA")
            assert (ground[..., 3] == 255).all()
            corner = ground[:5, :5, :3].reshape(-1, 3).astype(int)
            assert len(np.unique(corner, axis=0)) == 1
            assert distance(ground[..., :3], truth, opened.coverage == 1) < LIMIT
            assert window.console() == []


@needs_browser
@pytest.mark.long
def test_hidden_colours_of_a_transparent_photograph_do_not_show(monkeypatch, tmp_path):
    """The mask's soft edge lies before colours that the photograph hides by its transparency."""
    monkeypatch.setattr(material_list, "load_catalogue", dict)
    monkeypatch.setattr(material_list, "DESCRIBED", {})
    monkeypatch.setattr(interactive, "MEASURED", {})
    alpha = ball(SIDE, RADIUS + 3)[1].astype(np.float32)
    alpha[SIDE // 2 :] = 1
    result = result_of(alpha=alpha)
    path = tmp_path / interactive.NAME
    path.write_text(
        interactive.make_page(result, SimpleNamespace(tolerance=1e-2, detail=0.25, stops=0.0)),
        "utf-8",
    )
    compositor = Compositor(result.decomposition, 1e-2, 0.25)
    own = result.decomposition.label
    truth = tone.display(compositor.edit([own[0], own[1]]), 1.0)
    coverage = result.decomposition.photograph.coverage
    edge = (coverage > 0.05) & (coverage < 0.95)
    show = choice(SimpleNamespace(text=path.read_text("utf-8")), "own material 1", "own material 2")
    for address in ("", "#canvas"):
        with browser.Browser() as window:
            window.open(path, address)
            window.wait("document.documentElement.dataset.ready")
            assert distance(pixels(window, show), truth, edge) < LIMIT
            assert window.console() == []


@needs_browser
@pytest.mark.long
def test_the_page_is_used_by_mouse_and_keyboard(made):
    with browser.Browser() as window:
        window.resize(400, 800)
        window.open(made.path)
        window.wait("document.documentElement.dataset.ready")
        assert window.run("return document.documentElement.scrollWidth") <= 400
        window.resize(1300, 900)
        window.type("#search", "copper")
        shown = "[...document.querySelectorAll('.tiles button')].filter(b => b.offsetParent)"
        assert window.run(f"return {shown}.map(b => b.title)") == ["brass"]
        # no material has both words: those that have one come near
        window.run("document.getElementById('search').value = ''")
        window.type("#search", "gold plastic")
        note = "return document.getElementById('nothing').innerText"
        assert "plastic" in " ".join(window.run(f"return {shown}.map(b => b.title)"))
        assert window.run(note) == "No material has that name. These are close:"
        window.run("document.getElementById('search').value = ''")
        window.type("#search", "unobtainium")
        assert window.run(f"return {shown}.length") == 0 and "Try a colour" in window.run(note)
        window.run("document.getElementById('search').value = ''")
        window.type("#search", " ")
        assert window.run("return document.getElementById('nothing').hidden")
        window.click(".tiles button[title=green-fabric]")
        assert window.run("return editPage.state.regions[0].materials[0]") == 4
        window.run("document.activeElement.focus()")
        window.type(".tiles button[title=green-fabric]", "\ue014\ue007")  # right, enter
        assert window.run("return editPage.state.regions[0].materials[0]") == 5
        window.click("#slot-1")
        window.click(".tiles button[title=chrome]")
        assert "50 % red plastic with 50 % chrome" in window.run(
            "return document.getElementById('status').textContent"
        )
        own = pixels(window, "")
        window.click("#lights label:nth-of-type(2)")
        window.wait("editPage.state.light === 1")
        assert (pixels(window, "") != own).mean() > 0.2
        assert window.console() == []


def test_maps_that_do_not_fit_are_reduced_where_least_is_lost_for_the_bytes():
    def tried(*pairs):
        return [interactive_maps.TriedMap(16 << k, e, bytes(b)) for k, (e, b) in enumerate(pairs)]

    maps = [tried((9.0, 10), (1.0, 100)), tried((2.0, 10), (1.0, 100)), tried((3.0, 50))]
    interactive_maps.reduce_maps(maps, 1000)
    assert [len(each) for each in maps] == [2, 2, 1]
    interactive_maps.reduce_maps(maps, 200)
    assert [each[-1].error for each in maps] == [1.0, 2.0, 3.0]
    interactive_maps.reduce_maps(maps, 0)  # each keeps its coarsest
    assert [each[-1].error for each in maps] == [9.0, 2.0, 3.0]


def test_maps_that_are_good_enough_are_reduced_before_those_that_are_not():
    def tried(*pairs):
        return [interactive_maps.TriedMap(16 << k, e, bytes(b)) for k, (e, b) in enumerate(pairs)]

    # more is lost by the second, but it stays below two grey levels
    maps = [tried((2.3, 10), (1.9, 100)), tried((1.9, 10), (0.1, 100))]
    interactive_maps.reduce_maps(maps, 110)
    assert [each[-1].error for each in maps] == [1.9, 1.9]


def test_errors_are_those_of_the_stored_codes(made):
    page, light = Page(made.text), made.result.decomposition.parts.light
    _, n = interactive.add_picture(made.compositor, Chunks())
    scene = interactive.make_scene(made.compositor, light)
    checked = interactive.choose_normals(n, interactive.CHECKED_PIXELS)
    for name in CHOSEN:
        read = store.interpolate(page.values(0, name), checked)
        label = label_of(name)[0]
        truth = made.compositor.mirror_correction(label) * store.radiance(checked, label, scene, "")
        a, b = (tone.display(each, 1.0) for each in (read, truth))
        error = page.header["lights"][0]["errors"][page.names.index(name)]
        assert error == pytest.approx(np.sqrt(np.mean((a - b) ** 2)), abs=0.006), name
