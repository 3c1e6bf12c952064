"""Stacks of small matrices against NumPy, and lengths of normal vectors against sampling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from multicam.matching.linear import invert, probability_within
from tests.close import assert_close


@pytest.mark.parametrize("shape", [(6, 6), (4, 3, 3), (2, 3, 6, 6), (0, 6, 6), (5, 0, 0), (1, 40, 40), (40, 40)])
def test_inverses_and_determinants_are_those_of_numpy(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    root = rng.normal(size=shape)
    matrix = root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(shape[-1])
    inverse, log_determinant = invert(matrix)
    assert_close(inverse @ matrix, np.broadcast_to(np.eye(shape[-1]), shape), atol=1e-9)
    assert_close(log_determinant, np.linalg.slogdet(matrix)[1], atol=1e-9)


@pytest.mark.parametrize("matrix", [-np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)])
def test_what_is_not_positive_definite_has_no_inverse(matrix: np.ndarray) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        invert(np.stack((np.eye(3), matrix)))
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        invert(np.kron(np.eye(10), matrix))


def test_the_probability_of_a_length_is_exact_for_round_and_flat_covariances() -> None:
    assert probability_within(0.04 * np.eye(3), 0.3) == pytest.approx(chi2.cdf(0.3**2 / 0.04, 3))
    assert probability_within(np.diag([0.04, 0, 0]), 0.3) == pytest.approx(2 * norm.cdf(0.3 / 0.2) - 1)
    assert probability_within(np.zeros((3, 3)), 0.3) == 1


def test_the_probability_of_a_length_agrees_with_sampling(rng: np.random.Generator) -> None:
    for _ in range(10):
        root = rng.normal(size=(3, 3))
        covariance = root @ root.T
        lengths = np.linalg.norm(rng.normal(size=(20_000, 3)) @ root.T, axis=1)
        for share in (0.5, 0.8, 0.95):
            assert probability_within(covariance, float(np.quantile(lengths, share))) == pytest.approx(share, abs=0.03)
