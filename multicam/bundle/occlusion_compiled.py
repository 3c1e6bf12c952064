# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; occlusion, which wraps this kernel, is strict.
"""The test for occlusion, compiled."""

from __future__ import annotations

from numba import njit

from multicam.bundle.pixels import focal_length, inside, projected, transformed, window

STRIDES = 5
"""About how many pixels of a patch are looked at in each direction."""


@njit(cache=True, nogil=True, error_model="numpy")
def mark_hidden(depth, matrix, depth_from_object, point, offset, radius, threshold, seen):
    """See Occluders: clears `seen` (n,) of points (n, 3) with offsets (n,) that something hides in one picture."""
    focal = focal_length(matrix)
    for i in range(len(point)):
        x, y, z = transformed(depth_from_object, point[i, 0], point[i, 1], point[i, 2])
        if z <= 0:
            continue
        u, v = projected(matrix, x, y, z)
        if not inside(u, v, depth.shape):
            continue
        nearest = z - offset[i] - threshold
        stride, left, right, top, bottom = window(u, v, 2 * radius * focal / z, STRIDES, depth.shape)
        for row in range(top, bottom + 1, stride):
            for column in range(left, right + 1, stride):
                if 0 < depth[row, column] < nearest:
                    seen[i] = False
