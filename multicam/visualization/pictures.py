"""Overlays of a whole run, written as files step by step."""

from __future__ import annotations

import base64
import functools
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from multicam.dataset.results import Estimates
from multicam.dataset.runs import CameraResult, FrameIndex, RunResult, StepResult
from multicam.dataset.sequence import Recording
from multicam.files import write_bytes
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.progress import Progress
from multicam.types import ImageArray, ObjectEstimate
from multicam.visualization.overlay import GREY, WHITE, Color, Outline, color_of, draw_outlines

JPEG_QUALITY = 88


def overlay_path(folder: Path, camera_id: str, step: int) -> Path:
    """Where the overlay of a camera at a step (counted from 0) lies within a run's folder."""
    return folder / "overlays" / camera_id / f"{step:06d}.jpg"


def clear_overlays(folder: Path) -> None:
    """Removes the overlays of an earlier run."""
    shutil.rmtree(folder / "overlays", ignore_errors=True)


def write_overlays(
    folder: Path, run: RunResult, recording: Recording, estimates: Estimates, progress: Progress
) -> None:
    """Draws every picture of a run with outlines, one at a time, and writes it into the run's folder if not there yet.

    A camera with a pose shows the objects of the scene graph, and in white where they were before bundle adjustment of
    the step; one without a pose shows its own estimates in grey.

    Raises:
        DataError: a picture or mesh cannot be read, or the run belongs to another recording.
    """
    index = FrameIndex(recording)
    mesh_of = functools.cache(lambda obj_id: recording.catalogue[obj_id].load_mesh())
    for number, step in enumerate(progress.track(run.steps, "drawing", len(run.steps))):
        for result in step.cameras:
            path = overlay_path(folder, result.camera_id, number)
            if result.timestamp_ns is None or path.is_file():
                continue
            camera, entry = index.find(result.camera_id, result.timestamp_ns)
            frame = recording.load_frame(camera, entry)
            own = estimates.get((camera.scene_id, entry.im_id), [])
            outlines = _outlines(step, result, own, mesh_of)
            image = draw_outlines(frame.image, frame.camera, outlines)
            write_bytes(path, encode_jpeg(image))


def encode_jpeg(image: ImageArray) -> bytes:
    """JPEG data of an (h, w, 3) RGB picture."""
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(image[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise OSError("OpenCV could not encode a JPEG")
    return data.tobytes()


def data_uri(data: bytes, kind: str) -> str:
    """Image data to stand inside a page; `kind` is jpeg, png or svg+xml."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _outlines(
    step: StepResult, result: CameraResult, own: Sequence[ObjectEstimate], mesh_of: Callable[[int], Mesh]
) -> list[Outline]:
    if result.world_from_camera is None:
        return [Outline(mesh_of(e.obj_id), e.camera_from_object, GREY) for e in own]
    before = [] if step.adjustment is None else _graph_outlines(step.unadjusted, result.camera_id, mesh_of, WHITE)
    return before + _graph_outlines(step, result.camera_id, mesh_of)


def _graph_outlines(
    step: StepResult, camera_id: str, mesh_of: Callable[[int], Mesh], color: Color | None = None
) -> list[Outline]:
    """Objects of the scene graph as a camera with a pose should see them; in a thin line of one colour if given."""
    world_from_camera = step.camera(camera_id).world_from_camera
    if world_from_camera is None:
        return []
    camera_from_world = se3.inverse(world_from_camera)
    return [
        Outline(
            mesh_of(o.obj_id),
            camera_from_world @ o.world_from_object,
            color or color_of(o.obj_id),
            bold=color is None and camera_id in o.seen_by,
        )
        for o in step.objects
    ]
