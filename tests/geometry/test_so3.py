"""Rotations against the group axioms, SciPy's quaternions and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from multicam.geometry import so3
from tests.close import assert_close
from tests.strategies import Array, arrays, directions, rotation_vectors, rotations, seeds

STEP = 1e-6


@given(rotation_vectors())
def test_exp_gives_a_rotation_that_scipy_agrees_with(omega: Array) -> None:
    rotation = so3.exp(omega)
    assert_close(rotation @ rotation.T, np.eye(3), atol=1e-13)
    assert np.isclose(np.linalg.det(rotation), 1)
    assert_close(rotation, Rotation.from_rotvec(omega).as_matrix(), atol=1e-13)


@given(rotations(), rotations(), rotations())
def test_rotations_are_a_group(a: Array, b: Array, c: Array) -> None:
    product = a @ b
    assert_close(so3.project(product), product, atol=1e-12)
    assert_close(product @ c, a @ (b @ c), atol=1e-13)
    assert_close(a @ so3.exp(-so3.log(a)), np.eye(3), atol=1e-11)
    assert_close(so3.exp(np.zeros(3)), np.eye(3), atol=0)


@given(rotation_vectors(np.pi - 1e-9))
def test_log_returns_what_exp_was_given(omega: Array) -> None:
    assert_close(so3.log(so3.exp(omega)), omega, rtol=1e-9, atol=1e-12)


def test_no_digits_are_lost_on_the_way_to_zero() -> None:
    """Where closed forms hand over to series, either would lose half of its digits too late or too early."""
    axis = np.array([0.6, -0.48, 0.64])
    angles = np.logspace(-14, 0, 2000)[:, None]
    found = so3.log(so3.exp(angles * axis))
    assert np.abs(found / (angles * axis) - 1).max() < 1e-13
    # Turning by omega commutes with omega, so each Jacobian keeps it.
    for jacobian in (so3.left_jacobian, so3.left_jacobian_inverse):
        assert_close(jacobian(angles * axis) @ axis, np.tile(axis, (2000, 1)), atol=1e-14)
    assert_close(so3.left_jacobian(angles * axis), _series(angles * axis), atol=1e-15)


@given(rotations())
def test_exp_of_log_is_the_rotation_even_at_half_a_turn(rotation: Array) -> None:
    omega = so3.log(rotation)
    assert np.linalg.norm(omega) <= np.pi + 1e-12
    assert_close(so3.exp(omega), rotation, atol=1e-12)


@given(directions())
def test_half_a_turn_has_either_sign_of_its_axis(axis: Array) -> None:
    omega = so3.log(so3.exp(np.pi * axis))
    assert np.isclose(abs(omega @ axis), np.pi, atol=1e-7)


@given(arrays(3, 10), arrays(3, 10))
def test_hat_is_the_cross_product_and_vee_undoes_it(a: Array, b: Array) -> None:
    assert_close(so3.hat(a) @ b, np.cross(a, b), atol=1e-12)
    stacks = np.stack((a, b)), np.stack((b, a))
    assert_close(so3.cross(*stacks), np.cross(*stacks), atol=1e-12)
    assert np.array_equal(so3.vee(so3.hat(a)), a)


@given(rotations())
def test_quaternions_agree_with_scipy(rotation: Array) -> None:
    found = so3.to_quaternion(rotation)
    expected = np.roll(Rotation.from_matrix(rotation).as_quat(), 1)
    assert found[0] >= 0
    # At half a turn both signs are the same rotation.
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-9


@given(rotation_vectors())
def test_left_jacobian_matches_differences(omega: Array) -> None:
    columns = [
        so3.log(so3.exp(omega + STEP * axis) @ so3.exp(omega - STEP * axis).T) / (2 * STEP) for axis in np.eye(3)
    ]
    assert_close(so3.left_jacobian(omega), np.stack(columns, axis=-1), atol=1e-8)


@given(rotation_vectors())
def test_left_jacobian_inverse_is_the_inverse(omega: Array) -> None:
    assert_close(so3.left_jacobian_inverse(omega) @ so3.left_jacobian(omega), np.eye(3), atol=1e-11)


@given(rotations(), arrays(9, 0.2), seeds())
def test_projection_is_the_nearest_rotation(rotation: Array, noise: Array, rng: np.random.Generator) -> None:
    matrix = rotation + noise.reshape(3, 3)
    nearest = so3.project(matrix)
    assert_close(nearest @ nearest.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(nearest) > 0
    nudged = nearest @ so3.exp(rng.normal(scale=0.05, size=(50, 3)))
    distances = np.linalg.norm(nudged - matrix, axis=(-2, -1))
    assert np.linalg.norm(nearest - matrix) <= distances.min() + 1e-12


def test_projection_of_a_mirror_image_is_a_rotation() -> None:
    assert np.isclose(np.linalg.det(so3.project(np.diag([1.0, 1.0, -0.9]))), 1)


@given(seeds())
def test_batch_axes_lead(rng: np.random.Generator) -> None:
    omega = rng.normal(size=(2, 5, 3)) * np.array([1e-9, 1e-5, 1e-3, 1, 1.5])[:, None]
    for function in (so3.exp, so3.hat, so3.left_jacobian, so3.left_jacobian_inverse):
        each = [[function(v) for v in row] for row in omega]
        assert np.array_equal(function(omega), np.array(each))
    rotation = so3.exp(omega)
    for function in (so3.log, so3.vee, so3.to_quaternion, so3.project):
        each = [[function(r) for r in row] for row in rotation]
        assert_close(function(rotation), np.array(each), atol=1e-15)


def test_random_rotations_are_uniform() -> None:
    rotation = so3.random(np.random.default_rng(3), 4000)
    assert rotation.shape == (4000, 3, 3)
    angle = np.linalg.norm(so3.log(rotation), axis=-1)
    # The angle of a uniform rotation has the density (1 - cos a) / pi; a turned axis is uniform on the sphere.
    assert kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > 0.01
    for axis in range(3):
        assert kstest(rotation[:, axis, 2], lambda z: (z + 1) / 2).pvalue > 0.01


def _series(omega: Array) -> Array:
    """The left Jacobian as its power series, sum of hat(omega)^k / (k + 1)!."""
    power, total, skew = np.broadcast_to(np.eye(3), (*omega.shape, 3)), np.zeros((*omega.shape, 3)), so3.hat(omega)
    for k in range(20):
        total = total + power
        power = power @ skew / (k + 2)
    return total


@pytest.mark.parametrize("batch", [(), (0,), (2, 3)])
def test_random_takes_any_batch(batch: tuple[int, ...]) -> None:
    assert so3.random(np.random.default_rng(0), *batch).shape == (*batch, 3, 3)
