"""A TCP proxy on this machine that disturbs what goes through it, on demand.

cut    connections are reset, and new ones as soon as they are made
stall  nothing is forwarded, and connections are reset at the end
slow   a kilobyte every 10 ms in each direction
deaf   requests are forwarded, answers are dropped, and connections are reset at the end: the
       server has done what it was asked for, and the client cannot know
"""

import contextlib
import selectors
import socket
import struct
import threading
import time

KINDS = ("cut", "stall", "slow", "deaf")
PIECE = 1024


class Proxy:
    """Forwards connections to a port of this machine. Use it as a context.

    port       where it listens
    disturbed  number of pieces of data and connections that met a fault
    """

    def __init__(self, target):
        self._target, self._fault = target, None
        self.disturbed = 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._pairs = {}
        self._lock = threading.Lock()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._closing = False
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._closing = True
        self._thread.join()
        self._reset_all()
        self._listener.close()
        self._selector.close()

    @contextlib.contextmanager
    def fault(self, kind):
        """Disturb as a kind says until the end of the block."""
        self.disturbed, self._fault = 0, kind
        try:
            yield
        finally:
            if kind != "slow":
                self._fault = "cut"
                time.sleep(0.05)  # the thread resets what is open
            self._fault = None

    def _work(self):
        while not self._closing:
            if self._fault == "cut":
                self._reset_all()
            for key, _ in self._selector.select(0.02):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj in self._pairs:
                    self._forward(key.fileobj, key.data)
            if self._fault == "stall":
                time.sleep(0.01)

    def _accept(self):
        client, _ = self._listener.accept()
        if self._fault == "cut":
            self.disturbed += 1
            _reset(client)
            return
        server = socket.create_connection(("127.0.0.1", self._target))
        for each, other, is_answer in ((client, server, False), (server, client, True)):
            self._pairs[each] = other
            self._selector.register(each, selectors.EVENT_READ, is_answer)

    def _forward(self, source, is_answer):
        if self._fault == "stall":
            self.disturbed += 1
            return
        if self._fault == "slow":
            self.disturbed += 1
            time.sleep(0.01)
        target = self._pairs[source]
        try:
            data = source.recv(PIECE if self._fault == "slow" else 1 << 16)
            if self._fault == "deaf" and is_answer and data:
                self.disturbed += 1
                return
            target.sendall(data)
        except OSError:
            data = b""
        if not data:
            self._close(source)

    def _close(self, one):
        other = self._pairs.pop(one)
        self._pairs.pop(other)
        for each in (one, other):
            self._selector.unregister(each)
            each.close()

    def _reset_all(self):
        while self._pairs:
            self.disturbed += 1
            one, other = self._pairs.popitem()
            self._pairs.pop(other)
            for each in (one, other):
                self._selector.unregister(each)
                _reset(each)


def _reset(connection):
    """Close a connection as a broken network does: the other side sees a reset."""
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
