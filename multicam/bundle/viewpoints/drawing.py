# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; generate, which wraps these kernels, is strict.
"""One view of a mesh drawn as large as the picture allows: compiled, for a model has thousands of views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class View(NamedTuple):
    """A camera that looks at the origin of the object.

    Attributes:
        rotation: (3, 3) of camera_from_object.
        distance: metres from the camera to the origin.
        focal, center_x, center_y: pixels; the principal point may lie outside the picture.
    """

    rotation: NDArray[np.float64]
    distance: float
    focal: float
    center_x: float
    center_y: float

    @property
    def pixel_size(self) -> float:
        """Metres that a pixel spans at the distance of the origin."""
        return self.distance / self.focal


@njit(cache=True, nogil=True, error_model="numpy")
def project(vertices, rotation, distance, out):
    """Writes (x/z, y/z, 1/z) of each vertex as seen from `distance`; returns least x, y and greatest x, y."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(vertices)):
        x, y, z = vertices[i]
        inverse = 1 / (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + distance)
        u = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z) * inverse
        v = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z) * inverse
        out[i, 0], out[i, 1], out[i, 2] = u, v, inverse
        left, right = min(left, u), max(right, u)
        top, bottom = min(top, v), max(bottom, v)
    return left, top, right, bottom


@njit(cache=True, nogil=True, error_model="numpy")
def draw(projected, faces, closed, view, inverse_depth, face):
    """Draws triangles into an empty picture that holds them wholly.

    Corners are rounded to 1/256 pixel, so that integers decide exactly what is inside: no cracks between triangles.

    Args:
        projected: (V, 3) from `project`.
        faces, closed: of a Shell; the first `closed` faces are left out where they are seen from behind.
        inverse_depth: (h, w) float32, zeros; becomes 1/z at pixel centres.
        face: (h, w) int32; becomes the index of the face where one is seen.
    """
    corner = np.empty((len(projected), 2), np.int64)
    for i in range(len(projected)):
        corner[i, 0] = np.int64(np.rint((view.focal * projected[i, 0] + view.center_x) * 256))
        corner[i, 1] = np.int64(np.rint((view.focal * projected[i, 1] + view.center_y) * 256))
    for f in range(len(faces)):
        # Unsigned indices, here and below, spare the test for negative ones.
        i, j, k = np.uint32(faces[f, 0]), np.uint32(faces[f, 1]), np.uint32(faces[f, 2])
        ax, ay, bx, by, cx, cy = corner[i, 0], corner[i, 1], corner[j, 0], corner[j, 1], corner[k, 0], corner[k, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        # With y downwards a face that is counter-clockwise to the eye has a negative area.
        if area == 0 or (area > 0 and f < closed):
            continue
        if area < 0:
            j, k = k, j
            bx, by, cx, cy = cx, cy, bx, by
            area = -area
        x0, x1 = (min(ax, bx, cx) + 255) >> 8, max(ax, bx, cx) >> 8
        y0, y1 = (min(ay, by, cy) + 255) >> 8, max(ay, by, cy) >> 8
        if x0 > x1 or y0 > y1:
            continue
        # 1/z and the three edge functions are linear over the picture.
        to_b, to_c = projected[j, 2] - projected[i, 2], projected[k, 2] - projected[i, 2]
        slope_x = (to_b * (cy - ay) - to_c * (by - ay)) * 256.0 / area
        slope_y = (to_c * (bx - ax) - to_b * (cx - ax)) * 256.0 / area
        x, y = x0 << 8, y0 << 8
        row = projected[i, 2] + (slope_x * (x - ax) + slope_y * (y - ay)) / 256
        row_ab = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        row_bc = (cx - bx) * (y - by) - (cy - by) * (x - bx)
        row_ca = (ax - cx) * (y - cy) - (ay - cy) * (x - cx)
        for y in range(np.uint32(y0), np.uint32(y1 + 1)):
            here, ab, bc, ca = row, row_ab, row_bc, row_ca
            for x in range(np.uint32(x0), np.uint32(x1 + 1)):
                # The sign bit of the three together: none is negative.
                if (ab | bc | ca) >= 0 and here > inverse_depth[y, x]:
                    inverse_depth[y, x] = here
                    face[y, x] = f
                here += slope_x
                ab -= (by - ay) << 8
                bc -= (cy - by) << 8
                ca -= (ay - cy) << 8
            row += slope_y
            row_ab += (bx - ax) << 8
            row_bc += (cx - bx) << 8
            row_ca += (ax - cx) << 8
