"""Errors of a run against the truth of its recording, as the headset would see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from multicam.dataset.results import Estimates
from multicam.dataset.runs import CameraResult, RunResult, StepResult
from multicam.dataset.sequence import Recording
from multicam.evaluation.assignment import assign_greedily
from multicam.evaluation.board_error import BoardErrors, evaluate_board
from multicam.evaluation.camera_error import CameraError, camera_error
from multicam.evaluation.points import PointSets
from multicam.evaluation.single_view import ObjectErrors, evaluate_estimates
from multicam.evaluation.truth import Truth
from multicam.geometry import se3
from multicam.progress import Progress
from multicam.types import FloatArray

SAME_OBJECT = 0.02
"""Metres; true poses of one class from two cameras that are closer are one object."""


@dataclass(frozen=True)
class AdjustmentErrors:
    """Errors before and after bundle adjustment, at the steps that were adjusted.

    Attributes:
        cameras: static camera to its errors in the headset's frame, of the steps at which it was measured.
        objects: ADD(-S) errors (m) in the headset's frame of all objects in sight; infinite for a missing one.
    """

    cameras: dict[str, tuple[tuple[CameraError, CameraError], ...]]
    objects: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class RunErrors:
    """Errors per step, in the order of the run's steps; None where a camera had no pose.

    Attributes:
        cameras: static camera to its errors in the headset's frame: inv(world_from_headset) @ world_from_static.
        pairs: two static cameras to the errors of their relative pose.
        headset: errors of the headset against its first pose, as the run has it.
        tracking: the same by its own tracking alone, which drifts.
        objects: class to ADD(-S) errors (m) in the headset's frame over all steps; infinite for a missing object.
        single_view: class to the errors of the network's own estimates, picture by picture.
        adjustment: what bundle adjustment gained, or None if no step was adjusted.
        board: static camera to its errors by the recording's ChArUco board; empty without a board.
    """

    cameras: dict[str, tuple[CameraError | None, ...]]
    pairs: dict[tuple[str, str], tuple[CameraError | None, ...]]
    headset: tuple[CameraError | None, ...]
    tracking: tuple[CameraError | None, ...]
    objects: dict[int, tuple[float, ...]]
    single_view: dict[int, list[ObjectErrors]]
    adjustment: AdjustmentErrors | None = None
    board: dict[str, BoardErrors] = field(default_factory=dict[str, BoardErrors])


@dataclass(frozen=True, eq=False)
class _Reference:
    """The headset's pose as the run had it and as it was, at its latest picture."""

    found: CameraResult
    true_world_from_headset: FloatArray


def evaluate_run(run: RunResult, estimates: Estimates, recording: Recording, progress: Progress) -> RunErrors:
    """Compares every step of a run with the recording's truth.

    A static camera is judged where the headset needs it: in the headset's frame at its latest picture, so that drift
    of the tracking between the measurement and now counts as error.

    Args:
        estimates: of the network, by scene and image of the recording.

    Raises:
        DataError: run and recording do not belong together, or the recording carries no truth.
    """
    truth, points = Truth(recording), PointSets(recording.catalogue)
    cameras: dict[str, list[CameraError | None]] = {name: [] for name in run.statics}
    pairs: dict[tuple[str, str], list[CameraError | None]] = {pair: [] for pair in combinations(run.statics, 2)}
    objects: dict[int, list[float]] = {}
    reference: _Reference | None = None
    for step in run.steps:
        reference = _latest_reference(step.camera(run.headset), truth) or reference
        for name, errors in cameras.items():
            errors.append(_error_in_headset(step, name, reference, truth))
        for (a, b), errors in pairs.items():
            errors.append(_pair_error(step, a, b, truth))
        if reference is not None:
            _judge_objects(step, reference, truth, points, objects)
    pictures = [
        truth.record(camera.camera_id, camera.timestamp_ns)
        for step in run.steps
        for camera in step.cameras
        if camera.timestamp_ns is not None
    ]
    by_camera = {name: tuple(errors) for name, errors in cameras.items()}
    return RunErrors(
        by_camera,
        {pair: tuple(errors) for pair, errors in pairs.items()},
        *_headset_errors(run, truth),
        {obj_id: tuple(errors) for obj_id, errors in sorted(objects.items())},
        evaluate_estimates(estimates, pictures, points, progress),
        _adjustment_errors(run, truth, points),
        evaluate_board(run, by_camera, recording, progress),
    )


def run_from_true(run: RunResult, truth: Truth) -> FloatArray | None:
    """(4, 4) from the recording's world to that of the run, which coincide at the headset's first pose, if any."""
    for step in run.steps:
        reference = _latest_reference(step.camera(run.headset), truth)
        if reference is not None:
            assert reference.found.world_from_camera is not None
            return reference.found.world_from_camera @ se3.inverse(reference.true_world_from_headset)
    return None


