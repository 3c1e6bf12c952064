# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; linear, which wraps this kernel, is strict.
"""Products, inverses and systems of small matrices, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def decompose(matrix, lower):
    """Writes the Cholesky factor (n, n) of a matrix (n, n); its log determinant, NaN if it is not positive definite."""
    determinant = 0.0
    for j in range(len(matrix)):
        for i in range(j, len(matrix)):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = total / lower[j, j]
            elif total > 0:
                lower[j, j] = math.sqrt(total)
                determinant += math.log(total)
            else:
                return math.nan
    return determinant


@njit(cache=True, error_model="numpy")
def invert_all(matrices, inverses, log_determinants):
    """Writes the inverses (m, n, n) and log determinants (m,) of matrices (m, n, n); False if one has none."""
    n = matrices.shape[1]
    lower, whitening = np.zeros((n, n)), np.zeros((n, n))
    for m in range(len(matrices)):
        log_determinants[m] = decompose(matrices[m], lower)
        if math.isnan(log_determinants[m]):
            return False
        # Rows of the inverse of the triangle, then its Gram matrix.
        for i in range(n):
            for j in range(i):
                total = 0.0
                for k in range(j, i):
                    total -= lower[i, k] * whitening[k, j]
                whitening[i, j] = total / lower[i, i]
            whitening[i, i] = 1 / lower[i, i]
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(i, n):
                    total += whitening[k, i] * whitening[k, j]
                inverses[m, i, j] = inverses[m, j, i] = total
    return True


@njit(cache=True, error_model="numpy")
def solve_one(matrix, right, solution):
    """Writes the solution (n,) of matrix (n, n) @ solution = right (n,); False if there is none."""
    n = len(matrix)
    lower = np.zeros((n, n))
    if math.isnan(decompose(matrix, lower)):
        return False
    for i in range(n):
        total = right[i]
        for k in range(i):
            total -= lower[i, k] * solution[k]
        solution[i] = total / lower[i, i]
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * solution[k]
        solution[i] = total / lower[i, i]
    return True


@njit(cache=True, error_model="numpy")
def product(a, b, out):
    """Product of two matrices (n, n); BLAS would take longer to call than to work."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@njit(cache=True, error_model="numpy")
def add_congruent(matrix, covariance, out):
    """Adds M C M' of matrices (n, n)."""
    n = len(matrix)
    half = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            for j in range(n):
                half[i, j] += matrix[i, k] * covariance[k, j]
    for i in range(n):
        for j in range(n):
            for k in range(n):
                out[i, j] += half[i, k] * matrix[j, k]
