"""The page of `brdfactory app`, walked through in a browser: every step by what the page shows."""

import gc
import io
import json
import shlex
import shutil
import subprocess
import time
import urllib.error
import urllib.request
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from learn.app import gallery
from learn.commands.options import EDITING_WEIGHTS
from learn.data import photographs
from learn.editing import photograph
from tests.support import browser
from tests.support.browser import Browser

gradio = pytest.importorskip("gradio", reason="gradio is not installed (extra app)")
pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("default"),  # those of gradio's own packages are not ours
    pytest.mark.skipif(
        not browser.is_available(), reason="needs Debian's packages chromium and chromium-driver"
    ),
]
SIZE = (240, 160)  # of the photograph, reduced
CUP, SAUCER, TABLE = (94, 116), (56, 98), (154, 118)  # points of it
ERROR_TEXT = "[...document.querySelectorAll('.toast-body, .toast-text')].map(e => e.innerText)"
# the picture that the slider shows as the result
RESULT = (
    "[...document.querySelectorAll('#editor img')].map(i => i.src).find(s => s.includes('view-'))"
)

# what the browser does when a page is left or loaded again; true: it asks the user
LEAVING = (
    "const e = new Event('beforeunload', {cancelable: true}); dispatchEvent(e);"
    "return e.defaultPrevented"
)


@pytest.fixture(scope="module")
def served():
    from learn.app import page

    address, end = page.serve(EDITING_WEIGHTS, wait=False)
    yield address
    end()
    # event loops and sockets that gradio's threads leave open would be an error of a later test
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    path, _ = photograph.resolve_example("example:espresso-cup", [], None)
    file = tmp_path_factory.mktemp("photo") / "cup.png"
    Image.open(path).convert("RGB").resize(SIZE, Image.Resampling.BOX).save(file)
    return file


class Walk:
    """A browser on the page, which keeps a screenshot of each step."""

    def __init__(self, window: Browser, folder: Path):
        self.window, self.folder, self.count = window, folder, 0

    def shot(self, name: str) -> None:
        self.count += 1
        (self.folder / f"{self.count:02}-{name}.png").write_bytes(self.window.screenshot())

    def text(self, selector: str) -> str:
        return self.window.run(f"return document.querySelector({selector!r}).innerText")

    def wait_for(self, selector: str, part: str) -> None:
        self.window.wait(f"document.querySelector({selector!r})?.innerText.includes({part!r})")

    def point(self, point: tuple[int, int]) -> None:
        """Click on a point of the photograph, in its pixels."""
        before = self.window.run("return document.querySelector('#marking img').src")
        self.window.wait("document.querySelector('#marking img').naturalWidth")
        x, y, width = self.window.run(
            "const i = document.querySelector('#marking img'), r = i.getBoundingClientRect();"
            "const s = Math.min(r.width / i.naturalWidth, r.height / i.naturalHeight);"
            "return [r.left + (r.width - s * i.naturalWidth) / 2,"
            " r.top + (r.height - s * i.naturalHeight) / 2, s * i.naturalWidth]"
        )
        scale = width / SIZE[0]
        self.window.click_at(x + scale * (point[0] + 0.5), y + scale * (point[1] + 0.5))
        new = f"document.querySelector('#marking img').src !== {before!r}"
        self.window.wait(f"{new} || ({ERROR_TEXT}).length")
        assert self.window.run(f"return {new}"), self.window.run(f"return {ERROR_TEXT}")

    def take_back(self) -> None:
        """Undo what was marked last, and wait until the picture shows it."""
        before = self.window.run("return document.querySelector('#marking img').src")
        self.window.click("#undo")
        self.window.wait(f"document.querySelector('#marking img').src !== {before!r}")

    def changed(self, act, *says: str) -> np.ndarray:
        """Do something that changes the result, and return the picture then shown.

        The picture is taken when the line below it says that the view is exact and `says`.
        """
        before = self.window.run(f"return {RESULT}")
        act()
        self.window.wait(f"({RESULT}) && ({RESULT}) !== {json.dumps(before)}")
        for part in ("Exact view", *says):
            self.wait_for("#shown", part)
        return self.result()

    def result(self) -> np.ndarray:
        data = urllib.request.urlopen(self.window.run(f"return {RESULT}"), timeout=60).read()
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float64)

    def slide(self, selector: str, value: float) -> None:
        """Move a slider, again where it sprang back.

        A slider in a part of the page that was opened just now is given its first value a moment
        after it can be seen, and on a busy machine that comes after the move.
        """
        slider = f"{selector} input[type=range]"
        for _ in range(5):
            self.enter(slider, value)
            time.sleep(0.5)
            if float(self.window.run(f"return document.querySelector({slider!r}).value")) == value:
                return
        raise AssertionError(f"{selector} does not keep the value {value}")

    def enter(self, selector: str, value: float | str) -> None:
        """Set an input's value as typing does."""
        self.window.run(
            f"const i = document.querySelector({selector!r});"
            "Object.getOwnPropertyDescriptor(Object.getPrototypeOf(i), 'value')"
            f".set.call(i, {value!r}); i.dispatchEvent(new Event('input', {{bubbles: true}}));"
        )

    def choose(self, selector: str, number: int) -> None:
        """Press one of a row of radio buttons."""
        self.window.run(f"document.querySelectorAll('{selector} input')[{number}].click()")

    def search(self, words: str) -> list[str]:
        listed = "[...document.querySelectorAll('#materials .caption')].map(e => e.innerText)"
        before = self.window.run(f"return {listed}.join()")
        self.enter("#words input, #words textarea", words)
        self.window.wait(f"({listed}).join() != {before!r}")
        time.sleep(0.3)
        return self.window.run(f"return {listed}")

    def pick(self, name: str) -> None:
        self.window.run(f"document.querySelector('#materials [data-name={name}]').click()")

    def links(self) -> list[str]:
        """The addresses of all files for download; those for programs are in a closed part."""
        self.window.run(
            "[...document.querySelectorAll('.label-wrap')].filter(e => e.offsetParent"
            " && !e.classList.contains('open')).forEach(e => e.click())"
        )
        links = "[...document.querySelectorAll(':is(#pictures, #saved-work, #downloads) a')]"
        self.window.wait(f"{links}.some(a => a.href.endsWith('edit.json'))")
        return self.window.run(f"return {links}.map(a => a.href)")

    def errors(self, with_warnings: bool = True) -> list[str]:
        return [
            line
            for line in self.window.console(errors_only=not with_warnings)
            if "favicon" not in line and "manifest.json" not in line
        ]


