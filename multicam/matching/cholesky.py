# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; linear, which wraps this kernel, is strict.
"""Inverses of many small positive definite matrices, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def invert_all(matrices, inverses, log_determinants):
    """Writes the inverses (m, n, n) and log determinants (m,) of matrices (m, n, n); False if one has none."""
    n = matrices.shape[1]
    lower, whitening = np.zeros((n, n)), np.zeros((n, n))
    for m in range(len(matrices)):
        matrix, determinant = matrices[m], 0.0
        for j in range(n):
            for i in range(j, n):
                total = matrix[i, j]
                for k in range(j):
                    total -= lower[i, k] * lower[j, k]
                if i == j:
                    if not total > 0:
                        return False
                    lower[j, j] = math.sqrt(total)
                    determinant += math.log(total)
                else:
                    lower[i, j] = total / lower[j, j]
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
        log_determinants[m] = determinant
    return True
