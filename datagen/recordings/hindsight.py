"""What each camera sees at each step, from the labels and pictures on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datagen.recordings.board import BOARD
from datagen.recordings.sight import Sight, View
from datagen.recordings.stage import Stage
from datagen.recordings.statics import BOARD_CORNERS
from multicam.dataset.bop_reader import read_image, read_scene
from multicam.errors import DataError
from multicam.evaluation.charuco import detect_corners
from multicam.geometry import se3
from multicam.types import FloatArray

_CORNER_ERROR = 1.0
"""Pixels by which corners of the board may be found away from their true places, in the median."""


def read_sight(folder: Path, stage: Stage) -> Sight:
    """What the cameras see, from the labels and pictures on disk.

    Raises:
        DataError: the board is not where it should be.
    """
    sight: Sight = {}
    for camera in stage.cameras:
        views: dict[int, View] = {}
        for image in read_scene(scene_folder(folder, camera.scene_id)):
            shot = stage.shot_of(camera, image.im_id)
            truth = np.stack([item.world_from_object for item in stage.scene.objects_in(shot)])
            world_from_camera = stage.scene.shots[shot].world_from_camera
            objects = {
                _closest(truth, world_from_camera @ instance.camera_from_object): instance.visible_fraction
                for instance in image.instances
                if instance.visible_fraction
            }
            assert image.rgb_path is not None
            views[image.im_id] = View(objects, _count_corners(stage, shot, image.rgb_path) if stage.board else 0)
        sight[camera.camera_id] = views
    return sight


def scene_folder(folder: Path, scene_id: int) -> Path:
    """The BOP scene of a camera."""
    return folder / "test" / f"{scene_id:06d}"


def _count_corners(stage: Stage, shot: int, picture: Path) -> int:
    assert stage.board is not None
    taken = stage.scene.shots[shot]
    ids, found = detect_corners(read_image(picture), BOARD)
    # One or two corners at the border may be off; a board that is elsewhere is off at all of them.
    if len(ids) >= BOARD_CORNERS:
        points = se3.act(se3.inverse(taken.world_from_camera), stage.board.corners[ids])
        off = float(np.median(np.linalg.norm(taken.camera.project(points) - found, axis=1)))
        if off > _CORNER_ERROR:
            raise DataError(f"{picture}: the corners of the board are {off:.1f} pixels away from where they should be.")
    return len(ids)


def _closest(truth: FloatArray, world_from_object: FloatArray) -> int:
    """Index of the object with this pose; other objects are millimetres away at least."""
    return int(np.argmin(np.abs(truth - world_from_object).max(axis=(1, 2))))
