from __future__ import annotations

import numpy as np

from multicam.matching.arrays import is_best, ragged, rank_in_group
from multicam.matching.linear import invert, squared_norm


def test_ragged_flattens_ranges_and_skips_empty_ones() -> None:
    owner, member = ragged(np.array([5, 0, 2]), np.array([2, 0, 3]))
    assert owner.tolist() == [0, 0, 2, 2, 2]
    assert member.tolist() == [5, 6, 2, 3, 4]


def test_rank_counts_within_ascending_groups() -> None:
    assert rank_in_group(np.array([0, 0, 3, 3, 3, 7])).tolist() == [0, 1, 0, 1, 2, 0]


def test_exactly_one_of_equal_values_is_best() -> None:
    best = is_best(np.array([0, 0, 1, 1, 1]), np.array([2.0, 2.0, 1.0, 5.0, 3.0]))
    assert best[:2].sum() == 1
    assert best[2:].tolist() == [False, True, False]
    assert is_best(np.zeros(0, dtype=np.int64), np.zeros(0)).tolist() == []


def test_invert_agrees_with_lapack(rng: np.random.Generator) -> None:
    root = rng.normal(size=(4, 3, 6, 6))
    matrix = root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(6)
    inverse, log_determinant = invert(matrix)
    assert np.allclose(inverse, np.linalg.inv(matrix))
    assert np.allclose(log_determinant, np.linalg.slogdet(matrix)[1])
    vector = rng.normal(size=(4, 3, 6))
    assert np.allclose(squared_norm(vector, matrix), np.einsum("abi,abij,abj->ab", vector, matrix, vector))
    assert [part.shape for part in invert(np.zeros((0, 6, 6)))] == [(0, 6, 6), (0,)]
