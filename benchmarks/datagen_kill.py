"""Kills a rendering run again and again, lets it finish, and compares it with one that was left alone.

    python benchmarks/datagen_kill.py --kills 200 --models data/instruments/models --output data/kill

Each kill is a SIGKILL at a random moment to the whole session, to the parent, to one worker or to one Blender. What
must hold: no file but a temporary one is ever torn, a picture once labelled stays, nobody survives the parent, and in
the end verify finds nothing and every byte is that of the undisturbed run.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from datagen.config import DatagenConfig
from datagen.jobs.verify import verify_split
from multicam.config import parse_command, save_config

ROLES = {"parent": "datagen.cli", "worker": "datagen.jobs.worker", "blender": "datagen.blender.worker"}
TARGETS = ("session", "parent", "worker", "blender")


@dataclass(frozen=True)
class KillConfig:
    """Options of the benchmark."""

    kills: int = 200
    """How many."""
    models: Path = Path("data/instruments/models")
    """BOP models folder."""
    output: Path = Path(tempfile.gettempdir(), "datagen-kill")
    """Scratch folder, emptied first."""
    images: int = 60
    """Pictures of a data set; when it is whole, the next one is begun."""
    seed: int = 0
    """Of the moments and victims."""


def main() -> None:
    config = parse_command(KillConfig, sys.argv[1:], "datagen_kill.py", __doc__ or "")
    shutil.rmtree(config.output, ignore_errors=True)
    rng = random.Random(config.seed)
    job = DatagenConfig(
        models=config.models.resolve(), output=config.output / "quiet", images=config.images, images_per_scene=4,
        width=64, height=48, samples=1, workers=2,
    )  # fmt: skip
    began = time.monotonic()
    assert Run(job).wait() == 0, "the undisturbed run failed"
    print(f"undisturbed: {config.images} pictures in {time.monotonic() - began:.0f} s", flush=True)
    tally: Counter[str] = Counter()
    whole, restarts = 0, 0
    while sum(tally.values()) < config.kills:
        disturbed = replace(job, output=config.output / f"killed-{whole}")
        while sum(tally.values()) < config.kills:
            run = Run(disturbed)
            restarts += 1
            if not disturb(run, disturbed, tally, config.kills, rng):
                break
            if sum(tally.values()) % 20 < 2:
                print(f"{time.monotonic() - began:.0f} s: {dict(tally)}, {restarts} starts", flush=True)
        assert Run(disturbed).wait() == 0, "the run could not be finished"
        compare(job, disturbed)
        whole += 1
    print(f"kills: {dict(tally)}; {restarts} starts; {whole} data sets finished, verified and equal to the byte")


class Run:
    """A rendering run in a session of its own."""

    def __init__(self, job: DatagenConfig) -> None:
        path = job.output.with_suffix(".yaml")
        save_config(job, path)
        command = [sys.executable, "-m", "datagen.cli", "render", "--config", str(path)]
        self._log = open(job.output.with_suffix(".log"), "ab")  # noqa: SIM115
        self.process = subprocess.Popen(command, stdout=self._log, stderr=self._log, start_new_session=True)

    def wait(self) -> int:
        code = self.process.wait()
        self._log.close()
        return code

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    def members(self) -> dict[int, str]:
        """Process to role, of all that live in the session."""
        found: dict[int, str] = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                state, session = (folder / "stat").read_text().rpartition(")")[2].split()[0:4:3]
                words = (folder / "cmdline").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(session) == self.process.pid and state != "Z":
                found |= {int(folder.name): role for role, module in ROLES.items() if module in words}
        return found


def disturb(run: Run, job: DatagenConfig, tally: Counter[str], kills: int, rng: random.Random) -> bool:
    """Kills parts of a run until it ends or must be started again; False if it ended by itself."""
    while sum(tally.values()) < kills:
        wait_for_a_moment(run, job, rng)
        members = run.members()
        target = rng.choice(TARGETS)
        victims = [pid for pid, role in members.items() if target in ("session", role)]
        if not run.running:
            run.wait()
            return False
        if not victims:
            continue
        before = labelled(job)
        for pid in victims if target == "session" else [rng.choice(victims)]:
            kill(pid)
        tally[target] += 1
        if target in ("session", "parent"):
            run.wait()
            gone = time.monotonic() + 5
            while survivors := run.members():
                assert time.monotonic() < gone, f"they outlive their parent: {survivors}"
                time.sleep(0.02)
            after = labelled(job)
            assert before <= after, f"labelled pictures were lost: {before - after}"
            check_files(job)
            return True
    kill(run.process.pid)
    run.wait()
    return True


def wait_for_a_moment(run: Run, job: DatagenConfig, rng: random.Random) -> None:
    """Mostly while pictures are made, sometimes while the run still starts."""
    if rng.random() < 0.8:
        count = len(labelled(job))
        while run.running and len(labelled(job)) == count:
            time.sleep(0.01)
    time.sleep(rng.uniform(0, 0.6))


def kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def labelled(job: DatagenConfig) -> set[tuple[str, str]]:
    """Scene and image of all pictures that exist to a reader."""
    tables = (job.output / job.split).glob("*/scene_gt.json")
    return {(path.parent.name, key) for path in tables for key in json.loads(path.read_text())}


def check_files(job: DatagenConfig) -> None:
    """Every file that is not a temporary one reads, and every labelled picture has its pixels."""
    for path in (job.output / job.split).rglob("*"):
        if path.name.startswith(".") or not path.is_file():
            continue
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix in (".png", ".jpg"):
            data = np.frombuffer(path.read_bytes(), np.uint8)
            assert cv2.imdecode(data, cv2.IMREAD_UNCHANGED) is not None, f"{path} is torn"
    for scene, key in labelled(job):
        folder, stem = job.output / job.split / scene, f"{int(key):06d}"
        for table in ("scene_camera", "scene_gt_info", "scene_keypoints"):
            assert key in json.loads((folder / f"{table}.json").read_text()), f"{folder}: {table} lacks image {key}"
        assert (folder / "rgb" / f"{stem}.jpg").is_file() and (folder / "depth" / f"{stem}.png").is_file()


def compare(quiet: DatagenConfig, disturbed: DatagenConfig) -> None:
    """Nothing to complain of, and the same bytes everywhere, pixels included."""
    report = verify_split(disturbed.output / disturbed.split, 2)
    assert not report.problems, report.problems
    ours, theirs = (
        {path.relative_to(c.output): path for kind in (c.split, "models") for path in (c.output / kind).rglob("*.*")}
        for c in (disturbed, quiet)
    )
    assert ours.keys() == theirs.keys(), ours.keys() ^ theirs.keys()
    other = [name for name, path in ours.items() if path.read_bytes() != theirs[name].read_bytes()]
    assert [name.name for name in other] == ["config.yaml"], other


if __name__ == "__main__":
    main()
