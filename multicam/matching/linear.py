"""Small linear algebra on stacks of matrices; one place for its broadcasting and its types."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammainc

from multicam.matching.linear_compiled import invert_all, solve_one
from multicam.types import FloatArray

LARGE = 24
"""Rows from which LAPACK is faster than the compiled loops."""


def invert(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses and log determinants of symmetric positive definite matrices (..., n, n).

    By a compiled Cholesky decomposition: `numpy.linalg.inv` wakes the threads of BLAS for each 6x6 matrix, which costs
    several times the work and far more on a busy machine.

    Raises:
        numpy.linalg.LinAlgError: a matrix is not positive definite.
    """
    if matrix.ndim == 2 and len(matrix) > LARGE:
        return _invert_large(matrix)
    result, log_determinant = np.empty(matrix.shape), np.empty(matrix.shape[:-2])
    flat = np.ascontiguousarray(matrix).reshape(log_determinant.size, *matrix.shape[-2:])
    if not invert_all(flat, result.reshape(flat.shape), log_determinant.reshape(-1)):
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return result, log_determinant


def _invert_large(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    lower = _decompose_large(matrix)
    result = cho_solve((lower, True), np.eye(len(matrix)), check_finite=False)
    return (result + result.T) / 2, np.asarray(2 * np.log(np.diagonal(lower)).sum(), dtype=np.float64)


def _decompose_large(matrix: FloatArray) -> FloatArray:
    """A matrix whose lower triangle is the Cholesky factor."""
    factor, _ = cho_factor(matrix, lower=True, check_finite=False)
    # LAPACK lets some NaN pass.
    if not np.all(np.isfinite(np.diagonal(factor))):
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return factor


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverses of symmetric positive definite matrices (..., n, n)."""
    return invert(matrix)[0]


def solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution x (n,) of A x = b for one symmetric positive definite matrix A (n, n) and b (n,).

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """
    if len(matrix) > LARGE:
        return cho_solve((_decompose_large(matrix), True), right, check_finite=False)
    solution = np.empty(len(right))
    if not solve_one(matrix, right, solution):
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return solution


def apply(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Matrices (..., m, n) times vectors (..., n)."""
    return (matrix @ vector[..., None])[..., 0]


def squared_norm(vector: FloatArray, information: FloatArray) -> FloatArray:
    """v' A v of vectors (..., n) and matrices (..., n, n)."""
    return np.sum(vector * apply(information, vector), axis=-1)


def congruent(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """M C M': the covariance C of x as that of M x."""
    return matrix @ covariance @ np.swapaxes(matrix, -1, -2)


def total_std(covariance: FloatArray) -> FloatArray:
    """Root mean square length of vectors with covariances (..., n, n)."""
    return np.sqrt(np.trace(covariance, axis1=-2, axis2=-1))


def probability_within(covariance: FloatArray, radius: float) -> FloatArray:
    """Probability that zero-mean normal vectors with covariances (..., n, n) are no longer than a radius.

    The squared length is taken for a gamma variable with its mean and variance (Welch, Satterthwaite), which is exact
    for round and for one-dimensional covariances.
    """
    mean = np.trace(covariance, axis1=-2, axis2=-1)
    half_variance = np.sum(covariance**2, axis=(-2, -1))
    with np.errstate(invalid="ignore", divide="ignore"):
        probability = gammainc(mean**2 / (2 * half_variance), radius**2 * mean / (2 * half_variance))
    return np.where(mean > 0, probability, 1.0)
