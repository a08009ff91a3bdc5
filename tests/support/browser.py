"""Headless Chromium, driven through ChromeDriver's HTTP interface (W3C WebDriver)."""

import base64
import json
import shutil
import subprocess
import tempfile
import urllib.request
from pathlib import Path
from typing import Any, Self

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
SCRIPT_MS = 120_000


def is_available() -> bool:
    """Return whether this machine has Chromium and its driver."""
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


class Browser:
    """A browser window of a size in pixels; a context manager that ends it."""

    def __init__(self, width: int = 1300, height: int = 900, *flags: str):
        self.size, self.flags = (width, height), flags

    def __enter__(self) -> Self:
        self.profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.driver = subprocess.Popen(
            [shutil.which("chromedriver") or "chromedriver", "--port=0"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.driver.stdout is not None
        try:
            port = next(
                line.rsplit("port ", 1)[1].strip(". \n")
                for line in self.driver.stdout
                if "successfully on port" in line
            )
            self.address = f"http://127.0.0.1:{port}/session"
            width, height = self.size
            arguments = [
                *FLAGS,
                f"--window-size={width},{height}",
                f"--user-data-dir={self.profile.name}",
                *self.flags,
            ]
            options = {"binary": shutil.which("chromium"), "args": arguments}
            capabilities = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
            session = self._call(
                "POST",
                "",
                {"capabilities": {"alwaysMatch": {"browserName": "chrome"} | capabilities}},
            )
            self.address += f"/{session['sessionId']}"
            self._call("POST", "/timeouts", {"script": SCRIPT_MS, "pageLoad": SCRIPT_MS})
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self._call("DELETE", "")
        finally:
            self._end()

    def _end(self) -> None:
        self.driver.terminate()
        self.driver.wait(30)
        if self.driver.stdout is not None:
            self.driver.stdout.close()
        self.profile.cleanup()

    def _call(self, method: str, path: str, body: dict | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self.address + path, data, {"Content-Type": "application/json"}, method=method
        )
        with urllib.request.urlopen(request, timeout=180) as answer:
            return json.load(answer)["value"]

    def open(self, path: Path, fragment: str = "") -> None:
        """Load a file of this machine; fragment: "#…" or nothing."""
        self._call("POST", "/url", {"url": path.absolute().as_uri() + fragment})

    def visit(self, address: str) -> None:
        """Load an address."""
        self._call("POST", "/url", {"url": address})

    def reload(self) -> None:
        """Load the page again, without a question whether to leave it."""
        ask = "addEventListener('beforeunload', e => e.stopImmediatePropagation(), true);"
        self.run(f"{ask} window.isOld = true;")
        self._call("POST", "/goog/cdp/execute", {"cmd": "Page.reload", "params": {}})
        self.wait("!window.isOld")

    def click_at(self, x: float, y: float) -> None:
        """Click on a point of the window, in pixels from its upper left corner."""
        place = {"type": "pointerMove", "duration": 0, "x": round(x), "y": round(y)}
        steps = [place, *({"type": f"pointer{what}", "button": 0} for what in ("Down", "Up"))]
        self._act(steps)

    def drag(self, points: list[tuple[float, float]]) -> None:
        """Draw a line through points of the window with the button pressed."""
        moves: list[dict] = [
            {"type": "pointerMove", "duration": 60, "x": round(x), "y": round(y)} for x, y in points
        ]
        down, up = ({"type": f"pointer{what}", "button": 0} for what in ("Down", "Up"))
        self._act([moves[0], down, *moves[1:], up])

    def press(self, *keys: str) -> None:
        """Press keys, by their codes of WebDriver, one after the other where the focus is.

        Keys that one word holds are pressed at the same time.
        """
        for word in keys:
            steps = [{"type": "keyDown", "value": key} for key in word]
            steps += [{"type": "keyUp", "value": key} for key in reversed(word)]
            board = {"type": "key", "id": "keyboard", "actions": steps}
            self._call("POST", "/actions", {"actions": [board]})

    def _act(self, steps: list[dict]) -> None:
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}}
        self._call("POST", "/actions", {"actions": [mouse | {"actions": steps}]})

    def resize(self, width: int, height: int) -> None:
        """Show pages as on a screen of a size in pixels, which may be a telephone's."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        command = {"cmd": "Emulation.setDeviceMetricsOverride", "params": size}
        self._call("POST", "/goog/cdp/execute", command)

    def run(self, script: str) -> Any:
        """Return what the body of an asynchronous JavaScript function returns."""
        wrapped = (
            "const done = arguments[arguments.length - 1];"
            f"(async () => {{{script}}})()"
            ".then(v => done([true, v]), e => done([false, String(e)]))"
        )
        good, value = self._call("POST", "/execute/async", {"script": wrapped, "args": []})
        assert good, value
        return value

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        self.run(f"while (!({condition})) await new Promise(r => setTimeout(r, 50));")

    def click(self, selector: str) -> None:
        """Click on the element that a CSS selector finds."""
        self._call("POST", f"/element/{self._element(selector)}/click", {})

    def type(self, selector: str, keys: str) -> None:
        """Press keys in an element."""
        self._call("POST", f"/element/{self._element(selector)}/value", {"text": keys})

    def _element(self, selector: str) -> str:
        body = {"using": "css selector", "value": selector}
        return next(iter(self._call("POST", "/element", body).values()))

    def console(self, errors_only: bool = False) -> list[str]:
        """Return the console's messages since the last call."""
        entries = self._call("POST", "/se/log", {"type": "browser"})
        return [e["message"] for e in entries if e["level"] == "SEVERE" or not errors_only]

    def screenshot(self) -> bytes:
        """Return a PNG of the window."""
        return base64.b64decode(self._call("GET", "/screenshot"))
