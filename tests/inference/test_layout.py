"""Compiled shape measures against NumPy, and the order in which samples are tried."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.inference import layout
from multicam.inference.initial_pose import sample_turns

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(5, 20))
def test_the_normal_is_the_least_principal_direction(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * [0.1, 0.05, 0.01] @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 0.3
    least = np.linalg.svd(points - points.mean(0))[2][2]
    assert abs(layout.normal(points) @ least) == pytest.approx(1, abs=1e-9)


@given(seeds, st.integers(5, 20))
def test_the_extent_is_three_times_the_median_distance_from_the_median(seed: int, count: int) -> None:
    pixels = np.random.default_rng(seed).uniform(0, 400, (count, 2))
    expected = 3 * np.median(np.linalg.norm(pixels - np.median(pixels, axis=0), axis=1))
    assert layout.extent(pixels) == pytest.approx(expected)


@pytest.mark.parametrize(("width", "straight"), [(0.0, True), (5e-4, True), (2e-3, False), (0.5, False)])
def test_points_are_a_line_below_a_thousandth_of_their_length(width: float, straight: bool) -> None:
    # Corners of a rectangle: the principal extents are its sides.
    corners = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-width / 2, width / 2)])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert layout.collinear(corners @ turn + 1.0) == straight


@pytest.mark.parametrize("count", [5, 8, 9, 17])
def test_every_turn_of_samples_knows_every_keypoint(count: int) -> None:
    turns = sample_turns(count)
    triples = [tuple(row) for turn in turns for row in turn]
    assert len(set(triples)) == len(triples) == min(len(list(combinations(range(count), 3))), 60)
    if count in (8, 9):
        # A wrong keypoint must not be in all samples of a turn.
        for turn in turns:
            shares = [np.any(turn == keypoint, axis=1).mean() for keypoint in range(count)]
            assert min(shares) > 0
            assert max(shares) < 1
