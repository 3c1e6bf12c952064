"""Walks through the pipeline: what the graph says at each step, against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multicam import pipeline
from multicam.dataset.runs import StepResult
from multicam.geometry import se3
from multicam.pipeline import PipelineConfig
from multicam.scenegraph.graph import SceneGraph
from multicam.types import Frame, FrameSet, ObjectEstimate, View
from tests.toy_walk import HEADSET, LEFT, RIGHT, ToyStep, ToyWalk

BLANK = np.zeros((480, 640, 3), dtype=np.uint8)
CONFIG = PipelineConfig()
SLOW = 2_000_000_000
"""Nanoseconds per step at which the toy headset is slow enough to measure."""

NOISE: dict[str, float] = {"rotation_noise": 0.02, "translation_noise": 0.004}
"""Of one estimate: rad, m."""

Seen = tuple[FrameSet, list[tuple[ObjectEstimate, ...]]]


@dataclass(frozen=True, eq=False)
class Walked:
    """A walk and what was made of it."""

    walk: ToyWalk
    graphs: tuple[SceneGraph, ...]
    results: tuple[StepResult, ...]

    def in_headset(self, step: int, camera_id: str) -> tuple[float, float]:
        """(rad, m) by which a static camera is off, seen from the headset, at a step."""
        return error(*self._relative(step, HEADSET, camera_id))

    def pair(self, step: int) -> tuple[float, float]:
        """(rad, m) by which the two static cameras are off relative to each other."""
        return error(*self._relative(step, LEFT, RIGHT))

    def headset(self, step: int) -> tuple[float, float]:
        """(rad, m) by which the headset is off in the world."""
        found = self.results[step].camera(HEADSET).world_from_camera
        assert found is not None
        return error(found, self.walk.steps[step].world.world_from_camera[HEADSET])

    def tracked(self, step: int) -> tuple[float, float]:
        """(rad, m) by which the headset's tracking is off."""
        moment = self.walk.steps[step]
        return error(moment.tracked_world_from_headset, moment.world.world_from_camera[HEADSET])

    def status(self, camera_id: str) -> list[str]:
        """Of a camera at every step."""
        return [result.camera(camera_id).status for result in self.results]

    def squared(self, step: int, camera_id: str) -> float:
        """Squared error of a static camera, seen from the headset, by its stated covariance; chi-square with 6."""
        found, truth = self._relative(step, HEADSET, camera_id)
        twist = se3.minus(truth, found)
        covariance = self.results[step].camera(camera_id).covariance
        assert covariance is not None
        return float(twist @ np.linalg.solve(covariance, twist))

    def _relative(self, step: int, a: str, b: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        found, truth = self.results[step], self.walk.steps[step].world.world_from_camera
        pose_a, pose_b = found.camera(a).world_from_camera, found.camera(b).world_from_camera
        assert pose_a is not None
        assert pose_b is not None
        return se3.inverse(pose_a) @ pose_b, se3.inverse(truth[a]) @ truth[b]


def seen(step: ToyStep, views: tuple[View, ...], tracked: bool = True) -> Seen:
    """Frames and estimates of a step; the headset's frame carries its tracked pose."""
    frames = []
    for camera, view in zip(step.world.cameras, views, strict=True):
        assert camera.camera_id == view.view_id
        pose = step.tracked_world_from_headset if tracked and camera.camera_id == HEADSET else None
        frames.append(Frame(camera.camera_id, step.timestamp_ns, BLANK, camera.camera, pose))
    return FrameSet(step.timestamp_ns, tuple(frames)), [view.estimates for view in views]


def go(
    walk: ToyWalk, rng: np.random.Generator, untracked: tuple[int, ...] = (), config: PipelineConfig = CONFIG,
    **noise: Any,
) -> Walked:  # fmt: skip
    """The pipeline over a walk; keywords as in `ToyWorld.views`. At the steps `untracked` tracking gives no pose."""
    graph = pipeline.start(HEADSET, (LEFT, RIGHT), config)
    graphs, results = [], []
    for number, step in enumerate(walk.steps):
        views = step.world.views(rng, with_detections=False, **noise)
        frame_set, estimates = seen(step, views, number not in untracked)
        graph, result = pipeline.step(graph, frame_set, estimates, step.world.catalogue, config)
        graphs.append(graph)
        results.append(result)
    return Walked(walk, tuple(graphs), tuple(results))


def error(found: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """(rad, m) between two poses."""
    twist = se3.minus(found, truth)
    return float(np.linalg.norm(twist[:3])), float(np.linalg.norm(found[:3, 3] - truth[:3, 3]))
