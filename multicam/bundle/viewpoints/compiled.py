# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; model, which wraps this kernel, is strict.
"""The search for a view, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def closest_view(direction, camera_from_object):
    """See ViewpointModel.closest_view."""
    rotation, translation = camera_from_object[:3, :3], camera_from_object[:3, 3]
    x = np.float32(np.sum(rotation[:, 0] * translation))
    y = np.float32(np.sum(rotation[:, 1] * translation))
    z = np.float32(np.sum(rotation[:, 2] * translation))
    best, most = 0, np.float32(-np.inf)
    for view in range(len(direction)):
        along = direction[view, 0] * x + direction[view, 1] * y + direction[view, 2] * z
        if along > most:
            best, most = view, along
    return best
