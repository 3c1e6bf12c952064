"""What sequence.json says of a recording besides its pictures: the board, the tracking's errors, and the truth."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from multicam.types import FloatArray


@dataclass(frozen=True)
class Board:
    """A ChArUco board in view, as `cv2.aruco.CharucoBoard((columns, rows), square, marker, dictionary)` makes it.

    Attributes:
        columns, rows: squares.
        square, marker: edge lengths, metres.
        dictionary: name in cv2.aruco, such as DICT_4X4_50.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str


@dataclass(frozen=True)
class TrackingErrors:
    """Size of the errors of the headset's tracking, as a data sheet would state it.

    Each tracked step over dt seconds is off by exp(b dt + w sqrt(dt) n) from the right, n ~ N(0, 1).

    Attributes:
        rotation_bias, translation_bias: |b|, rad/s and m/s; its direction is not stated.
        rotation_walk, translation_walk: w per axis, rad and m per root second.
    """

    rotation_bias: float
    translation_bias: float
    rotation_walk: float
    translation_walk: float


@dataclass(frozen=True)
class Bump:
    """A static camera was knocked and stands elsewhere from `timestamp_ns` on."""

    camera_id: str
    timestamp_ns: int


@dataclass(frozen=True)
class ObjectMotion:
    """The one object of a class moved; it stands still before `start_ns` and from `end_ns` on."""

    obj_id: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True, eq=False)
class SequenceTruth:
    """What only an evaluation may know; times in nanoseconds on the true clock, which is the headset's.

    Attributes:
        clock_offsets_ns: per camera, its time stamps minus the true times of exposure.
        world_from_board: (4, 4), or None without a board. The board's frame is OpenCV's: origin at the outer corner
            of the first square, x along the columns, y along the rows, z into the board.
    """

    clock_offsets_ns: dict[str, int]
    bumps: tuple[Bump, ...] = ()
    motions: tuple[ObjectMotion, ...] = ()
    world_from_board: FloatArray | None = None


def board_to_plain(board: Board | None, truth: SequenceTruth | None) -> dict[str, Any] | None:
    """The entry "board", its true pose included."""
    if board is None:
        return None
    pose = None if truth is None or truth.world_from_board is None else truth.world_from_board.tolist()
    return {**vars(board), "world_from_board": pose}


def board_from_plain(row: Any) -> tuple[Board | None, FloatArray | None]:
    """The board and its true pose, where they are stated.

    Raises:
        KeyError, TypeError, ValueError: the entry does not follow the format.
    """
    if row is None:
        return None, None
    board = Board(
        int(row["columns"]), int(row["rows"]), float(row["square"]), float(row["marker"]), str(row["dictionary"])
    )
    if not (board.columns >= 2 <= board.rows and 0 < board.marker < board.square):
        raise ValueError(f"the board has {board}: it needs 2x2 squares or more, and markers smaller than its squares")
    pose = row.get("world_from_board")
    return board, None if pose is None else rigid_pose(pose, "the board's pose")


def tracking_to_plain(tracking: TrackingErrors | None) -> dict[str, float] | None:
    """The entry "tracking"."""
    return None if tracking is None else dict(vars(tracking))


def tracking_from_plain(row: Any) -> TrackingErrors | None:
    """Inverse of `tracking_to_plain`; raises as `board_from_plain`."""
    if row is None:
        return None
    return TrackingErrors(*(float(row[field.name]) for field in fields(TrackingErrors)))


def truth_to_plain(truth: SequenceTruth | None) -> dict[str, Any] | None:
    """The entry "truth"."""
    if truth is None:
        return None
    return {
        "clock_offset_ns": truth.clock_offsets_ns,
        "bumps": [dict(vars(bump)) for bump in truth.bumps],
        "moved": [dict(vars(motion)) for motion in truth.motions],
    }


def truth_from_plain(row: Any, camera_ids: set[str], world_from_board: FloatArray | None) -> SequenceTruth | None:
    """Inverse of `truth_to_plain`; raises as `board_from_plain`."""
    if row is None:
        return None
    offsets = {str(name): int(offset) for name, offset in row["clock_offset_ns"].items()}
    bumps = tuple(Bump(str(b["camera_id"]), int(b["timestamp_ns"])) for b in row["bumps"])
    motions = tuple(ObjectMotion(int(m["obj_id"]), int(m["start_ns"]), int(m["end_ns"])) for m in row["moved"])
    unknown = ({bump.camera_id for bump in bumps} | offsets.keys()) - camera_ids
    if unknown:
        raise ValueError(f"the truth speaks of camera {', '.join(sorted(unknown))}, which the recording lacks")
    for motion in motions:
        if motion.end_ns < motion.start_ns:
            raise ValueError(f"the motion of object {motion.obj_id} ends before it starts")
    return SequenceTruth(offsets, bumps, motions, world_from_board)


def rigid_pose(rows: Any, what: str) -> FloatArray:
    """(4, 4) from nested lists.

    Raises:
        ValueError: they are no rigid transform.
    """
    matrix = np.array(rows, dtype=np.float64)
    if not _is_rigid(matrix):
        raise ValueError(f"{what} is no 4x4 rigid transform in metres")
    return matrix


def _is_rigid(matrix: FloatArray) -> bool:
    if matrix.shape != (4, 4) or not np.allclose(matrix[3], [0, 0, 0, 1]) or not np.all(np.isfinite(matrix)):
        return False
    rotation = matrix[:3, :3]
    return np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and bool(np.linalg.det(rotation) > 0)
