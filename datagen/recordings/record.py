"""Renders a recording and proves from its labels that the cameras see what they should."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from datagen.pictures.generate import label
from datagen.pictures.output import claim, copy_models
from datagen.pictures.renderer import BlenderRenderer
from datagen.recordings.config import SequenceConfig
from datagen.recordings.stage import HEADSET, LEFT, RIGHT, Stage, sample_stage
from datagen.scenes.stock import Stock, load_stock
from multicam.dataset.bop_reader import read_scene
from multicam.dataset.bop_writer import SceneWriter
from multicam.dataset.sequence import CameraEntry, write_sequence
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.progress import Progress, SilentProgress
from multicam.types import FloatArray

_log = logging.getLogger(__name__)

Sight = dict[str, list[dict[int, float]]]
"""Camera to, per step, the objects in sight: index in the scene to visible fraction."""
_WELL_SEEN = 0.3
"""Visible fraction from which an object counts as shared."""
_SHARED = 2
"""Objects that the headset must share with a static camera at the best moment."""


def record(config: SequenceConfig, progress: Progress | None = None) -> None:
    """Renders the recording of a configuration, or what is missing of it; sequence.json completes it.

    Raises:
        DataError: the folder holds another recording, labels disagree with the render, or the cameras do not see
            what the recording promises.
        MissingDependencyError: Blender cannot start.
    """
    stock = load_stock(config.models)
    claim(config.output / "config.yaml", config, free=("models", "output"))
    copy_models(config.models, config.output / "models")
    stage = sample_stage(config, stock)
    plan = [(camera, _missing(config.output, camera)) for camera in stage.cameras]
    total = sum(len(missing) for _, missing in plan)
    _log.info("%d of %d pictures are to be rendered into %s", total, len(stage.scene.shots), config.output)
    if total:
        pictures = _render(config, stock, stage, plan)
        for _ in (progress or SilentProgress()).track(pictures, "recording", total):
            pass
    verify_sight(read_sight(config.output, stage), stage)
    write_sequence(config.output, stage.cameras)


def read_sight(folder: Path, stage: Stage) -> Sight:
    """What each camera sees at each step, from the labels on disk."""
    truth = np.stack([item.world_from_object for item in stage.scene.objects])
    sight: Sight = {}
    for camera in stage.cameras:
        steps: list[dict[int, float]] = []
        for image in read_scene(_scene_folder(folder, camera)):
            assert image.camera_from_world is not None
            world_from_camera = se3.inverse(image.camera_from_world)
            steps.append(
                {
                    _closest(truth, world_from_camera @ instance.camera_from_object): instance.visible_fraction
                    for instance in image.instances
                    if instance.visible_fraction
                }
            )
        sight[camera.camera_id] = steps
    return sight


def verify_sight(sight: Sight, stage: Stage) -> None:
    """The static cameras never share an object; the headset shares some with each, at some times and not at all times.

    Raises:
        DataError: the first promise that is broken.
    """
    name = stage.scene.name
    for step, (left, right) in enumerate(zip(sight[LEFT], sight[RIGHT], strict=True)):
        common = sorted(left.keys() & right.keys())
        if common:
            classes = ", ".join(str(stage.scene.objects[index].obj_id) for index in common)
            raise DataError(
                f"{name}: the static cameras both see objects of class {classes} at step {step}; "
                "raise spacing or focal, or take another seed."
            )
    for static in (LEFT, RIGHT):
        shared = [
            sum(min(head[i], other[i]) > _WELL_SEEN for i in head.keys() & other.keys())
            for head, other in zip(sight[HEADSET], sight[static], strict=True)
        ]
        if max(shared) < _SHARED:
            raise DataError(
                f"{name}: the headset shares at most {max(shared)} objects with camera {static} at any time, "
                f"{_SHARED} are needed; raise distance, lower focal, or take another seed."
            )
        if min(shared) >= _SHARED:
            raise DataError(
                f"{name}: the headset shares objects with camera {static} all the time; raise spacing or focal."
            )


def _closest(truth: FloatArray, world_from_object: FloatArray) -> int:
    """Index of the object with this pose; other objects are millimetres away at least."""
    return int(np.argmin(np.abs(truth - world_from_object).max(axis=(1, 2))))


def _missing(folder: Path, camera: CameraEntry) -> list[int]:
    done = SceneWriter(_scene_folder(folder, camera)).completed
    return [entry.im_id for entry in camera.frames if entry.im_id not in done]


def _scene_folder(folder: Path, camera: CameraEntry) -> Path:
    return folder / "test" / f"{camera.scene_id:06d}"


def _render(
    config: SequenceConfig, stock: Stock, stage: Stage, plan: list[tuple[CameraEntry, list[int]]]
) -> Iterator[None]:
    """Yields after every picture that is safely on disk.

    The world stands still, so a static camera is rendered once; its pictures differ by their sensor noise.
    """
    with BlenderRenderer(config.models, config.samples) as renderer:
        for camera, missing in plan:
            writer = SceneWriter(_scene_folder(config.output, camera))
            first = camera.scene_id * config.steps
            shots = [first + im_id for im_id in missing]
            rendered = renderer.render(stage.scene, shots if camera.moving else [first] * bool(shots))
            passes = None
            for im_id, shot in zip(missing, shots, strict=True):
                passes = next(rendered) if camera.moving or passes is None else passes
                writer.add(im_id, label(stage.scene, shot, passes, stock))
                yield
