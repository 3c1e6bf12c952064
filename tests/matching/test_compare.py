"""Compiled comparison of poses against plain NumPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from multicam.geometry import se3, so3
from multicam.matching.compare import accumulate, difference_all, turn_angle
from tests.close import assert_close
from tests.strategies import directions, rotations


@given(rotations(), directions())
def test_closest_turn_is_the_best_of_all_angles(rotation: np.ndarray, direction: np.ndarray) -> None:
    angles = np.linspace(-np.pi, np.pi, 721)
    traces = np.trace(rotation @ so3.exp(angles[:, None] * direction), axis1=-2, axis2=-1)
    found = turn_angle(rotation, direction)
    assert np.trace(rotation @ so3.exp(found * direction)) >= traces.max() - 1e-9


def test_a_difference_without_an_axis_is_that_of_the_poses(rng: np.random.Generator) -> None:
    pose, measured, found = se3.random(rng, 5), se3.random(rng, 5), np.empty((5, 4, 4))
    difference_all(pose, measured, np.zeros((5, 6)), found)
    assert_close(found, se3.inverse(pose) @ measured, atol=1e-12)


def test_turns_about_the_axis_are_no_difference(rng: np.random.Generator) -> None:
    pose, found = se3.random(rng, 5), np.empty((5, 4, 4))
    direction, point = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    axis = np.concatenate((direction, np.cross(point, direction)), axis=1)
    turned = se3.plus(pose, rng.uniform(-3, 3, (5, 1)) * axis)
    difference_all(pose, turned, axis, found)
    assert_close(found, np.broadcast_to(np.eye(4), (5, 4, 4)), atol=1e-12)


def test_values_are_summed_by_owner(rng: np.random.Generator) -> None:
    owner, values, found = np.array([0, 0, 2, 2, 2]), rng.normal(size=(5, 6, 6)), np.zeros((3, 6, 6))
    accumulate(owner, values, found)
    assert_close(found, np.stack((values[:2].sum(0), np.zeros((6, 6)), values[2:].sum(0))), atol=1e-12)
