"""Attitudes spread evenly, and those of them that a box and the depth in it suggest."""

from __future__ import annotations

import numpy as np
import pytest

from multicam.bundle.depth_image import DepthImage, draw_bodies
from multicam.bundle.tracking import Sight
from multicam.fitting.agreement import confirmed
from multicam.fitting.attitudes import even_rotations, poses_at_box
from multicam.fitting.config import FitConfig
from multicam.fitting.sampled import outline_sides, surface_errors
from multicam.geometry import se3, so3
from multicam.types import FloatArray
from tests.bundle.box_rig import CAMERA, body

CONFIG = FitConfig(attitudes=90)
CENTRE = np.zeros(3)


def sight(depth: DepthImage) -> Sight:
    return Sight(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), CAMERA, np.eye(4), depth)


def suggested(depth: DepthImage, box: FloatArray, config: FitConfig = CONFIG) -> tuple[FloatArray, FloatArray]:
    """Scores (n,) and poses (n, 4, 4)."""
    found = list(poses_at_box(sight(depth), depth, body().model, CENTRE, box, config))
    return np.array([score for score, _ in found]), np.reshape([pose for _, pose in found], (-1, 4, 4))


def unlike(poses: FloatArray, box: FloatArray) -> FloatArray:
    sides = outline_sides(body().model, CAMERA.matrix, poses)
    return np.abs(np.log(sides / (box[2:] - box[:2]))).sum(axis=1)


@pytest.mark.parametrize(("count", "farthest"), [(1, 180.0), (300, 32.0), (3000, 15.5)])
def test_every_attitude_has_one_of_the_even_ones_near(rng: np.random.Generator, count: int, farthest: float) -> None:
    rotations = even_rotations(count)
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(rotations), 1)
    nearest = [
        np.degrees(np.arccos(np.clip((np.einsum("nij,ij->n", rotations, so3.random(rng)) - 1) / 2, -1, 1))).min()
        for _ in range(500)
    ]
    assert max(nearest) < farthest


def test_a_third_is_compared_with_the_depth_those_most_like_the_box() -> None:
    wall = DepthImage(np.full((CAMERA.height, CAMERA.width), 0.6, np.float32), CAMERA, np.eye(4))
    box = np.array([100.0, 60, 220, 90])
    scores, poses = suggested(wall, box)
    every = np.tile(np.eye(4), (90, 1, 1))
    every[:, :3, :3], every[:, :3, 3] = even_rotations(90), 0.6 * CAMERA.unproject(np.array([160.0, 75]), np.ones(()))
    assert len(scores) == 30
    kept = (every[:, None, :3, :3] == poses[None, :, :3, :3]).all(axis=(2, 3)).any(axis=1)
    assert kept.sum() == 30 and unlike(every[kept], box).max() <= unlike(every[~kept], box).min()
    # What an unlike outline takes from the depth's share grows with it.
    taken = [
        confirmed(surface_errors(body().model, wall, pose), CONFIG) - score
        for score, pose in zip(scores, poses, strict=True)
    ]
    assert np.min(taken) > 0 and np.corrcoef(taken, np.sort(unlike(every[kept], box)))[0, 1] > 0.99


def test_poses_stand_where_the_depth_is(rng: np.random.Generator) -> None:
    at = se3.from_parts(so3.random(rng), np.array([0.03, -0.02, 0.55]))
    depth = draw_bodies([(body().mesh, at)], CAMERA)
    pixels = CAMERA.project(se3.act(at, body().mesh.vertices))
    box = np.r_[pixels.min(axis=0), pixels.max(axis=0)]
    scores, poses = suggested(depth, box, FitConfig(attitudes=3000))
    best = poses[np.argmax(scores)]
    assert np.abs(poses[:, 2, 3] - 0.55).max() < 0.05
    assert np.linalg.norm(best[:3, 3] - at[:3, 3]) < 0.01
    # Looks the same after half a turn about each axis.
    turns = [np.diag(d) for d in ((1.0, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    assert min(np.linalg.norm(so3.log((at[:3, :3] @ turn).T @ best[:3, :3])) for turn in turns) < 0.4


def test_nothing_is_suggested_without_depth_in_the_box_or_attitudes() -> None:
    unknown = DepthImage(np.full((CAMERA.height, CAMERA.width), np.nan, np.float32), CAMERA, np.eye(4))
    wall = DepthImage(np.full((CAMERA.height, CAMERA.width), 0.6, np.float32), CAMERA, np.eye(4))
    box = np.array([100.0, 60, 220, 90])
    assert len(suggested(unknown, box)[0]) == 0
    assert len(suggested(wall, box, FitConfig(attitudes=0))[0]) == 0
    assert len(suggested(wall, box - 1000)[0]) == 0
