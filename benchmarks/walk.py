"""The scene graph over time, in simulation: how accurate, how honest, how soon it notices what changed, how fast.

    OMP_NUM_THREADS=1 python benchmarks/walk.py [--walks 6] [--only NAME]

A headset walks between two tables with five objects each, each watched by a static camera of its own; the two
cameras never share an object. Errors of the estimates (0.02 rad, 4 mm per axis) have half their variance in common with
those of the same object from like directions, as those of one network do. Tracking drifts as the configuration expects
unless the row says otherwise. Something happens after half the time.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field

import numpy as np
from registration import machine
from rich.console import Console
from rich.table import Table
from scale import box

from multicam import pipeline
from multicam.dataset.objects import Catalogue
from multicam.dataset.runs import StepResult
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.pipeline import PipelineConfig
from multicam.progress import RichProgress
from multicam.scenegraph.graph import SceneGraph
from multicam.types import FloatArray, Frame, FrameSet, ObjectEstimate

HEADSET, LEFT, RIGHT = "headset", "left", "right"
SECONDS, RATE = 40.0, 5.0
HALF = 0.8
"""Metres from the middle to each table."""

PER_TABLE = 5
SPREAD = np.repeat((0.02, 0.004), 3)
COMMON = 0.5
MISSED = 0.1
CAMERA = Camera.from_focal(600.0, 640, 480)
BLANK = np.zeros((480, 640, 3), dtype=np.uint8)
CHI_SQUARE_95 = 12.59


@dataclass(frozen=True)
class Scenario:
    """What is different from a quiet walk.

    Attributes:
        drift: of the tracking, as a multiple of what is expected.
        common: share of the variance of errors that like views have in common.
        gross: share of gross errors.
        bump: of the left camera, a twist on the right (rad, m).
        moved: objects that are moved (the first ones stand on the left table), and their twist.
        carried: seconds for which they are in motion; 0 for a single move.
    """

    drift: float = 1.0
    common: float = COMMON
    gross: float = 0.0
    bump: tuple[float, ...] = ()
    moved: tuple[int, ...] = ()
    twist: tuple[float, ...] = ()
    carried: float = 0.0


SCENARIOS = {
    "quiet": Scenario(),
    "no drift": Scenario(drift=0.0),
    "drift x 3": Scenario(drift=3.0),
    "independent errors": Scenario(common=0.0),
    "20 % gross errors": Scenario(gross=0.2),
    "camera bumped, 62 mm 4.7 deg": Scenario(bump=(0.08, 0.02, 0, 0.05, 0.03, 0)),
    "camera bumped, 10 mm 1.1 deg": Scenario(bump=(0.02, 0, 0, 0.01, 0, 0)),
    "object moved, 130 mm": Scenario(moved=(0,), twist=(0, 0, 0.5, 0.12, 0.05, 0)),
    "two objects nudged, 20 mm": Scenario(moved=(0, 1), twist=(0, 0, 0.05, 0.02, 0, 0)),
    "a whole table moved, 130 mm": Scenario(moved=(0, 1, 2, 3, 4), twist=(0, 0, 0.5, 0.12, 0.05, 0)),
    "object carried for 6 s": Scenario(moved=(2,), twist=(0, 0.1, 0.1, 0.05, 0.03, 0), carried=6.0),
}


@dataclass
class Record:
    """What was measured on the walks of a scenario; errors in mm and degrees."""

    headset: list[float] = field(default_factory=list[float])
    tracking: list[float] = field(default_factory=list[float])
    seen: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    pair: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    inside: list[bool] = field(default_factory=list[bool])
    noticed: list[float] = field(default_factory=list[float])
    seconds: list[float] = field(default_factory=list[float])
    due: int = 0


class LikeErrors:
    """Errors of unit variance that vary smoothly with the direction of view, over about 30 degrees."""

    def __init__(self, rng: np.random.Generator) -> None:
        waves = 24
        self._weight = rng.normal(size=(waves, 6)) * np.sqrt(2 / waves)
        self._wave, self._phase = rng.normal(size=(waves, 3)) / 0.5, rng.uniform(0, 2 * np.pi, waves)

    def __call__(self, direction: FloatArray) -> FloatArray:
        """(6,) the error from a direction (3,)."""
        return np.cos(self._wave @ direction + self._phase) @ self._weight


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walks", type=int, default=6, help="walks of each scenario (default: 6)")
    parser.add_argument("--only", default="", help="scenarios whose name contains this")
    options = parser.parse_args()
    print(machine())
    table = Table(
        "walk", "placed %", "seen from headset mm / deg", "pair mm / deg", "in 95 % bars", "headset mm",
        "by tracking alone", "noticed after s", "ms", title="Scene graph over time, means",
    )  # fmt: skip
    names = [name for name in SCENARIOS if options.only in name]
    for name in RichProgress().track(names, "walking", len(names)):
        record = Record()
        for seed in range(options.walks):
            walk(SCENARIOS[name], np.random.default_rng(seed), record)
        table.add_row(name, *figures(record))
    Console(width=170).print(table)


def figures(record: Record) -> list[str]:
    def pair(errors: list[tuple[float, float]]) -> str:
        return "{:.1f} / {:.2f}".format(*np.mean(errors, axis=0))

    return [
        f"{100 * len(record.seen) / record.due:.0f}", pair(record.seen), pair(record.pair),
        f"{100 * np.mean(record.inside):.0f}", f"{np.mean(record.headset):.1f}", f"{np.mean(record.tracking):.1f}",
        f"{np.mean(record.noticed):.1f}, at most {max(record.noticed):.1f}" if record.noticed else "",
        f"{1000 * np.median(record.seconds):.0f}",
    ]  # fmt: skip


def walk(scenario: Scenario, rng: np.random.Generator, record: Record) -> None:
    """One walk there and back, added to the record."""
    catalogue = Catalogue({n: box(n, rng) for n in range(1, PER_TABLE + 1)})
    objects = [(1 + n % PER_TABLE, place(rng, -HALF if n < PER_TABLE else HALF)) for n in range(2 * PER_TABLE)]
    errors = [LikeErrors(rng) for _ in objects]
    statics = {LEFT: looking(-HALF - 0.4, -0.5, -HALF), RIGHT: looking(HALF + 0.4, -0.5, HALF)}
    config = PipelineConfig()
    graph = pipeline.start(HEADSET, (LEFT, RIGHT), config)
    tracking = config.graph.tracking
    drift = scenario.drift * np.repeat((np.radians(tracking.drift_rotation_deg), tracking.drift_translation), 3)
    paths = path(rng)
    tracked = paths[0]
    event = int(len(paths) / 2)
    last = event + max(1, int(scenario.carried * RATE))
    noticed = False
    for number, headset in enumerate(paths):
        if number:
            motion = se3.inverse(paths[number - 1]) @ headset
            tracked = se3.plus(tracked @ motion, drift * rng.normal(size=6) / np.sqrt(RATE))
        if scenario.bump and number == event:
            statics[LEFT] = se3.plus(statics[LEFT], np.array(scenario.bump))
        if event <= number < last:
            share = 1 / RATE if scenario.carried else 1.0
            for index in scenario.moved:
                obj_id, pose = objects[index]
                objects[index] = obj_id, se3.plus(pose, share * np.array(scenario.twist))
        cameras = {HEADSET: headset, **statics}
        stamp = round(number / RATE * 1e9)
        found = [look(cameras[name], objects, errors, scenario, rng) for name in cameras]
        frames = tuple(
            Frame(name, stamp, BLANK, CAMERA, tracked if name == HEADSET else None) for name in (HEADSET, LEFT, RIGHT)
        )
        began = time.perf_counter()
        graph, result = pipeline.step(graph, FrameSet(stamp, frames), found, catalogue, config)
        record.seconds.append(time.perf_counter() - began)
        judge(result, cameras, tracked, record)
        if not noticed and number >= event and has_noticed(scenario, graph, event):
            noticed = True
            record.noticed.append((number - event) / RATE)


def has_noticed(scenario: Scenario, graph: SceneGraph, event: int) -> bool:
    """Whether the graph knows of the bump, or that every moved object has left its place."""
    since = event / RATE * 1e9
    if scenario.bump:
        return graph.places[LEFT].since_ns >= since
    over = {rest.instance for rest in graph.rests.values() if rest.over}
    return bool(scenario.moved) and len(over | set(graph.movers)) >= len(scenario.moved)


def judge(result: StepResult, truth: dict[str, FloatArray], tracked: FloatArray, record: Record) -> None:
    poses = {name: result.camera(name).world_from_camera for name in truth}
    headset = poses[HEADSET]
    assert headset is not None
    record.headset.append(1000 * float(np.linalg.norm((headset - truth[HEADSET])[:3, 3])))
    record.tracking.append(1000 * float(np.linalg.norm((tracked - truth[HEADSET])[:3, 3])))
    for name in (LEFT, RIGHT):
        record.due += 1
        pose, covariance = poses[name], result.camera(name).covariance
        if pose is None or covariance is None:
            continue
        found, true = se3.inverse(headset) @ pose, se3.inverse(truth[HEADSET]) @ truth[name]
        twist = se3.minus(true, found)
        record.seen.append(error(found, true))
        record.inside.append(bool(twist @ np.linalg.solve(covariance, twist) < CHI_SQUARE_95))
    left, right = poses[LEFT], poses[RIGHT]
    if left is not None and right is not None:
        record.pair.append(error(se3.inverse(left) @ right, se3.inverse(truth[LEFT]) @ truth[RIGHT]))


def error(found: FloatArray, true: FloatArray) -> tuple[float, float]:
    """(mm, degrees) between two poses."""
    turn = np.degrees(np.linalg.norm(se3.minus(found, true)[:3]))
    return 1000 * float(np.linalg.norm((found - true)[:3, 3])), float(turn)


def look(
    camera: FloatArray,
    objects: list[tuple[int, FloatArray]],
    errors: list[LikeErrors],
    scenario: Scenario,
    rng: np.random.Generator,
) -> tuple[ObjectEstimate, ...]:
    """What a network makes of the objects that a camera sees within 1.5 m."""
    found: list[ObjectEstimate] = []
    for (obj_id, world_from_object), like in zip(objects, errors, strict=True):
        pose = se3.inverse(camera) @ world_from_object
        if not visible(pose[:3, 3]) or rng.uniform() < MISSED:
            continue
        if rng.uniform() < scenario.gross:
            shift = rng.normal(size=3)
            pose = se3.from_parts(so3.random(rng), pose[:3, 3] + 0.15 * shift / np.linalg.norm(shift))
        towards = -pose[:3, :3].T @ pose[:3, 3]
        own = np.sqrt(1 - scenario.common) * rng.normal(size=6)
        deviation = np.sqrt(scenario.common) * like(towards / np.linalg.norm(towards)) + own
        found.append(ObjectEstimate(obj_id, 0.8, se3.plus(pose, SPREAD * deviation), np.diag(SPREAD**2)))
    return tuple(found)


def visible(centre: FloatArray) -> bool:
    u, v = CAMERA.project(centre)
    return bool(0.2 < centre[2] < 1.5 and 20 < u < CAMERA.width - 20 and 20 < v < CAMERA.height - 20)


def place(rng: np.random.Generator, centre: float) -> FloatArray:
    """A pose within 20 cm of the middle of a table."""
    angle, radius = rng.uniform(0, 2 * np.pi), 0.2 * np.sqrt(rng.uniform())
    return se3.from_parts(so3.random(rng), np.array([centre + radius * np.cos(angle), radius * np.sin(angle), 0.05]))


def path(rng: np.random.Generator) -> FloatArray:
    """(n, 4, 4) world_from_headset: from the left table to the right one and back, with halts and an unsteady hand."""
    count = int(SECONDS * RATE)
    sway = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    sway -= np.stack([np.convolve(sway[:, axis], np.ones(15) / 15, mode="same") for axis in range(3)], axis=1)
    away = 1 - np.abs(np.linspace(-1, 1, count))
    progress = np.clip((away - 0.2) / 0.6, 0, 1)
    progress = progress**2 * (3 - 2 * progress)
    poses: list[FloatArray] = []
    for number in range(count):
        x = HALF * (2 * progress[number] - 1)
        stroll = 0.25 * np.sin(2 * np.pi * number / RATE / 9)
        poses.append(looking(x + stroll, -0.7, x, sway=0.02 * sway[number]))
    return np.array(poses)


def looking(x: float, y: float, at: float, sway: FloatArray | None = None) -> FloatArray:
    """world_from_camera of a camera 70 cm up that looks at the middle of a table; z of the world is up."""
    eye = np.array([x, y, 0.7]) + (0 if sway is None else sway)
    towards = np.array([at, 0, 0]) - eye
    towards /= np.linalg.norm(towards)
    right = np.cross(towards, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return se3.from_parts(np.stack((right, np.cross(towards, right), towards), axis=-1), eye)


if __name__ == "__main__":
    main()
