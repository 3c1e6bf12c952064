"""Processes that end together and keep apart."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from datagen.processes import child_command, lock, resident_memory
from multicam.errors import DataError

SLEEPER = "import sys, time; print(sys.argv[1], flush=True); time.sleep(60)"
PARENT = """
import subprocess, time
from datagen.processes import child_command
child = subprocess.Popen(child_command("sleeper", "hello"), stdout=subprocess.PIPE, text=True)
print(child.stdout.readline().strip(), child.pid, flush=True)
time.sleep(60)
"""


def test_a_child_that_hears_nothing_ends_with_its_killed_parent(tmp_path: Path) -> None:
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{Path(__file__).parents[2]}"}
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True, env=environment)
    assert parent.stdout is not None
    word, pid = parent.stdout.readline().split()
    assert word == "hello"
    assert resident_memory(int(pid)) > 2**20
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    deadline = time.monotonic() + 5
    while resident_memory(int(pid)):
        assert time.monotonic() < deadline, "it sleeps on"
        time.sleep(0.01)


def test_a_child_whose_parent_went_before_it_began_does_nothing(tmp_path: Path) -> None:
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    command = child_command("sleeper", "hello")
    command[3] = "1"
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{Path(__file__).parents[2]}"}
    assert subprocess.run(command, env=environment, capture_output=True, check=True, timeout=30).stdout == b""


def test_a_lock_excludes_others_until_it_is_given_up(tmp_path: Path) -> None:
    path = tmp_path / "scene" / ".lock"
    with lock(path, 0), pytest.raises(DataError, match="Another process is writing"), lock(path, 0.1):
        pass
    with lock(path, 0):
        pass


def test_nobody_holds_no_memory() -> None:
    assert resident_memory(2**22 + 1) == 0
