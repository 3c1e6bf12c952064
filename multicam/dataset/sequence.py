"""Recordings of several cameras: one BOP scene per camera plus `sequence.json` with times and tracking.

    RECORDING/
      models/                    BOP models folder
      sequence.json              cameras, time stamps, tracked poses, events
      test/000000/ 000001/ ...   one BOP scene per camera, all in one world

sequence.json, lengths in metres, angles in radians, poses 4x4:

    {"format": "multicam-sequence", "version": 2,
     "cameras": [{"camera_id", "scene_id", "kind": "headset" or "static", "rate_hz": pictures a second or null,
                  "frames": [{"im_id", "timestamp_ns", "tracked_world_from_camera": pose or null}]}],
     "board": null or {"columns", "rows", "square", "marker", "dictionary", "world_from_board": true pose or null},
     "tracking": null or {"rotation_bias", "translation_bias", "rotation_walk", "translation_walk"},
     "truth": null or {"clock_offset_ns": {camera_id: stamp minus true time},
                       "bumps": [{"camera_id", "timestamp_ns"}], "moved": [{"obj_id", "start_ns", "end_ns"}]}}

A frame that the camera lost is not listed. A tracked pose is what the headset reports (it drifts). A pipeline may use
cameras, board and tracking; the rest is for evaluation: true poses of cameras and objects stand in the BOP scenes and
are read by `truth_of` and `record`, and "truth" and "world_from_board" by `Recording.truth`. Version 1, still read, has
"moving": true or false for "kind", and neither a rate nor the last three entries.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from multicam.dataset.bop_reader import ImageRecord, read_depth, read_image, read_scene
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.dataset.sequence_facts import (
    Board,
    SequenceTruth,
    TrackingErrors,
    board_from_plain,
    board_to_plain,
    rigid_pose,
    tracking_from_plain,
    tracking_to_plain,
    truth_from_plain,
    truth_to_plain,
)
from multicam.errors import DataError, describe
from multicam.files import read_json, write_json
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray, Frame, FrameSet

FORMAT = "multicam-sequence"
VERSION = 2
_KINDS = {"headset": True, "static": False}
"""Kind of camera in the file, and whether it moves."""


@dataclass(frozen=True, eq=False)
class FrameEntry:
    """Time and tracking of one picture; the picture itself stands in the camera's BOP scene."""

    im_id: int
    timestamp_ns: int
    tracked_world_from_camera: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class CameraEntry:
    """One camera of a recording; frames in order of time.

    Attributes:
        moving: a headset, tracked by itself; the others are static, though one may be bumped.
        rate_hz: pictures a second when none is lost, or None where the recording does not say.
    """

    camera_id: str
    scene_id: int
    moving: bool
    frames: tuple[FrameEntry, ...]
    rate_hz: float | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording on disk.

    Attributes:
        board: the ChArUco board in view, or None.
        tracking: size of the errors of the headset's tracking, or None where not stated.
        truth: clocks, events and the board's pose, for evaluation only, or None where not stated.
    """

    folder: Path
    catalogue: Catalogue
    cameras: tuple[CameraEntry, ...]
    board: Board | None
    tracking: TrackingErrors | None
    truth: SequenceTruth | None
    _records: dict[str, dict[int, ImageRecord]]

    def record(self, camera_id: str, im_id: int) -> ImageRecord:
        """The BOP record of a picture, ground truth included: for evaluation only."""
        return self._records[camera_id][im_id]

    @property
    def measures_depth(self) -> bool:
        """Whether any picture comes with depth."""
        return any(
            self.record(camera.camera_id, entry.im_id).depth_path is not None
            for camera in self.cameras
            for entry in camera.frames
        )

    def truth_of(self, camera_id: str, im_id: int) -> FloatArray:
        """True world_from_camera (4, 4) of a picture.

        Raises:
            DataError: the recording carries no true poses.
        """
        pose = self.record(camera_id, im_id).camera_from_world
        if pose is None:
            raise DataError(f"{self.folder} has no true poses (cam_R_w2c) for camera {camera_id}.")
        return se3.inverse(pose)

    def load_frame(self, camera: CameraEntry, entry: FrameEntry) -> Frame:
        """Reads the pixels of one picture.

        Raises:
            DataError: image missing or truncated, intrinsics missing.
        """
        record = self.record(camera.camera_id, entry.im_id)
        if record.rgb_path is None or record.camera_matrix is None:
            raise DataError(
                f"{self.folder}: camera {camera.camera_id}, image {entry.im_id} lacks its picture or its cam_K."
            )
        image = read_image(record.rgb_path)
        intrinsics = Camera(record.camera_matrix, image.shape[1], image.shape[0])
        depth = read_depth(record.depth_path, record.depth_scale) if record.depth_path else None
        return Frame(camera.camera_id, entry.timestamp_ns, image, intrinsics, entry.tracked_world_from_camera, depth)

    def frame_sets(self, tolerance_ns: int = 20_000_000) -> Iterator[FrameSet]:
        """Groups frames by time, oldest first: each set spans at most the tolerance and has each camera once."""
        for group in group_by_time(self.cameras, tolerance_ns):
            frames = tuple(self.load_frame(camera, entry) for camera, entry in group)
            yield FrameSet(min(f.timestamp_ns for f in frames), frames)


def group_by_time(cameras: tuple[CameraEntry, ...], tolerance_ns: int) -> list[list[tuple[CameraEntry, FrameEntry]]]:
    """Cuts the frames of all cameras, sorted by time, into sets that span at most the tolerance."""
    entries = sorted(
        ((camera, entry) for camera in cameras for entry in camera.frames),
        key=lambda pair: pair[1].timestamp_ns,
    )
    groups: list[list[tuple[CameraEntry, FrameEntry]]] = []
    for camera, entry in entries:
        current = groups[-1] if groups else []
        fits = bool(current) and entry.timestamp_ns - current[0][1].timestamp_ns <= tolerance_ns
        if fits and all(other.camera_id != camera.camera_id for other, _ in current):
            current.append((camera, entry))
        else:
            groups.append([(camera, entry)])
    return groups


def load_recording(folder: Path) -> Recording:
    """Reads a recording's JSON files; pixels are read frame by frame later.

    Raises:
        DataError: a file is missing or malformed, or sequence.json names pictures that do not exist.
    """
    path = folder / "sequence.json"
    content = read_json(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") not in (1, VERSION):  # pyright: ignore[reportUnknownMemberType]
        raise DataError(f'{path} is not a recording: it must hold "format": "{FORMAT}" and "version": 1 or {VERSION}.')
    version: int = content["version"]  # pyright: ignore[reportUnknownVariableType]
    try:
        cameras = tuple(_read_camera(row, version) for row in content["cameras"])  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        _check_names(cameras, path)
        board, world_from_board = board_from_plain(content["board"] if version > 1 else None)
        tracking = tracking_from_plain(content["tracking"] if version > 1 else None)
        camera_ids = {camera.camera_id for camera in cameras}
        truth = truth_from_plain(content["truth"] if version > 1 else None, camera_ids, world_from_board)
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise DataError(f"{path} does not follow the recording format: {describe(error)}.") from error
    records: dict[str, dict[int, ImageRecord]] = {}
    for camera in cameras:
        scene = {r.im_id: r for r in read_scene(folder / "test" / f"{camera.scene_id:06d}")}
        missing = [e.im_id for e in camera.frames if e.im_id not in scene]
        if missing:
            raise DataError(f"{path}: camera {camera.camera_id} names images {missing[:5]} that its scene lacks.")
        records[camera.camera_id] = scene
    return Recording(folder, load_catalogue(folder / "models"), cameras, board, tracking, truth, records)


def write_sequence(
    folder: Path,
    cameras: tuple[CameraEntry, ...],
    board: Board | None = None,
    tracking: TrackingErrors | None = None,
    truth: SequenceTruth | None = None,
) -> None:
    """Writes sequence.json, atomically; the BOP scenes and models are written by `bop_writer`."""
    rows = [
        {
            "camera_id": camera.camera_id,
            "scene_id": camera.scene_id,
            "kind": next(kind for kind, moving in _KINDS.items() if moving == camera.moving),
            "rate_hz": camera.rate_hz,
            "frames": [
                {
                    "im_id": e.im_id,
                    "timestamp_ns": e.timestamp_ns,
                    "tracked_world_from_camera": None
                    if e.tracked_world_from_camera is None
                    else e.tracked_world_from_camera.tolist(),
                }
                for e in camera.frames
            ],
        }
        for camera in cameras
    ]
    content = {
        "format": FORMAT,
        "version": VERSION,
        "cameras": rows,
        "board": board_to_plain(board, truth),
        "tracking": tracking_to_plain(tracking),
        "truth": truth_to_plain(truth),
    }
    write_json(folder / "sequence.json", content, indent=1)


def _check_names(cameras: tuple[CameraEntry, ...], path: Path) -> None:
    if not cameras:
        raise DataError(f"{path} names no camera.")
    names = [camera.camera_id for camera in cameras]
    if len(set(names)) != len(names):
        raise DataError(f"{path} names a camera twice: {', '.join(names)}.")


def _read_camera(row: dict[str, Any], version: int) -> CameraEntry:
    frames: list[FrameEntry] = []
    for frame in row["frames"]:
        im_id, timestamp_ns = int(frame["im_id"]), int(frame["timestamp_ns"])
        pose = frame.get("tracked_world_from_camera")
        matrix = None if pose is None else rigid_pose(pose, f"the tracked pose of image {im_id}")
        frames.append(FrameEntry(im_id, timestamp_ns, matrix))
    frames.sort(key=lambda entry: entry.timestamp_ns)
    camera_id, scene_id = str(row["camera_id"]), int(row["scene_id"])
    if version == 1:
        if not isinstance(row["moving"], bool):
            raise ValueError(f'"moving" of camera {camera_id} is {row["moving"]!r}, not true or false')
        return CameraEntry(camera_id, scene_id, row["moving"], tuple(frames))
    if row["kind"] not in _KINDS:
        raise ValueError(f'"kind" of camera {camera_id} is {row["kind"]!r}, not {" or ".join(_KINDS)}')
    rate = None if row["rate_hz"] is None else float(row["rate_hz"])
    if rate is not None and not rate > 0:
        raise ValueError(f'"rate_hz" of camera {camera_id} is {rate:g}; it must be more than 0')
    return CameraEntry(camera_id, scene_id, _KINDS[row["kind"]], tuple(frames), rate)