def _adjustment_errors(run: RunResult, truth: Truth, points: PointSets) -> AdjustmentErrors | None:
    adjusted = [step for step in run.steps if step.adjustment is not None]
    if not adjusted:
        return None
    cameras: dict[str, list[tuple[CameraError, CameraError]]] = {name: [] for name in run.statics}
    objects: list[tuple[float, float]] = []
    for step in adjusted:
        versions = step.unadjusted, step
        references = [_latest_reference(each.camera(run.headset), truth) for each in versions]
        for name, found in cameras.items():
            if any(each.camera(name).status != "placed" for each in versions):
                continue
            before, after = (_error_in_headset(e, name, r, truth) for e, r in zip(versions, references, strict=True))
            if before is not None and after is not None:
                found.append((before, after))
        judged: list[dict[int, list[float]]] = [{}, {}]
        for each, reference, errors in zip(versions, references, judged, strict=True):
            if reference is not None:
                _judge_objects(each, reference, truth, points, errors)
        if all(reference is not None for reference in references):
            for obj_id, errors in judged[0].items():
                objects += zip(errors, judged[1][obj_id], strict=True)
    return AdjustmentErrors({name: tuple(found) for name, found in cameras.items()}, tuple(objects))


def _headset_errors(
    run: RunResult, truth: Truth
) -> tuple[tuple[CameraError | None, ...], tuple[CameraError | None, ...]]:
    """Per step as the run has the headset, and by its tracking alone."""
    change = run_from_true(run, truth)
    corrected: list[CameraError | None] = []
    alone: list[CameraError | None] = []
    for step in run.steps:
        reference = _latest_reference(step.camera(run.headset), truth)
        if reference is None or change is None:
            corrected.append(None)
            alone.append(None)
            continue
        found, true = reference.found.world_from_camera, change @ reference.true_world_from_headset
        assert found is not None
        corrected.append(camera_error(found, true))
        drift = step.world_from_tracking
        alone.append(None if drift is None else camera_error(se3.inverse(drift) @ found, true))
    return tuple(corrected), tuple(alone)


def _latest_reference(headset: CameraResult, truth: Truth) -> _Reference | None:
    if headset.world_from_camera is None or headset.timestamp_ns is None:
        return None
    return _Reference(headset, truth.camera(headset.camera_id, headset.timestamp_ns))


def _error_in_headset(step: StepResult, name: str, reference: _Reference | None, truth: Truth) -> CameraError | None:
    camera = step.camera(name)
    if reference is None or camera.world_from_camera is None:
        return None
    true = se3.inverse(reference.true_world_from_headset) @ _true_static(step, camera, truth)
    estimated, covariance = _relative(reference.found, camera)
    return camera_error(estimated, true, covariance)


def _pair_error(step: StepResult, first: str, second: str, truth: Truth) -> CameraError | None:
    a, b = step.camera(first), step.camera(second)
    if a.world_from_camera is None or b.world_from_camera is None:
        return None
    estimated, covariance = _relative(a, b)
    true = se3.inverse(_true_static(step, a, truth)) @ _true_static(step, b, truth)
    return camera_error(estimated, true, covariance)


def _true_static(step: StepResult, camera: CameraResult, truth: Truth) -> FloatArray:
    """Where a static camera is at a step; one that gave no picture then is where its latest one was taken."""
    return truth.static(camera.camera_id, step.timestamp_ns if camera.timestamp_ns is None else camera.timestamp_ns)


def _relative(a: CameraResult, b: CameraResult) -> tuple[FloatArray, FloatArray]:
    """a_from_b of two placed cameras with its covariance: Cov_b + Ad(b_from_a) Cov_a Ad(b_from_a)^T."""
    assert a.world_from_camera is not None
    assert b.world_from_camera is not None
    assert a.covariance is not None
    assert b.covariance is not None
    relative = se3.inverse(a.world_from_camera) @ b.world_from_camera
    adjoint = se3.adjoint(se3.inverse(relative))
    return relative, b.covariance + adjoint @ a.covariance @ adjoint.T


def _judge_objects(
    step: StepResult, reference: _Reference, truth: Truth, points: PointSets, errors: dict[int, list[float]]
) -> None:
    assert reference.found.world_from_camera is not None
    found_from_world = se3.inverse(reference.found.world_from_camera)
    true_from_world = se3.inverse(reference.true_world_from_headset)
    truths = _objects_of_step(step, truth)
    for obj_id in {class_id for class_id, _ in truths}:
        wanted = [true_from_world @ pose for class_id, pose in truths if class_id == obj_id]
        results = sorted((o for o in step.objects if o.obj_id == obj_id), key=lambda o: -o.score)
        found = [found_from_world @ o.world_from_object for o in results]

        def error(estimated: FloatArray, true: FloatArray, obj_id: int = obj_id) -> float:
            return points.add_or_add_s(obj_id, estimated, true)

        answers = assign_greedily(found, wanted, error)
        errors.setdefault(obj_id, []).extend(np.inf if answer is None else answer[1] for answer in answers)


def _objects_of_step(step: StepResult, truth: Truth) -> Sequence[tuple[int, FloatArray]]:
    """All objects that some camera of the step sees, each once."""
    objects: list[tuple[int, FloatArray]] = []
    for camera in step.cameras:
        if camera.timestamp_ns is None:
            continue
        for obj_id, pose in truth.objects(camera.camera_id, camera.timestamp_ns):
            known = (p for i, p in objects if i == obj_id)
            if all(np.linalg.norm(p[:3, 3] - pose[:3, 3]) > SAME_OBJECT for p in known):
                objects.append((obj_id, pose))
    return objects
