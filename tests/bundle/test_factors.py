"""Every factor against central differences, and its Gauss-Newton Hessian where the residual is zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from multicam.bundle.bearing import BearingFactor
from multicam.bundle.epipolar import EpipolarFactor
from multicam.bundle.factor import Linearization
from multicam.bundle.keypoint import KeypointFactor
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.pair import PairFactor
from multicam.bundle.pose import PoseFactor
from multicam.bundle.robust import Student
from multicam.geometry import se3, so3
from tests.strategies import seeds, twists
from tests.toy_world import CAMERA

STEP = 1e-6
KERNEL = Student(2.0, 6)
ONE = np.zeros(1, dtype=np.int64)


def numeric_gradient(linearize, pose: np.ndarray) -> np.ndarray:
    """Central differences of the energy in the right tangent of one pose (1, 4, 4)."""
    steps = STEP * np.eye(6)
    return np.array(
        [(linearize(se3.plus(pose, s)).energy - linearize(se3.plus(pose, -s)).energy)[0] / (2 * STEP) for s in steps]
    )


def numeric_hessian(linearize, pose: np.ndarray) -> np.ndarray:
    """Central differences of the gradient."""
    steps = STEP * np.eye(6)
    return np.array(
        [
            (linearize(se3.plus(pose, s)).gradient - linearize(se3.plus(pose, -s)).gradient)[0] / (2 * STEP)
            for s in steps
        ]
    )


def information(rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(1, 6, 6))
    return root @ np.swapaxes(root, -1, -2) + np.eye(6)


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    assert np.allclose(actual, expected, atol=1e-5 * max(1.0, np.abs(expected).max()))


@given(seeds(), twists(most=3.0, reach=1.0))
def test_the_gradient_of_a_pose_factor_is_exact(rng: np.random.Generator, difference: np.ndarray) -> None:
    observed = se3.random(rng, 1)
    factor = PoseFactor(ONE, ONE, observed, information(rng), KERNEL)
    pose = se3.plus(observed, difference)
    assert_close(factor.linearize(pose).gradient[0], numeric_gradient(factor.linearize, pose))


@given(seeds(), twists(most=3.0, reach=1.0))
def test_the_gradient_of_an_odometry_factor_is_exact_in_both_poses(
    rng: np.random.Generator, difference: np.ndarray
) -> None:
    factor, poses = odometry_factor(rng)
    poses[1] = se3.plus(poses[1], difference)
    assert_close(factor.linearize(poses).gradient[0], numeric_pair_gradient(factor, poses))


@given(seeds())
def test_the_hessian_of_an_odometry_factor_is_exact_where_the_residual_vanishes(rng: np.random.Generator) -> None:
    factor, poses = odometry_factor(rng)
    assert_close(factor.linearize(poses).hessian[0], numeric_pair_hessian(factor, poses))


@given(seeds(), twists(most=2.0, reach=0.3))
def test_the_gradient_of_a_bearing_factor_is_exact_in_both_poses_and_knows_no_length(
    rng: np.random.Generator, difference: np.ndarray
) -> None:
    factor, poses = bearing_factor(rng)
    poses[1] = se3.plus(poses[1], difference)
    local = factor.linearize(poses)
    assert_close(local.gradient[0], numeric_pair_gradient(factor, poses))
    longer = poses.copy()
    longer[1, :3, 3] += 2 * (poses[1, :3, 3] - poses[0, :3, 3])
    assert factor.linearize(longer).energy[0] == pytest.approx(local.energy[0], rel=1e-9)
    assert np.linalg.eigvalsh(local.hessian[0]).min() > -1e-8 * np.abs(local.hessian).max()


@given(seeds())
def test_the_hessian_of_a_bearing_factor_is_exact_where_the_residual_vanishes(rng: np.random.Generator) -> None:
    factor, poses = bearing_factor(rng)
    local = factor.linearize(poses)
    assert local.energy[0] == pytest.approx(0, abs=1e-12) and factor.agrees(poses).all()
    assert_close(local.hessian[0], numeric_pair_hessian(factor, poses))


def test_a_bearing_is_whitened_by_its_covariance_and_the_opposite_one_is_far() -> None:
    covariance = np.diag([0.1, 0.1, 0.1, 0.02, 0.02]) ** 2
    measured = se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))[None]
    factor = BearingFactor(ONE, ONE + 1, measured, np.linalg.inv(covariance)[None])
    turned = np.stack((np.eye(4), se3.exp(np.array([0.1, 0, 0, 0, 0, 0]))))
    turned[1, :3, 3] = 0.7 * np.array([np.sin(0.02), 0, np.cos(0.02)])
    # One deviation of turn and one of direction.
    assert factor.linearize(turned).energy[0] == pytest.approx(11.07 / 2 * np.log1p(2 / 11.07), rel=1e-3)
    assert factor.agrees(turned).all()
    behind = turned.copy()
    behind[1, :3, 3] *= [1, 1, -1]
    assert not factor.agrees(behind).any()
    for place in (np.zeros(3), -measured[0, :3, 3]):
        turned[1] = np.eye(4)
        turned[1, :3, 3] = place
        local = factor.linearize(turned)
        assert np.isfinite(local.energy).all() and np.isfinite(local.hessian).all()


@given(seeds(), twists(most=0.3, reach=0.1))
def test_the_gradient_of_an_epipolar_factor_is_exact_in_both_poses(
    rng: np.random.Generator, difference: np.ndarray
) -> None:
    factor, poses = epipolar_factor(rng)
    poses[1] = se3.plus(poses[1], difference)
    local = factor.linearize(poses)
    assert_close(local.gradient[0], numeric_pair_gradient(factor, poses))
    assert np.linalg.eigvalsh(local.hessian[0]).min() > -1e-8 * np.abs(local.hessian).max()


def test_matches_lie_on_their_lines_at_any_length_and_a_pixel_across_is_a_deviation(rng: np.random.Generator) -> None:
    factor, poses = epipolar_factor(rng)
    relative = (se3.inverse(poses[0]) @ poses[1])[None]
    for length in (1.0, 3.0):
        relative[0, :3, 3] *= length
        assert np.allclose(factor.whitened(relative)[0], 0, atol=1e-9)
    essential = so3.hat(relative[0, :3, 3]) @ relative[0, :3, :3]
    line = np.c_[factor.second_ray, np.ones(len(factor.pair))] @ essential.T
    normal = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    # All of the error lies in the first picture, which Sampson's distance shares out between both.
    only_first = replace(
        factor, first_ray=factor.first_ray + 2e-3 * normal, std=np.tile([1e-3, 1e-9], (len(normal), 1))
    )
    assert np.allclose(np.abs(only_first.whitened(relative)[0]), 2, rtol=1e-6)


@given(seeds())
def test_the_gradient_of_a_keypoint_factor_is_exact(rng: np.random.Generator) -> None:
    factor, pose = keypoint_factor(rng, error=20.0)
    assert_close(factor.linearize(pose).gradient[0], numeric_gradient(factor.linearize, pose))


@settings(max_examples=30)
@given(seeds())
def test_hessians_are_exact_where_the_residual_vanishes(rng: np.random.Generator) -> None:
    observed = se3.random(rng, 1)
    pose_factor = PoseFactor(ONE, ONE, observed, information(rng), KERNEL)
    keypoints, pose = keypoint_factor(rng, error=0.0)
    for linearize, at in ((pose_factor.linearize, observed), (keypoints.linearize, pose)):
        local: Linearization = linearize(at)
        assert local.energy[0] == pytest.approx(0, abs=1e-12)
        assert_close(local.hessian[0], numeric_hessian(linearize, at))


def test_a_keypoint_error_counts_in_standard_deviations() -> None:
    factor, pose = keypoint_factor(np.random.default_rng(0), error=0.0)
    shifted = KeypointFactor(
        ONE,
        ONE,
        factor.point,
        factor.pixel + np.array([[3.0, -8.0]]),
        np.array([[1.5, 2.0]]),
        factor.camera_matrix,
        KERNEL,
    )
    assert shifted.linearize(pose).energy[0] == pytest.approx((2**2 + 4**2) / 2)


def test_the_energy_of_a_pose_is_half_its_squared_mahalanobis_distance() -> None:
    covariance = np.diag([0.1, 0.1, 0.1, 0.01, 0.01, 0.02]) ** 2
    factor = PoseFactor(ONE, ONE, np.eye(4)[None], np.linalg.inv(covariance)[None], KERNEL)
    assert factor.linearize(se3.exp(np.array([[0, 0, 0, 0.01, 0, 0.06]]))).energy[0] == pytest.approx((1 + 9) / 2)


def test_student_grows_as_the_logarithm_of_gross_errors_and_weighs_them_down() -> None:
    kernel = Student(tail=2.0, dimension=6)
    squared = np.array([0.0, 6.0, 1e6])
    assert kernel.energy(squared)[0] == 0
    assert kernel.weight(squared).tolist() == pytest.approx([4.0, 1.0, 8e-6], rel=1e-5)
    step = 1e-4
    slope = (kernel.energy(squared + step) - kernel.energy(squared)) / step
    assert slope == pytest.approx(kernel.weight(squared) / 2, rel=1e-3)


def numeric_pair_gradient(factor: PairFactor, poses: np.ndarray) -> np.ndarray:
    """(12,) central differences of the energy in the right tangents of both poses."""
    return _pair_differences(lambda moved: factor.linearize(moved).energy, poses)


def numeric_pair_hessian(factor: PairFactor, poses: np.ndarray) -> np.ndarray:
    """(12, 12) of the gradient."""
    return _pair_differences(lambda moved: factor.linearize(moved).gradient, poses)


def _pair_differences(value: Callable[[np.ndarray], np.ndarray], poses: np.ndarray) -> np.ndarray:
    steps = STEP * np.eye(12).reshape(12, 2, 6)
    return np.array([(value(se3.plus(poses, s)) - value(se3.plus(poses, -s)))[0] / (2 * STEP) for s in steps])


def bearing_factor(rng: np.random.Generator) -> tuple[BearingFactor, np.ndarray]:
    """Two cameras and what is measured of them: turn and direction."""
    poses = se3.random(rng, 2)
    measured = se3.inverse(poses[:1]) @ poses[1:]
    measured[0, :3, 3] /= np.linalg.norm(measured[0, :3, 3])
    return BearingFactor(ONE, ONE + 1, measured, information(rng)[:, :5, :5]), poses


def epipolar_factor(rng: np.random.Generator) -> tuple[EpipolarFactor, np.ndarray]:
    """Points before two cameras, half a metre apart."""
    poses = se3.exp(rng.normal(size=(2, 6)) * np.repeat([0.2, 0.3], 3))
    points = rng.uniform(-0.5, 0.5, size=(12, 3)) + np.array([0, 0, 2.0])
    rays = [(seen := se3.act(se3.inverse(each), points))[:, :2] / seen[:, 2:] for each in poses]
    std = rng.uniform(1e-3, 3e-3, size=(12, 2))
    return EpipolarFactor(ONE, ONE + 1, np.zeros(12, dtype=np.int64), *rays, std, Student(1.0, 1)), poses


def keypoint_factor(rng: np.random.Generator, error: float) -> tuple[KeypointFactor, np.ndarray]:
    """One keypoint of an object about 0.8 m before a camera, and the pose at which it is seen."""
    pose = se3.exp(np.concatenate((rng.normal(size=3), [0, 0, 0])))[None]
    pose[0, :3, 3] = [0.05, -0.03, 0.8]
    point = 0.05 * rng.normal(size=(1, 3))
    pixel = CAMERA.project(se3.act(pose, point)[0]) + error * rng.normal(size=(1, 2))
    std = rng.uniform(1, 3, size=(1, 2))
    return KeypointFactor(ONE, ONE, point, pixel, std, CAMERA.matrix[None], Student(2.0, 2)), pose


@pytest.mark.parametrize(("tail", "dimension"), [(2.0, 6), (2.0, 2), (5.0, 3)])
def test_information_over_a_student_distribution_is_that_of_fisher(
    rng: np.random.Generator, tail: float, dimension: int
) -> None:
    student = Student(tail, dimension)
    normal, spread = rng.normal(size=(200_000, dimension)), rng.chisquare(tail, 200_000) / tail
    squared = np.sum(normal**2, axis=1) / spread
    assert student.information(squared).mean() == pytest.approx((tail + dimension) / (tail + dimension + 2), rel=0.01)
    # Smaller residuals are no proof of precision.
    assert student.information(np.array([0.0])) == student.information(np.array([dimension - 1e-9]))


def odometry_factor(rng: np.random.Generator) -> tuple[OdometryFactor, np.ndarray]:
    """A factor between two poses (2, 4, 4) that agree with it."""
    poses = se3.random(rng, 2)
    measured = se3.inverse(poses[:1]) @ poses[1:]
    return OdometryFactor(ONE, ONE + 1, measured, information(rng)), poses
