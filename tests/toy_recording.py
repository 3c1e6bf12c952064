"""The toy walk as a recording on disk, drawn with flat shading; and an estimator that knows the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from multicam.dataset.bop_writer import InstanceLabels, LabelledImage, SceneWriter, write_models
from multicam.dataset.results import Estimates
from multicam.dataset.runs import CameraResult, ObjectResult, RunResult, Status, StepResult
from multicam.dataset.sequence import CameraEntry, FrameEntry, Recording, load_recording, write_sequence
from multicam.geometry import se3
from multicam.geometry.rasterizer import render_depth
from multicam.inference.estimator import FrameEstimates
from multicam.types import Frame, ImageArray, ObjectEstimate
from tests.toy_objects import toy_meshes
from tests.toy_walk import HEADSET, ToyWalk, make_walk
from tests.toy_world import ToyCamera, ToyWorld

MESHES = toy_meshes()

SURE = np.diag(np.repeat((1e-3, 1e-3), 3) ** 2)


def write_toy_recording(
    folder: Path, walk: ToyWalk | None = None, scale: float = 0.25, marked: bool = False
) -> Recording:
    """Writes models, one scene per camera and sequence.json; by default a slow walk of six steps.

    With `marked`, a grey square in the middle of each picture tells a toy network which one it is: see `mark_of`.
    """
    walk = walk or make_walk(np.random.default_rng(0), num_steps=6, step_ns=2_000_000_000)
    write_models(folder / "models", walk.steps[0].world.catalogue, MESHES)
    entries: list[CameraEntry] = []
    for scene_id, name in enumerate(c.camera_id for c in walk.steps[0].world.cameras):
        writer = SceneWriter(folder / "test" / f"{scene_id:06d}")
        frames: list[FrameEntry] = []
        for im_id, step in enumerate(walk.steps):
            camera = next(c for c in step.world.cameras if c.camera_id == name)
            picture = _picture(step.world, camera, scale)
            if marked:
                height, width = picture.image.shape[0] // 2, picture.image.shape[1] // 2
                picture.image[height - 16 : height + 16, width - 16 : width + 16] = mark_of(scene_id, im_id)
            writer.add(im_id, picture)
            tracked = step.tracked_world_from_headset if name == HEADSET else None
            frames.append(FrameEntry(im_id, step.timestamp_ns, tracked))
        entries.append(CameraEntry(name, scene_id, name == HEADSET, tuple(frames)))
    write_sequence(folder, tuple(entries))
    return load_recording(folder)


def mark_of(scene_id: int, im_id: int) -> int:
    """Grey value of a picture's mark; values differ by 12, so that JPEG's rounding does no harm."""
    return 12 * (6 * scene_id + im_id) + 6


def truthful_estimator(
    recording: Recording, rng: np.random.Generator, noise: float = 0.0
) -> Callable[[Sequence[Frame]], tuple[list[FrameEstimates], dict[str, float]]]:
    """Stands in for the network: labelled poses moved by `noise` (m per axis, and 2 rad per m), with covariance."""
    images = {(c.camera_id, e.timestamp_ns): e.im_id for c in recording.cameras for e in c.frames}
    spread = np.repeat((2 * max(noise, 5e-4), max(noise, 5e-4)), 3)

    def estimate(frames: Sequence[Frame]) -> tuple[list[FrameEstimates], dict[str, float]]:
        found: list[FrameEstimates] = []
        for frame in frames:
            record = recording.record(frame.camera_id, images[frame.camera_id, frame.timestamp_ns])
            poses = [
                (i.obj_id, se3.plus(i.camera_from_object, (noise > 0) * spread * rng.normal(size=6)))
                for i in record.instances
            ]
            estimates = tuple(ObjectEstimate(i, 0.9, pose, np.diag(spread**2)) for i, pose in poses)
            found.append(FrameEstimates(estimates, ()))
        return found, {"network": 0.02, "pnp": 0.001}

    return estimate


def truth_as_estimates(recording: Recording) -> Estimates:
    """The labels of all pictures in the place of a network's answers."""
    return {
        (record.scene_id, record.im_id): [
            ObjectEstimate(i.obj_id, 0.5, i.camera_from_object) for i in record.instances
        ]
        for camera in recording.cameras
        for record in (recording.record(camera.camera_id, e.im_id) for e in camera.frames)
    }  # fmt: skip


