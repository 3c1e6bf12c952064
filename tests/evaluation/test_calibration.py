import numpy as np
import pytest

from multicam.dataset.bop_reader import ImageRecord, Instance
from multicam.evaluation.calibration import (
    LEVELS,
    KeypointErrors,
    best_symmetry,
    keypoint_errors,
    keypoint_shares,
    pose_shares,
    with_covariance,
)
from multicam.evaluation.detection import FoundObject
from multicam.evaluation.network_tables import SIGMAS, keypoint_table, pose_calibration_table
from multicam.evaluation.single_view import ObjectErrors
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import Detection, ObjectEstimate
from tests.toy_objects import BRACKET, PLATE, random_symmetry, toy_symmetries

CAMERA = Camera.from_focal(600.0, 640, 480)
POSE = se3.exp(np.array([0.3, -0.2, 0.5, 0.02, 0.01, 0.8]))
RECORD = ImageRecord(1, 2, CAMERA.matrix, None, 1.0, None, None, (), ())


def drawn(rng, std: float, stated: float, count: int = 400) -> list[KeypointErrors]:
    return [KeypointErrors(rng.normal(0, std, (8, 2)), np.full((8, 2), stated)) for _ in range(count)]


def test_honest_deviations_hold_what_they_should(rng):
    np.testing.assert_allclose(SIGMAS, [0.6827, 0.9545, 0.9973], atol=1e-4)
    assert keypoint_shares(drawn(rng, 3.0, 3.0), SIGMAS) == pytest.approx(SIGMAS, abs=0.015)
    assert keypoint_shares(drawn(rng, 3.0, 3.0), LEVELS) == pytest.approx(LEVELS, abs=0.02)


def test_deviations_stated_half_as_large_hold_less(rng):
    # Within one stated deviation lies half a true one: 38 %.
    assert keypoint_shares(drawn(rng, 2.0, 1.0), SIGMAS[:1]) == pytest.approx([0.383], abs=0.015)


def detection(keypoints: np.ndarray) -> Detection:
    return Detection(PLATE, 0.9, np.zeros(4), keypoints, np.ones(8), np.full((8, 2), 2.0))


def test_keypoints_are_compared_at_the_best_symmetry(catalogue, rng):
    model = catalogue[PLATE]
    turned = POSE @ toy_symmetries()[PLATE].discrete[1]
    pixels = CAMERA.project(se3.act(turned, model.keypoints)) + np.array([3.0, 4.0])
    found = FoundObject(CAMERA, Instance(PLATE, POSE), detection(pixels))
    errors = keypoint_errors(found, model.keypoints, model.symmetries.transforms())
    np.testing.assert_allclose(errors.errors, np.tile([3.0, 4.0], (8, 1)), atol=1e-9)
    np.testing.assert_allclose(errors.pixels, 5.0)
    row = keypoint_table({PLATE: [errors]}, catalogue).to_plain()["rows"][0]
    assert (row["median px"], row["stated px"]) == (pytest.approx(5), 2)
    # 3 px are 1.5 and 4 px are 2 stated deviations; the latter is inside 2 but for rounding.
    assert row["inside 1 %"] == 0
    assert row["inside 3 %"] == 100


def judged(rng, obj_id: int, spread: np.ndarray, stated: np.ndarray, symmetry: bool = False) -> ObjectErrors:
    estimated = se3.plus(POSE, spread * rng.normal(size=6))
    if symmetry:
        estimated = POSE @ random_symmetry(toy_symmetries()[obj_id], rng)
        estimated = se3.plus(estimated, spread * rng.normal(size=6))
    estimate = ObjectEstimate(obj_id, 0.9, estimated, np.diag(stated**2))
    return ObjectErrors(RECORD, Instance(obj_id, POSE), estimate, mssd=0.001)


SPREAD = np.repeat([0.01, 0.002], 3)


@pytest.mark.parametrize(("obj_id", "symmetry"), [(BRACKET, False), (PLATE, True)])
def test_honest_covariances_hold_95_percent(catalogue, rng, obj_id, symmetry):
    errors = [judged(rng, obj_id, SPREAD, SPREAD, symmetry) for _ in range(500)]
    assert pose_shares(errors, catalogue, np.array([0.5, 0.95])) == pytest.approx([0.5, 0.95], abs=0.06)
    row = pose_calibration_table({obj_id: errors}, catalogue).to_plain()["rows"][0]
    assert row["inside 95 %"] == row["near inside 95 %"] == pytest.approx(95, abs=3)


def test_covariances_a_third_as_wide_hold_little(catalogue, rng):
    errors = [judged(rng, BRACKET, SPREAD, SPREAD / 3) for _ in range(300)]
    assert pose_shares(errors, catalogue, np.array([0.95]))[0] < 0.2


def test_the_best_symmetry_is_that_of_the_estimate(catalogue, rng):
    error = judged(rng, PLATE, 0 * SPREAD, SPREAD, symmetry=True)
    assert error.estimate is not None
    np.testing.assert_allclose(best_symmetry(error, catalogue), error.estimate.camera_from_object, atol=1e-9)


def test_poses_without_covariance_are_left_out(catalogue):
    plain = ObjectErrors(RECORD, Instance(PLATE, POSE), ObjectEstimate(PLATE, 0.9, POSE))
    assert with_covariance([plain, ObjectErrors(RECORD, Instance(PLATE, POSE))]) == []
    assert pose_calibration_table({PLATE: [plain]}, catalogue).rows == ()
    assert np.isnan(pose_shares([], catalogue, LEVELS)).all()
