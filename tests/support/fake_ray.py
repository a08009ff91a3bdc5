"""A cluster of two workers without Ray: pieces run in this process; workers are lost at will."""

import random
from contextlib import nullcontext
from types import SimpleNamespace

from manifests import ray_cluster, ray_tasks


class FakeTasks(ray_tasks.Tasks):
    """Tasks whose actors are objects here.

    lost  called with the number of a piece, None for the start of a worker: whether the worker is
          lost; it may have done its work before that, as one behind a broken network has
    """

    lost = staticmethod(lambda piece: False)
    draw = random.Random(0)
    ended = 0

    def _start_worker(self):
        worker = ray_tasks.Worker(self._maker, self._settings)

        def method(call):
            return SimpleNamespace(remote=lambda *words: lambda: call(*words))

        return SimpleNamespace(ready=method(worker.ready), do=method(worker.do))

    def _finished_workers(self):
        return [self.draw.choice(self._hands)]

    def _answer(self, hand):
        gone = type(self).lost(hand.piece)
        if gone and self.draw.random() < 0.5:
            return RuntimeError("its node is gone")
        answer = hand.reference()
        return RuntimeError("its node is gone") if gone else answer

    def _end(self, actor):
        type(self).ended += 1


def installed(monkeypatch, lost=None):
    """Have everything that asks for a cluster use two such workers; returns the class."""
    tasks = type("Tasks", (FakeTasks,), {"draw": random.Random(1)})
    if lost:
        tasks.lost = staticmethod(lost)
    monkeypatch.setattr(ray_tasks, "Tasks", tasks)
    monkeypatch.setattr(ray_cluster, "connected", lambda address: nullcontext())
    monkeypatch.setattr(ray_cluster, "workers", lambda threads: 2)
    return tasks
