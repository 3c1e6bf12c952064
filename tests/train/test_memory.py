"""Freed memory stays with the process."""

import subprocess
import sys

import pytest

RESIDENT = """
import sys, torch
from pathlib import Path
from train.memory import reuse_freed_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

if sys.argv[1] == "kept" and not reuse_freed_memory():
    sys.exit("not with this C library")
before = resident()
pieces = [torch.ones(6 * 2**20) for _ in range(8)]
del pieces
print(resident() - before)
"""
TAKEN = 8 * 24 * 2**20


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mallopt is glibc's")
def test_what_is_freed_stays_for_the_next_step() -> None:
    def left(how: str) -> int:
        return int(subprocess.run([sys.executable, "-c", RESIDENT, how], check=True, capture_output=True).stdout)

    assert left("given back") < 0.2 * TAKEN < 0.8 * TAKEN < left("kept")
