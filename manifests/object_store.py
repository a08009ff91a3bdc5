"""Folders on object stores, named by a URL: s3://BUCKET/FOLDER, gs, abfs, sftp, file, memory.

An object is written whole or not at all, and cannot be appended to. Requests that fail are tried
again with growing pauses for some minutes, and a write that was tried twice leaves one object with
the same bytes. The package obstore serves s3, gs and abfs; other protocols have plug-ins of fsspec.
Credentials are those of the environment; a URL must not hold any.
"""

import contextlib
import os
import re
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from importlib import import_module
from typing import Any, TypeVar

from manifests.errors import InputError
from manifests.notices import notice
from manifests.store_sessions import Sessions

T = TypeVar("T")
# Path("s3://bucket") has lost a slash; a scheme has two letters or more, a Windows drive has one
# plug-ins in front of a scheme ("simplecache::s3://…") are recognised, to be refused
URL = re.compile(r"((?:[A-Za-z]\w*::)*[A-Za-z][A-Za-z0-9+.-]+):/+(.*)", re.DOTALL)
# protocols that obstore serves, and the first word of their variables
BY_OBSTORE = {
    "s3": "AWS",
    "s3a": "AWS",
    "gs": "GOOGLE",
    "gcs": "GOOGLE",
    "abfs": "AZURE",
    "abfss": "AZURE",
    "az": "AZURE",
}
# protocols of file systems, where a file that is being written can be seen: it is renamed at last
RENAMED = ("file", "local", "sftp", "ssh", "smb", "ftp", "hdfs", "webdav")
PATIENCE = 300.0  # seconds for which a request is tried again
FIRST_PATIENCE = 30.0  # the same, before the store has answered at all: its name may be wrong
SAY_AFTER = 3.0  # seconds without a first answer after which a line says so
VARIABLE = "BRDFACTORY_STORE_PATIENCE"  # another number of seconds
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 20.0
TIMEOUT = 60  # seconds for one request
THREADS = 16
# what protocols say of an object: its size, a tag of its bytes, or when it was changed
STATE = ("size", "e_tag", "ETag", "mtime", "LastModified", "last_modified", "created")
AHEAD = 64  # objects that are read before the first of them is used
# errors that another try does not mend
LASTING = (
    FileNotFoundError,
    PermissionError,
    IsADirectoryError,
    NotADirectoryError,
    ImportError,
    TypeError,
    ValueError,
    AttributeError,
    NotImplementedError,
)
DENIED = ("credential", "403 forbidden", "401 unauthorized", "account must be specified")
NO_SUCH_HOST = "name or service not known"
METADATA = "169.254.169.254"  # where obstore asks for credentials if the environment has none
SFTP = "pip install 'brdfactory[sftp]', or '.[sftp]' in a checkout"
PLUG_IN = "install fsspec's plug-in for it"
EXTRA = "pip install 'brdfactory[stores]', or '.[stores]' in a checkout"


class Unreachable(InputError):
    """The store did not answer, or refuses. Nothing can be said of its objects."""


def is_url(folder: object) -> bool:
    """Return whether a data set's folder is named by a URL."""
    return URL.fullmatch(str(folder)) is not None


def normalise(url: object) -> str:
    """Return a URL with two slashes after its scheme and none at its end.

    Raises  InputError for one with a password, a query, or ".."
    """
    match = URL.fullmatch(str(url))
    assert match, "a URL, as is_url says"
    scheme, rest = match[1].lower(), match[2].rstrip("/")
    authority = rest.partition("/")[0]
    # nothing of the URL after its scheme is shown: it may be a secret
    if ":" in authority.rpartition("@")[0] or "?" in rest or "#" in rest:
        remedy = "put credentials into the environment: docs/clusters.md names the variables"
        raise InputError(f"{scheme}://…", "a URL without password or query", "one", remedy)
    if ".." in rest.split("/") or "::" in f"{scheme}{rest}" or not rest:
        raise InputError(
            f"{scheme}://{rest}", "SCHEME://BUCKET/FOLDER", "something else", "check the URL"
        )
    return f"{scheme}:///{rest}" if scheme == "file" else f"{scheme}://{rest}"


