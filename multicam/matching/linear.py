"""Small linear algebra on stacks of matrices; one place for its broadcasting and its types."""

from __future__ import annotations

import numpy as np

from multicam.types import FloatArray


def invert(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses and log determinants of symmetric positive definite matrices (..., n, n).

    By Cholesky and forward substitution over the whole stack: `numpy.linalg.inv` wakes the threads of BLAS for each
    6x6 matrix, which costs several times the work and far more on a busy machine.

    Raises:
        numpy.linalg.LinAlgError: a matrix is not positive definite.
    """
    lower = np.linalg.cholesky(matrix)
    diagonal = np.diagonal(lower, axis1=-2, axis2=-1)
    whitening = np.zeros_like(lower)
    for row in range(matrix.shape[-1]):
        whitening[..., row, row] = 1 / diagonal[..., row]
        above = lower[..., row : row + 1, :row] @ whitening[..., :row, :row]
        whitening[..., row, :row] = -above[..., 0, :] / diagonal[..., row, None]
    return np.swapaxes(whitening, -1, -2) @ whitening, 2 * np.log(diagonal).sum(axis=-1)


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverses of symmetric positive definite matrices (..., n, n)."""
    return invert(matrix)[0]


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
