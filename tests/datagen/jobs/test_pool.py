"""Who works at what, who died, when it is enough: with workers that follow a script."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from datagen.jobs.local import share_cores
from datagen.jobs.pool import TRIES, Worker, run_scenes
from datagen.jobs.work import Event, PictureDone, SceneDone, SceneRefused, WorkerDied
from multicam.errors import DataError, MulticamError

DONE, WORN = SceneDone(worn=False), SceneDone(worn=True)


class ScriptedWorker:
    """Says what the script has for its scene."""

    def __init__(self, stage: ScriptedExecutor) -> None:
        self.stage, self.stopped = stage, False
        self.lines: list[Event] = []

    def begin(self, index: int) -> None:
        assert not self.stopped and not self.lines
        self.stage.begun.append(index)
        self.lines = list(self.stage.script[index].pop(0))

    def stop(self) -> None:
        self.stopped = True


class ScriptedExecutor:
    """Scene to what each attempt at it says."""

    def __init__(self, workers: int, script: dict[int, list[list[Event]]]) -> None:
        self.workers, self.script = workers, script
        self.started: list[ScriptedWorker] = []
        self.begun: list[int] = []
        self.most = 0

    def __enter__(self) -> ScriptedExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.started:
            worker.stop()

    def start(self) -> Worker:
        self.started.append(ScriptedWorker(self))
        return self.started[-1]

    def wait(self, busy: Collection[Worker]) -> list[tuple[Worker, Event]]:
        self.most = max(self.most, len(busy))
        return [(worker, worker.lines.pop(0)) for worker in busy if isinstance(worker, ScriptedWorker)]


def pictures(executor: ScriptedExecutor, plan: dict[int, int]) -> int:
    return len(list(run_scenes(executor, plan, seed=7)))


def test_every_picture_is_counted_once() -> None:
    script = {index: [[PictureDone(), PictureDone(), DONE]] for index in range(5)}
    executor = ScriptedExecutor(2, script)
    assert pictures(executor, dict.fromkeys(range(5), 2)) == 10
    assert executor.begun == [0, 1, 2, 3, 4]
    assert len(executor.started) == executor.most == 2
    assert all(worker.stopped for worker in executor.started)


def test_a_scene_that_lost_its_worker_is_given_to_a_fresh_one() -> None:
    # The second picture was on disk when the first worker died, and was never spoken of.
    script = {0: [[PictureDone(), WorkerDied("gone")], [PictureDone(), DONE]], 1: [[DONE]]}
    executor = ScriptedExecutor(1, script)
    assert pictures(executor, {0: 3, 1: 0}) == 3
    assert executor.begun == [0, 0, 1]
    assert len(executor.started) == 2


def test_a_scene_that_costs_too_many_workers_stops_the_run_by_name() -> None:
    executor = ScriptedExecutor(1, {3: [[WorkerDied("Blender ended with code -9: killed.")]] * TRIES})
    with pytest.raises(MulticamError, match=r"Seed 7, scene 3 .*code -9: killed\. Is there"):
        pictures(executor, {3: 1})
    assert all(worker.stopped for worker in executor.started)


def test_what_nobody_can_make_stops_the_run_at_once() -> None:
    executor = ScriptedExecutor(1, {0: [[SceneRefused(DataError("labels differ"))]]})
    with pytest.raises(DataError, match="labels differ"):
        pictures(executor, {0: 1, 1: 1})
    assert executor.begun == [0]


def test_a_worn_worker_gives_way_to_a_fresh_one() -> None:
    executor = ScriptedExecutor(1, {index: [[WORN]] for index in range(3)})
    assert pictures(executor, dict.fromkeys(range(3), 1)) == 3
    assert len(executor.started) == 3


def test_workers_stop_when_the_run_is_closed_half_way() -> None:
    executor = ScriptedExecutor(1, {0: [[PictureDone(), PictureDone(), DONE]]})
    run = run_scenes(executor, {0: 2}, seed=7)
    next(run)
    run.close()
    assert [worker.stopped for worker in executor.started] == [True]


@pytest.mark.parametrize(
    ("cores", "asked", "expected"),
    [(1, 0, (1, 1)), (2, 0, (1, 2)), (2, 2, (2, 1)), (2, 3, (3, 1)), (16, 0, (4, 4)), (30, 0, (7, 4))],
)
def test_cores_are_shared_by_processes_of_a_few_threads(cores: int, asked: int, expected: tuple[int, int]) -> None:
    assert share_cores(cores, asked) == expected