def opened(window: Browser, address: str, folder: Path) -> Walk:
    window.visit(address)
    window.wait("document.querySelector('#photo')")
    return Walk(window, folder)


def send(walk: Walk, button: str, path: Path) -> None:
    """Give a file to the upload button of that text."""
    selector = f'input[data-testid="{button}-upload-button"]'
    walk.window.wait(f"document.querySelector('{selector}')")
    walk.window.type(selector, str(path))


def test_a_photograph_is_edited_from_upload_to_download(served, photo, tmp_path):
    folder = tmp_path / "screenshots"
    folder.mkdir()
    with Browser(1300, 1150) as window:
        walk = opened(window, served, folder)
        assert window.run("return document.querySelector('#decompose').disabled")
        walk.shot("empty")

        # a file that is no picture: the command line's line, and the page goes on
        bad = tmp_path / "notes.png"
        bad.write_text("no picture")
        send(walk, "Choose a photograph", bad)
        window.wait(f"({ERROR_TEXT}).join().includes('notes.png: expected')")
        time.sleep(0.5)  # it fades in
        walk.shot("bad-file")
        # and no sign of it lies over the picture, where a photograph may be open
        signs = "[...document.querySelectorAll('[data-testid=status-tracker] .error')]"
        assert window.run(f"return {signs}.filter(e => e.checkVisibility()).length") == 0
        window.run("document.querySelector('.toast-close').click()")
        window.wait(f"!({ERROR_TEXT}).length")

        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')")
        walk.wait_for("#status", "click on the object")
        walk.shot("photograph")

        # object, background, and a second region by clicks
        for point in (CUP, SAUCER):
            walk.point(point)
        assert "covers" in walk.text("#status")
        walk.choose("#marked", 1)  # not the object
        walk.point(TABLE)
        walk.choose("#marked", 2)  # its second part
        walk.point(SAUCER)
        walk.point((120, 139))
        walk.wait_for("#status", "2 parts")
        walk.shot("regions")
        walk.take_back()
        walk.take_back()
        window.wait("!document.querySelector('#status').innerText.includes('2 parts')")
        walk.point(SAUCER)
        walk.wait_for("#status", "2 parts")

        window.click("#decompose")
        window.wait("document.querySelector('#editor img')")
        walk.wait_for("#shown", "choose a material")
        time.sleep(0.5)
        walk.shot("decomposed")
        count = window.run("return document.querySelectorAll('#materials button').length")
        assert count == len(gallery.families())

        # a material by an everyday word
        names = walk.search("leather")
        assert names[0] == "leather" and "natural-209" in names
        painted = "part 1: leather; part 2: as it is"
        first = walk.changed(lambda: walk.pick("leather"), painted)
        walk.shot("material")

        # a refinement that is stopped leaves the edit as it is
        window.click("#improve")
        walk.wait_for("#improving", "refining, step")
        walk.shot("improving")
        window.click("#stop-improving")
        walk.wait_for("#improving", "Stopped")
        assert painted in walk.text("#shown")

        # the second region, then a blend
        walk.choose("#region", 1)
        names = walk.search("gold")
        second = walk.changed(lambda: walk.pick(names[0]), f"part 2: {names[0]}")
        assert abs(second - first).mean() > 1
        walk.choose("#slot", 1)
        names = walk.search("blue rubber")
        blended = walk.changed(lambda: walk.pick(names[0]), "50%")
        third = walk.changed(lambda: walk.slide("#share", 100), "100%")
        assert abs(third - blended).mean() > 0.5
        walk.shot("blend")
        halfway = walk.changed(lambda: walk.slide("#share", 30), "30%")
        assert abs(halfway - third).mean() > 0.5

        # light: turned, and another
        turned = walk.changed(lambda: walk.slide("#rotation", 90), "turned by 90°")
        assert abs(turned - halfway).mean() > 0.5
        window.click("#light input")
        walk.changed(
            lambda: window.run(
                "[...document.querySelectorAll('[role=option]')]"
                ".find(e => e.innerText.includes('sunset')).dispatchEvent("
                "new MouseEvent('mousedown', {bubbles: true}))"
            ),
            "light: ",
            "sunset",
        )
        walk.shot("light")

        # the files
        window.run(
            "[...document.querySelectorAll('[role=tab]')]"
            ".find(e => e.innerText.includes('Download')).click()"
        )
        window.click("#make")
        walk.wait_for("#made", "is ready")
        walk.shot("download")
        links = walk.links()
        files = {link.rsplit("/", 1)[1]: link for link in links}
        expected = {"edited.exr", "material.json", "edit.json", "command.txt", "cup-work.zip"}
        assert expected < set(files)
        (picture,) = (link for name, link in files.items() if "leather" in name)
        data = urllib.request.urlopen(picture, timeout=60).read()
        assert Image.open(io.BytesIO(data)).size == SIZE
        recipe = json.load(urllib.request.urlopen(files["edit.json"], timeout=60))
        assert recipe["regions"][0]["first"]["text"] == "leather"
        command = window.run("return document.querySelector('#command textarea').value")
        assert command.startswith("brdfactory app cup.png") and "--repeat edit.json" in command
        assert walk.errors() == []


