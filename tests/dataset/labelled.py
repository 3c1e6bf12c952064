"""Labelled pictures of the toy world, for writing and reading back."""

from __future__ import annotations

import numpy as np

from multicam.dataset.bop_writer import InstanceLabels, LabelledImage
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from tests.pictures import noise_image
from tests.strategies import Array

CAMERA = Camera(np.array([[61.25, 0, 31.5], [0, 60.5, 23.25], [0, 0, 1]]), 64, 48)


def labelled_image(
    rng: np.random.Generator, obj_ids: tuple[int, ...] = (1, 2), camera_from_world: Array | None = None
) -> LabelledImage:
    """A small picture with random labels; depth lies on the 0.1 mm grid of the file format."""
    height, width = CAMERA.height, CAMERA.width
    depth = np.rint(rng.uniform(0, 6.5, (height, width)) * 1e4) / 1e4
    depth[:5] = 0
    instances = tuple(instance_labels(rng, obj_id) for obj_id in obj_ids)
    pose = se3.random(rng) if camera_from_world is None else camera_from_world
    return LabelledImage(CAMERA, pose, noise_image(width, height, rng), depth.astype(np.float32), instances)


def instance_labels(rng: np.random.Generator, obj_id: int) -> InstanceLabels:
    """Random labels; the visible mask is a part of the whole one."""
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=np.bool_)
    mask[10:30, 15:40] = True
    visible = mask & (rng.uniform(size=mask.shape) < 0.5)
    return InstanceLabels(
        obj_id,
        se3.from_parts(so3.random(rng), rng.uniform(-1, 1, 3)),
        box=np.array([-3.5, 4.25, 41.0, 47.75]),
        mask=mask,
        mask_visible=visible,
        visible_fraction=float(visible.sum() / 640),
        pixel_count=640,
        keypoints=rng.uniform(-10, 70, (8, 2)),
        keypoints_visible=rng.uniform(size=8) < 0.5,
    )
