"""Rigid transforms against the group axioms, their adjoint identity and finite differences."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from scipy.linalg import expm

from multicam.geometry import se3, so3
from tests.close import assert_close
from tests.strategies import Array, arrays, rotations, seeds, transforms, twists

STEP = 1e-6


@given(transforms(), transforms(), transforms())
def test_transforms_are_a_group(a: Array, b: Array, c: Array) -> None:
    product = a @ b
    assert_close(product[3], [0, 0, 0, 1], atol=0)
    assert_close(product[:3, :3] @ product[:3, :3].T, np.eye(3), atol=1e-12)
    assert_close(product @ c, a @ (b @ c), atol=1e-12)
    assert_close(a @ se3.inverse(a), np.eye(4), atol=1e-12)
    assert_close(se3.inverse(product), se3.inverse(b) @ se3.inverse(a), atol=1e-12)


@given(twists())
def test_exp_is_the_matrix_exponential(xi: Array) -> None:
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = so3.hat(xi[:3]), xi[3:]
    assert_close(se3.exp(xi), expm(generator), atol=1e-11)


@given(twists(np.pi - 1e-6))
def test_log_returns_what_exp_was_given(xi: Array) -> None:
    assert_close(se3.log(se3.exp(xi)), xi, atol=1e-8)


@given(transforms())
def test_exp_of_log_is_the_transform_even_at_half_a_turn(transform: Array) -> None:
    assert_close(se3.exp(se3.log(transform)), transform, atol=1e-11)


@given(transforms(), twists(np.pi - 1e-6))
def test_minus_undoes_plus(transform: Array, xi: Array) -> None:
    assert_close(se3.minus(se3.plus(transform, xi), transform), xi, atol=1e-7)


@given(transforms(), transforms())
def test_plus_undoes_minus(a: Array, b: Array) -> None:
    assert_close(se3.plus(b, se3.minus(a, b)), a, atol=1e-10)


@given(transforms(), twists())
def test_adjoint_moves_a_twist_through_a_transform(transform: Array, xi: Array) -> None:
    moved = transform @ se3.exp(xi) @ se3.inverse(transform)
    # Compared as transforms: at half a turn the twist itself has two signs.
    assert_close(se3.exp(se3.adjoint(transform) @ xi), moved, atol=1e-10)


@given(transforms(), transforms())
def test_adjoint_is_a_homomorphism(a: Array, b: Array) -> None:
    assert_close(se3.adjoint(a @ b), se3.adjoint(a) @ se3.adjoint(b), atol=1e-11)
    assert_close(se3.adjoint(se3.inverse(a)), np.linalg.inv(se3.adjoint(a)), atol=1e-9)


@given(twists(np.pi - 1e-2))
def test_left_jacobian_inverse_matches_differences(xi: Array) -> None:
    pose = se3.exp(xi)
    columns = [
        (se3.log(se3.exp(STEP * axis) @ pose) - se3.log(se3.exp(-STEP * axis) @ pose)) / (2 * STEP)
        for axis in np.eye(6)
    ]
    assert_close(se3.left_jacobian_inverse(xi), np.stack(columns, axis=-1), atol=2e-7)


@given(twists(np.pi - 1e-2))
def test_a_right_perturbation_takes_the_jacobian_at_minus_xi(xi: Array) -> None:
    pose = se3.exp(xi)
    columns = [
        (se3.log(se3.plus(pose, STEP * axis)) - se3.log(se3.plus(pose, -STEP * axis))) / (2 * STEP)
        for axis in np.eye(6)
    ]
    assert_close(se3.left_jacobian_inverse(-xi), np.stack(columns, axis=-1), atol=2e-7)


def test_left_jacobian_inverse_loses_no_digits_on_the_way_to_zero() -> None:
    """Against its power series with the numbers of Bernoulli, which is exact for small angles."""
    angles = np.logspace(-12, -1.7, 500)[:, None]
    xi = np.concatenate((angles * [0.6, -0.48, 0.64], np.ones((500, 1)) * [0.9, -0.7, 0.4]), axis=-1)
    small = np.zeros((500, 6, 6))
    small[:, :3, :3] = small[:, 3:, 3:] = so3.hat(xi[:, :3])
    small[:, 3:, :3] = so3.hat(xi[:, 3:])
    square = small @ small
    series = np.eye(6) - small / 2 + square / 12 - square @ square / 720
    assert_close(se3.left_jacobian_inverse(xi), series, atol=2e-11)


@given(twists())
def test_left_jacobian_inverse_has_no_step_where_the_series_takes_over(xi: Array) -> None:
    angle = np.linalg.norm(xi[:3])
    direction = xi[:3] / angle if angle > 0 else np.array([1.0, 0, 0])
    for threshold in (1e-4, 1e-2):
        below, above = (
            se3.left_jacobian_inverse(np.concatenate((direction * threshold * (1 + sign * 1e-9), xi[3:])))
            for sign in (-1, 1)
        )
        assert_close(below, above, atol=1e-10)


@given(transforms(), arrays(3, 5), seeds())
def test_act_maps_points_and_batches(transform: Array, point: Array, rng: np.random.Generator) -> None:
    expected = (transform @ np.append(point, 1))[:3]
    assert_close(se3.act(transform, point), expected)
    points = rng.normal(size=(7, 3))
    many = se3.random(rng, 2, 5)
    assert se3.act(many, point).shape == (2, 5, 3)
    assert_close(se3.act(many, points)[1, 3], (many[1, 3] @ np.c_[points, np.ones(7)].T)[:3].T)
    each = rng.normal(size=(2, 5, 7, 3))
    assert_close(se3.act(many, each)[1, 3], se3.act(many[1, 3], each[1, 3]))


@given(rotations(), arrays(3, 5))
def test_from_parts_sets_rotation_and_translation(rotation: Array, translation: Array) -> None:
    transform = se3.from_parts(rotation, translation)
    assert np.array_equal(transform[:3], np.c_[rotation, translation])
    assert np.array_equal(transform[3], [0, 0, 0, 1])


@given(seeds())
def test_batch_axes_lead(rng: np.random.Generator) -> None:
    xi = rng.normal(size=(2, 4, 6)) * np.array([1e-9, 1e-3, 0.1, 1])[:, None]
    for function in (se3.exp, se3.left_jacobian_inverse):
        assert_close(function(xi), np.array([[function(v) for v in row] for row in xi]), atol=1e-14)
    poses = se3.exp(xi)
    for function in (se3.log, se3.inverse, se3.adjoint):
        assert_close(function(poses), np.array([[function(p) for p in row] for row in poses]), atol=1e-14)


def test_covariance_of_a_pose_between_two_cameras_agrees_with_sampling() -> None:
    """camera_a_from_camera_b = A S B^-1 with A, B uncertain by right perturbations; formula of the fact sheet, 8.2."""
    rng = np.random.default_rng(5)
    a, b, symmetry = se3.random(rng), se3.random(rng), se3.random(rng, spread=0.02)
    spreads = np.array([0.02, 0.005, 0.01, 0.004, 0.002, 0.02])
    cov_a, cov_b = (_random_covariance(rng, spreads) for _ in range(2))

    to_symmetric = se3.adjoint(se3.inverse(symmetry))
    expected = se3.adjoint(b) @ (to_symmetric @ cov_a @ to_symmetric.T + cov_b) @ se3.adjoint(b).T

    samples = 200_000
    noisy_a = se3.plus(a, rng.multivariate_normal(np.zeros(6), cov_a, samples))
    noisy_b = se3.plus(b, rng.multivariate_normal(np.zeros(6), cov_b, samples))
    deviation = se3.minus(noisy_a @ symmetry @ se3.inverse(noisy_b), a @ symmetry @ se3.inverse(b))
    found = deviation.T @ deviation / samples

    whiten = np.linalg.inv(np.linalg.cholesky(expected))
    assert np.abs(whiten @ found @ whiten.T - np.eye(6)).max() < 0.02


def _random_covariance(rng: np.random.Generator, spreads: Array) -> Array:
    rotation, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    root = np.diag(spreads) @ rotation
    return root @ np.diag(rng.uniform(0.3, 1, 6)) @ root.T