def open_tab(walk: Walk, text: str) -> None:
    walk.window.run(
        "[...document.querySelectorAll('[role=tab]')]"
        f".find(e => e.innerText.includes({text!r})).click()"
    )


def draw(walk: Walk, points: list[tuple[float, float]]) -> None:
    """Draw a line on the canvas, through points in shares of its width and height."""
    x, y, width, height = walk.window.run(
        "const r = document.querySelector('#brush canvas').getBoundingClientRect();"
        "return [r.left, r.top, r.width, r.height]"
    )
    walk.window.drag([(x + width * column, y + height * row) for column, row in points])
    time.sleep(0.5)


def covered_share(walk: Walk) -> int:
    """Return how much of the picture the object covers, in per cent, as the page says."""
    return int(walk.text("#status").split("covers ")[1].split("%")[0])


def test_drawing_sliders_another_pictures_material_an_own_light_and_the_same_pixels_again(
    served, photo, tmp_path
):
    from brdfactory.command_line import run

    folder = tmp_path / "screenshots"
    folder.mkdir()
    with Browser(1300, 1150) as window:
        walk = opened(window, served, folder)
        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')")
        assert window.run("return document.querySelector('#decompose').disabled")

        # a line around the cup, then paint on the table beside it, which is not the object
        open_tab(walk, "Draw")
        window.wait("document.querySelector('#brush canvas')?.getBoundingClientRect().width > 99")
        time.sleep(2)  # the canvas is laid out in steps
        window.click("#use-line")
        window.wait(f"({ERROR_TEXT}).some(e => e.includes('Draw on the picture first'))")
        around = [(0.27, 0.42), (0.5, 0.42), (0.68, 0.55), (0.6, 0.85), (0.3, 0.85), (0.27, 0.42)]
        draw(walk, around)
        walk.shot("line")
        window.click("#use-line")
        walk.wait_for("#status", "covers")
        enclosed = covered_share(walk)
        assert 2 <= enclosed <= 25
        time.sleep(2)
        draw(walk, [(0.3, 0.8), (0.6, 0.8)])
        window.click("#marked label:nth-of-type(2)")
        walk.shot("not-the-object")
        window.click("#use-brush")
        window.wait(f"!document.querySelector('#status').innerText.includes('covers {enclosed}%')")
        # the line that was drawn before is no paint of the second
        assert 0 < covered_share(walk) < enclosed
        window.click("#undo")
        walk.wait_for("#status", f"covers {enclosed}%")
        open_tab(walk, "Click")
        walk.shot("drawn-mask")

        window.click("#decompose")
        window.wait("document.querySelector('#editor img')")
        walk.wait_for("#shown", "choose a material")

        # a material by sliders
        open_all = "[...document.querySelectorAll('#own button, .label-wrap')]"
        window.run(f"{open_all}.filter(e => !e.classList.contains('open')).forEach(e => e.click())")
        window.wait("document.querySelector('#roughness input[type=range]')")
        window.wait("document.querySelectorAll('#decomposition img').length == 4")
        rough = walk.changed(lambda: walk.slide("#roughness", 0.9), "principled(", "roughness=0.9")
        smooth = walk.changed(lambda: walk.slide("#roughness", 0.1), "roughness=0.1")
        metal = walk.changed(lambda: walk.slide("#metallic", 1.0), "metallic=1")
        assert abs(smooth - rough).mean() > 0.1 and abs(metal - smooth).mean() > 0.1
        walk.shot("sliders")

        # the material of another picture, which is cut out
        cut = tmp_path / "other.png"
        y_, x_ = np.mgrid[-1:1:96j, -1:1:96j]
        depth = np.sqrt(np.clip(0.6 - x_ * x_ - y_ * y_, 0, 1))
        shade = (60 + 150 * depth).clip(0, 255)[..., None] * [0.3, 0.9, 0.4]
        opacity = np.where(depth > 0, 255, 0)[..., None]
        Image.fromarray(np.concatenate([shade, opacity], -1).astype(np.uint8)).save(cut)
        no_object = tmp_path / "opaque.png"
        Image.fromarray(shade.astype(np.uint8)).save(no_object)
        send(walk, "Choose a picture or material.json", no_object)
        window.wait(f"({ERROR_TEXT}).join().includes('opaque.png')")
        window.run("document.querySelector('.toast-close').click()")
        window.wait(f"!({ERROR_TEXT}).length")
        choose = "Choose a picture or material.json"
        other = walk.changed(lambda: send(walk, choose, cut), "other.png")
        assert abs(other - metal).mean() > 0.5
        walk.shot("other-pictures-material")

        # a light of one's own
        light = np.full((32, 64, 3), 0.2, np.float32)
        light[6:12, 10:20] = (30.0, 20.0, 10.0)
        photographs.write_exr(tmp_path / "mine.exr", light)
        own_light = "Or a map of your own (.exr)"
        lit = walk.changed(lambda: send(walk, own_light, tmp_path / "mine.exr"), "light: mine.exr")
        assert abs(lit - other).mean() > 0.5
        walk.shot("own-light")

        # the command repeats the files pixel by pixel
        open_tab(walk, "Download")
        window.click("#make")
        walk.wait_for("#made", "is ready")
        links = walk.links()
        command = window.run("return document.querySelector('#command textarea').value")
        walk.shot("files")
        assert walk.errors(with_warnings=False) == []  # Gradio's brush warns of its own library
        for link in links:
            data = urllib.request.urlopen(link, timeout=60).read()
            (tmp_path / link.rsplit("/", 1)[1]).write_bytes(data)
    program, *words = shlex.split(command)
    assert program == "brdfactory" and "--repeat" in words
    files = {"cup.png": photo} | {n: tmp_path / n for n in ("edit.json", "mask.png", "regions.png")}
    assert run([str(files.get(word, word)) for word in words[:-1]] + [str(tmp_path / "again")]) == 0
    (picture,) = tmp_path.glob("cup-other-png-*.png")
    made, again = (
        np.asarray(Image.open(path), int) for path in (picture, tmp_path / "again/edited.png")
    )
    assert made.shape == again.shape and abs(made - again).max() == 0
    linear = [photographs.read_exr(tmp_path / where / "edited.exr")[0] for where in ("", "again")]
    np.testing.assert_allclose(*linear, rtol=1e-5, atol=1e-6)  # the light is stored as an EXR


