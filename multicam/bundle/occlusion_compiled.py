# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; occlusion, which wraps this kernel, is strict.
"""The test for occlusion, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from multicam.bundle.pixels import focal_length, inside, projected, transformed, window
from multicam.geometry.compiled import compose

STRIDES = 5
"""About how many pixels of a patch are looked at in each direction."""


BLOCK = 16
"""Side, in pixels, of the squares whose nearest depth is known beforehand."""


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_of_blocks(depth):
    """(ceil(height / BLOCK), ceil(width / BLOCK)) least depth that is known in each square; infinite without any."""
    height, width = depth.shape
    least = np.full(((height + BLOCK - 1) // BLOCK, (width + BLOCK - 1) // BLOCK), np.inf, np.float32)
    for row in range(height):
        for column in range(width):
            # The order counts: false for NaN.
            if 0 < depth[row, column] < least[row // BLOCK, column // BLOCK]:
                least[row // BLOCK, column // BLOCK] = depth[row, column]
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def find_visible(images, radius, threshold, point, offset, offset_step, camera_from_object):
    """See Occluders.visible; images as DepthImage.packed, at least one."""
    within = min(int(radius / offset_step + 0.5), offset.shape[1] - 1)
    seen = np.ones(len(point), np.bool_)
    depth_from_object = np.empty((4, 4))
    for depth, blocks, matrix, depth_from_camera in images:
        compose(depth_from_camera, camera_from_object, depth_from_object)
        mark_hidden(depth, blocks, matrix, depth_from_object, point, offset[:, within], radius, threshold, seen)
    return seen


@njit(cache=True, nogil=True, error_model="numpy")
def mark_hidden(depth, blocks, matrix, depth_from_object, point, offset, radius, threshold, seen):
    """See Occluders: clears `seen` (n,) of points (n, 3) with offsets (n,) that something hides in one picture.

    Args:
        blocks: from `nearest_of_blocks`, so that patches where nothing is near enough need not be looked at.
    """
    focal = focal_length(matrix)
    for i in range(len(point)):
        if not seen[i]:
            continue
        x, y, z = transformed(depth_from_object, point[i, 0], point[i, 1], point[i, 2])
        if z <= 0:
            continue
        u, v = projected(matrix, x, y, z)
        if not inside(u, v, depth.shape):
            continue
        nearest = z - offset[i] - threshold
        stride, left, right, top, bottom = window(u, v, 2 * radius * focal / z, STRIDES, depth.shape)
        if _any_below(blocks, nearest, left // BLOCK, right // BLOCK, top // BLOCK, bottom // BLOCK, 1):
            seen[i] = not _any_below(depth, nearest, left, right, top, bottom, stride)


@njit(cache=True, nogil=True, error_model="numpy")
def _any_below(depth, limit, left, right, top, bottom, stride):
    for row in range(top, bottom + 1, stride):
        for column in range(left, right + 1, stride):
            if 0 < depth[row, column] < limit:
                return True
    return False
