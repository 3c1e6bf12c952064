import numpy as np

from multicam.geometry.boxes import overlap


def test_overlap_of_hand_worked_boxes():
    a = np.array([[0.0, 0, 10, 10]])
    b = np.array([[0.0, 0, 10, 10], [5, 0, 15, 10], [30, 30, 40, 40], [7, 7, 7, 7]])
    np.testing.assert_allclose(overlap(a, b), [[1, 50 / 150, 0, 0]])


def test_no_boxes_overlap_nothing():
    assert overlap(np.zeros((0, 4)), np.ones((2, 4))).shape == (0, 2)
