"""The cameras of a run beside the same cameras by a ChArUco board, in the same pictures."""

from __future__ import annotations

from dataclasses import dataclass

from multicam.dataset.bop_reader import read_image
from multicam.dataset.runs import RunResult
from multicam.dataset.sequence import Recording
from multicam.evaluation.camera_error import CameraError, camera_error
from multicam.evaluation.charuco import board_pose
from multicam.evaluation.truth import Truth
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.progress import Progress
from multicam.types import FloatArray


@dataclass(frozen=True)
class BoardErrors:
    """A static camera in the headset's frame, at the steps at which both read the board.

    Attributes:
        board: by the board, from one picture of each.
        run: of the run at the same steps; None where it has no pose.
    """

    board: tuple[CameraError, ...]
    run: tuple[CameraError | None, ...]


def evaluate_board(
    run: RunResult, errors: dict[str, tuple[CameraError | None, ...]], recording: Recording, progress: Progress
) -> dict[str, BoardErrors]:
    """Errors of the static cameras by the board of a recording; empty where it has none.

    A static camera counts where it saw the board last, unless it has been bumped since; the headset where it sees it
    at the step.

    Args:
        errors: of the run, per static camera and step, as `evaluate_run` has them.
    """
    if recording.board is None:
        return {}
    truth, latest = Truth(recording), dict[str, tuple[FloatArray, FloatArray]]()
    pairs: dict[str, list[tuple[CameraError, CameraError | None]]] = {name: [] for name in run.statics}
    for number, step in enumerate(progress.track(run.steps, "reading the board")):
        seen: dict[str, FloatArray] = {}
        for camera in step.cameras:
            if camera.timestamp_ns is None:
                continue
            pose = _read(recording, truth, camera.camera_id, camera.timestamp_ns)
            place = truth.camera(camera.camera_id, camera.timestamp_ns)
            if pose is not None:
                seen[camera.camera_id] = pose
                latest[camera.camera_id] = pose, place
        headset = step.camera(run.headset)
        if run.headset not in seen or headset.timestamp_ns is None:
            continue
        world_from_headset = truth.camera(run.headset, headset.timestamp_ns)
        for name, found in pairs.items():
            true = truth.static(name, step.timestamp_ns)
            if name not in latest or abs(latest[name][1] - true).max() > 0:
                continue
            estimated = seen[run.headset] @ se3.inverse(latest[name][0])
            by_board = camera_error(estimated, se3.inverse(world_from_headset) @ true)
            found.append((by_board, errors[name][number]))
    return {
        name: BoardErrors(tuple(board for board, _ in both), tuple(own for _, own in both))
        for name, both in pairs.items()
        if both
    }


def _read(recording: Recording, truth: Truth, camera_id: str, timestamp_ns: int) -> FloatArray | None:
    """camera_from_board in a picture."""
    record = truth.record(camera_id, timestamp_ns)
    assert recording.board is not None and record.rgb_path is not None and record.camera_matrix is not None
    image = read_image(record.rgb_path)
    return board_pose(image, Camera(record.camera_matrix, image.shape[1], image.shape[0]), recording.board)
