"""Recordings of several cameras: one BOP scene per camera plus `sequence.json` with times and tracking.

    RECORDING/
      models/                    BOP models folder
      sequence.json              cameras, time stamps, tracked poses
      test/000000/ 000001/ ...   one BOP scene per camera, all in one world

sequence.json: {"format": "multicam-sequence", "version": 1, "cameras": [{"camera_id", "scene_id", "moving": bool,
"frames": [{"im_id", "timestamp_ns", "tracked_world_from_camera": 4x4 metres or null}]}]}. The tracked pose is what a
headset reports (it drifts); the truth stays in scene_camera.json and is read by `truth_of` only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multicam.dataset.bop_reader import ImageRecord, read_depth, read_image, read_scene
from multicam.dataset.objects import Catalogue, load_catalogue
from multicam.errors import DataError, describe
from multicam.files import read_json, write_json
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray, Frame, FrameSet

FORMAT = "multicam-sequence"
VERSION = 1


@dataclass(frozen=True, eq=False)
class FrameEntry:
    """Time and tracking of one picture; the picture itself stands in the camera's BOP scene."""

    im_id: int
    timestamp_ns: int
    tracked_world_from_camera: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class CameraEntry:
    """One camera of a recording; frames in order of time. A moving camera is tracked, the others stand still."""

    camera_id: str
    scene_id: int
    moving: bool
    frames: tuple[FrameEntry, ...]


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording on disk."""

    folder: Path
    catalogue: Catalogue
    cameras: tuple[CameraEntry, ...]
    _records: dict[str, dict[int, ImageRecord]]

    def record(self, camera_id: str, im_id: int) -> ImageRecord:
        """The BOP record of a picture, ground truth included: for evaluation only."""
        return self._records[camera_id][im_id]

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
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:  # pyright: ignore[reportUnknownMemberType]
        raise DataError(f'{path} is not a recording: it must hold "format": "{FORMAT}" and "version": {VERSION}.')
    try:
        cameras = tuple(_read_camera(row) for row in content["cameras"])  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    except (KeyError, ValueError, TypeError) as error:
        raise DataError(f"{path} does not follow the recording format: {describe(error)}.") from error
    if not cameras:
        raise DataError(f"{path} names no camera.")
    names = [camera.camera_id for camera in cameras]
    if len(set(names)) != len(names):
        raise DataError(f"{path} names a camera twice: {', '.join(names)}.")
    records: dict[str, dict[int, ImageRecord]] = {}
    for camera in cameras:
        scene = {r.im_id: r for r in read_scene(folder / "test" / f"{camera.scene_id:06d}")}
        missing = [e.im_id for e in camera.frames if e.im_id not in scene]
        if missing:
            raise DataError(f"{path}: camera {camera.camera_id} names images {missing[:5]} that its scene lacks.")
        records[camera.camera_id] = scene
    return Recording(folder, load_catalogue(folder / "models"), cameras, records)


def write_sequence(folder: Path, cameras: tuple[CameraEntry, ...]) -> None:
    """Writes sequence.json, atomically; the BOP scenes and models are written by `bop_writer`."""
    rows = [
        {
            "camera_id": camera.camera_id,
            "scene_id": camera.scene_id,
            "moving": camera.moving,
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
    write_json(folder / "sequence.json", {"format": FORMAT, "version": VERSION, "cameras": rows}, indent=1)


def _read_camera(row: dict[str, Any]) -> CameraEntry:
    frames: list[FrameEntry] = []
    for frame in row["frames"]:
        im_id, timestamp_ns = int(frame["im_id"]), int(frame["timestamp_ns"])
        pose = frame.get("tracked_world_from_camera")
        matrix = None if pose is None else np.array(pose, dtype=np.float64)
        if matrix is not None and not _is_rigid(matrix):
            raise ValueError(f"the tracked pose of image {im_id} is no 4x4 rigid transform in metres")
        frames.append(FrameEntry(im_id, timestamp_ns, matrix))
    frames.sort(key=lambda entry: entry.timestamp_ns)
    if not isinstance(row["moving"], bool):
        raise ValueError(f'"moving" of camera {row["camera_id"]} is {row["moving"]!r}, not true or false')
    return CameraEntry(str(row["camera_id"]), int(row["scene_id"]), row["moving"], tuple(frames))


def _is_rigid(matrix: FloatArray) -> bool:
    if matrix.shape != (4, 4) or not np.allclose(matrix[3], [0, 0, 0, 1]) or not np.all(np.isfinite(matrix)):
        return False
    rotation = matrix[:3, :3]
    return np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and bool(np.linalg.det(rotation) > 0)
