"""One pure step of the runtime: the scene graph and what all cameras see now give the next graph and all poses.

The pictures of a step may differ in time by some milliseconds. Objects and static cameras stand still meanwhile, and
the headset's tracked pose is that of its own picture, so the relative poses found are exact all the same.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from multicam.adjuster import Adjuster, Adjustment, BundleConfig, is_due
from multicam.dataset.objects import Catalogue
from multicam.dataset.runs import AdjustmentResult, CameraResult, ObjectResult, Status, StepResult
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.matching.linear import total_std
from multicam.registration import RegistrationConfig
from multicam.scenegraph.advance import TrackedPose, advance
from multicam.scenegraph.config import GraphConfig
from multicam.scenegraph.expectation import predicted
from multicam.scenegraph.graph import SceneGraph
from multicam.scenegraph.keyframe import keep
from multicam.scenegraph.query import chain
from multicam.scenegraph.solution import Solution
from multicam.types import FloatArray, Frame, FrameSet, ObjectEstimate, View

NO_PICTURE = "it gave no picture at this time"


@dataclass(frozen=True)
class PipelineConfig:
    """How views become poses over time."""

    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    """Adjustment on the pictures, where some camera measures depth."""


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
    adjuster: Adjuster | None = None,
) -> tuple[SceneGraph, StepResult]:
    """Enters the views of one time step into the graph and solves it; twice where the pictures adjust the estimates.

    Args:
        estimates: for each frame of the set its object estimates, each with a covariance.
        adjuster: moves the estimates of keyframes to where the pictures show the objects; None leaves them alone.

    Raises:
        DataError: an estimate of a class that the catalogue does not hold.
    """
    now = frame_set.timestamp_ns
    frames = {frame.camera_id: frame for frame in frame_set.frames}
    views = [_view(frame, found) for frame, found in zip(frame_set.frames, estimates, strict=True)]
    tracked = _tracked_pose(graph, frames.get(graph.headset))
    seconds = {"graph": 0.0} if adjuster is None else {"graph": 0.0, "bundle": 0.0}

    def enter(views: Sequence[View]) -> tuple[Solution | None, StepResult]:
        with _timed(seconds, "graph"):
            solution, reasons = advance(graph, views, tracked, catalogue, config.registration, now)
            return solution, _result(graph, solution, frames, tracked, reasons, now)

    solution, result = enter(views)
    if solution is not None and adjuster is not None and is_due(graph, solution.graph):
        with _timed(seconds, "bundle"):
            adjustment = adjuster.adjust(solution, views, frames, catalogue, config.registration.noise, now)
        if adjustment is not None:
            solution, adjusted = enter(adjustment.views)
            result = replace(adjusted, adjustment=_adjustment_result(result, adjustment))
    if solution is not None:
        graph = keep(solution.graph, tracked is not None)
    return graph, replace(result, seconds=seconds)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Generator[None]:
    began = time.perf_counter()
    yield
    seconds[stage] += time.perf_counter() - began


def _result(
    graph: SceneGraph,
    solution: Solution | None,
    frames: Mapping[str, Frame],
    tracked: TrackedPose | None,
    reasons: Mapping[str, str],
    now: int,
) -> StepResult:
    """What a solution says of all cameras and objects; None if nothing has a pose."""
    if solution is None:
        cameras = tuple(_unplaced(name, frames.get(name), reasons) for name in (graph.headset, *graph.statics))
        return StepResult(now, cameras, (), None, {})
    cameras, objects = solution.seen_from(_reference(solution.graph))
    results = _camera_results(solution.graph, cameras, frames, tracked, reasons, now)
    drift = None
    if tracked is not None and solution.graph.now is not None:
        drift = solution.graph.now.world_from_camera @ se3.inverse(tracked.tracking_from_headset)
    return StepResult(now, results, _object_results(solution, objects, now), drift, {})


def _adjustment_result(before: StepResult, adjustment: Adjustment) -> AdjustmentResult:
    kept = adjustment.kept_cameras | {f"object {n}": why for n, why in adjustment.kept_objects.items()}
    return AdjustmentResult(before.cameras, before.objects, adjustment.energy, kept)


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


def _tracked_pose(graph: SceneGraph, frame: Frame | None) -> TrackedPose | None:
    """What tracking says of the headset now; None also for an old packet, which says nothing of now."""
    if frame is None or frame.tracked_world_from_camera is None:
        return None
    if graph.tracking is not None and frame.timestamp_ns <= graph.tracking.timestamp_ns:
        return None
    return TrackedPose(frame.timestamp_ns, frame.tracked_world_from_camera)


def _camera_results(
    graph: SceneGraph,
    covariances: FloatArray,
    frames: Mapping[str, Frame],
    tracked: TrackedPose | None,
    reasons: Mapping[str, str],
    now: int,
) -> tuple[CameraResult, ...]:
    results: list[CameraResult] = []
    for name in (graph.headset, *graph.statics):
        frame, stay, index = frames.get(name), graph.stay_of(name), graph.index_of(name)
        if stay is None or index is None:
            results.append(_unplaced(name, frame, reasons))
            continue
        status, reason = _status(name == graph.headset, frame, tracked, stay.seen_ns == now, reasons.get(name, ""))
        taken = None if frame is None else frame.timestamp_ns
        results.append(
            CameraResult(
                name, status, reason, taken, stay.world_from_camera, covariances[index], stay.seen_ns,
                chain(graph, name),
            )
        )  # fmt: skip
    return tuple(results)


def _reference(graph: SceneGraph) -> int:
    """The stay that covariances are relative to: the headset now, or at its last keyframe."""
    return max(len(graph.path) - 1, 0)


def _unplaced(name: str, frame: Frame | None, reasons: Mapping[str, str]) -> CameraResult:
    if frame is None:
        return CameraResult(name, "not placed", NO_PICTURE, None, None, None, None, ())
    reason = reasons.get(name, "no camera has a pose yet: the headset's tracking gave none")
    return CameraResult(name, "not placed", reason, frame.timestamp_ns, None, None, None, ())


def _status(
    is_headset: bool, frame: Frame | None, tracked: TrackedPose | None, confirmed: bool, reason: str
) -> tuple[Status, str]:
    """What is known of a camera with a pose and, unless it was measured, why not."""
    if is_headset:
        return ("tracked", "") if tracked is not None else ("placed", "its tracking gave no pose")
    if confirmed:
        return "placed", ""
    if frame is None:
        return "kept", NO_PICTURE
    return "kept", reason or "it sees none of the objects that are known"


def _object_results(solution: Solution, covariances: FloatArray, now: int) -> tuple[ObjectResult, ...]:
    graph = solution.graph
    present = [stay for stay in map(graph.stay_of, (graph.headset, *graph.statics)) if stay is not None]
    results: list[ObjectResult] = []
    vague = total_std(covariances[:, 3:, 3:]) > graph.config.objects.max_position_std
    for covariance, number, hidden in zip(covariances, solution.numbers, vague, strict=True):
        rest = graph.rests[number]
        if rest.over or rest.sightings < graph.config.objects.min_sightings or hidden:
            continue
        cameras = tuple(
            sorted(stay.camera_id for stay in present if number in stay.edges and stay.edges[number].last_ns == now)
        )
        results.append(
            ObjectResult(rest.instance, rest.obj_id, rest.score, rest.world_from_object, covariance, cameras)
        )
    for mover in graph.movers.values():
        pose = predicted(mover, now, graph.config.objects.motion_per_second)
        cameras = mover.seen_by if mover.seen_ns == now else ()
        results.append(ObjectResult(mover.instance, mover.obj_id, mover.score, pose.pose, pose.covariance, cameras))
    return tuple(sorted(results, key=lambda result: result.instance))
