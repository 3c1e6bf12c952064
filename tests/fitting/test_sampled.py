"""What a body would show, by the points of its nearest view, against drawing it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.bundle.depth_image import draw_bodies
from multicam.fitting.agreement import confirmed, drawn_errors
from multicam.fitting.config import FitConfig
from multicam.fitting.sampled import outline_sides, surface_errors
from multicam.geometry import se3, so3
from tests.bundle.box_rig import CAMERA, body


def pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return se3.from_parts(so3.random(rng), np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.8)]))


@given(st.integers(0, 1000))
def test_points_of_the_nearest_view_lie_where_the_body_is_drawn(seed: int) -> None:
    at = pose(seed)
    depth = draw_bodies([(body().mesh, at)], CAMERA)
    behind = surface_errors(body().model, depth, at)
    assert len(behind) > 150 and np.quantile(np.abs(behind), 0.8) < 4e-3
    nearer = at.copy()
    nearer[:3, 3] *= 1 - 0.02 / np.linalg.norm(at[:3, 3])
    shift = np.median(surface_errors(body().model, depth, nearer))
    assert shift == pytest.approx(0.02, abs=4e-3)
    assert np.median(drawn_errors(body(), depth, nearer)) == pytest.approx(shift, abs=2e-3)


@given(st.integers(0, 1000))
def test_the_outline_is_as_large_as_the_projected_mesh(seed: int) -> None:
    poses = np.array([pose(seed), pose(seed + 1)])
    sides = np.array([np.ptp(CAMERA.project(se3.act(each, body().mesh.vertices)), axis=0) for each in poses])
    assert np.allclose(outline_sides(body().model, CAMERA.matrix, poses), sides, atol=4, rtol=0.05)


def test_only_known_depth_inside_the_picture_counts() -> None:
    at = pose(0)
    depth = draw_bodies([(body().mesh, at)], CAMERA)
    unknown = np.array([0, np.nan, np.inf], np.float32)
    depth.depth[:] = unknown[np.arange(CAMERA.width) % 3]
    assert len(surface_errors(body().model, depth, at)) == 0
    behind_camera, beside = at.copy(), at.copy()
    behind_camera[2, 3], beside[0, 3] = -0.5, 3.0
    depth.depth[:] = 1.0
    assert len(surface_errors(body().model, depth, behind_camera)) == 0
    assert len(surface_errors(body().model, depth, beside)) == 0
    assert np.allclose(outline_sides(body().model, CAMERA.matrix, behind_camera[None]), 0)


def test_shares_by_hand() -> None:
    config = FitConfig(confirms=0.01, contradicts=0.02)
    # Two confirm, one says neither, one lies behind, two before.
    behind = np.array([0.0, -0.009, 0.015, 0.5, -0.03, -0.021])
    assert confirmed(behind, config) == pytest.approx((2 - 1 - 2 * 0.5) / 6)
    assert confirmed(np.empty(0), config) == -1
