"""Firefox, driven by its own remote protocol, Marionette, without a driver.

Without a screen it has no WebGL; on the virtual screen of Xvfb it computes WebGL by software.
"""

import base64
import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Self

PREFERENCES = {
    "marionette.port": 0,  # chosen by the browser, which writes it into its profile
    "webgl.force-enabled": True,  # by software, where there is no graphics card
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "toolkit.telemetry.enabled": False,
    "app.update.enabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
}
SCRIPT_MS = 120_000
START_SECONDS = 120


def executable() -> str | None:
    """Return Firefox's path, None where there is none."""
    return shutil.which("firefox-esr") or shutil.which("firefox")


def is_available() -> bool:
    """Return whether this machine has Firefox and a virtual screen."""
    return bool(executable() and shutil.which("Xvfb"))


class Firefox:
    """A window of a size in pixels; a context manager that ends it.

    screen  whether it is on a virtual screen, and so has WebGL
    """

    def __init__(self, width: int = 1300, height: int = 900, screen: bool = True):
        self.size, self.screen, self.number = (width, height), screen, 0
        self.processes: list[subprocess.Popen] = []

    def __enter__(self) -> Self:
        path = executable()
        assert path is not None
        self.profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        folder = Path(self.profile.name)
        lines = [f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in PREFERENCES.items()]
        (folder / "user.js").write_text("\n".join(lines))
        words = [path, "--marionette", "--no-remote", "--profile", str(folder)]
        words += [f"--width={self.size[0]}", f"--height={self.size[1]}"]
        environment = os.environ | {"HOME": str(folder), "MOZ_CRASHREPORTER_DISABLE": "1"}
        try:
            if self.screen:
                environment["DISPLAY"] = self._display()
            else:
                words.append("--headless")
            self.processes.append(
                subprocess.Popen(
                    words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
                )
            )
            self.socket = self._connected(folder / "MarionetteActivePort")
            self._received()  # a greeting
            self.call("WebDriver:NewSession", {"capabilities": {"alwaysMatch": {}}})
            self.call("WebDriver:SetTimeouts", {"script": SCRIPT_MS, "pageLoad": SCRIPT_MS})
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self.socket.close()
        finally:
            self._end()

    def _end(self) -> None:
        for process in reversed(self.processes):
            process.terminate()
            process.wait(60)
        self.profile.cleanup()

    def _display(self) -> str:
        """Start a virtual screen and return its name."""
        width, height = self.size
        read, write = os.pipe()
        words = ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24"]
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(words, stdout=quiet, stderr=quiet, pass_fds=[write])
        self.processes.append(process)
        os.close(write)
        with open(read) as pipe:
            return f":{pipe.readline().strip()}"

    def _connected(self, port_file: Path) -> socket.socket:
        end = time.monotonic() + START_SECONDS
        while time.monotonic() < end:
            if port_file.exists() and port_file.read_text().strip():
                address = ("127.0.0.1", int(port_file.read_text()))
                return socket.create_connection(address, timeout=SCRIPT_MS / 1000)
            assert self.processes[-1].poll() is None, "Firefox ended"
            time.sleep(0.1)
        raise TimeoutError("Firefox did not open its port")

    def _received(self) -> Any:
        """Return a message: its length in bytes, a colon, JSON."""
        length = b""
        while not length.endswith(b":"):
            length += self._bytes(1)
        return json.loads(self._bytes(int(length[:-1])))

    def _bytes(self, count: int) -> bytes:
        parts = []
        while count:
            part = self.socket.recv(min(count, 1 << 20))
            if not part:
                raise ConnectionError("Firefox closed the connection")
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def call(self, name: str, arguments: dict | None = None) -> Any:
        """Return the result of one of the protocol's commands."""
        self.number += 1
        text = json.dumps([0, self.number, name, arguments or {}]).encode()
        self.socket.sendall(str(len(text)).encode() + b":" + text)
        _, number, error, result = self._received()
        assert number == self.number
        if error:
            raise RuntimeError(f"{name}: {error}")
        return result.get("value") if isinstance(result, dict) else result

    def open(self, path: Path, fragment: str = "") -> None:
        """Load a file of this machine; fragment: "#…" or nothing."""
        self.call("WebDriver:Navigate", {"url": path.absolute().as_uri() + fragment})

    def run(self, script: str) -> Any:
        """Return what the body of an asynchronous JavaScript function returns.

        Of the page's variables it sees `editPage`.
        """
        wrapped = (
            "const done = arguments[arguments.length - 1];"
            # scripts run in a sandbox, which sees a page's own variables only so
            "const {editPage} = window.wrappedJSObject ?? window;"
            f"(async () => {{{script}}})()"
            ".then(v => done(JSON.stringify([true, v])),"
            " e => done(JSON.stringify([false, String(e)])))"
        )
        result = self.call("WebDriver:ExecuteAsyncScript", {"script": wrapped, "args": []})
        good, *value = json.loads(result)
        assert good, value
        return value[0] if value else None

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        self.run(f"while (!({condition})) await new Promise(r => setTimeout(r, 50));")

    def screenshot(self) -> bytes:
        """Return a PNG of the window."""
        value = self.call("WebDriver:TakeScreenshot", {"full": False})
        return base64.b64decode(value)