def test_five_materials_are_compared_and_work_goes_on_after_the_page_was_left(
    served, photo, tmp_path
):
    folder = tmp_path / "screenshots"
    folder.mkdir()
    with Browser(1300, 1150) as window:
        walk = opened(window, served, folder)
        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')")
        # the browser asks, as the photograph would be gone; who stays still has it, as clicks show
        window.run(
            "window.stays = 0;"
            "document.querySelector('#stayed').addEventListener('click', () => window.stays++)"
        )
        assert window.run(LEAVING)
        window.wait("window.stays === 1")  # the server is asked to keep the session
        for place in ("#status", "#progress"):
            assert window.run(f"return document.querySelector('{place}').ariaLive") == "polite"
        assert (
            "click on it" in window.run("return document.querySelector('#marking img').alt").lower()
        )
        for point in (CUP, SAUCER):
            walk.point(point)
        window.click("#decompose")
        window.wait("document.querySelector('#editor img')")
        walk.wait_for("#shown", "choose a material")

        # nothing is called so: what comes near is shown, and said
        names = walk.search("blue velvet")
        walk.wait_for("#count", "No material is called “blue velvet”")
        assert names[0] == "blue-fabric"
        walk.search("")
        kept = "document.querySelectorAll('#kept figure').length"
        pictures = []
        for number, name in enumerate(("blue-fabric", "blue-metallic-paint", "brass"), 1):
            pictures.append(walk.changed(lambda name=name: walk.pick(name), name))
            window.click("#keep-it")
            window.wait(f"{kept} == {number}")
        walk.shot("kept")
        darker = walk.changed(lambda: walk.slide("#brightness", -1), "brightness −1")
        assert darker.mean() < pictures[2].mean() - 1
        shaded = walk.changed(lambda: walk.slide("#detail", 100), "own shading 100%")
        assert abs(shaded - darker).max() > 10 and abs(shaded.mean() - darker.mean()) < 2

        # one of them on the left of the line, one shown again, one removed
        window.run("document.querySelectorAll('#kept [data-act=beside]')[1].click()")
        walk.wait_for("#shown", "Left of the line: blue-metallic-paint.")
        pressed = (
            "[...document.querySelectorAll('#kept [data-act=beside]')].map(e => e.ariaPressed)"
        )
        window.wait(f"({pressed})[1] === 'true'")
        again = walk.changed(
            lambda: window.run("document.querySelector('#kept [data-act=show]').click()"),
            "blue-fabric. Left",
        )
        np.testing.assert_allclose(again, pictures[0], atol=4)
        slider = "return document.querySelector('#brightness input[type=range]').value"
        window.wait(f"(() => {{{slider}}})() == 0")
        window.wait(f"(() => {{{slider.replace('#brightness', '#detail')}}})() == 50")
        window.run("document.querySelector('#kept [data-act=remove]').click()")
        window.wait(f"{kept} == 2")
        walk.wait_for("#shown", "Left of the line: blue-metallic-paint.")

        open_tab(walk, "Download")
        window.click("#make")
        walk.wait_for("#made", "4 pictures are ready")
        names = [link.rsplit("/", 1)[1] for link in walk.links()]
        assert names[:4] == [
            "cup-blue-fabric.png",
            "cup-blue-metallic-paint.png",
            "cup-brass.png",
            "cup-compared.jpg",
        ]
        (link,) = (link for link in walk.links() if link.endswith("cup-work.zip"))
        work = tmp_path / "cup-work.zip"
        work.write_bytes(urllib.request.urlopen(link, timeout=60).read())
        walk.shot("download")

    with Browser(1300, 1150) as window:
        walk = opened(window, served, folder)
        send(walk, "Or open saved work (.zip)", work)
        window.wait(f"{kept} == 2")
        walk.wait_for("#shown", "Exact view. blue-fabric. Left of the line: the photograph.")
        window.wait(RESULT)
        np.testing.assert_allclose(walk.result(), again, atol=1)
        walk.shot("work-opened")
        assert walk.errors() == []