class ObjectFolder:
    """A folder on an object store. Several threads may use it.

    url       as `normalise` returns it
    patience  seconds for which a request that fails is tried again; None: VARIABLE or PATIENCE
    Raises    InputError: an unknown protocol, a package that is missing
    """

    def __init__(self, url: object, patience: float | None = None):
        self.url = normalise(url)
        self._patience = _patience() if patience is None else patience
        self._scheme = self.url.partition(":")[0]
        self._answered = False  # whether the store has ever answered
        self._is_said = False  # whether a line has said that it does not
        self._files, base = _file_system(self._scheme, self.url)
        self._base = base.rstrip("/")

    def names(self, folder: str, deep: bool = False) -> dict[str, int | None]:
        """Return {path: size in bytes} of the objects in a folder, paths relative to the URL's.

        deep    those in folders below it, too
        Raises  Unreachable
        """
        result: dict[str, int | None] = {}
        waiting = [folder]
        while waiting:
            for name, size, is_folder in self._list(waiting.pop()):
                if not is_folder:
                    result[name] = size
                elif deep:
                    waiting.append(name)
        return result

    def states(self, folder: str) -> dict[str, list[str]]:
        """Return {path: state} of the objects in a folder: another state means other bytes.

        A state is the size, and a tag or the time of the last change where the protocol has one.
        Raises  Unreachable
        """
        return {
            name: [str(entry.get(key)) for key in STATE if key in entry]
            for name, entry in self._entries(folder)
            if entry["type"] != "directory"
        }

    def _list(self, folder: str) -> list[tuple[str, int | None, bool]]:
        """Return (path, size, whether it is a folder) of what lies in a folder."""
        return [
            (path, entry.get("size"), entry["type"] == "directory")
            for path, entry in self._entries(folder)
        ]

    def _entries(self, folder: str) -> list[tuple[str, dict[str, Any]]]:
        """Return (path, what the protocol says of it) of what lies in a folder."""
        place = f"{self._base}/{folder}".rstrip("/")

        def listed() -> list[dict[str, Any]]:
            self._files.invalidate_cache()
            try:
                return self._files.ls(place, detail=True)
            except FileNotFoundError:  # an empty folder does not exist on an object store
                return []

        result = []
        for entry in self._try_several_times(f"{self.url}/{folder}", listed):
            name = str(entry["name"]).rstrip("/").rpartition("/")[2]
            if name and str(entry["name"]).rstrip("/").lstrip("/") != place.strip("/"):
                result.append((f"{folder}/{name}" if folder else name, entry))
        return result

    def read(self, relative: str) -> bytes:
        """Return an object's bytes. Raises FileNotFoundError; Unreachable."""
        place = f"{self._base}/{relative}"
        return self._try_several_times(
            f"{self.url}/{relative}", lambda: bytes(self._files.cat_file(place))
        )

    def write(self, relative: str, data: bytes) -> None:
        """Write an object whole; an earlier one of that name is replaced. Raises Unreachable."""
        place = f"{self._base}/{relative}"

        def written() -> None:
            if self._scheme not in RENAMED:
                self._files.pipe_file(place, data)
                return
            draft = f"{self._base}/partial/{uuid.uuid4().hex}"
            try:
                self._files.pipe_file(draft, data)
                self._files.mv(draft, place)
            except FileNotFoundError:  # the first file of a folder
                for path in (draft, place):
                    self._files.makedirs(path.rpartition("/")[0], exist_ok=True)
                self._files.pipe_file(draft, data)
                self._files.mv(draft, place)

        try:
            self._try_several_times(f"{self.url}/{relative}", written)
        except FileNotFoundError as error:
            raise Unreachable(
                self.url,
                "a bucket that exists",
                _error_as_line(error),
                "make it, or check its name",
            ) from None

    def remove(self, relative: str) -> None:
        """Remove an object; one that is not there counts as removed. Raises Unreachable."""
        place = f"{self._base}/{relative}"
        with contextlib.suppress(FileNotFoundError):
            self._try_several_times(f"{self.url}/{relative}", lambda: self._files.rm_file(place))

    def read_all(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield (name, bytes) of objects, several at a time. Raises as `read`.

        At most AHEAD of them are in memory.
        """
        names = list(names)
        with ThreadPoolExecutor(THREADS, thread_name_prefix="store") as threads:
            for first in range(0, len(names), AHEAD):
                some = names[first : first + AHEAD]
                yield from zip(some, threads.map(self.read, some), strict=True)

    def _try_several_times(self, where: str, request: Callable[[], T]) -> T:
        """Return what a request returns, after several tries.

        A store that does not answer at first is named on standard error.

        Raises  FileNotFoundError at once; Unreachable after the last try, or for a lasting error
        """
        patience = self._patience
        if not self._answered:  # the whole store may be missing, not only this object
            where, patience = self.url, min(patience, FIRST_PATIENCE)
        end, pause = time.monotonic() + patience, FIRST_PAUSE
        while True:
            try:
                with self._say_if_slow(where):
                    result = request()
            except FileNotFoundError:
                self._answered = True
                raise
            except Exception as error:  # each plug-in has its own
                expected, remedy = self._lasting_error(error)
                if not expected and time.monotonic() + pause > end:
                    expected = "a store that answers"
                    remedy = "check the network, then run the same command: what was written stays"
                if expected:
                    raise Unreachable(where, expected, _error_as_line(error), remedy) from None
                self._say(
                    f"{where}: {_error_as_line(error)}; trying again for up to {patience:g} s"
                )
            else:
                self._answered, self._is_said = True, False
                return result
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    @contextlib.contextmanager
    def _say_if_slow(self, where: str) -> Iterator[None]:
        """Say during a request, after SAY_AFTER seconds, that there is no answer yet.

        Only before the first answer: later ones may be large and take their time.
        """
        if self._answered or self._is_said:
            yield
            return
        text = f"{where}: connecting, no answer yet; one request may take {TIMEOUT} s"
        timer = threading.Timer(SAY_AFTER, self._say, [text])
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _say(self, text: str) -> None:
        """Print a line, unless one was printed since the last answer."""
        if not self._is_said:
            self._is_said = True
            notice(text)

    def _lasting_error(self, error: Exception) -> tuple[str, str]:
        """Return (what was expected, a remedy) of an error that another try does not mend.

        Both are empty for one that it may mend.
        """
        text, variables = str(error), BY_OBSTORE.get(self._scheme)
        if isinstance(error, LASTING):
            return "a store that serves this", "check the URL and credentials"
        if (
            type(error).__name__ in ("PermissionDeniedError", "UnauthenticatedError")
            or any(word in text.lower() for word in DENIED)
            or (METADATA in text and not self._answered)
        ):
            remedy = "check the credentials: docs/clusters.md names the variables"
            return "a store that answers", remedy
        if not self._answered and NO_SUCH_HOST in text.lower():
            return "a host that exists", "check the host's name and the network"
        if "BadScheme" in text:
            return "a server with TLS", f"export {variables}_ALLOW_HTTP=true to do without"
        if "404 Not Found" in text:  # of a list, which is empty where only the folder is missing
            return "a bucket that exists", "make it, or check its name"
        return "", ""


def _error_as_line(error: Exception) -> str:
    """Return an error as a short line."""
    text = str(error).partition("Debug source:")[0]  # obstore's, of many lines
    if METADATA in text:
        return "no credentials in the environment, and none from the cloud's metadata service"
    words = " ".join(f"{type(error).__name__}: {text}".split())
    return words if len(words) <= 200 else f"{words[:200]}…"


def _patience() -> float:
    try:
        return float(os.environ.get(VARIABLE, PATIENCE))
    except ValueError:
        raise InputError(
            VARIABLE, "a number of seconds", f"'{os.environ[VARIABLE]}'", f"export {VARIABLE}=300"
        ) from None


def _file_system(scheme: str, url: str) -> tuple[Any, str]:
    """Return fsspec's file system of a protocol, and a URL's path there. Raises InputError."""
    try:
        import fsspec
    except ModuleNotFoundError:
        raise InputError(url, "the package fsspec", "that it is not installed", EXTRA) from None
    try:
        if scheme in BY_OBSTORE:
            allowed = os.environ.get(f"{BY_OBSTORE[scheme]}_ALLOW_HTTP", "").lower()
            files = import_module("obstore.fsspec").FsspecStore(
                scheme,
                client_options={
                    "timeout": timedelta(seconds=TIMEOUT),
                    # obstore's own variables have no effect beside other options
                    "allow_http": allowed in ("1", "true"),
                },
                # the pauses are ours: the library's own end sooner
                retry_config={"max_retries": 1, "retry_timeout": timedelta(seconds=TIMEOUT)},
                # one that fsspec kept would have the variables of its first use
                skip_instance_cache=True,
            )
            return files, str(files._strip_protocol(url))
        if scheme in ("file", "local", "memory"):
            files = fsspec.filesystem(
                scheme, **({} if scheme == "memory" else {"auto_mkdir": True})
            )
            return files, str(files._strip_protocol(url))
        if scheme in ("sftp", "ssh"):
            kind, options = import_module("manifests.sftp").SSHFileSystem, {"timeout": TIMEOUT}
        else:
            kind, options = fsspec.get_filesystem_class(scheme), {}
    except (ValueError, ImportError) as error:
        remedy = EXTRA if scheme in BY_OBSTORE else SFTP if scheme in ("sftp", "ssh") else PLUG_IN
        raise InputError(
            url, "a protocol that can be used", _error_as_line(error), remedy
        ) from None
    options |= kind._get_kwargs_from_urls(url) | {"skip_instance_cache": True}
    return Sessions(lambda: kind(**options)), str(kind._strip_protocol(url))
