from __future__ import annotations

import numpy as np
import pytest

from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Matches, find_features, match_features
from multicam.bundle.scenery.motion import SeenMotion, see_motion
from multicam.geometry import se3, so3
from tests.bundle.scenery.room import BOX, CAMERA, TABLE, WALL, draw, standing

CONFIG = SceneryConfig()
COVARIANCE = np.diag(np.repeat([0.05, 0.04], 3) ** 2)
ANGLES = (-0.2, 0.15)


def matched(*surfaces: int, second: tuple[int, ...] | None = None) -> tuple[Matches, np.ndarray]:
    """Matches of two views of some surfaces, and the true first_from_second."""
    cameras = [standing(angle) for angle in ANGLES]
    images = draw(cameras[0], surfaces), draw(cameras[1], surfaces if second is None else second)
    features = [find_features(image, CAMERA, CONFIG) for image in images]
    return match_features(*features, CONFIG), se3.inverse(cameras[0]) @ cameras[1]


def known(rng: np.random.Generator, true: np.ndarray) -> np.ndarray:
    return se3.plus(true, rng.multivariate_normal(np.zeros(6), COVARIANCE))


def errors(seen: SeenMotion, true: np.ndarray) -> tuple[float, float]:
    """Radians of turn and of direction."""
    turn = se3.minus(seen.first_from_second, true)[:3]
    cosine = seen.first_from_second[:3, 3] @ true[:3, 3] / np.linalg.norm(true[:3, 3])
    return float(np.linalg.norm(turn)), float(np.arccos(min(cosine, 1)))


def test_a_room_shows_turn_and_direction_far_better_than_they_were_known(rng: np.random.Generator) -> None:
    matches, true = matched(TABLE, WALL, BOX)
    for _ in range(3):
        seen = see_motion(matches, known(rng, true), COVARIANCE, CONFIG)
        assert seen is not None and seen.matches > 100
        turn, direction = errors(seen, true)
        assert turn < 0.012 and direction < 0.02
        assert np.linalg.norm(seen.first_from_second[:3, 3]) == pytest.approx(1)
        sure = np.sqrt(np.diag(seen.covariance))
        assert (sure[:3] >= CONFIG.rotation_std).all() and (sure[3:] >= CONFIG.direction_std).all()
        assert (sure < 0.04).all()


def test_one_plane_has_two_motions_and_the_wrong_one_is_never_taken(rng: np.random.Generator) -> None:
    matches, true = matched(TABLE)
    found = [see_motion(matches, known(rng, true), COVARIANCE, CONFIG) for _ in range(5)]
    assert all(max(errors(seen, true)) < 0.08 for seen in found if seen is not None)


def test_things_that_moved_between_the_pictures_are_outvoted(rng: np.random.Generator) -> None:
    cameras = [standing(angle) for angle in ANGLES]
    images = [draw(each) for each in cameras]
    # A quarter of the second picture is from another place.
    images[1][:, :80] = draw(se3.plus(cameras[1], np.array([0, 0, 0, 0.2, 0.1, 0])))[:, :80]
    matches = match_features(*(find_features(image, CAMERA, CONFIG) for image in images), CONFIG)
    true = se3.inverse(cameras[0]) @ cameras[1]
    seen = see_motion(matches, known(rng, true), COVARIANCE, CONFIG)
    assert seen is not None and max(errors(seen, true)) < 0.03


def test_matches_that_mean_nothing_show_no_motion(rng: np.random.Generator) -> None:
    matches, true = matched(TABLE, WALL, BOX)
    shuffled = Matches(matches.first, rng.permutation(matches.second), matches.std)
    assert see_motion(shuffled, known(rng, true), COVARIANCE, CONFIG) is None


def test_other_surfaces_in_each_picture_show_no_motion(rng: np.random.Generator) -> None:
    matches, true = matched(WALL, second=(TABLE,))
    assert see_motion(matches, known(rng, true), COVARIANCE, CONFIG) is None


def test_a_motion_far_from_the_known_one_is_not_seen() -> None:
    matches, true = matched(TABLE, WALL, BOX)
    other = se3.plus(true, np.array([0, 0.6, 0, 0, 0, 0]))
    seen = see_motion(matches, other, COVARIANCE, CONFIG)
    assert seen is None or errors(seen, other)[0] < 6 * 0.05


def test_the_same_pictures_show_the_same_motion(rng: np.random.Generator) -> None:
    matches, true = matched(TABLE, WALL, BOX)
    start = known(rng, true)
    one, two = (see_motion(matches, start, COVARIANCE, CONFIG) for _ in range(2))
    assert one is not None and two is not None
    assert np.array_equal(one.first_from_second, two.first_from_second)


def test_two_cameras_at_one_place_show_no_direction(rng: np.random.Generator) -> None:
    camera = standing(0.1)
    features = find_features(draw(camera), CAMERA, CONFIG)
    matches = match_features(features, features, CONFIG)
    assert see_motion(matches, np.eye(4), COVARIANCE, CONFIG) is None
    nearly = se3.exp(np.array([0.01, 0, 0, 0.02, 0, 0]))
    seen = see_motion(matches, nearly, COVARIANCE, CONFIG)
    # Any direction fits; the turn is none.
    assert seen is None or np.abs(so3.log(seen.first_from_second[:3, :3])).max() < 0.01
