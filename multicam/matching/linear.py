"""Small linear algebra on stacks of matrices; one place for its broadcasting and its types."""

from __future__ import annotations

import numpy as np

from multicam.matching.cholesky import invert_all
from multicam.types import FloatArray


def invert(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses and log determinants of symmetric positive definite matrices (..., n, n).

    By a compiled Cholesky decomposition: `numpy.linalg.inv` wakes the threads of BLAS for each 6x6 matrix, which costs
    several times the work and far more on a busy machine.

    Raises:
        numpy.linalg.LinAlgError: a matrix is not positive definite.
    """
    result, log_determinant = np.empty(matrix.shape), np.empty(matrix.shape[:-2])
    flat = np.ascontiguousarray(matrix).reshape(log_determinant.size, *matrix.shape[-2:])
    if not invert_all(flat, result.reshape(flat.shape), log_determinant.reshape(-1)):
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return result, log_determinant


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
