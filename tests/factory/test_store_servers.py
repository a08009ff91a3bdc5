"""Rendering into each kind of object store on a real server, as a process of this machine, with a
studio without Blender: S3 (moto), SSH (asyncssh), Azure (azurite) and Google (fake-gcs-server).

tests/factory/test_object_stores.py has what does not depend on the protocol.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time

import msgspec
import pytest

from factory.execution import leases, uploads
from manifests import cached_store, object_store
from manifests.cached_store import CachedStore, open_store
from manifests.object_store import ObjectFolder, Unreachable
from manifests.store import Store
from manifests.verification import faults_of
from tests.support import s3_server, store_servers
from tests.support.network_faults import KINDS, Proxy
from tests.support.store_content import content
from tests.support.tetrahedron import ROOT

pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")


class Server:
    """A running server.

    folder  its own
    proxy   through which clients come
    """

    def __init__(self, protocol, folder, proxy):
        self.protocol, self.folder, self.proxy = protocol, folder, proxy
        self.variables = store_servers.variables(protocol, proxy.port, folder)

    def url(self, name):
        """The URL of a data set of its own."""
        return store_servers.url(self.protocol, self.proxy.port, self.folder, name)


@pytest.fixture(scope="module", params=store_servers.PROTOCOLS)
def running(request, tmp_path_factory):
    """The Server of each protocol, one after the other."""
    protocol = request.param
    if protocol == "sftp":
        pytest.importorskip("paramiko", reason="paramiko is not installed (extra sftp)")
    else:
        pytest.importorskip("obstore", reason="obstore is not installed (extra stores)")
    if (reason := store_servers.missing(protocol)) is not None:
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp(protocol)
    with store_servers.started(protocol, folder) as port, Proxy(port) as proxy:
        yield Server(protocol, folder, proxy)


@pytest.fixture
def server(running, monkeypatch, tmp_path):
    """The same, with the environment of its clients; scratch folders and copies are in tmp_path."""
    for name, value in running.variables.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    monkeypatch.setattr(leases, "EXPIRED", 1.0)
    monkeypatch.setattr(leases, "RENEWED", 0.2)
    monkeypatch.setattr(leases, "PAUSE", 0.1)
    return running


@pytest.fixture
def url(server, request):
    """The URL of an empty data set there."""
    return server.url(request.node.originalname)


def test_objects_are_listed_read_replaced_and_removed(url):
    remote = ObjectFolder(url)
    assert remote.names("records") == {}
    with pytest.raises(FileNotFoundError):
        remote.read("records/a b.jsonl")
    for data in (b"1\n", b"12\n"):
        remote.write("records/a b.jsonl", data)
    large = bytes(range(256)) * 2000
    remote.write("images/ab/x.exr", large)
    remote.write("images/ab/y.exr", b"")
    assert remote.names("records") == {"records/a b.jsonl": 3}
    assert remote.names("images") == {}
    assert remote.names("images", deep=True) == {"images/ab/x.exr": 512000, "images/ab/y.exr": 0}
    names = ["records/a b.jsonl", "images/ab/x.exr", "images/ab/y.exr"] * 20
    assert list(remote.read_all(names)) == list(zip(names, [b"12\n", large, b""] * 20, strict=True))
    for _ in range(2):
        remote.remove("records/a b.jsonl")
    assert remote.names("records") == {}


def test_a_store_holds_what_a_folder_would(url, render, small_job, tmp_path):
    expected = render(small_job, tmp_path / "folder")
    assert render(small_job, url, limit=5).made == 5
    assert render(small_job, url, workers=2).already_there == 5
    theirs = open_store(url, fresh=True)
    assert expected.made == 12 and content(theirs) == content(Store(tmp_path / "folder"))
    assert faults_of(theirs) == [] and theirs.remote.names(leases.FOLDER) == {}


def test_copies_for_reading_are_bounded(url, render, small_job, monkeypatch):
    render(small_job, url)
    whole = open_store(url, fresh=True)
    records = list(whole.records())
    sizes = {name: len(whole.remote.read(name)) for name in {record.image for record in records}}
    store = CachedStore(url, limit_bytes=sum(sizes.values()) // 2)
    monkeypatch.setattr(cached_store, "RECENT", 0)  # copies used lately would be kept
    for name in sizes:
        assert store.fetch(name).read_bytes() == whole.remote.read(name)
    held = [name for name in sizes if (store.folder / name).exists()]
    assert 0 < len(held) < len(sizes)


@pytest.mark.long
def test_nothing_is_lost_or_doubled_when_the_connection_is_disturbed(
    server, url, render, small_job, monkeypatch, tmp_path
):
    monkeypatch.setattr(uploads, "SECONDS", 0.05)
    monkeypatch.setattr(object_store, "TIMEOUT", 5)
    monkeypatch.setenv("FAKE_STUDIO", "slow")
    job = msgspec.structs.replace(small_job, views=tuple(range(12)))
    render(job, tmp_path / "folder")
    kinds, made = list(KINDS), 0

    def watch(event, value):
        nonlocal made
        made += event == "made"
        if event == "made" and made % 15 == 0 and kinds:
            with server.proxy.fault(kinds.pop()):
                while not server.proxy.disturbed:
                    time.sleep(0.01)

    outcome = render(job, url, watch, workers=2)
    assert (outcome.made, outcome.failed, kinds) == (72, 0, [])
    theirs = open_store(url, fresh=True)
    assert content(theirs) == content(Store(tmp_path / "folder"))
    # a draft whose renaming was not answered stays
    said = [fault.text for fault in faults_of(theirs)]
    assert [text for text in said if not text.startswith("partial/")] == []


@pytest.mark.long
def test_a_run_that_is_killed_is_continued(url, render, small_job, tmp_path, catalogue):
    job = msgspec.structs.replace(small_job, views=tuple(range(12)))
    shutil.copy(small_job.lights[0], tmp_path / "lamp.exr")
    (tmp_path / "job.json").write_bytes(
        msgspec.json.encode(msgspec.structs.replace(job, lights=("lamp.exr",)))
    )
    words = [sys.executable, "-m", "tests.support.fake_render", str(tmp_path / "job.json")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "FAKE_STUDIO": "slow"}
    remote, end = ObjectFolder(url), time.monotonic() + 100
    process = subprocess.Popen(
        [*words, url, str(catalogue), "0.1"],
        env={**environment, "TMPDIR": str(tmp_path)},
        start_new_session=True,
        stderr=subprocess.DEVNULL,
    )
    try:
        while not remote.names("records"):
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.02)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    before = content(open_store(url, fresh=True))
    render(job, tmp_path / "whole")
    outcome = render(job, url)
    assert outcome.already_there == len(before) and outcome.made == 72 - len(before) > 0
    assert content(open_store(url, fresh=True)) == content(Store(tmp_path / "whole"))


def test_a_store_that_does_not_answer_is_said_in_a_line(
    server, url, render, small_job, monkeypatch
):
    monkeypatch.setattr(object_store, "TIMEOUT", 5)
    monkeypatch.setenv(object_store.VARIABLE, "1")
    with server.proxy.fault("cut"), pytest.raises(Unreachable) as caught:
        render(small_job, url)
    assert "a store that answers" in str(caught.value) and "\n" not in str(caught.value)
    assert render(small_job, url).made == 12


def test_a_place_that_is_missing_is_said_at_once(server, monkeypatch):
    monkeypatch.setattr(object_store.time, "sleep", lambda _: pytest.fail("it waits"))
    if server.protocol == "sftp":  # folders are made, but not below a file
        url = server.url("x").replace("/stored/", "/authorized/")
    else:
        url = f"{server.protocol}://no-such-bucket/x"
    with pytest.raises(Unreachable, match="a bucket that exists"):
        ObjectFolder(url).write("records/x", b"")
    if server.protocol in ("s3", "az"):  # fake-gcs-server answers that it has failed
        with pytest.raises(Unreachable, match="a bucket that exists"):
            ObjectFolder(url).names("records")


def make_key(path):
    """Write a new private key of SSH over another one, which no server knows."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.OpenSSH,
        serialization.NoEncryption(),
    )
    path.write_bytes(key)


