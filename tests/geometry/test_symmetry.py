"""Symmetries against brute force and against the surfaces that have them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.geometry import se3, so3
from multicam.geometry.symmetry import Axis, Symmetries, symmetric_distance
from tests.close import assert_close
from tests.strategies import Array, arrays, directions, seeds, transforms
from tests.toy_objects import PEG, PLATE, PYRAMID, ROD, random_symmetry, toy_catalogue, toy_symmetries

SYMMETRIC = (PLATE, PEG, ROD, PYRAMID)
KEYPOINTS = {obj_id: model.keypoints for obj_id, model in toy_catalogue().objects.items()}


@st.composite
def symmetry_sets(draw: st.DrawFn) -> Symmetries:
    """Any mixture: up to two discrete transforms and up to two axes, both away from the origin."""
    discrete = [draw(transforms(reach=0.05)) for _ in range(draw(st.integers(0, 2)))]
    axes = [Axis(draw(directions()), draw(arrays(3, 0.05))) for _ in range(draw(st.integers(0, 2)))]
    return Symmetries(np.array(discrete).reshape(-1, 4, 4), tuple(axes))


@pytest.mark.parametrize("obj_id", SYMMETRIC)
@given(pose=transforms(), rng=seeds())
def test_distance_is_zero_for_every_symmetry(obj_id: int, pose: Array, rng: np.random.Generator) -> None:
    symmetries, points = toy_symmetries()[obj_id].transforms(), KEYPOINTS[obj_id]
    twins = pose @ symmetries
    assert symmetric_distance(twins, pose, symmetries, points) == pytest.approx(0, abs=1e-12)
    # In the other order too: the set holds the inverse of each member.
    assert symmetric_distance(pose, twins, symmetries, points) == pytest.approx(0, abs=1e-12)
    moved = pose @ random_symmetry(toy_symmetries()[obj_id], rng)
    # A continuous angle lies within half a step of 1/64 turn of one in the set.
    assert symmetric_distance(moved, pose, symmetries, points) < np.pi / 64 * 0.03


@given(transforms(reach=0.1), transforms(reach=0.1))
def test_distance_without_symmetry_is_the_mean_distance_of_points(a: Array, b: Array) -> None:
    points = KEYPOINTS[PLATE]
    expected = np.mean([np.linalg.norm((a - b)[:3, :3] @ p + (a - b)[:3, 3]) for p in points])
    assert symmetric_distance(a, b, Symmetries().transforms(), points) == pytest.approx(expected)
    assert symmetric_distance(a, b, toy_symmetries()[PLATE].transforms(), points) <= expected + 1e-12


@given(symmetry_sets(), transforms(reach=0.05), transforms(reach=0.05), st.floats(0.02, 0.3))
def test_closest_is_at_least_as_close_as_any_sampled_symmetry(
    symmetries: Symmetries, target: Array, source: Array, extent: float
) -> None:
    found = symmetries.closest(target, source, extent)
    everything = symmetries.transforms(steps=720)
    best = closeness(target, source @ everything, extent).min()
    assert closeness(target, source @ found, extent) <= best + 1e-9
    # The answer is a member: some sample comes as near to it as half a step allows.
    nearest = np.abs(everything - found).max(axis=(-2, -1)).min()
    assert nearest < (np.pi / 720 * 1.1 if symmetries.axes else 1e-12)


@pytest.mark.parametrize("obj_id", SYMMETRIC)
@given(pose=transforms(), rng=seeds())
def test_closest_undoes_a_twin_exactly(obj_id: int, pose: Array, rng: np.random.Generator) -> None:
    symmetries = toy_symmetries()[obj_id]
    twin = pose @ random_symmetry(symmetries, rng)
    assert_close(twin @ symmetries.closest(pose, twin, 0.1), pose, atol=1e-9)


@given(seeds())
def test_closest_takes_batches(rng: np.random.Generator) -> None:
    symmetries = toy_symmetries()[ROD]
    target, source = se3.random(rng, 2, 3), se3.random(rng, 2, 3)
    found = symmetries.closest(target, source, 0.1)
    assert found.shape == (2, 3, 4, 4)
    assert_close(found[1, 2], symmetries.closest(target[1, 2], source[1, 2], 0.1))
    assert_close(
        symmetries.closest(target, source[0, 0], 0.1)[1, 2], symmetries.closest(target[1, 2], source[0, 0], 0.1)
    )


def test_no_symmetry_leaves_only_the_identity(rng: np.random.Generator) -> None:
    none = Symmetries()
    assert not none
    assert np.array_equal(none.transforms(), np.eye(4)[None])
    assert np.array_equal(none.closest(se3.random(rng), se3.random(rng), 0.1), np.eye(4))


@pytest.mark.parametrize(("obj_id", "count"), [(PLATE, 4), (PYRAMID, 4), (PEG, 64), (ROD, 128)])
def test_transforms_hold_every_product_once_and_the_identity_first(obj_id: int, count: int) -> None:
    found = toy_symmetries()[obj_id].transforms(steps=64)
    assert len(found) == count
    assert_close(found[0], np.eye(4))
    gaps = np.abs(found[:, None] - found).max(axis=(-2, -1)) + np.eye(count)
    assert gaps.min() > 1e-3
    # A group: any product of two members is a member.
    products = (found[:, None] @ found[None]).reshape(-1, 4, 4)[:: max(1, count // 8)]
    assert np.abs(products[:, None] - found).max(axis=(-2, -1)).min(axis=1).max() < 1e-9


def test_two_axes_are_listed_without_repeating_the_identity() -> None:
    both = Symmetries(axes=(Axis(np.array([1.0, 0, 0])), Axis(np.array([0, 0, 1.0]))))
    found = both.transforms(steps=8)
    assert len(found) == 15
    assert np.isclose(np.abs(found - np.eye(4)).max(axis=(-2, -1)), 0).sum() == 1


@given(directions(), arrays(3, 0.5), st.floats(-7, 7), st.floats(-0.3, 0.3))
def test_an_axis_stays_where_it_is_while_the_rest_turns(
    direction: Array, offset: Array, angle: float, s: float
) -> None:
    axis = Axis(3 * direction, offset)
    turn = axis.rotation(np.asarray(angle))
    assert_close(se3.act(turn, offset + s * direction), offset + s * direction, atol=1e-12)
    assert_close(turn[:3, :3], so3.exp(angle * direction), atol=1e-12)


def test_a_mirror_image_and_a_zero_axis_are_refused() -> None:
    with pytest.raises(ValueError, match="mirror"):
        Symmetries(np.diag([1.0, 1, -1, 1])[None])
    with pytest.raises(ValueError, match="not a rotation"):
        Symmetries(np.diag([2.0, 1, 1, 1])[None])
    with pytest.raises(ValueError, match="zero"):
        Axis(np.zeros(3))


def test_toy_symmetries_are_those_of_the_toy_catalogue() -> None:
    assert [bool(m.symmetries) for m in toy_catalogue().objects.values()] == [False, True, True, True, True, False]


def closeness(target: Array, poses: Array, extent: float) -> Array:
    """|t|^2 / extent^2 + |R - R'|_F^2 / 2 between the target and each pose."""
    difference = poses - target
    rotation = np.sum(difference[..., :3, :3] ** 2, axis=(-2, -1)) / 2
    return rotation + np.sum(difference[..., :3, 3] ** 2, axis=-1) / extent**2
