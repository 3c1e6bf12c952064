# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; generate, which wraps these kernels, is strict.
"""Contour and surface points of one drawn view, compiled. Pictures and pixels are those of `drawing`."""

from __future__ import annotations

import numpy as np
from numba import njit

REACH = 4
"""Pixels of the contour on either side of a point that its normal is fitted to."""

SHORTEST = 15
"""Contours of fewer pixels are specks and pinholes."""


@njit(cache=True, nogil=True, error_model="numpy")
def find_border(chain, start, inverse_depth, pixel, normal):
    """Writes the places of the contour from which a line leads straight out of the silhouette.

    Args:
        chain: (n, 2) pixels x, y of closed contours one after the other, as cv2.findContours orders them: the
            silhouette to the same side of all.
        start: (c + 1,) where each contour starts.
        pixel, normal: (n, 2) out; normals are unit and outward.

    Returns:
        Number of places written, and of pixels on all contours but the shortest.
    """
    count, length = 0, 0
    for contour in range(len(start) - 1):
        first, size = start[contour], start[contour + 1] - start[contour]
        if size < SHORTEST:
            continue
        length += size
        for i in range(size):
            # Slope of the least-squares line through the neighbours, and their chord.
            tangent_x, tangent_y = 0.0, 0.0
            for k in range(1, REACH + 1):
                ahead, behind = chain[first + (i + k) % size], chain[first + (i - k + size) % size]
                tangent_x += k * (ahead[0] - behind[0])
                tangent_y += k * (ahead[1] - behind[1])
                chord = (ahead[0] - behind[0]) ** 2 + (ahead[1] - behind[1]) ** 2
            largest = max(abs(tangent_x), abs(tangent_y))
            # A contour that turns back on itself has no normal.
            if chord <= REACH**2 or largest == 0:
                continue
            x, y = chain[first + i]
            if inverse_depth[round(y + tangent_x / largest), round(x - tangent_y / largest)] > 0:
                continue
            norm = np.hypot(tangent_x, tangent_y)
            pixel[count, 0], pixel[count, 1] = x, y
            normal[count, 0], normal[count, 1] = -tangent_y / norm, tangent_x / norm
            count += 1
    return count, length


@njit(cache=True, nogil=True, error_model="numpy")
def measure_line(x, y, normal_x, normal_y, inverse_depth):
    """Steps, inwards and outwards from the border pixel, to the first pixel of the other kind; 0 if there is none.

    A step is one pixel along the larger component of the normal.
    """
    height, width = inverse_depth.shape
    largest = max(abs(normal_x), abs(normal_y))
    step_x, step_y = normal_x / largest, normal_y / largest
    inward = 1
    while inverse_depth[round(y - inward * step_y), round(x - inward * step_x)] > 0:
        inward += 1
    outward = 2
    while True:
        u, v = round(x + outward * step_x), round(y + outward * step_y)
        if u < 0 or v < 0 or u >= width or v >= height:
            return inward, 0
        if inverse_depth[v, u] > 0:
            return inward, outward
        outward += 1


@njit(cache=True, nogil=True, error_model="numpy")
def sample_contour(
    share, border_pixel, border_normal, inverse_depth, view, pixel, point, normal, foreground, background
):
    """Writes the contour points that `share` (N,), each in [0, 1), picks of the border (n, 2).

    The border of the silhouette runs, on average, half a step outside the centres of its outermost pixels: there the
    points lie, at the depth of those pixels.

    Args:
        view: View of `drawing`.
        pixel: (N, 2) int64 out, x and y of the outermost pixel.
        point, normal, foreground, background: out, as in ViewpointModel.
    """
    for i in range(len(share)):
        chosen = int(share[i] * len(border_pixel))
        x, y = border_pixel[chosen]
        nx, ny = border_normal[chosen]
        pixel[i, 0], pixel[i, 1] = x, y
        step = 1 / max(abs(nx), abs(ny))
        depth = 1 / inverse_depth[y, x]
        unproject(x + step / 2 * nx, y + step / 2 * ny, depth, view, point[i])
        for axis in range(3):
            normal[i, axis] = view.rotation[0, axis] * nx + view.rotation[1, axis] * ny
        inward, outward = measure_line(x, y, nx, ny, inverse_depth)
        # Both borders lie half a step away from the pixels on either side.
        foreground[i] = inward * step * depth / view.focal
        background[i] = (outward - 1) * step * depth / view.focal if outward > 0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def sample_surface(share, seen, inverse_depth, face, face_normal, view, pixel, point, normal):
    """Writes the surface points that `share` (N,), each in [0, 1), picks of the pixels that are `seen` (n,).

    Args:
        seen: flat indices into the picture.
        face: (h, w) of `draw`.
        face_normal: (F, 3) unit, turned either way.
        view, pixel, point, normal: as of `sample_contour`.
    """
    for i in range(len(share)):
        y, x = divmod(seen[int(share[i] * len(seen))], inverse_depth.shape[1])
        pixel[i, 0], pixel[i, 1] = x, y
        unproject(x, y, 1 / inverse_depth[y, x], view, point[i])
        towards = 0.0
        for axis in range(3):
            # The camera stands at minus its axis times its distance.
            normal[i, axis] = face_normal[face[y, x], axis]
            towards -= normal[i, axis] * (point[i, axis] + view.distance * view.rotation[2, axis])
        if towards < 0:
            for axis in range(3):
                normal[i, axis] = -normal[i, axis]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def unproject(x, y, depth, view, point):
    """Writes the point (3,) of the object whose image is the pixel."""
    rotation, focal = view.rotation, view.focal
    in_x, in_y = (x - view.center_x) / focal * depth, (y - view.center_y) / focal * depth
    for axis in range(3):
        point[axis] = rotation[0, axis] * in_x + rotation[1, axis] * in_y + rotation[2, axis] * (depth - view.distance)
