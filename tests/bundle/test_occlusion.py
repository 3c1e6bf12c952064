"""What hides points: patches that need not be looked at say nothing else than those that are."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.bundle.depth_image import DepthImage
from multicam.bundle.occlusion import OcclusionConfig
from multicam.bundle.occlusion_compiled import BLOCK, mark_hidden, nearest_of_blocks
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.geometry.camera import Camera

CAMERA = Camera.from_focal(90.0, 75, 50)


def scattered(seed: int) -> DepthImage:
    """A wall behind holes, nothing known in places, and a few near pixels."""
    rng = np.random.default_rng(seed)
    depth = np.full((50, 75), 1.0)
    for value, share in ((0.0, 0.2), (np.nan, 0.2), (np.inf, 0.2), (0.3, 0.01)):
        depth[rng.random(depth.shape) < share] = value
    return DepthImage(depth.astype(np.float32), CAMERA, np.eye(4))


@given(seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_the_nearest_of_a_square_is_the_least_depth_known_in_it(seed: int) -> None:
    image = scattered(seed)
    known = np.where(image.depth > 0, image.depth, np.float32(np.inf))
    for row in range(image.blocks.shape[0]):
        for column in range(image.blocks.shape[1]):
            square = known[row * BLOCK : (row + 1) * BLOCK, column * BLOCK : (column + 1) * BLOCK]
            assert image.blocks[row, column] == square.min()
    assert image.blocks.shape == (4, 5)


@given(seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_squares_without_anything_near_change_nothing(seed: int) -> None:
    image = scattered(seed)
    rng = np.random.default_rng(seed + 1)
    # From a few pixels to most of a square across, also over the border of the picture.
    point = rng.uniform((-0.5, -0.5, 0.4), (0.5, 0.5, 1.4), (300, 3)).astype(np.float32)
    offset, radius = np.zeros(300, np.float32), rng.uniform(0.005, 0.1)
    quick, thorough = np.ones(300, np.bool_), np.ones(300, np.bool_)
    everywhere = np.full_like(nearest_of_blocks(image.depth), 1e-6)
    for blocks, seen in ((image.blocks, quick), (everywhere, thorough)):
        mark_hidden(image.depth, blocks, CAMERA.matrix, np.eye(4), point, offset, radius, 0.03, seen)
    assert np.array_equal(quick, thorough)
    assert 0 < (~quick).sum() < 300


def test_models_know_their_relief_as_far_around_as_occlusion_is_looked_for() -> None:
    models = ViewpointConfig()
    assert round(OcclusionConfig().radius / models.offset_step) < models.offsets
