# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; points and factor, which wrap these kernels, are strict.
"""Measured points and planes of the surface, compiled: the search, and the energy.

The mathematics is that of Stoiber et al., "Iterative corresponding geometry" (CVPR 2022).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from multicam.bundle.occlusion_compiled import find_visible
from multicam.bundle.pixels import focal_length, inside, projected, transformed, unprojected, window
from multicam.bundle.viewpoints.compiled import closest_view
from multicam.geometry.compiled import compose, inverse

PAIR = np.dtype(
    [
        ("point", np.float64, 3),
        ("normal", np.float64, 3),
        ("measured", np.float64, 3),
        ("weight", np.float64),
    ]
)
"""A point of the surface with its normal, in the object frame, the measured point that was found near it, in the colour
camera's frame, and one over the standard deviation of their distance along the normal."""


@njit(cache=True, nogil=True, error_model="numpy")
def search_surface(
    image, camera_from_object, images, within, threshold, direction, area, point, normal, offset, offset_step,
    radius, spacing, deviation, pairs,
):  # fmt: skip
    """See find_points: writes `pairs` and returns how many there are."""
    depth, _, matrix, depth_from_camera = image
    depth_from_object, camera_from_depth = np.empty((4, 4)), np.empty((4, 4))
    compose(depth_from_camera, camera_from_object, depth_from_object)
    view, n = closest_view(direction, depth_from_object), len(pairs)
    if area[view] == 0:
        return 0
    inverse(depth_from_camera, camera_from_depth)
    seen = find_visible(images, within, threshold, point[view, :n], offset[view, :n], offset_step, camera_from_object)
    return search_points(
        depth, matrix, depth_from_object, camera_from_depth, point[view, :n], normal[view, :n], seen,
        radius, spacing, deviation, pairs,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def search_points(
    depth, matrix, depth_from_object, camera_from_depth, point, normal, seen, radius, spacing, deviation, pairs
):  # fmt: skip
    """Writes `pairs` of a view and returns how many there are; `seen` tells which may be looked for."""
    focal = focal_length(matrix)
    unprojection = unprojected(matrix)
    most = max(int(2 * radius / spacing + 0.5), 1)
    count = 0
    for i in range(len(point)):
        x, y, z = transformed(depth_from_object, point[i, 0], point[i, 1], point[i, 2])
        if not seen[i] or z <= 0:
            continue
        u, v = projected(matrix, x, y, z)
        if not inside(u, v, depth.shape):
            continue
        stride, left, right, top, bottom = window(u, v, 2 * radius * focal / z, most, depth.shape)
        least = radius * radius
        found = (0.0, 0.0, 0.0)
        for row in range(top, bottom + 1, stride):
            across = unprojection[0, 1] * row + unprojection[0, 2]
            down = unprojection[1, 1] * row + unprojection[1, 2]
            for column in range(left, right + 1, stride):
                measured = np.float64(depth[row, column])
                behind = measured - z
                # Most pixels are too near or too far already; also false for NaN.
                if not (measured > 0 and behind * behind < least):
                    continue
                mx = (unprojection[0, 0] * column + across) * measured
                my = (unprojection[1, 0] * column + down) * measured
                square = (mx - x) ** 2 + (my - y) ** 2 + behind * behind
                if square < least:
                    least, found = square, (mx, my, measured)
        if least == radius * radius:
            continue
        pair = pairs[count]
        in_camera = transformed(camera_from_depth, found[0], found[1], found[2])
        for k in range(3):
            pair.point[k], pair.normal[k], pair.measured[k] = point[i, k], normal[i, k], in_camera[k]
        pair.weight = 1 / (deviation * found[2])
        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def linearize_points(pairs, start, pose, energy, gradient, hessian):
    """See DepthFactor: writes energies (e,), gradients (e, 6) and Hessians (e, 6, 6) at poses (e, 4, 4)."""
    energy[:], gradient[:], hessian[:] = 0.0, 0.0, 0.0
    jacobian = np.empty(6)
    for e in range(len(pose)):
        t = pose[e]
        for i in range(start[e], start[e + 1]):
            pair = pairs[i]
            dx, dy, dz = pair.measured[0] - t[0, 3], pair.measured[1] - t[1, 3], pair.measured[2] - t[2, 3]
            # The measured point in the object frame.
            x = t[0, 0] * dx + t[1, 0] * dy + t[2, 0] * dz
            y = t[0, 1] * dx + t[1, 1] * dy + t[2, 1] * dz
            z = t[0, 2] * dx + t[1, 2] * dy + t[2, 2] * dz
            nx, ny, nz = pair.weight * pair.normal[0], pair.weight * pair.normal[1], pair.weight * pair.normal[2]
            residual = nx * (pair.point[0] - x) + ny * (pair.point[1] - y) + nz * (pair.point[2] - z)
            jacobian[0], jacobian[1], jacobian[2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
            jacobian[3], jacobian[4], jacobian[5] = nx, ny, nz
            energy[e] += residual * residual / 2
            for row in range(6):
                gradient[e, row] += residual * jacobian[row]
                for column in range(row + 1):
                    hessian[e, row, column] += jacobian[row] * jacobian[column]
        for row in range(6):
            for column in range(row):
                hessian[e, column, row] = hessian[e, row, column]
