# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; the function that uses these kernels is strict.
"""How keypoints lie, on the object and in the picture; compiled, for calls of NumPy would take longer than this."""

from __future__ import annotations

import numpy as np
from numba import njit

_COLLINEAR = 1e-3
"""Ratio of the second to the first principal extent below which points are a line; thin rods have 1e-2."""


@njit(cache=True)
def collinear(points):
    """Whether points (n, 3) lie on one line."""
    squares = np.linalg.eigvalsh(_scatter(points))
    return squares[1] <= _COLLINEAR**2 * squares[2]


@njit(cache=True)
def normal(points):
    """(3,) unit direction in which points (n, 3) spread least."""
    return np.linalg.eigh(_scatter(points))[1][:, 0].copy()


@njit(cache=True)
def extent(pixels):
    """About the diagonal of the box of pixels (n, 2), blind to a few gross errors."""
    x, y = np.median(pixels[:, 0]), np.median(pixels[:, 1])
    return 3 * np.median(np.hypot(pixels[:, 0] - x, pixels[:, 1] - y))


@njit(cache=True)
def _scatter(points):
    mean = np.zeros(3)
    for point in points:
        mean += point
    mean /= len(points)
    scatter = np.zeros((3, 3))
    for point in points:
        for i in range(3):
            for j in range(3):
                scatter[i, j] += (point[i] - mean[i]) * (point[j] - mean[j])
    return scatter
