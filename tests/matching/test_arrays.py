from __future__ import annotations

import numpy as np
import pytest

from multicam.matching.arrays import ragged, rank_in_group
from multicam.matching.linear import LARGE, invert, solve, squared_norm


def test_ragged_flattens_ranges_and_skips_empty_ones() -> None:
    owner, member = ragged(np.array([5, 0, 2]), np.array([2, 0, 3]))
    assert owner.tolist() == [0, 0, 2, 2, 2]
    assert member.tolist() == [5, 6, 2, 3, 4]


def test_rank_counts_within_ascending_groups() -> None:
    assert rank_in_group(np.array([0, 0, 3, 3, 3, 7])).tolist() == [0, 1, 0, 1, 2, 0]


def test_invert_agrees_with_lapack(rng: np.random.Generator) -> None:
    root = rng.normal(size=(4, 3, 6, 6))
    matrix = root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(6)
    inverse, log_determinant = invert(matrix)
    assert np.allclose(inverse, np.linalg.inv(matrix))
    assert np.allclose(log_determinant, np.linalg.slogdet(matrix)[1])
    vector = rng.normal(size=(4, 3, 6))
    assert np.allclose(squared_norm(vector, matrix), np.einsum("abi,abij,abj->ab", vector, matrix, vector))
    assert [part.shape for part in invert(np.zeros((0, 6, 6)))] == [(0, 6, 6), (0,)]


@pytest.mark.parametrize("size", [0, 1, 6, LARGE, LARGE + 1])
def test_a_system_is_solved_as_by_lapack(rng: np.random.Generator, size: int) -> None:
    root, right = rng.normal(size=(size, size)), rng.normal(size=size)
    matrix = root @ root.T + 0.1 * np.eye(size)
    assert np.allclose(solve(matrix, right), np.linalg.solve(matrix, right), rtol=1e-8)


def test_a_large_matrix_is_inverted_as_by_lapack(rng: np.random.Generator) -> None:
    root = rng.normal(size=(LARGE + 6, LARGE + 6))
    matrix = root @ root.T + 0.1 * np.eye(LARGE + 6)
    inverse, log_determinant = invert(matrix)
    assert np.allclose(inverse, np.linalg.inv(matrix), rtol=1e-8)
    assert np.isclose(log_determinant, np.linalg.slogdet(matrix)[1])


@pytest.mark.parametrize("worst", [-1.0, np.nan])
@pytest.mark.parametrize("size", [6, LARGE + 6])
def test_a_matrix_that_is_not_positive_definite_has_no_inverse(size: int, worst: float) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        invert(np.diag([1.0] * (size - 1) + [worst]))


@pytest.mark.parametrize("size", [6, LARGE + 6])
def test_a_system_that_is_not_positive_definite_is_refused(size: int) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        solve(np.diag([1.0] * (size - 1) + [-1.0]), np.ones(size))
