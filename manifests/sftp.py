"""Files on an SSH server, for fsspec.

fsspec's own class accepts any server's key and waits without end for a server that is silent. This
one accepts the keys of ~/.ssh/known_hosts alone, gives up after a time, follows ~/.ssh/config, and
sends and reads files without waiting for each answer.
"""

import io
import logging
from pathlib import Path
from typing import Any

import paramiko
from fsspec.implementations.sftp import SFTPFileSystem

# without a handler the reasons of each broken connection would be printed with their tracebacks
logging.getLogger("paramiko").addHandler(logging.NullHandler())


class SSHFileSystem(SFTPFileSystem):
    """One connection to an SSH server. Only one thread at a time may use it.

    host                   its name in the URL, or in ~/.ssh/config
    timeout                seconds for each answer
    ssh_options            port and username, where the URL has them
    Raises PermissionError for a server whose key is not known and for a user that it does not let
    in; ValueError for a file ~/.ssh/config that cannot be read
    """

    cachable = False  # the instances' own cache would give several threads the same connection

    def __init__(self, host: str, timeout: float = 60.0, **ssh_options: Any):
        self._timeout = timeout
        super().__init__(host, **ssh_options)

    def _connect(self) -> None:
        self.client = paramiko.SSHClient()
        self.client.load_system_host_keys()
        self.client.set_missing_host_key_policy(paramiko.RejectPolicy())
        words = self._read_configuration() | self.ssh_kwargs
        try:
            self.client.connect(
                **words,
                timeout=self._timeout,
                banner_timeout=self._timeout,
                auth_timeout=self._timeout,
            )
            self.ftp = self.client.open_sftp()
        except BaseException as error:
            self.client.close()
            if (text := _refusal(error)) is None:
                raise
            raise PermissionError(f"{self.host}: {text}") from None
        self.ftp.get_channel().settimeout(self._timeout)

    def _read_configuration(self) -> dict[str, Any]:
        """Return what ~/.ssh/config says of the host, as paramiko's `connect` takes it."""
        path = Path.home() / ".ssh" / "config"
        try:
            entry = paramiko.SSHConfig.from_path(str(path)).lookup(self.host)
        except FileNotFoundError:
            return {"hostname": self.host}
        except paramiko.SSHException as error:
            raise ValueError(f"{path}: {error}") from None
        result: dict[str, Any] = {"hostname": entry["hostname"]}
        if "port" in entry:
            result["port"] = int(entry["port"])
        if "user" in entry:
            result["username"] = entry["user"]
        keys = [key for key in entry.get("identityfile", []) if Path(key).expanduser().exists()]
        if keys:  # ssh leaves out those that are missing, too
            result["key_filename"] = keys
        return result

    def close(self) -> None:
        """End the connection."""
        self.client.close()

    def makedirs(self, path: str, exist_ok: bool = False, mode: int = 0o777) -> None:
        """Make a folder and those above it; another connection may make them at the same time."""
        made = ""
        for part in path.strip("/").split("/"):
            made = f"{made}/{part}"
            if not self.exists(made):
                try:
                    self.ftp.mkdir(made, mode)
                except OSError:
                    if not self.exists(made):
                        raise

    def cat_file(self, path: str, start: Any = None, end: Any = None, **options: Any) -> bytes:
        """Return a file's bytes."""
        assert start is None and end is None, "whole files only"
        result = io.BytesIO()
        self.ftp.getfo(self._strip_protocol(path), result)
        return result.getvalue()

    def pipe_file(self, path: str, value: bytes, mode: str = "overwrite", **options: Any) -> None:
        """Write a file's bytes; the server is asked for its size then."""
        self.ftp.putfo(io.BytesIO(value), self._strip_protocol(path))

    def mv(self, old: str, new: str, **options: Any) -> None:
        """Rename a file; one that has the new name is replaced in the same step."""
        try:
            self.ftp.posix_rename(self._strip_protocol(old), self._strip_protocol(new))
        except OSError as error:
            if "unsupported" not in str(error).lower():
                raise
            text = "the server cannot rename over a file (posix-rename@openssh.com)"
            raise NotImplementedError(text) from None


def _refusal(error: BaseException) -> str | None:
    """Return why a server or its user is refused; None for what another try may mend."""
    if isinstance(error, paramiko.BadHostKeyException):
        return "the server's key is not the one in ~/.ssh/known_hosts"
    if isinstance(error, FileNotFoundError):  # or the store would look empty
        return f"a file that ~/.ssh/config names is missing: {error.filename or error}"
    text = str(error)
    if "not found in known_hosts" in text:
        return "the server's key is not in ~/.ssh/known_hosts: connect once with ssh"
    is_cut = "transport shut down" in text or "timeout" in text.lower()
    if isinstance(error, paramiko.AuthenticationException) and not is_cut:
        return "the server accepts no key of ~/.ssh or of the agent"
    if "No authentication methods available" in text:
        return "there is no key in ~/.ssh or in the agent"
    return None
