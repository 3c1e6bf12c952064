"""Noise of depth cameras."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datagen.recordings.config import DepthConfig
from datagen.recordings.depth_sensor import sense_depth

CONFIG = DepthConfig()
QUIET = DepthConfig(shift_px=0.0, noise_mm=0.0, noise_mm_per_m=0.0)
GREY = np.full((60, 80, 3), 120, np.uint8)


def wall(distance: float) -> np.ndarray:
    return np.full(GREY.shape[:2], distance, np.float32)


@given(st.floats(0.3, 5.4), st.integers(0, 2**16))
def test_noise_grows_with_distance_as_stated(distance: float, seed: int) -> None:
    found = sense_depth(wall(distance), GREY, CONFIG, np.random.default_rng(seed))
    assert found.dtype == np.float32
    assert np.all(found > 0)
    assert np.allclose(found * 1000, np.rint(found * 1000), atol=2e-3)
    error = found.astype(np.float64) - distance
    sigma = 0.0005 + 0.001 * max(distance - 0.5, 0)
    # Rounding to millimetres adds its own 1/12.
    assert error.std() == pytest.approx(np.hypot(sigma, 1e-3 / np.sqrt(12)), rel=0.06)
    assert abs(error.mean()) < 5 * sigma / np.sqrt(error.size) + 1.5e-4


def test_on_a_slope_the_sideways_error_shows() -> None:
    slope = (1 + 0.02 * np.arange(80, dtype=np.float32))[None].repeat(60, axis=0)
    shaken = DepthConfig(noise_mm=0.0, noise_mm_per_m=0.0)
    error = sense_depth(slope, GREY, shaken, np.random.default_rng(0))[:, 2:-2] - slope[:, 2:-2]
    assert error.std() == pytest.approx(0.25 * 0.02, rel=0.05)


def test_there_is_no_depth_at_high_edges_and_some_at_low_ones() -> None:
    for height, lost in ((0.9, True), (0.5, False)):
        depth = wall(1.0)
        depth[:, 40:] = 1.0 + height
        holes = sense_depth(depth, GREY, QUIET, np.random.default_rng(0)) == 0
        assert np.all(holes[:, 39:41]) == lost
        assert not holes[:, :39].any()
        assert not holes[:, 41:].any()


def test_there_is_no_depth_in_the_dark() -> None:
    image = GREY.copy()
    image[:, :20], image[:, 20:40] = 14, 15
    holes = sense_depth(wall(1.0), image, QUIET, np.random.default_rng(0)) == 0
    assert holes[:, :20].all()
    assert not holes[:, 20:].any()


def test_there_is_no_depth_out_of_range_or_beside_nothing() -> None:
    for distance in (0.2, 5.6, 0.0):
        assert not sense_depth(wall(distance), GREY, QUIET, np.random.default_rng(0)).any()
    depth = wall(0.6)
    depth[30, 40] = 0
    holes = sense_depth(depth, GREY, CONFIG, np.random.default_rng(0)) == 0
    assert holes[29:32, 39:42].all()
    assert holes.sum() == 9


def test_without_errors_depth_is_the_truth_in_millimetres() -> None:
    depth = np.random.default_rng(0).uniform(1.0, 1.3, GREY.shape[:2]).astype(np.float32)
    found = sense_depth(depth, GREY, QUIET, np.random.default_rng(0))
    assert np.abs(found - depth).max() < 0.5001e-3
    again = [sense_depth(depth, GREY, CONFIG, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert np.array_equal(again[0], again[1])
    assert not np.array_equal(again[0], again[2])