def test_on_a_telephone_the_picture_is_near_the_buttons_and_nothing_is_wider(served, tmp_path):
    with Browser(390, 844) as window:
        window.resize(390, 844)
        walk = opened(window, served, tmp_path)
        time.sleep(1)
        place = "document.querySelector('{}').getBoundingClientRect()"
        tabs = "[...document.querySelectorAll('[role=tab]')].filter(e => e.offsetParent)"
        assert window.run(f"return {tabs}.map(e => e.innerText)")[:3] == [
            "1 Photo",
            "2 Material",
            "3 Download",
        ]
        walk.shot("telephone")
        window.click("#example")
        window.wait("document.querySelector('#marking img')")
        time.sleep(1)
        walk.shot("telephone-example")
        tops = [
            window.run(f"return {place.format(i)}.top")
            for i in ("#photo", "#marking", "#decompose")
        ]
        assert tops == sorted(tops) and tops[1] < 844
        assert window.run("return document.documentElement.scrollWidth") <= 390
        # the view stays in sight while a material is chosen further down
        open_tab(walk, "Material")
        window.wait("document.querySelector('#editor')?.getBoundingClientRect().height > 50")
        window.run("scrollTo(0, 700)")
        time.sleep(0.5)
        walk.shot("telephone-materials")
        assert window.run("return scrollY") > 300
        assert window.run(f"return {place.format('#editor')}.top") == pytest.approx(0, abs=12)


def test_on_a_low_screen_what_comes_next_is_seen_without_scrolling(served, tmp_path):
    with Browser(1366, 768) as window:
        walk = opened(window, served, tmp_path)
        low = window.run("return innerHeight")
        assert low < 700
        bottom = "document.querySelector('{}').getBoundingClientRect().bottom"
        seen = "!!document.querySelector('{}').offsetParent"
        # before there is a photograph, only the ways to choose one are there
        of_marks = ("#marked", "#undoing", "#fit", "#shape", "#own-mask", "#decompose")
        assert window.run(f"return {seen.format('#photo')}")
        assert not any(window.run(f"return {seen.format(i)}") for i in of_marks)
        window.click("#example")
        window.wait("document.querySelector('#marking img')")
        time.sleep(1)
        walk.shot("low-screen")
        assert all(window.run(f"return {seen.format(i)}") for i in of_marks)
        for part in ("#decompose", "#marking"):
            assert window.run(f"return {bottom.format(part)}") <= low
        window.click("#decompose")
        window.wait("document.querySelector('#editor img')")
        time.sleep(1)
        window.run("scrollTo(0, 0)")
        walk.shot("low-screen-materials")
        for part in ("#editor", "#improve", "#materials .tiles"):
            assert window.run(f"return {bottom.format(part)}") <= low
        open_tab(walk, "Download")
        assert not window.run(f"return {seen.format('#pictures')}")


def test_two_users_do_not_see_each_others_photographs(served, photo, tmp_path):
    other = tmp_path / "other.png"
    Image.fromarray(np.full((50, 100, 3), 90, np.uint8)).save(other)
    with Browser(1300, 1000) as one, Browser(1300, 1000) as two:
        first, second = opened(one, served, tmp_path), opened(two, served, tmp_path)
        send(first, "Choose a photograph", photo)
        one.wait("document.querySelector('#marking img')")
        send(second, "Choose a photograph", other)
        two.wait("document.querySelector('#marking img')")
        first.point(CUP)
        shape = (
            "const i = document.querySelector('#marking img');"
            "return i.naturalWidth / i.naturalHeight"
        )
        for window in (one, two):
            window.wait("document.querySelector('#marking img').complete")
        assert (one.run(shape), two.run(shape)) == pytest.approx((1.5, 2), abs=0.01)
        assert "covers" in first.text("#status") and "covers" not in second.text("#status")
        second.shot("second-user")
        address = one.run("return document.querySelector('#marking img').src")
        assert urllib.request.urlopen(address, timeout=60).status == 200
        assert first.errors() == second.errors() == []
    # both pages are closed: their files are deleted
    for _ in range(400):
        try:
            urllib.request.urlopen(address, timeout=60)
        except urllib.error.HTTPError:
            break
        time.sleep(0.2)
    else:
        pytest.fail("the photograph of a closed page is still served")


def test_a_page_that_is_loaded_again_goes_on_and_another_page_sees_nothing(served):
    kept = "sessionStorage.getItem('brdfactory-session')"
    with Browser() as window:
        walk = opened(window, served, Path())
        window.click("#example")
        window.wait("document.querySelector('#marking img')")
        key = window.run(f"return {kept}")
        window.reload()
        window.wait("document.querySelector('#marking img')?.naturalWidth")
        walk.wait_for("#status", "in 2 parts")
        assert window.run(f"return {kept}") == key and key not in window.run("return location.href")
        # a page that is loaded again while it analyses the photograph does so again
        window.click("#decompose")
        window.wait("document.querySelector('#stop')?.checkVisibility()")
        window.reload()
        window.wait("document.querySelector('#editor img')")
        window.reload()
        # the tab that was open is open again
        window.wait("document.querySelector('#editor img')?.naturalWidth")
        assert "Your edit is in step 2" in walk.window.run(
            "return document.querySelector('#status').textContent"
        )
    with Browser() as window:
        walk = opened(window, served, Path())
        window.wait(kept)
        time.sleep(1)
        assert window.run(f"return {kept}") != key
        assert "Choose a photograph" in walk.text("#status")
        assert not window.run("return !!document.querySelector('#marking img, #editor img')")


