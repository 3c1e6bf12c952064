"""Depth maps of triangle meshes by a z-buffer on the CPU: exact at pixel centres, no graphics driver needed."""

from __future__ import annotations

from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit
from numpy.typing import NDArray

from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh

NEAR = 0.01
"""Triangles are clipped at this depth (metres); what lies nearer is not drawn."""


def render_depth(
    mesh: Mesh, camera: Camera, camera_from_object: Float64[np.ndarray, "4 4"], near: float = NEAR
) -> NDArray[np.float32]:
    """Depth along the optical axis at each pixel centre, metres; 0 where the mesh is not seen.

    To draw beyond the border of an image, pass the camera of a larger canvas: `camera.warped(shift, w, h)`.

    Returns:
        (height, width) float32.

    Raises:
        ValueError: the camera has distortion, under which triangles have curved edges.
    """
    if camera.distortion:
        raise ValueError("the rasterizer draws straight edges: use camera.without_distortion()")
    # Homogeneous pixels (u z, v z, z) stay linear in 3-D, so clipping and interpolation need no special case.
    homogeneous = se3.act(camera_from_object, mesh.vertices) @ camera.matrix.T
    inverse_depth = np.zeros((camera.height, camera.width), dtype=np.float64)
    _fill(homogeneous, mesh.faces, near, inverse_depth)
    seen = inverse_depth > 0
    return np.divide(1.0, inverse_depth, out=np.zeros_like(inverse_depth), where=seen).astype(np.float32)


def _compiled(function: Any) -> Any:
    """njit without types, kept on disk between runs."""
    return njit(cache=True, nogil=True)(function)


@_compiled
@no_type_check
def _fill(homogeneous: Any, faces: Any, near: float, inverse_depth: Any) -> None:
    """Draws every triangle; one crossing the near plane becomes a polygon of up to four corners."""
    polygon = np.empty((4, 3))
    for face in range(faces.shape[0]):
        count = 0
        for corner in range(3):
            a = homogeneous[faces[face, corner]]
            b = homogeneous[faces[face, (corner + 1) % 3]]
            if a[2] >= near:
                polygon[count] = a
                count += 1
            if (a[2] >= near) != (b[2] >= near):
                share = (near - a[2]) / (b[2] - a[2])
                for axis in range(3):
                    polygon[count, axis] = a[axis] + share * (b[axis] - a[axis])
                count += 1
        for last in range(2, count):
            _triangle(polygon[0], polygon[last - 1], polygon[last], inverse_depth)


@_compiled
@no_type_check
def _triangle(a: Any, b: Any, c: Any, inverse_depth: Any) -> None:
    """Keeps the greatest 1/z at each pixel centre inside; 1/z is linear over the image."""
    height, width = inverse_depth.shape
    ax, ay, aw = a[0] / a[2], a[1] / a[2], 1 / a[2]
    bx, by, bw = b[0] / b[2], b[1] / b[2], 1 / b[2]
    cx, cy, cw = c[0] / c[2], c[1] / c[2], 1 / c[2]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == 0:
        return
    x0 = int(max(0.0, np.ceil(min(ax, bx, cx))))
    x1 = int(min(width - 1.0, np.floor(max(ax, bx, cx))))
    y0 = int(max(0.0, np.ceil(min(ay, by, cy))))
    y1 = int(min(height - 1.0, np.floor(max(ay, by, cy))))
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            # Barycentric coordinates; their signs agree with the area's inside, whichever way the face winds.
            u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
            v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
            # Not 1 - u - v: a pixel on an edge must get the same sign, or zero, from the triangles on both sides.
            w = ((ax - x) * (by - y) - (ay - y) * (bx - x)) / area
            if u >= 0 and v >= 0 and w >= 0:
                inverse_depth[y, x] = max(inverse_depth[y, x], u * aw + v * bw + w * cw)
