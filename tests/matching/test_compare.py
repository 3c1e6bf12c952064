"""Compiled comparison of poses against plain NumPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from multicam.geometry import se3, so3
from multicam.matching.compare import difference, fuse, refit, squared_norms, turn_angle
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
    for n in range(5):
        difference(pose[n], measured[n], np.zeros(6), found[n])
    assert_close(found, se3.inverse(pose) @ measured, atol=1e-12)


def test_turns_about_the_axis_are_no_difference(rng: np.random.Generator) -> None:
    pose, found = se3.random(rng, 5), np.empty((5, 4, 4))
    direction, point = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    axis = np.concatenate((direction, np.cross(point, direction)), axis=1)
    turned = se3.plus(pose, rng.uniform(-3, 3, (5, 1)) * axis)
    for n in range(5):
        difference(pose[n], turned[n], axis[n], found[n])
    assert_close(found, np.broadcast_to(np.eye(4), (5, 4, 4)), atol=1e-12)


def test_a_refit_is_the_weighted_mean_of_what_agrees(rng: np.random.Generator) -> None:
    root = rng.normal(size=(4, 6, 6))
    information = root @ np.swapaxes(root, -1, -2)
    # The middle pose has no residual, the first and the last have two and three.
    owner, member, weight = np.array([0, 0, 2, 2, 2]), np.array([3, 1, 0, 1, 2]), rng.uniform(1, 2, size=5)
    residual, pose = 0.1 * rng.normal(size=(5, 6)), se3.random(rng, 3)
    moved, covariance, determinant = np.empty((3, 4, 4)), np.empty((3, 6, 6)), np.empty(3)
    assert refit(pose, owner, residual, weight, information, member, moved, covariance, determinant)
    for h in (0, 2):
        own = owner == h
        normal = np.einsum("n,nij->ij", weight[own], information[member[own]])
        right = np.einsum("n,nij,nj->i", weight[own], information[member[own]], residual[own])
        assert_close(covariance[h], np.linalg.inv(normal), atol=1e-9)
        assert_close(se3.minus(moved[h], pose[h]), np.linalg.solve(normal, right), atol=1e-9)
        assert np.isclose(determinant[h], np.linalg.slogdet(normal)[1])
    assert np.array_equal(moved[1], pose[1]) and np.array_equal(covariance[1], np.eye(6)) and determinant[1] == 0


def test_squared_norms_take_the_matrices_of_their_members(rng: np.random.Generator) -> None:
    information, residual, member = rng.normal(size=(3, 6, 6)), rng.normal(size=(4, 6)), np.array([2, 0, 1, 2])
    found = np.empty(4)
    squared_norms(residual, information, member, found)
    assert_close(found, np.einsum("ni,nij,nj->n", residual, information[member], residual), atol=1e-12)


def test_fusing_is_the_weighted_mean_of_both_poses(rng: np.random.Generator) -> None:
    root = 0.01 * rng.normal(size=(5, 6, 6))
    covariance = root @ np.swapaxes(root, -1, -2)
    before, row = se3.random(rng, 3), np.array([2, 0])
    noise = 1e-4 * rng.normal(size=(2, 6))
    pose, found = before.copy(), covariance[:3].copy()
    assert fuse(pose, found, row, se3.plus(before[row], noise), covariance[3:])
    information = np.linalg.inv(covariance[:3][row]), np.linalg.inv(covariance[3:])
    joint = np.linalg.inv(information[0] + information[1])
    assert_close(se3.minus(pose[row], before[row]), (joint @ information[1] @ noise[..., None])[..., 0], atol=1e-9)
    assert_close(found[row], joint, atol=1e-12)
    assert np.array_equal(pose[1], before[1]) and np.array_equal(found[1], covariance[1])


def test_what_has_no_covariance_is_not_fused() -> None:
    pose, covariance = np.eye(4)[None], np.zeros((1, 6, 6))
    assert not fuse(pose.copy(), covariance, np.array([0]), pose, covariance)