# texts whose contrast with what is behind them is below 4.5 to 1, or 3 to 1 for large ones; those
# of buttons that cannot be pressed do not count (WCAG 2.2, 1.4.3)
FAINT = """
const pen = new OffscreenCanvas(1, 1).getContext('2d', {willReadFrequently: true});
const read = color => {
  pen.clearRect(0, 0, 1, 1); pen.fillStyle = color; pen.fillRect(0, 0, 1, 1);
  const [r, g, b, a] = pen.getImageData(0, 0, 1, 1).data;
  return [[r, g, b], a / 255];
};
const over = ([top, share], below) => top.map((v, k) => v * share + below[k] * (1 - share));
const behind = e => {
  const color = e ? read(getComputedStyle(e).backgroundColor) : [[255, 255, 255], 1];
  return color[1] > 0.99 ? color[0] : over(color, behind(e.parentElement));
};
const luminance = c => c.map(v => v / 255)
  .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
  .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
return [...document.querySelectorAll('body *')].filter(e => {
  const own = [...e.childNodes].some(n => n.nodeType === 3 && /\\w/.test(n.data));
  if (!(own || e.placeholder) || !e.checkVisibility() || e.closest('[disabled]')) return false;
  const style = getComputedStyle(e, e.placeholder ? '::placeholder' : null);
  const below = behind(e), [color, share] = read(style.color);
  const pair = [luminance(over([color, share * style.opacity], below)), luminance(below)];
  const large = parseFloat(style.fontSize) >= 24;
  return (Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05) < (large ? 3 : 4.5);
}).map(e => e.placeholder || e.innerText);
"""
# drops a picture, a red disk before grey, on the page
DROP = """
const canvas = new OffscreenCanvas(300, 200), pen = canvas.getContext('2d');
pen.fillStyle = '#888'; pen.fillRect(0, 0, 300, 200);
pen.fillStyle = '#c33'; pen.arc(150, 100, 60, 0, 7); pen.fill();
const files = new DataTransfer();
files.items.add(new File([await canvas.convertToBlob()], 'disk.png', {type: 'image/png'}));
const event = new DragEvent('drop', {dataTransfer: files, bubbles: true, cancelable: true});
document.body.dispatchEvent(event);
return event.defaultPrevented;
"""


def faint(window: Browser, dark: bool) -> list[str]:
    """Return texts that are too faint on the page in dark or light colours.

    Colours change smoothly, and late on a busy computer: what is faint has to stay so.
    """
    window.run(f"document.body.classList.toggle('dark', {str(dark).lower()})")
    for _ in range(12):
        time.sleep(0.5)
        if not (texts := window.run(FAINT)):
            break
    return texts


def press(window: Browser, selector: str, key: str) -> None:
    """Press a key where a selector's element has the focus, as only a keyboard would give it."""
    window.run(f"document.querySelector({selector!r}).focus()")
    window.run(
        "const e = document.activeElement, given = {key: "
        f"{key!r}, bubbles: true, cancelable: true}};"
        "if (e.dispatchEvent(new KeyboardEvent('keydown', given)) && given.key === 'Enter')"
        " e.click();"
    )


def test_a_dropped_photograph_is_edited_by_the_keyboard_and_quick_choices_are_not_lost(served):
    # a page that has just been loaded again has no tabs yet
    selected = "(document.querySelector('[role=tab][aria-selected=true]')?.innerText ?? '')"
    with Browser(1300, 1000) as window:
        walk = opened(window, served, Path())
        window.wait("sessionStorage.getItem('brdfactory-session')")
        assert window.run(DROP)
        window.wait("document.querySelector('#marking img')?.naturalWidth")
        image = "document.querySelector('#marking img')"
        x, y = window.run(
            f"const r = {image}.getBoundingClientRect();"
            "return [r.left + r.width / 2, r.top + r.height / 2]"
        )
        window.click_at(x, y)
        walk.wait_for("#status", "covers")
        assert faint(window, dark=False) == faint(window, dark=True) == []
        press(window, "#decompose", "Enter")
        walk.wait_for("#shown", "choose a material")
        # the focus is where the user is by now
        window.wait("document.activeElement.innerText.includes('Material')")
        # a drop here is not taken for another photograph, nor does the browser leave the page
        before = window.run(f"return {image}.src")
        assert window.run(DROP)
        assert faint(window, dark=True) == faint(window, dark=False) == []

        press(window, "#materials button", "ArrowRight")
        name = window.run("return document.activeElement.dataset.name")
        press(window, f"#materials [data-name={name}]", "Enter")
        walk.wait_for("#shown", f"Exact view. {name}")
        place = "document.querySelector('#editor .outer').getBoundingClientRect().left"
        left = window.run(f"return {place}")
        press(window, "#editor .outer", "ArrowRight")
        window.wait(f"{place} > {left} + 10")

        names = ["chrome", "blue-fabric", "natural-209", "brass", "red-fabric", "green-latex"]
        for each in names:
            window.run(f"document.querySelector('#materials [data-name={each}]').click()")
            time.sleep(0.08)
        walk.wait_for("#shown", f"Exact view. {names[-1]}")
        assert window.run(f"return {image}.src") == before
        assert walk.errors() == []
        window.reload()
        window.wait(f"{selected}.includes('Material')")
        walk.wait_for("#shown", f"Exact view. {names[-1]}")


