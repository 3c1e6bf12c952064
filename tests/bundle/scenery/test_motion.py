from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Matches, find_features, match_features
from multicam.bundle.scenery.motion import SeenMotion, see_motion
from multicam.geometry import se3, so3
from tests.bundle.scenery.room import BOX, CAMERA, TABLE, WALL, draw, standing

CONFIG = SceneryConfig()
CAMERAS = [standing(angle) for angle in (-0.2, 0.15)]
TRUE = se3.inverse(CAMERAS[0]) @ CAMERAS[1]


def matched(first: np.ndarray, second: np.ndarray) -> Matches:
    """Matches of two pictures."""
    return match_features(*(find_features(image, CAMERA, CONFIG) for image in (first, second)), CONFIG)


@cache
def room(*surfaces: int) -> Matches:
    """Matches of two views of some surfaces."""
    return matched(*(draw(each, surfaces) for each in CAMERAS))


def errors(seen: SeenMotion) -> tuple[float, float]:
    """Radians of turn and of direction."""
    turn = se3.minus(seen.first_from_second, TRUE)[:3]
    cosine = seen.first_from_second[:3, 3] @ TRUE[:3, 3] / np.linalg.norm(TRUE[:3, 3])
    return float(np.linalg.norm(turn)), float(np.arccos(min(cosine, 1)))


def test_a_room_shows_turn_and_direction() -> None:
    seen = see_motion(room(TABLE, WALL, BOX), CONFIG)
    assert seen is not None and seen.matches > 100
    turn, direction = errors(seen)
    assert turn < 0.012 and direction < 0.02
    assert np.linalg.norm(seen.first_from_second[:3, 3]) == pytest.approx(1)
    sure = np.sqrt(np.diag(seen.covariance))
    assert (sure[:3] >= CONFIG.rotation_std).all() and (sure[3:] >= CONFIG.direction_std).all()
    assert (sure < 0.04).all()


def test_motions_of_other_lengths_agree_and_other_turns_and_directions_do_not() -> None:
    seen = see_motion(room(TABLE, WALL, BOX), CONFIG)
    assert seen is not None
    longer, turned, aside = TRUE.copy(), se3.plus(TRUE, np.array([0, 0.2, 0, 0, 0, 0])), TRUE.copy()
    longer[:3, 3] *= 2
    aside[:3, 3] = so3.exp(np.array([0, 0, 0.4])) @ aside[:3, 3]
    here = np.eye(4)
    here[:3, :3] = TRUE[:3, :3]
    sure = np.tile(1e-6 * np.eye(6), (5, 1, 1))
    poses = np.array([TRUE, longer, turned, aside, here])
    assert seen.agrees(poses, sure).tolist() == [True, True, False, False, False]
    # Whoever is unsure enough agrees with everything.
    assert seen.agrees(poses[2:4], 1e5 * sure[2:4]).all()


def test_one_plane_has_two_motions_and_the_wrong_one_is_not_taken() -> None:
    seen = see_motion(room(TABLE), CONFIG)
    assert seen is None or max(errors(seen)) < 0.08


def test_things_that_moved_between_the_pictures_are_outvoted() -> None:
    first, second = (draw(each) for each in CAMERAS)
    # A quarter of the second picture is from another place.
    second[:, :80] = draw(se3.plus(CAMERAS[1], np.array([0, 0, 0, 0.2, 0.1, 0])))[:, :80]
    seen = see_motion(matched(first, second), CONFIG)
    assert seen is not None and max(errors(seen)) < 0.03


def test_matches_that_mean_nothing_show_no_motion(rng: np.random.Generator) -> None:
    matches = room(TABLE, WALL, BOX)
    assert see_motion(Matches(matches.first, rng.permutation(matches.second), matches.std), CONFIG) is None


def test_other_surfaces_in_each_picture_show_no_motion() -> None:
    assert see_motion(matched(draw(CAMERAS[0], (WALL,)), draw(CAMERAS[1], (TABLE,))), CONFIG) is None


def test_a_motion_must_fit_enough_matches() -> None:
    matches = room(TABLE, WALL, BOX)
    seen = see_motion(matches, CONFIG)
    assert seen is not None
    for least, believed in ((seen.matches, True), (seen.matches + 1, False), (len(matches) + 1, False)):
        assert (see_motion(matches, replace(CONFIG, least_matches=least)) is not None) is believed


def test_the_same_pictures_show_the_same_motion() -> None:
    matches = room(TABLE, WALL, BOX)
    one, two = (see_motion(matches, CONFIG) for _ in range(2))
    assert one is not None and two is not None
    assert np.array_equal(one.first_from_second, two.first_from_second)


def test_two_cameras_at_one_place_show_no_direction() -> None:
    """Any direction fits matches that have not moved."""
    features = find_features(draw(standing(0.1)), CAMERA, SceneryConfig(features=200))
    assert see_motion(match_features(features, features, CONFIG), CONFIG) is None
