"""Which of a detector's keypoints are taken as observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.matching.keypoints import keypoints_of
from multicam.types import Detection, ObjectEstimate
from tests.toy_objects import BRACKET, PEG

MATRIX = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])


def estimate(obj_id: int, pixels: np.ndarray) -> ObjectEstimate:
    seen = Detection(obj_id, 0.9, np.zeros(4), pixels, np.ones(len(pixels)), np.full(pixels.shape, 2.0))
    return ObjectEstimate(obj_id, 0.9, np.eye(4), None, seen)


def test_keypoints_that_are_no_numbers_are_left_out(catalogue: Catalogue) -> None:
    pixels = np.arange(16.0).reshape(8, 2)
    pixels[3, 1] = np.nan
    found = keypoints_of(estimate(BRACKET, pixels), MATRIX, catalogue)
    points = catalogue[BRACKET].keypoints
    assert found is not None
    assert points is not None
    np.testing.assert_array_equal(found.points, np.delete(points, 3, axis=0))
    np.testing.assert_array_equal(found.pixels, np.delete(pixels, 3, axis=0))
    assert found.std.shape == (7, 2)
    assert keypoints_of(estimate(BRACKET, np.full((8, 2), np.nan)), MATRIX, catalogue) is None


def test_without_detection_camera_or_a_fixed_turn_there_are_none(catalogue: Catalogue) -> None:
    seen = estimate(BRACKET, np.ones((8, 2)))
    assert keypoints_of(seen, MATRIX, catalogue) is not None
    assert keypoints_of(replace(seen, detection=None), MATRIX, catalogue) is None
    assert keypoints_of(seen, None, catalogue) is None
    assert catalogue[PEG].symmetries.axes
    assert keypoints_of(estimate(PEG, np.ones((8, 2))), MATRIX, catalogue) is None