def truthful_run(recording: Recording, placed_from: int = 0) -> RunResult:
    """The result a perfect run would have; static cameras are placed at step `placed_from` and kept from then on."""
    headset = next(c for c in recording.cameras if c.moving)
    statics = [c for c in recording.cameras if not c.moving]
    steps: list[StepResult] = []
    for number, entry in enumerate(headset.frames):
        now = entry.timestamp_ns
        cameras = [_result(recording, headset, number, "tracked", now)]
        for camera in statics:
            since = headset.frames[placed_from].timestamp_ns if number >= placed_from else None
            status: Status = "placed" if number == placed_from else "kept" if number > placed_from else "not placed"
            cameras.append(_result(recording, camera, number, status, since))
        objects: list[ObjectResult] = []
        for camera in recording.cameras:
            record = recording.record(camera.camera_id, camera.frames[number].im_id)
            world_from_camera = recording.truth_of(camera.camera_id, record.im_id)
            for instance in record.instances if camera in statics else ():
                pose = world_from_camera @ instance.camera_from_object
                objects.append(ObjectResult(len(objects), instance.obj_id, 0.9, pose, SURE, (camera.camera_id,)))
        seconds = {"network": 0.02, "pnp": 0.001, "graph": 0.005}
        steps.append(StepResult(now, tuple(cameras), tuple(objects), np.eye(4), seconds))
    return RunResult(recording.folder, recording.folder / "no.onnx", headset.camera_id, True, tuple(steps))


def _result(
    recording: Recording, camera: CameraEntry, number: int, status: Status, updated_ns: int | None
) -> CameraResult:
    entry, name = camera.frames[number], camera.camera_id
    if status == "not placed":
        return CameraResult(name, status, "nothing in common", entry.timestamp_ns, None, None, None, ())
    pose = recording.truth_of(name, entry.im_id)
    reason = "nothing in common" if status == "kept" else ""
    return CameraResult(name, status, reason, entry.timestamp_ns, pose, SURE, updated_ns, ("headset", name))


def _picture(world: ToyWorld, toy_camera: ToyCamera, scale: float) -> LabelledImage:
    camera = toy_camera.camera.scaled(scale)
    camera_from_world = se3.inverse(toy_camera.world_from_camera)
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    image: ImageArray = np.full((camera.height, camera.width, 3), 90, dtype=np.uint8)
    alone = [render_depth(MESHES[o.obj_id], camera, camera_from_world @ o.world_from_object) for o in world.objects]
    owner = np.full(depth.shape, -1)
    for index, own in enumerate(alone):
        nearer = (own > 0) & (own < depth)
        depth[nearer], owner[nearer] = own[nearer], index
        image[nearer] = 120 + 20 * world.objects[index].obj_id
    labels: list[InstanceLabels] = []
    for index in toy_camera.visible:
        item, mask = world.objects[index], alone[index] > 0
        if mask.any():
            pose = camera_from_world @ item.world_from_object
            labels.append(_labels(item.obj_id, pose, mask, owner == index, replace(toy_camera, camera=camera), world))
    return LabelledImage(camera, camera_from_world, image, np.where(np.isinf(depth), 0, depth), tuple(labels))


def _labels(
    obj_id: int, pose: np.ndarray, mask: np.ndarray, visible: np.ndarray, camera: ToyCamera, world: ToyWorld
) -> InstanceLabels:
    model = world.catalogue[obj_id]
    assert model.keypoints is not None
    corners = camera.camera.project(se3.act(pose, model.box_corners()))
    return InstanceLabels(
        obj_id, pose, np.concatenate((corners.min(0), corners.max(0))), mask, visible,
        float(visible.sum() / mask.sum()), int(mask.sum()),
        camera.camera.project(se3.act(pose, model.keypoints)), np.ones(len(model.keypoints), dtype=np.bool_),
    )  # fmt: skip
