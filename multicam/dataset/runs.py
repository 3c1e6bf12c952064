"""What a run found, step by step, and its file results.json.

    {"format": "multicam-run", "version": 3, "recording": folder, "network": file, "headset": camera_id,
     "complete": false after Ctrl-C, "steps": [{"timestamp_ns",
       "cameras": [{"camera_id", "status", "reason", "timestamp_ns", "world_from_camera", "covariance", "updated_ns",
                    "chain"}],
       "objects": [{"instance", "obj_id", "score", "world_from_object", "covariance", "seen_by"}],
       "world_from_tracking": the headset's drift,
       "seconds": {"network" and "pnp" where the network looked, "graph", "fit", "bundle" and "follow" where asked for},
       "adjustment": null or {"cameras", "objects": as they were without it, "energy": [before, after],
                              "kept": {camera_id or "object INSTANCE": why it was not adjusted}}}]}

The world is the frame of the headset's tracking when it began; `world_from_tracking` is how far tracking has drifted
from it since, so that inverse(world_from_tracking) world_from_camera is a camera in the frame that the headset reports
now. Poses are 4x4 in metres, covariances 6x6 of the right perturbation [rotation rad; translation m], relative to the
headset at the step (to its last keyframe where it has no pose); null where unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cattrs
import numpy as np

from multicam.dataset.sequence import CameraEntry, FrameEntry, Recording
from multicam.errors import DataError
from multicam.files import read_json, write_json
from multicam.types import FloatArray

FORMAT = "multicam-run"
VERSION = 3

Status = Literal["tracked", "placed", "kept", "not placed"]
"""By its own tracking; measured at this step; from an earlier step; no pose."""


@dataclass(frozen=True, eq=False)
class CameraResult:
    """A camera at one step.

    Attributes:
        reason: why it was not measured at this step, in words; empty for tracked and placed cameras.
        timestamp_ns: time of its picture in this step, or None if it gave none.
        world_from_camera, covariance: (4, 4) and (6, 6) at this step, or None.
        updated_ns: when what the camera saw last confirmed its pose, or None.
        chain: cameras by which it hangs together with the headset, each sharing objects with the next.
    """

    camera_id: str
    status: Status
    reason: str
    timestamp_ns: int | None
    world_from_camera: FloatArray | None
    covariance: FloatArray | None
    updated_ns: int | None
    chain: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ObjectResult:
    """A known object at one step; `seen_by` names the cameras that agree with its pose at this step."""

    instance: int
    obj_id: int
    score: float
    world_from_object: FloatArray
    covariance: FloatArray
    seen_by: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class AdjustmentResult:
    """What bundle adjustment did to a step.

    Attributes:
        cameras, objects: the step's results by detections alone.
        energy: before and after, of those that were adjusted.
        kept: why a camera, or an object ("object 3" by its instance), was not adjusted.
    """

    cameras: tuple[CameraResult, ...]
    objects: tuple[ObjectResult, ...]
    energy: tuple[float, float]
    kept: dict[str, str]


@dataclass(frozen=True, eq=False)
class StepResult:
    """All cameras and objects at one step; `seconds` splits the time it took by stage.

    Attributes:
        world_from_tracking: (4, 4) drift of the headset's tracking, or None where it gave no pose.
        adjustment: what the pictures changed, or None at steps that were not adjusted.
    """

    timestamp_ns: int
    cameras: tuple[CameraResult, ...]
    objects: tuple[ObjectResult, ...]
    world_from_tracking: FloatArray | None
    seconds: dict[str, float]
    adjustment: AdjustmentResult | None = None

    def camera(self, camera_id: str) -> CameraResult:
        """The result of one camera.

        Raises:
            KeyError: no such camera.
        """
        return {camera.camera_id: camera for camera in self.cameras}[camera_id]

    @property
    def unadjusted(self) -> StepResult:
        """The step as it would be without bundle adjustment at this very step."""
        if self.adjustment is None:
            return self
        return replace(self, cameras=self.adjustment.cameras, objects=self.adjustment.objects, adjustment=None)

    def with_seconds(self, **seconds: float) -> StepResult:
        """The same result with the times of further stages in front."""
        return replace(self, seconds={**seconds, **self.seconds})


@dataclass(frozen=True, eq=False)
class RunResult:
    """A whole run of one step or more; `complete` is false if it was interrupted."""

    recording: Path
    network: Path
    headset: str
    complete: bool
    steps: tuple[StepResult, ...]

    @property
    def statics(self) -> tuple[str, ...]:
        """Names of the static cameras, in the order of the results."""
        return tuple(c.camera_id for c in self.steps[0].cameras if c.camera_id != self.headset)


class FrameIndex:
    """The pictures of a recording by camera and time stamp, by which results.json names them."""

    def __init__(self, recording: Recording) -> None:
        self._entries = {(c.camera_id, e.timestamp_ns): (c, e) for c in recording.cameras for e in c.frames}
        self._folder = recording.folder

    def find(self, camera_id: str, timestamp_ns: int) -> tuple[CameraEntry, FrameEntry]:
        """The camera and its picture at a time.

        Raises:
            DataError: the recording has none; the run was made on another one.
        """
        if (camera_id, timestamp_ns) not in self._entries:
            raise DataError(
                f"{self._folder} has no picture of camera {camera_id} at {timestamp_ns} ns: "
                "was the run made on another recording?"
            )
        return self._entries[camera_id, timestamp_ns]


def write_run(path: Path, run: RunResult) -> None:
    """Writes results.json, atomically."""
    write_json(path, {"format": FORMAT, "version": VERSION, **_converter().unstructure(run)})


def read_run(path: Path) -> RunResult:
    """Reads results.json.

    Raises:
        DataError: the file is missing, malformed or of another kind.
    """
    content = read_json(path)
    if (
        not isinstance(content, dict)
        or content.pop("format", None) != FORMAT
        or content.pop("version", None) != VERSION
    ):
        raise DataError(f'{path} is not the result of a run: it must hold "format": "{FORMAT}", "version": {VERSION}.')
    try:
        run = _converter().structure(content, RunResult)
    except cattrs.BaseValidationError as error:
        first = cattrs.transform_error(error, path="run", format_exception=lambda exception, _: str(exception))[0]
        raise DataError(f"{path} does not follow the run format: {first.replace(' @ ', ' at ')}.") from error
    if not run.steps:
        raise DataError(f"{path} holds no steps; run again.")
    return run


def _converter() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)
    converter.register_structure_hook_func(_is_array, lambda value, _: _to_pose(value))
    converter.register_unstructure_hook_func(_is_array, lambda value: None if value is None else value.tolist())
    converter.register_structure_hook(Path, lambda value, _: Path(value))
    converter.register_unstructure_hook(Path, str)
    return converter


def _is_array(kind: Any) -> bool:
    return kind in (np.ndarray, FloatArray, FloatArray | None)


def _to_pose(value: Any) -> FloatArray | None:
    if value is None:
        return None
    array = np.array(value, dtype=np.float64)
    if array.shape not in ((4, 4), (6, 6)) or not np.all(np.isfinite(array)):
        raise ValueError(f"expected a finite 4x4 or 6x6 matrix, got one of shape {array.shape}")
    return array
