# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; sampled, which wraps these kernels, is strict.
"""Points of the nearest view of a body in a picture, compiled."""

from __future__ import annotations

import math

from numba import njit

from multicam.bundle.pixels import inside, projected, transformed
from multicam.bundle.viewpoints.compiled import closest_view


@njit(cache=True, nogil=True, error_model="numpy")
def outline_sides(matrix, poses, direction, point, sides):
    """See sampled.outline_sides: writes (n, 2)."""
    for n in range(len(poses)):
        pose = poses[n]
        view = closest_view(direction, pose)
        left = top = math.inf
        right = bottom = -math.inf
        for i in range(point.shape[1]):
            x, y, z = transformed(pose, point[view, i, 0], point[view, i, 1], point[view, i, 2])
            if z > 0:
                u, v = projected(matrix, x, y, z)
                left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        sides[n, 0], sides[n, 1] = max(right - left, 0.0), max(bottom - top, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def surface_errors(depth, matrix, depth_from_object, direction, point, errors):
    """See sampled.surface_errors: writes `errors` and returns how many there are."""
    view, count = closest_view(direction, depth_from_object), 0
    for i in range(point.shape[1]):
        x, y, z = transformed(depth_from_object, point[view, i, 0], point[view, i, 1], point[view, i, 2])
        if z <= 0:
            continue
        u, v = projected(matrix, x, y, z)
        if not inside(u, v, depth.shape):
            continue
        measured = depth[int(v + 0.5), int(u + 0.5)]
        # The order counts: false for NaN.
        if 0 < measured < math.inf:
            errors[count] = measured - z
            count += 1
    return count
