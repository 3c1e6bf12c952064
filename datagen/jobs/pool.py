"""Hands scenes to workers until all are made: who works at what, who died, when it is enough. Knows no executor."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Generator, Mapping
from contextlib import AbstractContextManager
from typing import Protocol

from datagen.jobs.work import Event, PictureDone, SceneDone, SceneRefused, WorkerDied
from multicam.errors import MulticamError

TRIES = 3
"""Workers that a scene may cost before the run stops."""


class Worker(Protocol):
    """A process somewhere, with a Blender."""

    def begin(self, index: int) -> None:
        """Starts on a scene; a worker that cannot says so in its next event."""
        ...

    def stop(self) -> None:
        """Ends the process, whatever it is doing, and waits until it is gone."""
        ...


class Executor(AbstractContextManager["Executor"], Protocol):
    """A place that has workers; leaving it stops them all."""

    workers: int

    def start(self) -> Worker:
        """A fresh worker."""
        ...

    def wait(self, busy: Collection[Worker]) -> list[tuple[Worker, Event]]:
        """The next events of workers that have a scene, at least one; at most one of each worker."""
        ...


def run_scenes(executor: Executor, plan: Mapping[int, int], seed: int) -> Generator[None]:
    """Makes scenes; yields once for every picture.

    Args:
        plan: number of each scene to how many of its pictures are missing.
        seed: of the data set, for messages.

    Raises:
        MulticamError: a scene cannot be made, or has cost `TRIES` workers.
    """
    waiting = deque(plan)
    missing = dict(plan)
    deaths: Counter[int] = Counter()
    idle: list[Worker] = []
    busy: dict[Worker, int] = {}
    with executor:
        while waiting or busy:
            while waiting and len(busy) < executor.workers:
                worker = idle.pop() if idle else executor.start()
                busy[worker] = waiting.popleft()
                worker.begin(busy[worker])
            for worker, event in executor.wait(busy):
                index = busy[worker]
                match event:
                    case PictureDone():
                        missing[index] -= 1
                        yield
                    case SceneDone(worn):
                        del busy[worker]
                        if worn:
                            worker.stop()
                        else:
                            idle.append(worker)
                        # A worker may die after a picture is written and before it says so.
                        for _ in range(missing.pop(index)):
                            yield
                    case WorkerDied(words):
                        del busy[worker]
                        worker.stop()
                        deaths[index] += 1
                        if deaths[index] == TRIES:
                            raise MulticamError(
                                f"Seed {seed}, scene {index} has ended {TRIES} workers, one after the other; the last "
                                f"said: {words.rstrip('.')}. Is there enough memory? The same command tries again."
                            )
                        waiting.appendleft(index)
                    case SceneRefused(error):
                        raise error
