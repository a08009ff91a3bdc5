"""Pieces of work on a cluster: each result once, whatever is lost; without Ray, and with it."""

import os
from collections import Counter
from pathlib import Path

import msgspec
import pytest

from manifests import ray_cluster, ray_tasks
from manifests.errors import InputError
from tests.support import fake_ray
from tests.support.tetrahedron import ROOT

MAKER = f"{__name__}:squares"


def squares(settings):
    """A Work that squares numbers and adds one; what it cannot square says so."""
    given = msgspec.json.decode(settings)
    if given.get("refuse"):
        raise InputError("here", "a number", "none", "give one")

    def work(piece):
        number = msgspec.json.decode(piece)
        if number == "refused":
            raise InputError("there", "a number", "a word", "give a number")
        if number == given.get("deadly"):
            os._exit(7)
        return msgspec.json.encode(number * number + given["add"])

    return work


def results(pieces, **settings):
    yielded = ray_tasks.results("auto", MAKER, {"add": 1} | settings, pieces)
    return [(number, msgspec.json.decode(result)) for number, result in yielded]


def test_each_piece_has_one_result_though_workers_are_lost(monkeypatch, capsys):
    losses = Counter()

    def lost(piece):
        losses[piece] += 1
        return losses[piece] <= {3: 2, 7: 2, None: 2}.get(piece, 0)

    tasks = fake_ray.installed(monkeypatch, lost)
    assert sorted(results(list(range(20)))) == [(k, k * k + 1) for k in range(20)]
    assert losses[3] == losses[7] == 3
    assert capsys.readouterr().err.count("was lost") == 6
    assert tasks.ended == 6 + 2  # those that were lost, and both in the end


def test_no_piece_needs_no_worker(monkeypatch):
    tasks = fake_ray.installed(monkeypatch)
    monkeypatch.setattr(tasks, "_start_worker", None)
    assert results([]) == []


def test_a_piece_that_takes_its_worker_along_is_given_up(monkeypatch):
    fake_ray.installed(monkeypatch, lambda piece: piece == 2)
    yielded = []
    with pytest.raises(OSError, match="a piece of work lost its worker 5 times; its node is gone"):
        for number, _ in ray_tasks.results("auto", MAKER, {"add": 1}, list(range(6))):
            yielded.append(number)
    assert set(yielded) <= {0, 1, 3, 4, 5} and len(set(yielded)) == len(yielded)


def test_a_cluster_on_which_no_worker_begins_is_told(monkeypatch):
    fake_ray.installed(monkeypatch, lambda piece: piece is None)
    monkeypatch.setattr(ray_tasks, "SCALE_SECONDS", 0.0)
    with pytest.raises(OSError, match="21 workers in a row were lost"):
        results([1])


def test_what_a_worker_raises_is_raised_here(monkeypatch):
    fake_ray.installed(monkeypatch)
    with pytest.raises(InputError, match="there: expected a number, found a word"):
        results([1, "refused", 2])
    with pytest.raises(InputError, match="here: expected a number, found none"):
        results([1], refuse=True)
    with pytest.raises(RuntimeError, match=r"(?s)on a worker of the Ray cluster.*TypeError"):
        results([{}])


def test_paths_reach_workers_absolute_and_urls_as_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    encode = msgspec.json.Encoder(enc_hook=ray_tasks._absolute).encode
    assert msgspec.json.decode(encode([Path("a/b"), "c"])) == [str(tmp_path / "a/b"), "c"]
    assert msgspec.json.decode(encode(Path("s3://bucket/a"))).startswith("s3:/")
    with pytest.raises(NotImplementedError):
        encode(object())


@pytest.mark.long
def test_a_cluster_whose_node_is_killed_answers_each_piece_once(monkeypatch):
    ray = pytest.importorskip("ray", reason="ray is not installed (extra ray)")
    from tests.support.ray_cluster import started

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    with started(ray, nodes=2) as (cluster, nodes):
        assert ray_cluster.workers(1) == 2
        numbers = []
        for number, result in ray_tasks.results("auto", MAKER, {"add": 1}, list(range(300))):
            assert msgspec.json.decode(result) == number**2 + 1
            numbers.append(number)
            if len(numbers) == 40:
                cluster.remove_node(nodes[0], allow_graceful=False)
        assert sorted(numbers) == list(range(300))
        with pytest.raises(OSError, match="lost its worker 5 times"):
            results([1, 5, 2], deadly=5)
        with pytest.raises(InputError, match="there: expected a number, found a word"):
            results(["refused"])
