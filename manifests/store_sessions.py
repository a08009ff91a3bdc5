"""Several connections to a server whose file system of fsspec only one thread at a time may use.

fsspec's plug-ins for sftp, ftp and smb hold one connection, on which the answers of two threads
would be mixed up, and do not make a new one after it was cut.
"""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any

SESSIONS = 8  # OpenSSH refuses more than 10 connections that begin at once


class Sessions:
    """Looks like one file system of fsspec. Each call has a connection to itself.

    connect  makes a file system with a connection of its own; it may raise what the plug-in raises

    At most SESSIONS calls run at once; others wait. After an error of the connection all idle ones
    are closed, because the server that ended one has mostly ended them all. A forked process makes
    connections of its own.
    """

    def __init__(self, connect: Callable[[], Any]):
        self._connect = connect
        self._of_process: dict[int, _Connections] = {}

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("__"):
            raise AttributeError(name)

        def called(*values: Any, **options: Any) -> Any:
            with self._session() as files:
                return getattr(files, name)(*values, **options)

        return called

    @contextlib.contextmanager
    def _session(self) -> Iterator[Any]:
        # threads of a forked process that come at once all get the one that was set first
        own = self._of_process.setdefault(os.getpid(), _Connections())
        with own.places:
            try:
                files = own.idle.pop()
            except IndexError:
                files = self._connect()
            try:
                yield files
            except (FileNotFoundError, PermissionError):  # the server's answers
                own.idle.append(files)
                raise
            except BaseException:
                idle, own.idle = own.idle, []
                for each in (files, *idle):
                    close(each)
                raise
            own.idle.append(files)


class _Connections:
    """Those of one process: idle ones, and places for SESSIONS that are used or made."""

    def __init__(self) -> None:
        self.idle: list[Any] = []
        self.places = threading.BoundedSemaphore(SESSIONS)


def close(files: Any) -> None:
    """End a file system's connection, where its plug-in can."""
    with contextlib.suppress(Exception):
        files.close()
