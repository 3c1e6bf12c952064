"""Workers as Ray actors, on every machine of a cluster that shares the folders of this one; alone imports ray.

An actor keeps one Blender from scene to scene, as a plain task could not. Retries are the pool's: Ray knows only that
a call was lost, not which pictures of it are on disk.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Iterator
from typing import Any, cast

from datagen.config import DatagenConfig
from datagen.jobs.local import CORES_PER_WORKER
from datagen.jobs.pool import Worker
from datagen.jobs.work import Event, SceneWorker, WorkerDied
from multicam.errors import MissingDependencyError

try:
    import ray
except ModuleNotFoundError as error:
    raise MissingDependencyError("--executor ray needs Ray: install it with pip install -e '.[ray]'.") from error

_log = logging.getLogger(__name__)


class RayExecutor:
    """The cluster at RAY_ADDRESS, or one of this machine alone where there is none; a context manager."""

    def __init__(self, config: DatagenConfig) -> None:
        self._config = config
        self._connected_before = ray.is_initialized()
        if not self._connected_before:
            ray.init(log_to_driver=False, logging_level=logging.WARNING)
        nodes = [int(n["Resources"].get("CPU", 0)) for n in ray.nodes() if n["Alive"]]
        self._threads = min(CORES_PER_WORKER, max(nodes))
        self.workers = config.workers or max(1, sum(cores // self._threads for cores in nodes))
        self._started: list[RayWorker] = []
        _log.info("%d workers of %d threads on %d machines", self.workers, self._threads, len(nodes))

    def __enter__(self) -> RayExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._started:
            worker.stop()
        if not self._connected_before:
            ray.shutdown()

    def start(self) -> Worker:
        """A fresh actor; it waits for a machine with cores to spare."""
        worker = RayWorker(self._config, self._threads)
        self._started.append(worker)
        return worker

    def wait(self, busy: Collection[Worker]) -> list[tuple[Worker, Event]]:
        """The next events; an actor that is lost says so in Ray's words."""
        by_stream = {worker.stream: worker for worker in cast("Collection[RayWorker]", busy)}
        ready, _ = ray.wait(list(by_stream), num_returns=1)
        return [(by_stream[stream], by_stream[stream].read()) for stream in ready]


class RayWorker:
    """One actor."""

    def __init__(self, config: DatagenConfig, threads: int) -> None:
        self._actor = _Actor.options(num_cpus=threads).remote(config, threads, os.getcwd())
        self.stream: Any = None

    def begin(self, index: int) -> None:
        """Starts on a scene."""
        self.stream = self._actor.perform.remote(index)

    def read(self) -> Event:
        """Its next event, or how it was lost."""
        try:
            return ray.get(next(self.stream))
        except ray.exceptions.RayError as error:
            return WorkerDied(f"a Ray worker was lost: {str(error).strip().splitlines()[0]}")

    def stop(self) -> None:
        """Ends the actor; its Blender ends with it."""
        ray.kill(self._actor)


@ray.remote(max_restarts=0, max_task_retries=0)
class _Actor:
    """A SceneWorker in a process of Ray's."""

    def __init__(self, config: DatagenConfig, threads: int, folder: str) -> None:
        # Relative paths mean the same on every machine.
        os.chdir(folder)
        self._worker = SceneWorker(config, threads)

    @ray.method(num_returns="streaming")
    def perform(self, index: int) -> Iterator[Event]:
        """Makes what is missing of scene `index`."""
        yield from self._worker.perform(index)
