"""What ~/.ssh/config says of a server, and what a broken one must not look like."""

from pathlib import Path

import pytest

pytest.importorskip("paramiko", reason="paramiko is not installed (extra sftp)")
from manifests import sftp


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home folder without keys."""
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".ssh").mkdir()
    return tmp_path


def configured(host: str) -> dict:
    system = object.__new__(sftp.SSHFileSystem)  # without a connection
    system.host = host
    return system._read_configuration()


def test_keys_that_are_missing_are_left_out_as_ssh_does(home):
    (home / "key").write_text("a key")
    lines = ["Host store", "HostName store.example", "Port 2222", "User anna"]
    lines += [f"IdentityFile {home}/absent", f"IdentityFile {home}/key"]
    (home / ".ssh" / "config").write_text("\n".join(lines))
    assert configured("store") == {
        "hostname": "store.example",
        "port": 2222,
        "username": "anna",
        "key_filename": [f"{home}/key"],
    }
    (home / "key").unlink()
    assert "key_filename" not in configured("store")


def test_a_file_that_is_missing_while_connecting_is_no_empty_store(home, monkeypatch):
    def connect(self, *arguments, **words):
        raise FileNotFoundError(2, "No such file", "certificate")

    monkeypatch.setattr(sftp.paramiko.SSHClient, "connect", connect)
    with pytest.raises(PermissionError, match="names is missing: certificate"):
        sftp.SSHFileSystem("store")
