"""Compiled comparison of poses against plain NumPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from multicam.geometry import se3, so3
from multicam.matching.compare import difference, fuse, one_to_one, pair_up, refit, relative_poses, squared_norms, turn_angle
from tests.close import assert_close
from tests.strategies import directions, rotations, seeds


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


@given(seeds(), st.integers(0, 30))
def test_one_to_one_keeps_what_is_best_both_ways(rng: np.random.Generator, count: int) -> None:
    owner = np.sort(rng.integers(4, size=count))
    reference, query = rng.integers(3, size=(2, count))
    # Few values, so that some are equal: the last of them counts.
    gain = rng.integers(4, size=count).astype(float)
    found = np.empty(count, dtype=np.bool_)
    one_to_one(owner, reference, query, gain, found)

    def is_last_best(n: int, side: np.ndarray) -> bool:
        rivals = np.flatnonzero((owner == owner[n]) & (side == side[n]))
        return bool(max(rivals, key=lambda m: (gain[m], m)) == n)

    assert found.tolist() == [is_last_best(n, reference) and is_last_best(n, query) for n in range(count)]


@given(seeds(), st.integers(0, 8), st.integers(0, 8))
def test_pairs_are_those_of_one_class_sorted_by_frames(rng: np.random.Generator, references: int, queries: int) -> None:
    frame = np.sort(rng.integers(3, size=references)), np.sort(rng.integers(3, size=queries))
    obj_id = rng.integers(2, size=references), rng.integers(2, size=queries)
    allowed = rng.uniform(size=(references, queries)) < 0.7
    pairs = [(i, j) for i in range(references) for j in range(queries) if allowed[i, j] and obj_id[0][i] == obj_id[1][j]]
    pairs.sort(key=lambda pair: (frame[0][pair[0]], frame[1][pair[1]]))
    frames = [(frame[0][i], frame[1][j]) for i, j in pairs]
    numbers = {pair: n for n, pair in enumerate(dict.fromkeys(frames))}
    reference, query, link, rivals = pair_up(frame[0], obj_id[0], frame[1], obj_id[1], allowed)
    assert list(zip(reference.tolist(), query.tolist(), strict=True)) == pairs
    assert link.tolist() == [numbers[pair] for pair in frames]
    assert rivals.tolist() == [
        max(
            sum(other[side] == pair[side] and frames[m] == frames[n] for m, other in enumerate(pairs))
            for side in (0, 1)
        )
        for n, pair in enumerate(pairs)
    ]


def test_relative_poses_carry_the_covariances_of_both_objects(rng: np.random.Generator) -> None:
    poses, twins = (se3.random(rng, 2), se3.random(rng, 3)), se3.random(rng, 2)
    root = rng.normal(size=(5, 6, 6))
    covariance = root @ np.swapaxes(root, -1, -2)
    a, b, symmetry = np.array([0, 1, 1]), np.array([2, 0, 1]), np.array([0, 1, 0])
    pose, found, move = np.empty((3, 4, 4)), np.empty((3, 6, 6)), np.empty((3, 6, 6))
    relative_poses(a, b, symmetry, poses[0], covariance[:2], poses[1], covariance[2:], twins, pose, found, move)
    twin = poses[1][b] @ se3.inverse(twins[symmetry])
    of_twin, of_query = se3.adjoint(twin), se3.adjoint(poses[1][b])
    assert_close(pose, poses[0][a] @ se3.inverse(twin), atol=1e-12)
    assert_close(move, of_twin, atol=1e-12)
    expected = of_twin @ covariance[:2][a] @ np.swapaxes(of_twin, -1, -2)
    assert_close(found, expected + of_query @ covariance[2:][b] @ np.swapaxes(of_query, -1, -2), atol=1e-9)


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
