import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.evaluation.pose_error import add, add_s, mspd, mssd
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from tests.strategies import transforms
from tests.toy_objects import PEG, PLATE, random_symmetry, toy_meshes, toy_symmetries

POINTS = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 2, 0], [0, -2, 0]])
HALF_TURN = se3.from_parts(so3.exp(np.array([0, 0, np.pi])), np.zeros(3))
IDENTITY = np.eye(4)


def shifted(*translation: float) -> np.ndarray:
    return se3.from_parts(np.eye(3), np.array(translation, dtype=np.float64))


def test_add_of_a_shift_is_its_length():
    assert add(shifted(0.03, 0.04, 0), IDENTITY, POINTS) == pytest.approx(0.05)


def test_a_half_turn_counts_for_add_and_not_for_add_s():
    # Two points move by 2 and two by 4: the mean is 3. As a set the four points stay where they are.
    assert add(HALF_TURN, IDENTITY, POINTS) == pytest.approx(3.0)
    assert add_s(HALF_TURN, IDENTITY, POINTS) == pytest.approx(0.0, abs=1e-12)


def test_add_s_goes_from_true_points_to_the_nearest_estimated_ones():
    # True points 0, 10, 10; estimated 9, 19, 19. From the truth: (9 + 1 + 1) / 3; the other way: (1 + 9 + 9) / 3.
    points = np.array([[0.0, 0, 0], [10, 0, 0], [10, 0, 0]])
    assert add_s(shifted(9, 0, 0), IDENTITY, points) == pytest.approx(11 / 3)


def test_mssd_is_the_worst_point_at_the_best_symmetry():
    both = np.stack((IDENTITY, HALF_TURN))
    assert mssd(HALF_TURN, IDENTITY, IDENTITY[None], POINTS) == pytest.approx(4.0)
    assert mssd(HALF_TURN, IDENTITY, both, POINTS) == pytest.approx(0.0, abs=1e-12)
    assert mssd(shifted(0, 0, 0.1) @ HALF_TURN, IDENTITY, both, POINTS) == pytest.approx(0.1)


def test_mspd_is_the_worst_pixel_at_the_best_symmetry():
    camera = Camera.from_focal(500.0, 640, 480)
    points = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    away = shifted(0, 0, 2)
    # At depth 2 a shift of 20 mm is 500 * 0.02 / 2 = 5 px for both points.
    assert mspd(shifted(0.02, 0, 2), away, IDENTITY[None], points, camera) == pytest.approx(5.0)
    # At depth 1 instead of 2 the second point moves from 500 * 0.05 = 25 px to 50 px.
    assert mspd(shifted(0, 0, 1), away, IDENTITY[None], points, camera) == pytest.approx(25.0)


def test_mspd_of_a_pose_behind_the_camera_is_infinite():
    camera = Camera.from_focal(500.0, 640, 480)
    assert mspd(shifted(0, 0, -1), shifted(0, 0, 1), IDENTITY[None], POINTS, camera) == np.inf


@settings(max_examples=30)
@given(transforms(), st.sampled_from((PLATE, PEG)), st.integers(0, 2**32 - 1))
def test_a_pose_times_a_symmetry_has_no_error(pose, obj_id, seed):
    symmetries, points = toy_symmetries()[obj_id], toy_meshes()[obj_id].vertices
    turned = pose @ random_symmetry(symmetries, np.random.default_rng(seed))
    # A continuous symmetry is cut into 64 turns: half a turn's path at the rim remains.
    remains = 0.02 * np.pi / 64 + 1e-9 if symmetries.axes else 1e-9
    assert mssd(turned, pose, symmetries.transforms(), points) <= remains
    assert add_s(turned, pose, points) <= remains


@settings(max_examples=30)
@given(transforms(), transforms(), transforms())
def test_moving_the_camera_changes_no_distance(estimated, true, move):
    points = toy_meshes()[PLATE].vertices
    symmetries = toy_symmetries()[PLATE].transforms()
    assert add(move @ estimated, move @ true, points) == pytest.approx(add(estimated, true, points), abs=1e-9)
    assert add_s(move @ estimated, move @ true, points) == pytest.approx(add_s(estimated, true, points), abs=1e-9)
    moved = mssd(move @ estimated, move @ true, symmetries, points)
    assert moved == pytest.approx(mssd(estimated, true, symmetries, points), abs=1e-9)


@settings(max_examples=30)
@given(transforms(), transforms(), st.sampled_from((PLATE, PEG)))
def test_leaving_a_symmetry_early_changes_nothing(estimated, true, obj_id):
    points, symmetries = toy_meshes()[obj_id].vertices, toy_symmetries()[obj_id].transforms()
    placed = se3.act(estimated, points)
    every = np.linalg.norm(placed - se3.act(true @ symmetries, points), axis=-1).max(axis=-1)
    assert mssd(estimated, true, symmetries, points) == pytest.approx(every.min())
    camera = Camera.from_focal(500.0, 640, 480)
    in_front = shifted(0, 0, 30)
    pixels = camera.project(se3.act(in_front @ estimated, points))
    every = np.linalg.norm(pixels - camera.project(se3.act(in_front @ true @ symmetries, points)), axis=-1).max(axis=-1)
    assert mspd(in_front @ estimated, in_front @ true, symmetries, points, camera) == pytest.approx(every.min())


def test_a_lens_with_distortion_is_refused():
    camera = Camera(np.diag([500.0, 500, 1]), 640, 480, (0.1, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="ideal lens"):
        mspd(IDENTITY, IDENTITY, IDENTITY[None], POINTS, camera)
