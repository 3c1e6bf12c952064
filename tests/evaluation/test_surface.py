import numpy as np
import pytest

from multicam.evaluation.surface import DELTA, TAUS, distances, drawn_distances, vsd
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from tests.toy_objects import PLATE, toy_meshes

NEAR_5_PERCENT = 0
"""Index of the tightest tolerance."""


def row(*values: float) -> np.ndarray:
    """Distances of a picture of one line."""
    return np.array([values], dtype=np.float64)


def test_the_same_surface_has_no_error():
    drawn = row(0, 1, 1, 1)
    assert vsd(drawn, drawn, row(2, 1, 1, 1), diameter=0.1).tolist() == [0] * len(TAUS)


def test_pixels_of_one_pose_only_count_fully():
    # True at pixels 0 and 1, estimated at 1 and 2: of three, two are in one only.
    errors = vsd(row(0, 1, 1, 0), row(1, 1, 0, 0), row(1, 1, 1, 1), diameter=0.1)
    assert errors == pytest.approx([2 / 3] * len(TAUS))


def test_a_shift_in_depth_counts_from_its_tolerance_on():
    # 12 mm are 12 % of the diameter: too much for 5 and 10 %, little enough for 15 % and more.
    errors = vsd(row(1.012, 1.012), row(1.0, 1.0), row(1.0, 1.0), diameter=0.1)
    assert errors.tolist() == [1, 1] + [0] * 8


def test_a_shift_of_exactly_the_tolerance_counts():
    assert vsd(row(1.5), row(1.0), row(1.0), diameter=10.0)[NEAR_5_PERCENT] == 1


def test_what_something_hides_does_not_count():
    # At pixel 1 something stands before the object, true and estimated: there neither is visible.
    errors = vsd(row(1, 1), row(1, 0), row(1, 0.5), diameter=0.1)
    assert errors.tolist() == [0] * len(TAUS)


def test_a_surface_just_behind_the_measured_one_is_visible():
    hidden, seen = 1 + 1.1 * DELTA, 1 + 0.9 * DELTA
    assert vsd(row(0, 1), row(seen, 1), row(1, 1), diameter=0.1)[-1] == 0.5
    assert vsd(row(0, 1), row(hidden, 1), row(1, 1), diameter=0.1)[-1] == 0


def test_where_depth_is_missing_the_object_is_taken_as_visible():
    assert vsd(row(0, 1), row(1, 1), row(0, 1), diameter=0.1)[-1] == 0.5


def test_where_the_true_surface_is_visible_the_estimated_one_counts_even_behind_it():
    # The estimate lies 50 mm behind what was measured; it is compared there all the same.
    errors = vsd(row(1.05), row(1.0), row(1.0), diameter=0.2)
    assert errors.tolist() == [1] * 5 + [0] * 5


def test_an_object_visible_in_neither_pose_is_wrong():
    assert vsd(row(0, 0), row(2, 2), row(1, 1), diameter=0.1).tolist() == [1] * len(TAUS)


def test_distance_is_along_the_ray():
    camera = Camera(np.array([[100.0, 0, 0], [0, 100, 0], [0, 0, 1]]), 101, 1)
    depth = np.zeros((1, 101), dtype=np.float32)
    depth[0, 0] = depth[0, 100] = 2.0
    found = distances(depth, camera)
    assert found[0, 0] == pytest.approx(2)
    assert found[0, 100] == pytest.approx(2 * np.sqrt(2))
    assert found[0, 50] == 0


def test_a_brick_moved_by_half_its_width_keeps_a_third():
    mesh, camera = toy_meshes()[PLATE], Camera.from_focal(600.0, 320, 240)
    true = se3.exp(np.array([0, 0, 0, 0, 0, 0.8]))
    moved = se3.exp(np.array([0, 0, 0, 0.06, 0, 0.8]))
    first, second = (drawn_distances(mesh, camera, pose) for pose in (true, moved))
    scene = distances(np.full(first.shape, 0.78, dtype=np.float32), camera)
    errors = vsd(second, first, scene, diameter=0.134)
    # 120 mm wide, moved by 60: a third of the union is common, its depths all alike.
    assert errors == pytest.approx(2 / 3, abs=0.02)
