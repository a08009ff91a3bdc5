"""An S3 server (moto) as a process of this machine, with one bucket.

moto cannot be installed beside this project's other packages, so it has a virtual environment of
its own, whose folder is named by S3_SERVER, or is build/s3-server. `make s3-server` makes it.
"""

import os
import socket
import subprocess
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

from tests.support.tetrahedron import ROOT

BUCKET = "bucket"
REASON = "moto is not installed (make s3-server)"


def program():
    """The server's program, or None."""
    folder = Path(os.environ.get("S3_SERVER", ROOT / "build" / "s3-server"))
    path = folder / "bin" / "moto_server"
    return path if path.is_file() else None


@contextmanager
def started():
    """The port of a new server."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [str(program()), "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        made = urllib.request.Request(f"http://127.0.0.1:{port}/{BUCKET}", method="PUT")
        for left in reversed(range(600)):
            try:
                urllib.request.urlopen(made, timeout=10).close()
                break
            except OSError:
                if not left or process.poll() is not None:
                    raise
                time.sleep(0.1)
        yield port
    finally:
        process.kill()
        process.wait()


def variables(port):
    """Environment variables of a client of the server at a port."""
    return {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "any",
        "AWS_SECRET_ACCESS_KEY": "any",
        "AWS_REGION": "us-east-1",
    }


@contextmanager
def known_users_alone(port):
    """Meanwhile the server checks credentials; it has no accounts, and so refuses all of them."""
    address = f"http://127.0.0.1:{port}/moto-api/reset-auth"

    def reset(actions):  # how many actions the server lets through before it checks
        kind = {"Content-Type": "text/plain"}  # of a form the server would take the body away
        ask = urllib.request.Request(address, actions.encode(), kind, method="POST")
        urllib.request.urlopen(ask, timeout=10).close()

    reset("0")
    try:
        yield
    finally:
        reset("inf")
