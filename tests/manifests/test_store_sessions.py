"""Several connections to a server that allows one thread on each."""

import os
import threading

import pytest

from manifests.store_sessions import SESSIONS, Sessions


class Connection:
    """Counts those that were made, are open, and are in use; fails where two threads meet."""

    made, open, most, used = 0, 0, 0, 0
    lock = threading.Lock()

    def __init__(self):
        self.busy = threading.Lock()
        with Connection.lock:
            Connection.made += 1
            Connection.open += 1

    def call(self, action):
        assert self.busy.acquire(blocking=False), "two threads on one connection"
        with Connection.lock:
            Connection.used += 1
            Connection.most = max(Connection.most, Connection.used)
        try:
            return action()
        finally:
            with Connection.lock:
                Connection.used -= 1
            self.busy.release()

    def close(self):
        with Connection.lock:
            Connection.open -= 1


@pytest.fixture
def sessions():
    Connection.made = Connection.open = Connection.most = Connection.used = 0
    return Sessions(Connection)


def in_threads(count, work):
    threads = [threading.Thread(target=work) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def raised(error):
    raise error


def test_each_thread_has_a_connection_and_there_are_no_more_than_so_many(sessions):
    errors = []
    all_in_use = threading.Barrier(SESSIONS)

    def work():
        try:
            for _ in range(2):
                sessions.call(lambda: all_in_use.wait(10))
        except BaseException as error:
            errors.append(error)

    in_threads(2 * SESSIONS, work)
    assert errors == [] and Connection.most == Connection.made == SESSIONS


def test_a_connection_is_used_again_after_an_answer_of_the_server(sessions):
    for error in (FileNotFoundError("no"), PermissionError("no")):
        with pytest.raises(type(error)):
            sessions.call(lambda error=error: raised(error))
    assert sessions.call(lambda: 7) == 7 and Connection.made == 1


def test_all_idle_connections_end_with_one_that_is_cut(sessions):
    together = threading.Barrier(3)
    in_threads(3, lambda: sessions.call(lambda: together.wait(10)))
    assert Connection.open == 3
    with pytest.raises(EOFError):
        sessions.call(lambda: raised(EOFError()))
    assert Connection.open == 0
    assert sessions.call(lambda: 7) == 7 and Connection.made == 4


def test_a_connection_that_is_not_made_takes_no_place(sessions):
    sessions._connect = lambda: raised(OSError("refused"))
    for _ in range(2 * SESSIONS):
        with pytest.raises(OSError, match="refused"):
            sessions.call(lambda: 7)


def test_a_forked_process_makes_connections_of_its_own(sessions, monkeypatch):
    assert sessions.call(lambda: 7) == 7
    monkeypatch.setattr(os, "getpid", lambda: -1)
    assert sessions.call(lambda: 7) == 7 and Connection.made == 2
