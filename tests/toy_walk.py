"""The toy world over time: a headset walks between two tables, each watched by a static camera of its own.

The two static cameras never see a common object; only the headset's tracking links them. Cameras may be bumped and
objects moved or carried about.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multicam.geometry import se3
from multicam.types import View
from tests.toy_objects import BRACKET, PEG, PLATE, ROD, WEDGE, toy_catalogue
from tests.toy_world import FloatArray, ToyCamera, ToyWorld, looking_at, place_objects

HEADSET, LEFT, RIGHT = "headset", "static0", "static1"
TABLE_DISTANCE = 1.6
"""Metres between the centres of the two tables."""


@dataclass(frozen=True, eq=False)
class ToyStep:
    """One moment: the true world and what the headset's tracking says."""

    timestamp_ns: int
    world: ToyWorld
    tracked_world_from_headset: FloatArray

    def views(self, rng: np.random.Generator, **options: Any) -> tuple[View, ...]:
        """Views of the cameras that see anything at this moment; keywords as in `ToyWorld.views`."""
        return tuple(view for view in self.world.views(rng, **options) if view.estimates)


@dataclass(frozen=True, eq=False)
class ToyWalk:
    """A recording: steps in order of time."""

    steps: tuple[ToyStep, ...]

    @property
    def world_from_static(self) -> dict[str, FloatArray]:
        """True poses of the two static cameras at first."""
        poses = self.steps[0].world.world_from_camera
        return {name: poses[name] for name in (LEFT, RIGHT)}

    def with_bump(self, camera_id: str, at: int, twist: Sequence[float]) -> ToyWalk:
        """A static camera moves on the right by a twist (rad, m) and stays there from step `at` on."""

        def bump(camera: ToyCamera) -> ToyCamera:
            if camera.camera_id != camera_id:
                return camera
            return replace(camera, world_from_camera=se3.plus(camera.world_from_camera, np.array(twist)))

        steps = [
            replace(s, world=replace(s.world, cameras=tuple(map(bump, s.world.cameras)))) if n >= at else s
            for n, s in enumerate(self.steps)
        ]
        return ToyWalk(tuple(steps))

    def with_motion(self, indices: Sequence[int], first: int, last: int, twist: Sequence[float]) -> ToyWalk:
        """Objects move on the right by a twist (rad, m) at each step from `first` to `last`, both included."""
        steps = []
        for n, step in enumerate(self.steps):
            total = max(0, min(n, last) - first + 1)
            objects = list(step.world.objects)
            for index in indices:
                pose = objects[index].world_from_object
                for _ in range(total):
                    pose = se3.plus(pose, np.array(twist))
                objects[index] = replace(objects[index], world_from_object=pose)
            steps.append(replace(step, world=replace(step.world, objects=tuple(objects))))
        return ToyWalk(tuple(steps))

    def with_jump(self, at: int, twist: Sequence[float]) -> ToyWalk:
        """From step `at` on the tracking has lost its way by a twist (rad, m) on the left."""
        jump = se3.exp(np.array(twist))
        steps = [
            replace(s, tracked_world_from_headset=jump @ s.tracked_world_from_headset) if n >= at else s
            for n, s in enumerate(self.steps)
        ]
        return ToyWalk(tuple(steps))


def make_walk(
    rng: np.random.Generator,
    num_steps: int = 20,
    rotation_drift: float = 0.0,
    translation_drift: float = 0.0,
    step_ns: int = 100_000_000,
    path: Sequence[float] | None = None,
) -> ToyWalk:
    """A walk from the left table to the right one, by default straight; in between the headset sees nothing.

    Args:
        path: where the headset is at each step, from 0 (left) to 1 (right); `num_steps` is then left out.
        rotation_drift, translation_drift: standard deviation per axis and step (rad, m) of the random walk by
            which the tracked pose leaves the true one. Tracking begins at the truth.
    """
    classes = (BRACKET, PLATE, PEG, ROD, WEDGE)
    half = TABLE_DISTANCE / 2
    objects = place_objects(rng, classes, (-half, 0.0)) + place_objects(rng, classes, (half, 0.0))
    left, right = tuple(range(len(classes))), tuple(range(len(classes), 2 * len(classes)))
    statics = (
        ToyCamera(LEFT, looking_at(np.array([-half - 0.4, -0.5, 0.7]), np.array([-half, 0, 0.0])), left),
        ToyCamera(RIGHT, looking_at(np.array([half + 0.4, -0.5, 0.7]), np.array([half, 0, 0.0])), right),
    )
    catalogue = toy_catalogue()
    drift = np.repeat((rotation_drift, translation_drift), 3)
    steps: list[ToyStep] = []
    for index, fraction in enumerate(np.linspace(0, 1, num_steps) if path is None else np.array(path)):
        x = half * (2 * fraction - 1)
        eye = np.array([x, -0.7, 0.7 + 0.05 * np.sin(4 * np.pi * fraction)])
        pose = looking_at(eye, np.array([x, 0, 0.0]))
        headset = ToyCamera(HEADSET, pose, ())
        headset = replace(
            headset,
            visible=tuple(i for i, o in enumerate(objects) if _in_sight(headset, o.world_from_object)),
        )
        tracked = pose
        if steps:
            moved = se3.inverse(steps[-1].world.cameras[0].world_from_camera) @ pose
            tracked = se3.plus(steps[-1].tracked_world_from_headset @ moved, drift * rng.normal(size=6))
        steps.append(ToyStep(index * step_ns, ToyWorld(catalogue, (headset, *statics), objects), tracked))
    return ToyWalk(tuple(steps))


def _in_sight(camera: ToyCamera, world_from_object: FloatArray) -> bool:
    """Whether the object's centre lies in the image, 40 pixels from the border or more."""
    centre = se3.act(se3.inverse(camera.world_from_camera), world_from_object[:3, 3])
    u, v = camera.camera.project(centre)
    return bool(centre[2] > 0 and 40 < u < camera.camera.width - 40 and 40 < v < camera.camera.height - 40)
