"""The sessions of all users of the page: which belongs to whom, and when each ends.

A user is one open page, by the random name that the page has. A page that is loaded again has a
new name; it shows the secret key of its session, which the browser keeps for this tab alone, and
has the session back.

A session ends, and its files are deleted, some seconds after the page is closed, after IDLE_SECONDS
without a request, when MOST_SESSIONS newer ones are open, or when the server ends.
"""

import secrets
import threading
import time
from collections import OrderedDict
from pathlib import Path

from learn.app.background_decomposition import Network
from learn.app.session import Session

MOST_SESSIONS = 16
IDLE_SECONDS = 3600.0
LEAVING_SECONDS = 20.0  # for which the session of a page that is being left waits for its return


class Sessions:
    """The sessions of all users, by the names of their pages."""

    def __init__(self, folder: Path, network: Network):
        self.folder, self.network = folder, network
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, name: str, key: str = "") -> Session:
        """Return the session of a page that was opened just now.

        key  of the session that the page had before it was loaded again; "": none. A session
             belongs to one page: its earlier page then says that what it shows is lost
        """
        with self._lock:
            shown = key.encode(errors="replace")
            for old, session in self._sessions.items():
                if secrets.compare_digest(session.key.encode(), shown):
                    del self._sessions[old]
                    session.used = time.monotonic()  # it does not end with the page that was left
                    self._sessions[name] = session
                    return session
        session = self.of(name)
        session.is_lost = False
        return session

    def of(self, name: str) -> Session:
        """Return the session of a page.

        A page whose session ended, or that an earlier server served, has a new one, which knows
        that what the page shows is lost.
        """
        now = time.monotonic()
        with self._lock:
            session = self._sessions.get(name)
            if session is None:
                # so that its address cannot be guessed
                folder = self.folder / secrets.token_hex(16)
                folder.mkdir(mode=0o700)
                session = Session(folder, self.network, is_lost=True)
                self._sessions[name] = session
            session.used = now
            self._sessions.move_to_end(name)
            old = [k for k, each in self._sessions.items() if now - each.used > IDLE_SECONDS]
            more = list(self._sessions)[: max(0, len(self._sessions) - MOST_SESSIONS)]
            ended = [self._sessions.pop(each) for each in dict.fromkeys([*old, *more])]
        for each in ended:
            each.close()
        return session

    def close(self, name: str, only: Session | None = None) -> None:
        """End the session of a page, if there is one.

        only  the session that is meant: a later one of the same page stays. None: any
        """
        with self._lock:
            session = self._sessions.get(name)
            if session is None or (only is not None and session is not only):
                return
            del self._sessions[name]
        session.close()

    def close_later(self, name: str, seconds: float = LEAVING_SECONDS) -> None:
        """End the session of a page after some seconds, unless it is used meanwhile."""
        with self._lock:
            session = self._sessions.get(name)
        if session is None:
            return
        used = session.used

        def close() -> None:
            if session.used == used:
                self.close(name, session)

        timer = threading.Timer(seconds, close)
        timer.daemon = True
        timer.start()

    def close_all(self) -> None:
        """End all sessions."""
        for name in list(self._sessions):
            self.close(name)

    def __len__(self) -> int:
        return len(self._sessions)
