from __future__ import annotations

import numpy as np

from multicam.bundle.epipolar import EpipolarFactor
from multicam.bundle.robust import Student
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import find_features, match_features
from multicam.geometry.camera import Camera
from tests.bundle.scenery.room import CAMERA, draw, standing

CONFIG = SceneryConfig()


def test_points_of_a_moved_picture_are_matched_where_they_went() -> None:
    image = draw(standing(0.1))
    first = find_features(image[:, :-20], Camera.from_focal(300.0, 300, 240), CONFIG)
    second = find_features(image[:, 20:], Camera.from_focal(300.0, 300, 240), CONFIG)
    matches = match_features(first, second, CONFIG)
    shift = (matches.first - matches.second) * 300
    assert len(matches) > 200 and np.median(np.abs(shift - [20, 0])) < 0.1
    assert np.mean(np.abs(shift - [20, 0]).max(axis=1) < 1) > 0.95
    assert np.allclose(matches.std, CONFIG.std / 300)


def test_most_matches_of_two_views_lie_on_their_epipolar_lines() -> None:
    cameras = np.array([standing(-0.1), standing(0.2)])
    matches = match_features(*(find_features(draw(each), CAMERA, CONFIG) for each in cameras), CONFIG)
    pair = np.zeros(len(matches), dtype=np.int64)
    ends = np.array([0]), np.array([1])
    factor = EpipolarFactor(*ends, pair, matches.first, matches.second, matches.std, Student(1.0, 1))
    residual, _ = factor.whitened((np.linalg.inv(cameras[0]) @ cameras[1])[None])
    assert len(matches) > 100 and np.mean(np.abs(residual) < 3) > 0.8


def test_a_picture_without_texture_has_no_match() -> None:
    blank = find_features(np.full((240, 320, 3), 90, np.uint8), CAMERA, CONFIG)
    busy = find_features(draw(standing(0.1)), CAMERA, CONFIG)
    assert len(blank.rays) == 0
    assert len(match_features(blank, busy, CONFIG)) == len(match_features(busy, blank, CONFIG)) == 0


def test_only_so_many_points_are_kept() -> None:
    few = find_features(draw(standing(0.1)), CAMERA, SceneryConfig(features=50))
    # SIFT gives a point a second time where it has two directions.
    assert 50 <= len(few.rays) < 60
