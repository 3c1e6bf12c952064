"""Region and depth factors in the joint problem of cameras and objects."""

from __future__ import annotations

import numpy as np

from multicam.bundle.depth.config import DepthConfig
from multicam.bundle.depth.factor import DepthFactor
from multicam.bundle.depth.points import find_points
from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.occlusion import Occluders
from multicam.bundle.problem import Problem, State
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.region.factor import RegionFactor
from multicam.bundle.region.lines import find_lines
from multicam.bundle.tracking import first_colors
from multicam.geometry import se3
from tests.bundle.box_world import COLOR_CAMERA, box_model, pose, sight

REGION, DEPTH = RegionConfig(), DepthConfig()


def test_a_camera_and_an_object_that_were_moved_come_back_together(rng: np.random.Generator) -> None:
    # Both cameras stand at the world's origin; the second and the box are put elsewhere.
    seen = [sight(rng, pose()), sight(rng, pose())]
    colors = [first_colors(box_model(), each, pose(), REGION) for each in seen]
    start = np.array([[0, 0, 0, 0, 0, 0], [0.03, -0.036, 0.008, 0.004, -0.003, 0.005]])
    state = State(se3.exp(start), se3.plus(pose(), np.array([0.01, 0.01, -0.01, 0.002, 0.002, -0.003]))[None])
    camera, obj = np.array([0, 1]), np.array([0, 0])
    for search in range(5):
        poses = se3.inverse(state.world_from_camera) @ state.world_from_object
        lines = [
            find_lines(box_model(), each.image, COLOR_CAMERA.matrix, at, known, Occluders(), search, REGION)
            for each, at, known in zip(seen, poses, colors, strict=True)
        ]
        pairs = [
            find_points(box_model(), s.depth, at, Occluders(), search, DEPTH)
            for s, at in zip(seen, poses, strict=True)
            if s.depth
        ]
        matrices = np.stack([COLOR_CAMERA.matrix] * 2)
        factors = (
            RegionFactor.of_edges(camera, obj, matrices, lines, REGION).in_update(1, REGION),
            DepthFactor.of_edges(camera, obj, pairs),
        )
        minimum = minimize(Problem(factors, np.array([True, False])), state, LevenbergConfig(iterations=4))
        assert list(minimum.energies) == sorted(minimum.energies, reverse=True)
        state = minimum.state
    for world_from_camera in state.world_from_camera:
        error = se3.minus(se3.inverse(world_from_camera) @ state.world_from_object[0], pose())
        assert np.linalg.norm(error[3:]) < 0.0015 and np.linalg.norm(error[:3]) < 0.02
    # One box 60 cm away leaves the second camera only as sure of its place as it is of the box's rotation.
    assert np.linalg.norm(state.world_from_camera[1, :3, 3]) < 0.6 * 0.02