# fake-gcs-server lets everybody in
@pytest.mark.parametrize("running", ["s3", "sftp", "az"], indirect=True)
def test_credentials_that_are_refused_are_said_at_once(server, monkeypatch, tmp_path):
    monkeypatch.setattr(object_store.time, "sleep", lambda _: pytest.fail("it waits"))
    if server.protocol == "sftp":
        keys = tmp_path / "home" / ".ssh"
        shutil.copytree(server.folder / "home" / ".ssh", keys)
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        make_key(keys / "id_ed25519")
        with pytest.raises(Unreachable, match=r"the server accepts no key of ~/\.ssh"):
            ObjectFolder(server.url("x")).names("records")
        (keys / "id_ed25519").unlink()
        with pytest.raises(Unreachable, match=r"there is no key in ~/\.ssh or in the agent"):
            ObjectFolder(server.url("x")).names("records")
        (keys / "known_hosts").unlink()
        with pytest.raises(Unreachable, match=r"server's key is not in ~/\.ssh/known_hosts"):
            ObjectFolder(server.url("x")).names("records")
    elif server.protocol == "az":
        monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "bm9uZQ==")
        with pytest.raises(Unreachable, match="check the credentials"):
            ObjectFolder(server.url("x")).names("records")
    elif server.protocol == "s3":
        with s3_server.known_users_alone(server.proxy.port):
            with pytest.raises(Unreachable, match="check the credentials"):
                ObjectFolder(server.url("x")).names("records")
            with pytest.raises(Unreachable, match="check the credentials"):
                ObjectFolder(server.url("x")).write("records/x", b"x")
        assert ObjectFolder(server.url("x")).names("records") == {}


@pytest.mark.parametrize("running", ["s3", "gs"], indirect=True)
def test_a_server_without_tls_is_refused_at_once(server, monkeypatch):
    monkeypatch.setattr(object_store.time, "sleep", lambda _: pytest.fail("it waits"))
    monkeypatch.delenv(f"{object_store.BY_OBSTORE[server.protocol]}_ALLOW_HTTP")
    with pytest.raises(Unreachable, match=r"a server with TLS.*export (AWS|GOOGLE)_ALLOW_HTTP"):
        ObjectFolder(server.url("x")).names("records")
