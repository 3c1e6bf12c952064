"""Real processes, real Blender, tiny pictures: whoever makes them and whoever is killed, the bytes are the same."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from datagen.config import DatagenConfig, ObjectsConfig
from datagen.jobs import local, work
from datagen.jobs.generate import generate
from datagen.jobs.verify import verify_split
from datagen.jobs.work import PictureDone, SceneDone, SceneWorker
from datagen.pictures.generate import render_scene, scene_folder
from datagen.processes import lock, resident_memory
from multicam.config import save_config
from multicam.errors import DataError, MissingDependencyError

pytestmark = pytest.mark.blender

BLENDER, WORKER = "datagen.blender.worker", "datagen.jobs.worker"


def config_for(models: Path, output: Path) -> DatagenConfig:
    return DatagenConfig(
        models=models, output=output, images=6, images_per_scene=2, width=64, height=48, samples=1,
        objects=ObjectsConfig(assembled_fraction=0.5, loose=(4, 5)), seed=11,
    )  # fmt: skip


@pytest.fixture(scope="module")
def alone(models: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of an undisturbed run with one worker."""
    config = config_for(models, tmp_path_factory.mktemp("alone"))
    generate(config)
    return files(config)


def files(config: DatagenConfig) -> dict[str, bytes]:
    """Everything, pixels and hashes too, but the configuration, which names the folder."""
    split = config.output / config.split
    paths = [path for path in split.rglob("*") if path.is_file() and path.name != "config.yaml"]
    return {str(path.relative_to(split)): path.read_bytes() for path in paths}


def processes(module: str, parent: int | None = None) -> list[int]:
    """Living processes that run a module, below a parent or anywhere."""
    found: list[int] = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, above = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            if module in (folder / "cmdline").read_text() and state != "Z" and int(above) == (parent or int(above)):
                found.append(int(folder.name))
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def wait_until(condition: Callable[[], object], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def test_two_workers_and_their_deaths_change_no_byte(alone: dict[str, bytes], models: Path, tmp_path: Path) -> None:
    config = replace(config_for(models, tmp_path / "shared"), workers=2)

    def strike() -> None:
        wait_until(lambda: any(config.output.glob("train/*/rgb/*.jpg")))
        workers = processes(WORKER, os.getpid())
        os.kill(workers[0], signal.SIGKILL)
        for blender in processes(BLENDER, workers[-1]):
            os.kill(blender, signal.SIGKILL)

    striker = threading.Thread(target=strike)
    striker.start()
    generate(config)
    striker.join()
    assert files(config) == alone
    assert not processes(WORKER, os.getpid())


def test_nobody_outlives_a_killed_parent(alone: dict[str, bytes], models: Path, tmp_path: Path) -> None:
    config = config_for(models, tmp_path / "orphans")
    process = start(config, tmp_path)
    wait_until(lambda: any(config.output.glob("train/*/rgb/*.jpg")))
    workers = processes(WORKER, process.pid)
    below = workers + [pid for worker in workers for pid in processes(BLENDER, worker)]
    assert len(below) == 2
    process.kill()
    process.wait()
    # Long before the scene would be done: the kernel ends them.
    wait_until(lambda: not any(resident_memory(pid) for pid in below), seconds=5)
    generate(config)
    assert files(config) == alone


@pytest.mark.parametrize("word", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_asked_to_stop_says_how_to_go_on(models: Path, tmp_path: Path, word: signal.Signals) -> None:
    config = replace(config_for(models, tmp_path / "stopped"), images=60)
    process = start(config, tmp_path)
    wait_until(lambda: any(config.output.glob("train/*/rgb/*.jpg")))
    process.send_signal(word)
    _, said = process.communicate(timeout=30)
    assert process.returncode != 0
    assert "of 60 pictures done; the same command goes on" in said
    assert not [path for path in config.output.rglob(".*") if path.name != ".lock"]


def start(config: DatagenConfig, folder: Path) -> subprocess.Popen[str]:
    save_config(config, folder / "config.yaml")
    # A shell starts what runs in its background with Ctrl-C ignored, and children inherit that.
    heed = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heed}; from multicam.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "datagen", "render", "--config", str(folder / "config.yaml")]
    return subprocess.Popen(command, cwd=Path(__file__).parents[3], stderr=subprocess.PIPE, text=True)


def test_one_scene_can_be_made_alone_and_again(alone: dict[str, bytes], models: Path, tmp_path: Path) -> None:
    config = config_for(models, tmp_path / "one")
    for _ in range(2):
        render_scene(config, 1)
        made = {name: data for name, data in alone.items() if name.startswith("000001/")}
        assert files(config) == made


def test_a_worker_asks_to_be_replaced_after_some_scenes(
    models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "RECYCLE_SCENES", 2)
    monkeypatch.setattr(work, "RECYCLE_GROWTH", 100.0)
    worker = SceneWorker(config_for(models, tmp_path / "worn"), 1)
    last = [list(worker.perform(index)) for index in range(2)]
    assert last == [[PictureDone(), PictureDone(), SceneDone(worn=worn)] for worn in (False, True)]
    monkeypatch.setattr(work, "RECYCLE_GROWTH", 0.5)
    monkeypatch.setattr(work, "RECYCLE_SCENES", 100)
    assert list(worker.perform(2))[-1] == SceneDone(worn=True)
    worker.close()


def test_a_scene_in_other_hands_is_left_to_them(models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = config_for(models, tmp_path / "held")
    monkeypatch.setattr("datagen.pictures.generate._PATIENCE", 0.1)
    with lock(scene_folder(config, 0) / ".lock", 0), pytest.raises(DataError, match="Another process is writing"):
        render_scene(config, 0)


def test_a_scene_that_kills_every_worker_is_named(
    models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Stands for a worker that dies at once, whatever it is given.
    monkeypatch.setattr(local, "child_command", lambda *_: ["/bin/false"])
    with pytest.raises(Exception, match=r"Seed 11, scene 0 has ended 3 workers.*code 1: it said nothing"):
        generate(config_for(models, tmp_path / "fatal"))


def test_ray_renders_the_same_on_several_machines_one_of_which_is_lost(
    alone: dict[str, bytes], models: Path, tmp_path: Path
) -> None:
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    doomed = cluster.add_node(num_cpus=1)
    cluster.add_node(num_cpus=1)
    config = replace(config_for(models, tmp_path / "ray"), executor="ray", workers=3)

    def strike() -> None:
        wait_until(lambda: any(config.output.glob("train/*/rgb/*.jpg")))
        cluster.remove_node(doomed, allow_graceful=False)

    try:
        ray.init(address=cluster.address, log_to_driver=False)
        striker = threading.Thread(target=strike)
        striker.start()
        generate(config)
        striker.join()
        assert files(config) == alone
        assert not verify_split(config.output / "train", 1).problems
    finally:
        ray.shutdown()
        cluster.shutdown()


def test_without_ray_the_extra_is_named(models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "datagen.jobs.ray_cluster", raising=False)
    with pytest.raises(MissingDependencyError, match=r"pip install -e '\.\[ray\]'"):
        generate(replace(config_for(models, tmp_path / "none"), executor="ray"))
