"""One pure step of the runtime: the scene graph and what all cameras see now give the next graph and all poses.

The pictures of a step may differ in time by some milliseconds. Objects and static cameras stand still meanwhile, and
the headset's tracked pose is that of its own picture, so the relative poses found are exact all the same.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from multicam.dataset.objects import Catalogue
from multicam.dataset.runs import CameraResult, ObjectResult, Status, StepResult
from multicam.geometry.camera import Camera
from multicam.registration import RegistrationConfig, register_views
from multicam.scenegraph import update
from multicam.scenegraph.fold import CameraNow, cameras_now, fold_cameras, fold_objects
from multicam.scenegraph.graph import GraphConfig, SceneGraph, TrackedPose
from multicam.scenegraph.keyframe import KeyframeConfig
from multicam.types import Frame, FrameSet, ObjectEstimate, Registration, View


@dataclass(frozen=True)
class PipelineConfig:
    """How views become poses over time."""

    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)


def start(headset: str, statics: Sequence[str], config: PipelineConfig) -> SceneGraph:
    """The graph before the first step.

    Raises:
        DataError: two cameras of one name.
    """
    return SceneGraph(headset, tuple(statics), config.graph)


def step(
    graph: SceneGraph,
    frame_set: FrameSet,
    estimates: Sequence[tuple[ObjectEstimate, ...]],
    catalogue: Catalogue,
    config: PipelineConfig,
) -> tuple[SceneGraph, StepResult]:
    """Registers the views of one time step and folds them into the graph.

    Args:
        estimates: for each frame of the set its object estimates, each with a covariance.
    """
    began = time.perf_counter()
    now = frame_set.timestamp_ns
    frames = {frame.camera_id: frame for frame in frame_set.frames}
    views = {frame.camera_id: _view(frame, found) for frame, found in zip(frame_set.frames, estimates, strict=True)}
    registration = _register(graph.headset, views, catalogue, config.registration)
    registered = time.perf_counter()

    tracked = _tracked_pose(frames.get(graph.headset))
    if tracked is not None:
        graph = update.track_headset(graph, tracked.timestamp_ns, tracked.world_from_headset)
    graph, reasons = fold_cameras(graph, registration, tracked, now, config.keyframe)
    cameras = cameras_now(graph, registration, tracked, now)
    graph = fold_objects(graph, registration, views, cameras, catalogue, now)
    seconds = {"registration": registered - began, "graph": time.perf_counter() - registered}

    results = tuple(
        _camera_result(graph.headset, name, frames.get(name), cameras.get(name), reasons.get(name, ""), now)
        for name in (graph.headset, *graph.statics)
    )
    return graph, StepResult(now, results, _object_results(graph, now), seconds)


def _view(frame: Frame, estimates: tuple[ObjectEstimate, ...]) -> View:
    """A view of an ideal lens: keypoints move to where they would lie without distortion."""
    if frame.camera.distortion:
        estimates = tuple(_undistorted(estimate, frame.camera) for estimate in estimates)
    return View(frame.camera_id, estimates, frame.camera.matrix)


def _undistorted(estimate: ObjectEstimate, camera: Camera) -> ObjectEstimate:
    if estimate.detection is None:
        return estimate
    keypoints = camera.undistort_pixels(estimate.detection.keypoints)
    return replace(estimate, detection=replace(estimate.detection, keypoints=keypoints))


def _register(
    headset: str, views: Mapping[str, View], catalogue: Catalogue, config: RegistrationConfig
) -> Registration:
    # The headset leads, so that it is the gauge of its component and covariances are relative to it; the others
    # come in alphabetical order, so that the order of the pictures changes nothing.
    order = sorted(views, key=lambda name: (name != headset, name))
    if len(order) < 2:
        return Registration((), dict.fromkeys(order, "no other camera gave a picture at this time"))
    return register_views([views[name] for name in order], catalogue, config)


def _tracked_pose(frame: Frame | None) -> TrackedPose | None:
    if frame is None or frame.tracked_world_from_camera is None:
        return None
    return TrackedPose(frame.timestamp_ns, frame.tracked_world_from_camera)


def _camera_result(
    headset: str, name: str, frame: Frame | None, known: CameraNow | None, refused: str, now: int
) -> CameraResult:
    status, reason = _status(headset, name, frame, known, refused, now)
    taken = None if frame is None else frame.timestamp_ns
    if known is None:
        return CameraResult(name, status, reason, taken, None, None, None, ())
    pose = known.world_from_camera
    return CameraResult(name, status, reason, taken, pose.pose, pose.covariance, known.updated_ns, known.chain)


def _status(
    headset: str, name: str, frame: Frame | None, known: CameraNow | None, refused: str, now: int
) -> tuple[Status, str]:
    """What is known of a camera now and, unless it was measured, why not."""
    if frame is None:
        refused = "it gave no picture at this time"
    elif name == headset and frame.tracked_world_from_camera is None:
        refused = "its tracking gave no pose"
    if known is None:
        return "not placed", refused or "it shares no object with a camera of known pose"
    if name == headset:
        return ("placed", refused) if refused else ("tracked", "")
    if known.updated_ns == now:
        return "placed", ""
    return "kept", refused or f"it is known through {' and '.join(known.chain[1:-1])}, measured earlier"


def _object_results(graph: SceneGraph, now: int) -> tuple[ObjectResult, ...]:
    seen: dict[int, set[str]] = {}
    for edge in graph.edges:
        if edge.timestamp_ns == now and edge.inlier:
            seen.setdefault(edge.instance, set()).add(edge.camera_id)
    motion = graph.config.objects.motion_per_second
    results: list[ObjectResult] = []
    for node in graph.known_objects:
        pose = node.filtered.at(now, motion)
        cameras = tuple(sorted(seen.get(node.instance, ())))
        results.append(ObjectResult(node.instance, node.obj_id, node.score, pose.pose, pose.covariance, cameras))
    return tuple(results)