def test_the_object_is_marked_by_the_keyboard_alone(served, photo, tmp_path):
    tab, shift, control, enter, backspace = "\ue004", "\ue008", "\ue009", "\ue007", "\ue003"
    left, up, right, down = "\ue012", "\ue013", "\ue014", "\ue015"
    has_focus = "document.activeElement.matches('#marking button:has(img)')"
    # where the cross is in the picture, as shares of its width and height
    crossed = (
        "const i = document.querySelector('#marking img'), r = i.getBoundingClientRect();"
        "const s = Math.min(r.width / i.naturalWidth, r.height / i.naturalHeight);"
        "const c = document.querySelector('#cross').getBoundingClientRect();"
        "return [0.5 + (c.left + c.width / 2 - r.left - r.width / 2) / (s * i.naturalWidth),"
        " 0.5 + (c.top + c.height / 2 - r.top - r.height / 2) / (s * i.naturalHeight)]"
    )
    with Browser(1300, 1000) as window:
        walk = opened(window, served, tmp_path)
        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')?.naturalWidth")
        walk.point(CUP)
        by_mouse = walk.text("#status")
        walk.take_back()
        assert window.run(
            "return document.querySelector('#cross')?.checkVisibility() ?? false"
        ) is (False)

        window.run("document.querySelector('#marked input').focus()")
        for _ in range(20):
            window.press(tab)
            if window.run(f"return {has_focus}"):
                break
        assert window.run(f"return {has_focus}")
        walk.wait_for("#cross-line", "Cross at 50% from the left, 50% from the top. Arrow keys")
        assert window.run("return document.querySelector('#cross-line').ariaLive") == "polite"
        assert window.run("return document.querySelector('#marking').role") == "application"
        # the cup's point is at 39 % and 73 % of the picture
        window.press(shift + left, *4 * [right, down], *5 * [left], *2 * [shift + down], *3 * [up])
        window.press(*2 * [down])
        walk.wait_for("#cross-line", "Cross at 39% from the left, 73% from the top.")
        np.testing.assert_allclose(window.run(crossed), [0.39, 0.73], atol=0.003)
        window.press(enter)
        walk.wait_for("#status", "Marked as the object, 39% from the left and 73% from the top.")
        marked = walk.text("#status")
        assert marked.endswith(by_mouse) and "covers" in by_mouse
        assert window.run(f"return {has_focus}")  # the picture is another one by now
        walk.shot("marked by keys")

        window.press(*3 * [shift + right])
        window.press(backspace)
        walk.wait_for(
            "#status", "Marked as not the object, 69% from the left and 73% from the top."
        )
        window.press(control + "z")
        window.wait("!document.querySelector('#status').innerText.includes('Marked')")
        window.press(*20 * [shift + up])
        walk.wait_for("#cross-line", "69% from the left, 0% from the top")
        window.press("-")  # at the very edge
        walk.wait_for("#status", "69% from the left and 0% from the top")
        assert walk.errors() == []
        window.press(tab)
        assert not window.run("return document.querySelector('#cross').checkVisibility()")


def test_a_line_is_drawn_around_the_object_by_the_keyboard_alone(served, photo, tmp_path):
    tab, shift, control, escape = "\ue004", "\ue008", "\ue009", "\ue00c"
    left, up, right, down = "\ue012", "\ue013", "\ue014", "\ue015"
    drawn = (
        "[...document.querySelectorAll('#cross-path polyline')]"
        ".map(e => [e.dataset.part, e.points.length])"
    )
    with Browser(1300, 1000) as window:
        walk = opened(window, served, tmp_path)
        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')?.naturalWidth")
        window.run("document.querySelector('#marking button:has(img)').focus()")
        window.press(shift + left)  # the cross appears by the keyboard alone
        walk.wait_for("#cross-line", "Cross at 40% from the left, 50% from the top.")
        window.press("c")
        walk.wait_for("#cross-line", "Set three corners with L first.")
        window.press("p")
        walk.wait_for("#cross-line", "Set a corner with L first.")
        window.press(*2 * [shift + left], *3 * [shift + up], "l")
        walk.wait_for(
            "#cross-line", "Corner 1. Cross at 20% from the left, 20% from the top. L sets"
        )
        window.press(*6 * [shift + right], "l")
        walk.wait_for("#cross-line", "Corner 2. Cross at 80% from the left, 20% from the top.")
        assert "L sets" not in walk.text("#cross-line")
        window.press(down)
        sides = [["rim", 2], ["core", 2], ["rim", 2], ["next", 2]]
        assert window.run(f"return {drawn}") == sides
        place = window.run(
            "const i = document.querySelector('#marking img').getBoundingClientRect();"
            "const s = document.querySelector('#cross-path').getBoundingClientRect();"
            "const p = document.querySelector('#cross-path [data-part=core]').points;"
            "const w = Math.min(i.width, 1.5 * i.height), h = w / 1.5;"  # of 3 to 2
            "return [...p].map(q => [(s.left + q.x - i.left - (i.width - w) / 2) / w,"
            " (s.top + q.y - i.top - (i.height - h) / 2) / h])"
        )
        np.testing.assert_allclose(place, [[0.2, 0.2], [0.8, 0.2]], atol=0.005)
        walk.shot("line")
        window.press(control + "z")
        walk.wait_for("#cross-line", "The line has 1 corner now.")
        window.press(escape)
        walk.wait_for("#cross-line", "The line is removed.")
        assert window.run(f"return {drawn}") == []

        window.press(*3 * [up], "l", *6 * [shift + down], "L", *6 * [shift + left], "l", "c")
        walk.wait_for("#status", "Marked what the line encloses as the object: 3 corners.")
        assert "covers" in walk.text("#status") and window.run(f"return {drawn}") == []
        assert window.run("return document.activeElement.matches('#marking button:has(img)')")
        walk.shot("enclosed")
        before = walk.text("#status")
        window.press("l", shift + up, "p")
        walk.wait_for("#status", "Painted along the line as the object.")
        window.press(control + "z")
        window.wait("!document.querySelector('#status').innerText.includes('Painted')")
        after = walk.text("#status")
        assert after.startswith("The coloured object covers") and before.endswith(after)
        window.press("l")
        window.press(tab)
        assert not window.run("return document.querySelector('#cross-path').checkVisibility()")
        window.click("#example")  # another photograph, to which the line does not belong
        walk.wait_for("#status", "The example is marked already")
        window.run("document.querySelector('#marking button:has(img)').focus()")
        window.press(control + "z")
        walk.wait_for("#status", "Nothing is left to undo.")
        assert window.run(f"return {drawn}") == [] and walk.errors() == []


