"""A registration made from the truth of a toy step plus noise, so that the graph is tested without a matcher."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from multicam.geometry import se3
from multicam.scenegraph.fold import cameras_now, fold_cameras, fold_objects
from multicam.scenegraph.graph import GraphConfig, SceneGraph, TrackedPose
from multicam.scenegraph.keyframe import KeyframeConfig
from multicam.scenegraph.uncertain import isotropic
from multicam.scenegraph.update import track_headset
from multicam.types import Component, PlacedCamera, PlacedObject, Registration, View
from tests.toy_walk import HEADSET, LEFT, RIGHT, ToyStep, ToyWalk
from tests.toy_world import ToyWorld

NOISE = isotropic(2e-3, 2e-3)
ANY_SPEED = KeyframeConfig(max_speed=10.0, max_turn_deg=720.0)


def register(world: ToyWorld, rng: np.random.Generator, scale: float = 0.0) -> Registration:
    """Cameras that share two objects or more, in the frame of the first; errors of `scale` times NOISE (variances)."""
    groups: list[list[int]] = []
    for index, camera in enumerate(world.cameras):
        sharing = [g for g in groups if any(_shared(world.cameras[i].visible, camera.visible) > 1 for i in g)]
        merged = sorted({index}.union(*sharing))
        groups = [g for g in groups if g not in sharing] + [merged]
    components = tuple(_component(world, group, rng, scale) for group in groups if len(group) > 1)
    placed = {camera.view_id for component in components for camera in component.cameras}
    alone = [c.camera_id for c in world.cameras if c.camera_id not in placed]
    return Registration(components, dict.fromkeys(alone, "it shares too few objects with the others"))


def fold(
    graph: SceneGraph, step: ToyStep, registration: Registration, keyframe: KeyframeConfig = ANY_SPEED
) -> tuple[SceneGraph, dict[str, str]]:
    """What the pipeline does with a registration, single-camera objects left out."""
    tracked = TrackedPose(step.timestamp_ns, step.tracked_world_from_headset)
    graph = track_headset(graph, step.timestamp_ns, tracked.world_from_headset)
    graph, reasons = fold_cameras(graph, registration, tracked, step.timestamp_ns, keyframe)
    cameras = cameras_now(graph, registration, tracked, step.timestamp_ns)
    views: dict[str, View] = {}
    return fold_objects(graph, registration, views, cameras, step.world.catalogue, step.timestamp_ns), reasons


def walk_through(
    walk: ToyWalk, rng: np.random.Generator, scale: float = 0.0, config: GraphConfig | None = None
) -> SceneGraph:
    """The graph after all steps of a walk."""
    graph = SceneGraph(HEADSET, (LEFT, RIGHT), config or GraphConfig())
    for step in walk.steps:
        graph, _ = fold(graph, step, register(step.world, rng, scale))
    return graph


def _shared(a: tuple[int, ...], b: tuple[int, ...]) -> int:
    return len(set(a) & set(b))


def _component(world: ToyWorld, group: list[int], rng: np.random.Generator, scale: float) -> Component:
    cameras = [world.cameras[i] for i in group]
    gauge_from_world = se3.inverse(cameras[0].world_from_camera)
    placed: list[PlacedCamera] = []
    for camera in cameras:
        pose, covariance = gauge_from_world @ camera.world_from_camera, NOISE
        if camera is cameras[0]:
            covariance = np.zeros((6, 6))
        placed.append(PlacedCamera(camera.camera_id, _noisy(pose, scale * covariance, rng), covariance))
    objects: list[PlacedObject] = []
    for index, item in enumerate(world.objects):
        supports = tuple((c.camera_id, c.visible.index(index)) for c in cameras if index in c.visible)
        if len(supports) > 1:
            pose = _noisy(gauge_from_world @ item.world_from_object, scale * NOISE, rng)
            objects.append(PlacedObject(item.obj_id, 0.9, pose, NOISE, supports))
    return Component(tuple(placed), tuple(objects))


def _noisy(pose: NDArray[np.float64], covariance: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    return se3.plus(pose, np.sqrt(np.diag(covariance)) * rng.normal(size=6))
