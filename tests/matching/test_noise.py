from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from multicam.errors import DataError
from multicam.geometry import se3
from multicam.matching.noise import NoiseConfig, free_turns, geometric_covariance
from multicam.matching.observations import observe
from multicam.types import ObjectEstimate, View
from tests.strategies import rotations
from tests.toy_objects import BRACKET, PEG, toy_catalogue

CUBE = 0.05 * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
CONFIG = NoiseConfig(pixel_std=2.0, depth_ratio=5.0)


def covariance_of(pose: np.ndarray, corners: np.ndarray = CUBE, focal: float = 500.0) -> np.ndarray:
    return geometric_covariance(pose[None], corners[None], np.array([focal]), CONFIG)[0]


@given(rotations())
def test_the_centre_is_known_to_pixels_across_and_worse_along_the_ray(rotation: np.ndarray) -> None:
    centre = np.array([0.3, -0.2, 0.9])
    distance = np.linalg.norm(centre)
    covariance = rotation @ covariance_of(se3.from_parts(rotation, centre))[3:, 3:] @ rotation.T
    ray = centre / distance
    across = np.cross(ray, [0, 1.0, 0]) / np.linalg.norm(np.cross(ray, [0, 1.0, 0]))
    assert ray @ covariance @ ray == pytest.approx((5 * 2 * distance / 500) ** 2)
    assert across @ covariance @ across == pytest.approx((2 * distance / 500) ** 2)


def test_noise_grows_with_distance_and_shrinks_with_focal_length_and_size() -> None:
    near, far = se3.from_parts(np.eye(3), np.array([0, 0, 0.5])), se3.from_parts(np.eye(3), np.array([0, 0, 1.0]))
    assert np.allclose(covariance_of(far), 4 * covariance_of(near))
    assert np.allclose(covariance_of(near, focal=1000.0), covariance_of(near) / 4)
    assert np.allclose(covariance_of(near, 2 * CUBE)[:3, :3], covariance_of(near)[:3, :3] / 4)


@given(rotations())
def test_the_choice_of_the_object_frame_does_not_matter(rotation: np.ndarray) -> None:
    pose = se3.from_parts(rotation, np.array([0.1, 0.2, 0.7]))
    object_from_other = se3.from_parts(rotation.T, np.array([0.03, -0.02, 0.04]))
    moved = covariance_of(pose @ object_from_other, se3.act(se3.inverse(object_from_other), CUBE))
    adjoint = se3.adjoint(object_from_other)
    expected = covariance_of(pose)
    assert np.allclose(adjoint @ moved @ adjoint.T, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


def test_a_free_turn_moves_no_point_of_its_axis() -> None:
    model = toy_catalogue()[PEG]
    covariance, axis = free_turns(model), model.symmetries.axes[0]
    on_axis = axis.offset + 0.3 * axis.direction
    moved_by = np.concatenate((-np.cross(np.eye(3), on_axis), np.eye(3)), axis=-1)
    assert np.allclose(moved_by @ covariance @ moved_by.T, 0)
    assert np.sqrt(axis.direction @ covariance[:3, :3] @ axis.direction) == pytest.approx(np.pi / np.sqrt(3))
    assert not np.any(free_turns(toy_catalogue()[BRACKET]))


def test_stated_covariances_are_kept_and_missing_ones_modelled() -> None:
    pose = se3.from_parts(np.eye(3), np.array([0, 0, 0.8]))
    stated = ObjectEstimate(BRACKET, 0.9, pose, np.diag(np.arange(1, 7) * 1e-4))
    silent = ObjectEstimate(BRACKET, 1.0, pose)
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    known, unknown = View("a", (stated, silent), matrix), View("b", (silent,))
    found = observe((known, unknown), toy_catalogue(), NoiseConfig(assumed_focal=1000.0))
    assert found.frame.tolist() == [0, 0, 1]
    assert np.allclose(found.covariance[0], stated.covariance)
    assert np.allclose(found.covariance[1], 4 * found.covariance[2])
    assert found.score.tolist() == [0.9, 0.98, 0.98]


def test_an_unknown_class_is_named() -> None:
    view = View("a", (ObjectEstimate(77, 1.0, np.eye(4)),))
    with pytest.raises(DataError, match="unknown object class 77"):
        observe((view,), toy_catalogue(), NoiseConfig())


def test_a_covariance_without_a_direction_is_refused() -> None:
    flat = ObjectEstimate(BRACKET, 1.0, np.eye(4), np.diag([1.0, 1, 1, 1, 1, 0]))
    with pytest.raises(DataError, match="object 1 in view left"):
        observe((View("left", (flat,)),), toy_catalogue(), NoiseConfig())


def test_noise_must_be_positive() -> None:
    with pytest.raises(ValueError, match="positive"):
        NoiseConfig(pixel_std=0.0)