def test_the_fit_of_the_masks_edge_is_switched_off_by_the_keyboard_and_for_later(
    served, photo, tmp_path
):
    tab, space = "\ue004", " "
    switch = "document.querySelector('#fit input')"
    with Browser(1300, 1000) as window:
        walk = opened(window, served, tmp_path)
        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')?.naturalWidth")
        walk.point(CUP)
        assert "Moves the object's edge" in window.run(f"return {switch}.ariaDescription")
        window.run("document.querySelector('#clear').focus()")
        window.press(tab)
        assert window.run(f"return document.activeElement === {switch} && {switch}.checked")
        window.press(space)
        window.wait(f"!{switch}.checked")
        time.sleep(0.5)  # it is sent by itself
        window.reload()
        window.wait(f"{switch} && !{switch}.checked")
        window.wait("!document.querySelector('#decompose').disabled")
        walk.shot("switched off")
        window.click("#decompose")
        walk.wait_for("#shown", "choose a material")
        window.run(
            "[...document.querySelectorAll('[role=tab]')]"
            ".find(e => e.innerText.includes('Download')).click()"
        )
        window.wait("document.querySelector('#make')?.checkVisibility()")
        window.click("#make")
        walk.wait_for("#made", "The picture is ready")
        work, command = tmp_path / "work.zip", "document.querySelector('#command textarea').value"
        (link,) = (link for link in walk.links() if link.endswith("cup-work.zip"))
        work.write_bytes(urllib.request.urlopen(link, timeout=60).read())
        assert "--no-fit-mask" in window.run(f"return {command}")
        assert walk.errors() == []
    with Browser(1300, 1000) as window:
        walk = opened(window, served, tmp_path)
        window.wait(f"{switch}.checked")
        send(walk, "Or open saved work (.zip)", work)
        walk.wait_for("#shown", "choose a material")
        assert not window.run(f"return {switch}.checked")


def test_the_shape_of_the_object_is_named_by_the_keyboard_and_for_later(served, photo, tmp_path):
    tab, space = "\ue004", " "
    chosen = "document.querySelector('#shape input:checked')?.value"
    with Browser(1300, 1000) as window:
        walk = opened(window, served, tmp_path)
        send(walk, "Choose a photograph", photo)
        window.wait("document.querySelector('#marking img')?.naturalWidth")
        walk.point(CUP)
        group = window.run(
            "const e = document.querySelector('#shape'); return [e.ariaLabel, e.ariaDescription]"
        )
        assert group[0] == "Shape of the object" and "prints on it do not become relief" in group[1]
        assert window.run(f"return {chosen}") == "guessed"
        window.run("document.querySelector('#fit input').focus()")
        window.press(tab, tab, space, tab, tab, space)  # a box, then at once a ball
        window.wait(f"{chosen} === 'ball'")
        time.sleep(0.5)  # it is sent by itself
        window.reload()
        window.wait(f"{chosen} === 'ball'")
        window.wait("!document.querySelector('#decompose').disabled")
        walk.shot("ball")
        window.click("#decompose")
        walk.wait_for("#shown", "choose a material")
        walk.wait_for("#improving", "The outline of a ball overlaps the mask by only")
        walk.shot("warned")
        window.run(
            "[...document.querySelectorAll('[role=tab]')]"
            ".find(e => e.innerText.includes('Download')).click()"
        )
        window.wait("document.querySelector('#make')?.checkVisibility()")
        window.click("#make")
        walk.wait_for("#made", "The picture is ready")
        work, command = tmp_path / "work.zip", "document.querySelector('#command textarea').value"
        (link,) = (link for link in walk.links() if link.endswith("cup-work.zip"))
        work.write_bytes(urllib.request.urlopen(link, timeout=60).read())
        assert "--shape ball" in window.run(f"return {command}")
        assert walk.errors() == []
    with Browser(1300, 1000) as window:
        walk = opened(window, served, tmp_path)
        window.wait(f"{chosen} === 'guessed'")
        send(walk, "Or open saved work (.zip)", work)
        walk.wait_for("#shown", "choose a material")
        assert window.run(f"return {chosen}") == "ball"
        window.run("document.querySelector('[role=tab]').click()")
        window.click("#example")  # another object
        window.wait(f"{chosen} === 'guessed'")


def test_nothing_outside_this_computer_is_asked_for(served):
    with Browser() as window:
        window.visit(served)
        window.wait("document.querySelector('#photo')")
        time.sleep(1)
        assert not window.run(LEAVING)  # there is no photograph to lose
        asked = window.run("return performance.getEntriesByType('resource').map(e => e.name)")
    assert asked
    assert not [name for name in asked if not name.startswith((served, "data:", "blob:"))]


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.parametrize(
    ("storage", "expected"),
    [
        ("{value: {getItem: name => kept[name], setItem(name, key) {kept[name] = key}}}", "k"),
        ("{get() {throw new Error('The operation is insecure.')}}", ""),
    ],
)
def test_a_browser_that_may_keep_nothing_opens_the_page_all_the_same(storage, expected):
    from learn.app.page_script import KEEP_KEY, RECALL_KEY

    script = (
        f"const kept = {{}}; Object.defineProperty(globalThis, 'sessionStorage', {storage});"
        f"({KEEP_KEY})('k'); console.log(JSON.stringify(({RECALL_KEY})()))"
    )
    done = subprocess.run(["node", "-e", script], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [expected]
