import numpy as np
import pytest
from hypothesis import given, settings

from multicam.evaluation.camera_error import camera_error
from multicam.geometry import se3
from tests.strategies import transforms


def test_angle_in_degrees_and_distance_of_centres_in_millimetres():
    estimated = se3.exp(np.array([0, 0, np.radians(3), 0, 0, 0]))
    estimated[:3, 3] = [0.03, 0.04, 0]
    error = camera_error(estimated, np.eye(4))
    assert error.rotation_deg == pytest.approx(3)
    assert error.centre_mm == pytest.approx(50)
    assert error.inside is None


@settings(max_examples=50)
@given(transforms(), transforms(), transforms())
def test_the_frame_of_reference_does_not_matter(estimated, true, move):
    one, other = camera_error(estimated, true), camera_error(move @ estimated, move @ true)
    assert one.centre_mm == pytest.approx(other.centre_mm, abs=1e-6)
    assert one.rotation_deg == pytest.approx(other.rotation_deg, abs=1e-4)


def test_the_ellipsoid_holds_95_percent_of_honest_estimates(rng):
    true, covariance = se3.random(rng), np.diag([1, 2, 3, 1, 2, 3]) * 1e-4
    draws = rng.multivariate_normal(np.zeros(6), covariance, size=1000)
    inside = [camera_error(se3.plus(true, -xi), true, covariance).inside for xi in draws]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
