"""Several processes started by torchrun, or one."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import torch
import torch.distributed as dist

from multicam.errors import ConfigError
from train.memory import reuse_freed_memory


@dataclass(frozen=True)
class Group:
    """The processes of a run, as one of them sees it."""

    rank: int
    processes: int
    device: torch.device

    @property
    def leads(self) -> bool:
        """Whether this process validates and writes files."""
        return self.rank == 0

    def any(self, flag: bool) -> bool:
        """Whether the flag is set in any process."""
        if self.processes == 1:
            return flag
        value = torch.tensor(float(flag), device=self.device)
        dist.all_reduce(value)
        return bool(value > 0)

    def wait(self) -> None:
        """Returns when all processes are here."""
        if self.processes > 1:
            dist.barrier()


@contextmanager
def process_group(device: str) -> Iterator[Group]:
    """Joins the processes that torchrun started (gloo on CPUs, nccl on GPUs); a lone process has nothing to join.

    On a CPU the process keeps the memory that it frees, see `reuse_freed_memory`.

    Raises:
        ConfigError: a GPU is asked for and there is none.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError('device is "cuda" but PyTorch sees no GPU; set device to "auto" or "cpu".')
    gpu = device == "cuda" or (device == "auto" and torch.cuda.is_available())
    processes, local = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("LOCAL_RANK", "0"))
    chosen = torch.device("cuda", local) if gpu else torch.device("cpu")
    if not gpu:
        reuse_freed_memory()
    if processes == 1:
        yield Group(0, 1, chosen)
        return
    dist.init_process_group("nccl" if gpu else "gloo")
    try:
        yield Group(dist.get_rank(), processes, chosen)
    finally:
        dist.destroy_process_group()


class StopSignal:
    """Notes Ctrl-C and SIGTERM, so that a run can save before it ends."""

    def __init__(self) -> None:
        self.given = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.given = True

    @contextmanager
    def watching(self) -> Iterator[StopSignal]:
        """Takes over both signals inside the block."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = [signal.signal(number, self._note) for number in numbers]
        try:
            yield self
        finally:
            for number, handler in zip(numbers, before, strict=True):
                signal.signal(number, handler)
