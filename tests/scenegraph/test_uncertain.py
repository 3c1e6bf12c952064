import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.geometry import se3, so3
from multicam.scenegraph.uncertain import UncertainPose, fuse, isotropic, mahalanobis, spread
from tests.strategies import transforms

DRAWS = 40_000


def covariance(rng: np.random.Generator, scale: float = 0.01) -> np.ndarray:
    root = rng.normal(size=(6, 6)) * scale
    return root @ root.T + 1e-8 * np.eye(6)


def sample(estimate: UncertainPose, rng: np.random.Generator, count: int) -> np.ndarray:
    return se3.plus(estimate.pose, rng.multivariate_normal(np.zeros(6), estimate.covariance, size=count))


def empirical(samples: np.ndarray, mean: np.ndarray) -> np.ndarray:
    return np.cov(se3.minus(samples, np.broadcast_to(mean, samples.shape)).T)


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(found - expected).max() < 0.03 * np.abs(expected).max()


def test_a_chained_covariance_is_what_sampling_gives(rng):
    a = UncertainPose(se3.random(rng), covariance(rng))
    b = UncertainPose(se3.random(rng), covariance(rng))
    chained = a @ b
    samples = sample(a, rng, DRAWS) @ sample(b, rng, DRAWS)
    assert_close(empirical(samples, chained.pose), chained.covariance)


def test_an_inverted_covariance_is_what_sampling_gives(rng):
    a = UncertainPose(se3.random(rng), covariance(rng))
    samples = se3.inverse(sample(a, rng, DRAWS))
    assert_close(empirical(samples, a.inverse().pose), a.inverse().covariance)


def test_relative_pose_through_an_object_has_the_covariance_of_the_fact_sheet(rng):
    # With S = 1: Ad(T_bO) (Cov_aO + Cov_bO) Ad(T_bO)^T.
    a = UncertainPose(se3.random(rng), covariance(rng))
    b = UncertainPose(se3.random(rng), covariance(rng))
    adjoint = se3.adjoint(b.pose)
    expected = adjoint @ (a.covariance + b.covariance) @ adjoint.T
    np.testing.assert_allclose((a @ b.inverse()).covariance, expected, atol=1e-12)


@settings(max_examples=40)
@given(transforms(), st.integers(0, 2**32 - 1))
def test_fusing_does_not_depend_on_the_order(pose, seed):
    rng = np.random.default_rng(seed)
    a = UncertainPose(pose, covariance(rng))
    b = UncertainPose(se3.plus(pose, 0.05 * rng.normal(size=6)), covariance(rng))
    one, other = fuse(a, b), fuse(b, a)
    np.testing.assert_allclose(se3.minus(one.pose, other.pose), 0, atol=1e-7)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-5, atol=1e-14)


@settings(max_examples=40)
@given(transforms(), transforms(), st.integers(0, 2**32 - 1))
def test_moving_the_world_moves_the_fused_pose_along(pose, shift, seed):
    rng = np.random.default_rng(seed)
    a = UncertainPose(pose, covariance(rng))
    b = UncertainPose(se3.plus(pose, 0.05 * rng.normal(size=6)), covariance(rng))
    moved = fuse(UncertainPose(shift @ a.pose, a.covariance), UncertainPose(shift @ b.pose, b.covariance))
    np.testing.assert_allclose(moved.pose, shift @ fuse(a, b).pose, atol=1e-6)


@settings(max_examples=30)
@given(transforms(), st.integers(0, 2**32 - 1))
def test_the_fused_pose_is_a_minimum(pose, seed):
    rng = np.random.default_rng(seed)
    a = UncertainPose(pose, covariance(rng, 0.1))
    b = UncertainPose(se3.plus(pose, 0.3 * rng.normal(size=6)), covariance(rng, 0.1))
    fused = fuse(a, b)

    def energy(xi: np.ndarray) -> float:
        residuals = [(se3.minus(se3.plus(fused.pose, xi), m.pose), m.covariance) for m in (a, b)]
        return sum(r @ np.linalg.solve(c, r) for r, c in residuals) / 2

    # In whitened directions the gradient vanishes, by central differences.
    step = 1e-4 * np.linalg.cholesky(fused.covariance)
    gradient = np.array([(energy(column) - energy(-column)) / 2e-4 for column in step.T])
    np.testing.assert_allclose(gradient, 0, atol=1e-4 * max(1.0, energy(np.zeros(6))))


def test_two_equal_measurements_halve_the_covariance(rng):
    a = UncertainPose(se3.random(rng), covariance(rng))
    fused = fuse(a, a)
    np.testing.assert_allclose(fused.pose, a.pose, atol=1e-12)
    np.testing.assert_allclose(fused.covariance, a.covariance / 2, rtol=1e-6)


def test_the_more_certain_measurement_pulls_harder():
    far = np.eye(4)
    far[0, 3] = 0.1
    fused = fuse(UncertainPose(np.eye(4), isotropic(0.01, 0.01)), UncertainPose(far, isotropic(0.01, 0.03)))
    # Weights 1/1 and 1/9: the mean lies a tenth of the way.
    np.testing.assert_allclose(fused.pose[:3, 3], [0.01, 0, 0], atol=1e-12)


def test_errors_and_stated_deviations_fall_with_the_square_root_of_the_count(rng):
    truth, noise, count, runs = se3.random(rng), covariance(rng, 0.005), 9, 80
    errors, stated = np.zeros((runs, 2)), np.zeros(2)
    for run in range(runs):
        samples = sample(UncertainPose(truth, noise), rng, count)
        fused = UncertainPose(samples[0], noise)
        for measured in samples[1:]:
            fused = fuse(fused, UncertainPose(measured, noise))
        errors[run] = [np.sum(se3.minus(pose, truth)[3:] ** 2) for pose in (samples[0], fused.pose)]
        stated = np.array([np.trace(noise[3:, 3:]), np.trace(fused.covariance[3:, 3:])])
    one, many = np.sqrt(errors.mean(0))
    assert 0.8 < one / np.sqrt(stated[0]) < 1.2
    assert 0.8 < many / np.sqrt(stated[1]) < 1.2
    assert 2.5 < one / many < 3.5  # sqrt(9) = 3


def test_the_mahalanobis_distance_of_honest_measurements_is_chi_square(rng):
    truth = se3.random(rng)
    a, b = covariance(rng, 0.01), covariance(rng, 0.01)
    draws = zip(sample(UncertainPose(truth, a), rng, 1500), sample(UncertainPose(truth, b), rng, 1500), strict=True)
    squared = np.array([mahalanobis(UncertainPose(x, a), UncertainPose(y, b)) for x, y in draws])
    assert abs(squared.mean() - 6) < 0.3
    assert abs(np.mean(squared > 12.59) - 0.05) < 0.015


def test_the_spread_is_that_of_a_point_a_metre_away(rng):
    turn, shift = 0.02, 0.01
    points = sample(UncertainPose(np.eye(4), isotropic(turn, shift)), rng, DRAWS)[:, :3, 3]
    turned = so3.exp(turn * rng.normal(size=(DRAWS, 3)))[:, :, 2] + points - [0, 0, 1]
    # A turn about the line of sight moves nothing on it, but counts.
    found = spread(UncertainPose(np.eye(4), isotropic(turn, shift)))
    np.testing.assert_allclose(found**2 - turn**2, turned.var(axis=0).sum(), rtol=0.03)
