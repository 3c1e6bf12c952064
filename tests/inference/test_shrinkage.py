"""Expectations of keypoints crowd together where the attitude is unknown; they are spread again about their centre."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.geometry.camera import Camera
from multicam.inference.pnp import PnpConfig, PnpSolution, solve_pnp
from multicam.inference.shrinkage import undo_shrinkage

CAMERA = Camera.from_focal(600.0, 640, 480)
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.03, 0.03)])


@given(seed=st.integers(0, 2**32 - 1), deviation=st.floats(0, 60))
def test_centre_and_directions_stay_and_the_squares_grow_by_the_variances(seed: int, deviation: float) -> None:
    rng = np.random.default_rng(seed)
    keypoints, std = rng.uniform(0, 400, (8, 2)), deviation * rng.uniform(0.2, 1, (8, 2))
    restored = undo_shrinkage(keypoints, std)
    assert restored.mean(axis=0) == pytest.approx(keypoints.mean(axis=0))
    before, after = keypoints - keypoints.mean(axis=0), restored - keypoints.mean(axis=0)
    assert np.sum(after**2) == pytest.approx(np.sum(before**2) + np.sum(std**2))
    assert after * np.linalg.norm(before) == pytest.approx(before * np.linalg.norm(after), abs=1e-6)


def test_an_object_that_may_be_turned_either_way_is_as_far_away_as_it_is(rng: np.random.Generator) -> None:
    """A network that knows place and distance, but the turn about the optical axis only to 35 degrees: its expectations
    and deviations are those over all turns."""
    true = np.eye(4)
    true[:3, 3] = [0.05, -0.02, 0.6]
    turned = np.tile(true, (4000, 1, 1))
    angle = rng.normal(scale=np.radians(35), size=4000)
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angle)
    turned[:, 1, 0] = np.sin(angle)
    turned[:, 0, 1] = -turned[:, 1, 0]
    places = np.stack([CAMERA.project(CUBE @ pose[:3, :3].T + pose[:3, 3]) for pose in turned])
    keypoints, std = places.mean(axis=0), places.std(axis=0)

    def depth(seen: np.ndarray) -> float:
        answer = solve_pnp(seen, std, np.ones(8), CUBE, CAMERA, PnpConfig())
        assert isinstance(answer, PnpSolution)
        return float(answer.camera_from_object[2, 3])

    assert depth(keypoints) > 0.69
    assert depth(undo_shrinkage(keypoints, std)) == pytest.approx(0.6, abs=0.01)


def test_a_keypoint_that_is_not_finite_counts_for_nothing(rng: np.random.Generator) -> None:
    keypoints, std = rng.uniform(0, 100, (8, 2)), rng.uniform(1, 5, (8, 2))
    keypoints[3], std[5, 0] = np.nan, np.inf
    restored = undo_shrinkage(keypoints, std)
    rest = [0, 1, 2, 4, 6, 7]
    assert restored[rest] == pytest.approx(undo_shrinkage(keypoints[rest], std[rest]))
    assert np.isnan(restored[3]).all()


def test_nothing_to_go_by_changes_nothing() -> None:
    nowhere, one = np.full((8, 2), np.nan), np.tile([[10.0, 20.0]], (8, 1))
    assert np.array_equal(undo_shrinkage(nowhere, np.ones((8, 2))), nowhere, equal_nan=True)
    assert np.array_equal(undo_shrinkage(one, np.ones((8, 2))), one)
