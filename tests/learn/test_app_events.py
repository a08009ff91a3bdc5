"""What the page does when users are faster than it is, or press what cannot work yet."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from learn.app import choices, gallery
from learn.app.background_decomposition import Network
from learn.app.choices import Edit, Painted
from learn.app.session import Session
from learn.app.sessions import Sessions
from manifests.errors import InputError
from tests.support.known_ball import Knowing, ball, label_of

gr = pytest.importorskip("gradio", reason="gradio is not installed (extra app)")
from learn.app import page  # noqa: E402
from learn.app.download_tab import DownloadTab  # noqa: E402
from learn.app.edit_controls import FIRST, painting, share_of  # noqa: E402
from learn.app.edit_view import UNCHANGED, exact_view, quick_view  # noqa: E402
from learn.app.event_handling import in_place  # noqa: E402
from learn.app.material_tab import MaterialTab  # noqa: E402
from learn.app.object_tab import DONE, ObjectTab  # noqa: E402

SIDE = 64


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """A session with a photograph of a ball that is marked."""
    network = Network(Path("known.safetensors"))
    known = (Knowing(label_of("blue-rubber")), {"size": 64})
    monkeypatch.setattr(network, "loaded", lambda: known)
    result = Sessions(tmp_path, network).begin("one")
    result.load(photograph_in(tmp_path))
    return result


def photograph_in(folder: Path) -> Path:
    _, inside = ball(SIDE, 24)
    shade = np.where(inside[..., None], 150, 40) * np.ones(3)
    path = folder / "ball.png"
    pixels = np.concatenate([shade, 255.0 * inside[..., None]], -1).astype(np.uint8)
    Image.fromarray(pixels).save(path)
    return path


def tab_of(kind: type, session: Session, **parts: object):
    """Return a tab without its layout, for which `session` is whoever asks."""
    tab = kind.__new__(kind)
    tab.session_of = lambda request: session
    for name, value in parts.items():
        setattr(tab, name, value)
    return tab


def decompose(session: Session) -> None:
    for _ in session.decompose(refine=False):
        pass


def brass(edit: Edit) -> Edit:
    return edit.with_region(0, Painted(choices.named_material("brass")))


def test_of_quick_choices_the_last_one_is_shown(session: Session) -> None:
    decompose(session)
    viewer, _ = session.decomposed()
    rendered = viewer.view

    def slow(edit: Edit, *rest: object) -> np.ndarray:
        """Another choice comes while this one is rendered."""
        viewer.view = rendered
        session.choose(lambda e: e.with_region(0, Painted()))
        return rendered(edit, *rest)

    viewer.view = slow
    assert quick_view(session, brass) is UNCHANGED
    _, text = quick_view(session, brass)
    assert "brass" in text
    _, text = exact_view(session)
    assert "Exact view" in text and "brass" in text


def test_a_click_that_arrives_after_a_later_one_changes_nothing(session: Session) -> None:
    decompose(session)
    tab = tab_of(MaterialTab, session)
    for name, at in (("chrome", 20.0), ("brass", 10.0)):
        tab.from_gallery(1, FIRST, SimpleNamespace(name=name, at=at), None)
    assert session.edit is not None and session.edit.caption == "chrome"
    tab.from_gallery(1, FIRST, SimpleNamespace(name="brass", at=20.5), None)
    assert session.edit.caption == "brass"


def test_a_part_that_is_gone_is_named_in_a_sentence(session: Session) -> None:
    decompose(session)
    change = painting(2, FIRST, choices.named_material("brass"))
    with pytest.raises(InputError, match="a part from 1 to 1, found 2"):
        session.choose(change)
    assert share_of(session, 2) == 0
    first, text, *rest = in_place(lambda: session.choose(change), 4)()
    assert text == "**The object has fewer parts now: choose one.**"
    assert len(rest) == 2 and first == rest[0] == gr.skip()


def test_what_is_pressed_too_early_says_what_to_do(session: Session, tmp_path: Path) -> None:
    tab = tab_of(MaterialTab, session, filled=[None] * 12)
    assert "Mark the object in step 1 first" in tab.shown_again(session)[1]
    with pytest.raises(InputError, match="mark the object in step 1 first"):
        quick_view(session, brass)
    empty = Session(tmp_path, session.network)
    assert tab.shown_again(empty) == (gr.skip(),) * 12
    with pytest.raises(InputError, match="choose a photograph first"):
        quick_view(empty, brass)


@pytest.mark.parametrize("when", ["analysed", "shown"])
def test_another_photograph_takes_the_place_of_one_that_is_analysed(
    session: Session, tmp_path: Path, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    tab = tab_of(ObjectTab, session, materials=SimpleNamespace(filled=[None] * 12))
    said, other = [], photograph_in(tmp_path)
    if when == "shown":
        monkeypatch.setattr(
            "learn.app.object_tab.first_values",
            lambda session: session.load(other) and session.decomposed(),
        )
    for text, *_ in tab.run(None):
        if when == "analysed" and "reading shape" in text:
            session.load(other)
        said.append(text)
    assert said[-1] == "" and DONE not in said
    assert session.viewer is None and session.opened().name == "ball.png"


def test_files_of_a_photograph_that_gave_way_are_not_offered(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "learn.editing.material_file.write", lambda path, *rest: path.write_text("{}")
    )
    decompose(session)
    tab = tab_of(DownloadTab, session, outputs=[None] * 5)
    assert "is ready" in list(tab.write_all(None))[-1][-1]
    made = []
    for values in tab.write_all(None):
        made.append(values[-1])
        session.load(photograph_in(tmp_path))
    assert len(made) == 1 and "Rendering" in made[0]


def test_the_tab_key_stops_at_one_material() -> None:
    tiles = gallery.page_tiles(gallery.search("leather"), "materials.jpg")
    assert tiles.count('tabindex="0"') == 1
    assert tiles.count('tabindex="-1"') == tiles.count("<button") - 1 > 1


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_the_server_deletes_what_was_sent(
    tmp_path: Path, number: signal.Signals
) -> None:
    """SIGINT comes from Ctrl-C, SIGTERM from services that stop, SIGHUP from closed terminals."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [sys.executable, "-m", "brdfactory", "app", "--port", str(port)]
    place = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=place) as server:
        assert server.stdout is not None
        assert any("Open http" in line for line in server.stdout)
        (folder,) = tmp_path.glob("brdfactory-app-*")
        (folder / "sent").mkdir(exist_ok=True)
        (folder / "sent" / "photo.png").write_bytes(b"a user's photograph")
        server.send_signal(number)
        server.communicate(timeout=60)
    assert server.returncode == 0
    assert not folder.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("moment", ["launch", "print", "close"])
def test_a_signal_at_any_moment_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, moment: str
) -> None:
    """While the page is launched, while its address is printed, and twice while it is closed."""

    def reach(here: str) -> None:
        if here in (moment, "close"):
            os.kill(os.getpid(), number)

    def launch(**options: object) -> tuple[None, str, None]:
        reach("launch")
        return None, "http://here", None

    blocks = SimpleNamespace(launch=launch, close=lambda verbose: reach("close"))
    monkeypatch.setattr("learn.app.page.page", lambda sessions: blocks)
    monkeypatch.setattr("builtins.print", lambda *words, **options: reach("print"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("GRADIO_TEMP_DIR", "restored afterwards")
    if moment == "close":
        threading.Timer(0.3, os.kill, (os.getpid(), number)).start()
    page.serve(tmp_path / "weights.safetensors")
    assert not list(tmp_path.glob("brdfactory-app-*"))
