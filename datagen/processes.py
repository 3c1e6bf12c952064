"""What processes that work together need from the system: to end together, to keep apart, to know their size."""

from __future__ import annotations

import ctypes
import fcntl
import os
import runpy
import signal
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from multicam.errors import DataError

_PR_SET_PDEATHSIG = 1
"""From <linux/prctl.h>."""


def child_command(module: str, *arguments: str) -> list[str]:
    """Runs a module as a child of this process that the kernel kills as soon as this process is gone.

    However it ended, `kill -9` included. For children that leave nothing behind when they are killed. The end of a
    pipe from the parent says the same on any system, but only when the child next reads or writes, which may be a
    picture later.
    """
    return [sys.executable, "-m", "datagen.processes", str(os.getpid()), module, *arguments]


def _run_child(parent: int, module: str, arguments: list[str]) -> None:
    if sys.platform == "linux":
        # Before anything else is imported, which takes seconds.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return
    sys.argv[1:] = arguments
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def resident_memory(pid: int) -> int:
    """Bytes of RAM that a process holds; 0 where there is no /proc, or no such process any more."""
    # Not psutil: this one number does not need a dependency.
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


@contextmanager
def lock(path: Path, patience: float) -> Generator[None]:
    """Holds a file's advisory lock (flock), which ends with the process, however that ends; the file stays.

    Raises:
        DataError: another process did not give it up for `patience` seconds.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + patience
    with open(path, "ab") as stream:
        while True:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:
                if time.monotonic() > deadline:
                    raise DataError(
                        f"Another process is writing {path.parent}; wait until it is done, or stop it first."
                    ) from error
                time.sleep(0.05)
        yield


if __name__ == "__main__":
    _run_child(int(sys.argv[1]), sys.argv[2], sys.argv[3:])
