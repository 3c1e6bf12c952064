# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; the functions around these kernels are strict.
"""Greatest distances over many points and symmetries, compiled: a symmetry is left as soon as it cannot be the best."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@no_type_check
def least_greatest_distance(targets, transforms, points):
    """Min over transforms of the max over points of the distance to a target.

    Args:
        targets: (n, 3), one for each point; transforms: (count, 4, 4); points: (n, 3).
    """
    best = np.inf
    for transform in transforms:
        worst = 0.0
        for k in range(len(points)):
            square = 0.0
            for i in range(3):
                value = transform[i, 3] - targets[k, i]
                for j in range(3):
                    value += transform[i, j] * points[k, j]
                square += value * value
            if square > worst:
                worst = square
                if worst >= best:
                    break
        best = min(best, worst)
    return np.sqrt(best)


@njit(cache=True, nogil=True)
@no_type_check
def least_greatest_shift(targets, projections, points):
    """The same between pixels.

    Args:
        targets: (n, 2) pixels, one for each point; projections: (count, 3, 4) camera matrix times pose.
    """
    best = np.inf
    for projection in projections:
        worst = 0.0
        for k in range(len(points)):
            x, y, z = projection[0, 3], projection[1, 3], projection[2, 3]
            for j in range(3):
                x += projection[0, j] * points[k, j]
                y += projection[1, j] * points[k, j]
                z += projection[2, j] * points[k, j]
            square = (x / z - targets[k, 0]) ** 2 + (y / z - targets[k, 1]) ** 2
            if square > worst:
                worst = square
                if worst >= best:
                    break
        best = min(best, worst)
    return np.sqrt(best)
