"""Finite groups of rotations: closure, exactness, axes and words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datagen.cad.turns import Turn, as_turn, closed, from_turns, generators, in_words, turn, turns_of
from multicam.geometry import se3, so3
from multicam.geometry.symmetry import Symmetries
from tests.close import assert_close
from tests.datagen.cad.shapes import CASES, X, Y, Z, axes
from tests.strategies import Array, arrays, directions, seeds


@pytest.mark.parametrize(
    ("parts", "size"),
    [([(Z, 2)], 2), ([(Z, 5)], 5), ([(Z, 6), (X, 2)], 12), ([(X, 4), (Y, 4)], 24), ([(Z, 2), (X + Y + Z, 3)], 12)],
)
@settings(max_examples=10)
@given(rng=seeds())
def test_measured_turns_close_to_an_exact_group(
    parts: list[tuple[Array, int]], size: int, rng: np.random.Generator
) -> None:
    """Generators half a degree off give a group whose products miss nothing."""
    exact = [so3.exp(2 * np.pi / n * d / np.linalg.norm(d)) for d, n in parts]
    if len(exact) > 1:
        exact = [so3.exp(rng.normal(size=3) * np.deg2rad(0.3)) @ r for r in exact]
    group = closed(exact)
    assert group is not None
    assert len(group) == size
    assert_close(group[0], np.eye(3))
    products = (group[:, None] @ group[None]).reshape(-1, 3, 3)
    assert np.abs(products[:, None] - group).max(axis=(-2, -1)).min(axis=1).max() < 1e-9


def test_turns_without_end_are_no_group() -> None:
    assert closed([so3.exp(np.array([0, 0, 1.0])), so3.exp(np.array([1.3, 0, 0]))]) is None
    assert from_turns([Turn(Z, np.zeros(3), 5), Turn(X, np.zeros(3), 3)]) is None


@given(directions(), arrays(3, 0.1), st.integers(2, 12), arrays(3, 0.01))
def test_a_turn_is_read_out_of_a_transform_near_it(direction: Array, offset: Array, fold: int, shift: Array) -> None:
    exact = turn(direction, offset, 2 * np.pi / fold)
    assert_close(as_turn(exact, np.zeros(3), fold), exact, atol=1e-7)
    # What a transform does along the axis is no rotation and is left out.
    along = se3.from_parts(np.eye(3), direction * (direction @ shift)) @ exact
    assert_close(as_turn(along, np.zeros(3), fold), exact, atol=1e-7)


@pytest.mark.parametrize("name", CASES)
def test_few_axes_stand_for_all(name: str) -> None:
    symmetries = CASES[name][1]
    few = generators(symmetries)
    assert len(few) <= 2
    again = from_turns(few)
    assert again is not None
    assert len(again.axes) == len(symmetries.axes)
    gaps = np.abs(again.discrete[:, None] - symmetries.discrete).max(axis=(-2, -1))
    assert gaps.shape[0] == gaps.shape[1]
    assert gaps.size == 0 or gaps.min(axis=1).max() < 1e-6


@given(arrays(3, 0.1))
def test_axes_pass_through_their_common_point(point: Array) -> None:
    found = from_turns([Turn(Z, point + 0.3 * Z, 4), Turn(X, point - 0.2 * X, 2)])
    assert found is not None
    assert_close(se3.act(found.discrete, point), np.broadcast_to(point, (7, 3)), atol=1e-9)
    for row in turns_of(found):
        away = row.offset - point
        assert_close(away - row.direction * (row.direction @ away), np.zeros(3), atol=1e-7)


@pytest.mark.parametrize(
    ("symmetries", "words"),
    [
        (Symmetries(), "none"),
        (axes((Z, 2)), "180° about z"),
        (axes((X, 2), (Y, 2)), "180° about x, y, z"),
        (axes((Z, 0), (X, 2)), "any angle about z; 180° about x"),
        (axes((X, 4), (Y, 4)), "90° about x, y, z; 120° about 4 axes; 180° about 6 axes"),
        (axes((np.array([0.6, 0, 0.8]), 3)), "120° about (0.60, 0.00, 0.80)"),
        (axes((Z, 0), (X, 0), (Y, 0)), "any turn (a ball)"),
    ],
)
def test_symmetries_in_words(symmetries: Symmetries, words: str) -> None:
    sort = {word: sorted(word) for word in (in_words(symmetries), words)}
    assert sort[in_words(symmetries)] == sort[words]
