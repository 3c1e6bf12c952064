"""Worker processes on this machine: one Python each, spawned anew, which starts its own Blender.

Each has a pipe of its own to the parent. A queue that all share would be held for ever by a worker that is killed
while it writes; here the end of a pipe is the news of a death, to either side.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Collection
from multiprocessing.connection import Connection, Pipe, wait
from typing import cast

from datagen.config import DatagenConfig
from datagen.jobs.pool import Worker
from datagen.jobs.work import Event, WorkerDied
from datagen.processes import child_command

CORES_PER_WORKER = 4
"""Threads of one Blender beyond which more processes gain more than more threads."""
_GRACE = 10.0
"""Seconds that a worker has to end by itself."""


def share_cores(cores: int, workers: int) -> tuple[int, int]:
    """(workers, threads of each) for a machine; 0 workers means a number that fits."""
    workers = workers or max(1, cores // CORES_PER_WORKER)
    return workers, max(1, cores // workers)


class LocalExecutor:
    """Processes on this machine, as a context manager."""

    def __init__(self, config: DatagenConfig) -> None:
        self._config = config
        self.workers, self._threads = share_cores(len(os.sched_getaffinity(0)), config.workers)
        self._started: list[LocalWorker] = []

    def __enter__(self) -> LocalExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        # All are told before any is waited for.
        for worker in self._started:
            worker.terminate()
        for worker in self._started:
            worker.stop()

    def start(self) -> Worker:
        """A fresh process."""
        worker = LocalWorker(self._config, self._threads)
        self._started = [w for w in self._started if w.alive] + [worker]
        return worker

    def wait(self, busy: Collection[Worker]) -> list[tuple[Worker, Event]]:
        """The next events; a process that is gone says how."""
        by_channel = {worker.channel: worker for worker in cast("Collection[LocalWorker]", busy)}
        ready = [by_channel[cast("Connection", channel)] for channel in wait(list(by_channel))]
        return [(worker, worker.read()) for worker in ready]


class LocalWorker:
    """One process; see `datagen.jobs.worker` for its side."""

    def __init__(self, config: DatagenConfig, threads: int) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        self.channel, theirs = Pipe()
        self._process = subprocess.Popen(
            child_command("datagen.jobs.worker", str(theirs.fileno())),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._log,
            pass_fds=[theirs.fileno()],
        )
        theirs.close()
        self._send((config, threads))

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def begin(self, index: int) -> None:
        """Starts on a scene."""
        self._send(index)

    def read(self) -> Event:
        """Its next event, or how it ended."""
        try:
            return self.channel.recv()
        except (EOFError, OSError):
            code = self._process.wait()
            self._log.seek(0)
            lines = self._log.read().decode(errors="replace").strip().splitlines()
            return WorkerDied(f"a worker ended with code {code}: {lines[-1] if lines else 'it said nothing'}")

    def terminate(self) -> None:
        """Asks the process to end."""
        self._process.terminate()

    def stop(self) -> None:
        """Ends the process and waits for it."""
        self.terminate()
        try:
            self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.channel.close()
        self._log.close()

    def _send(self, message: object) -> None:
        try:
            self.channel.send(message)
        except OSError:
            # It is gone already, and says so when it is read.
            return
