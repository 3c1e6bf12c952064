"""Depth maps of triangle meshes by a z-buffer on the CPU: exact at pixel centres, no graphics driver needed."""

from __future__ import annotations

from collections.abc import Iterable
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
    """Depth of one mesh; see `render_depths`."""
    return render_depths([(mesh, camera_from_object)], camera, near)


def render_depths(
    meshes: Iterable[tuple[Mesh, Float64[np.ndarray, "4 4"]]], camera: Camera, near: float = NEAR
) -> NDArray[np.float32]:
    """Depth along the optical axis at each pixel centre, metres; 0 where no mesh is seen.

    To draw beyond the border of an image, pass the camera of a larger canvas: `camera.warped(shift, w, h)`.

    Args:
        meshes: each with its camera_from_object (4, 4).

    Returns:
        (height, width) float32.

    Raises:
        ValueError: the camera has distortion, under which triangles have curved edges.
    """
    if camera.distortion:
        raise ValueError("the rasterizer draws straight edges: use camera.without_distortion()")
    inverse_depth = np.zeros((camera.height, camera.width), dtype=np.float64)
    for mesh, camera_from_object in meshes:
        # Homogeneous pixels (u z, v z, z) stay linear in 3-D, so clipping and interpolation need no special case.
        homogeneous = se3.act(camera_from_object, mesh.vertices) @ camera.matrix.T
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
    projected = np.empty_like(homogeneous)
    for vertex in range(len(homogeneous)):
        _project(homogeneous[vertex], projected[vertex])
    polygon = np.empty((4, 3))
    for face in range(faces.shape[0]):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        if homogeneous[i, 2] >= near and homogeneous[j, 2] >= near and homogeneous[k, 2] >= near:
            _triangle(projected, i, j, k, inverse_depth)
            continue
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
        for corner in range(count):
            _project(polygon[corner], polygon[corner])
        for last in range(2, count):
            _triangle(polygon, 0, last - 1, last, inverse_depth)


@_compiled
@no_type_check
def _project(homogeneous: Any, out: Any) -> None:
    """(x, y, 1/z) of (x z, y z, z), which may be the same memory; of no use where z is not positive."""
    x, y, z = homogeneous[0], homogeneous[1], homogeneous[2]
    if z > 0:
        out[0], out[1], out[2] = x / z, y / z, 1 / z


@_compiled
@no_type_check
def _triangle(projected: Any, i: int, j: int, k: int, inverse_depth: Any) -> None:
    """Keeps the greatest 1/z at each pixel centre inside; 1/z is linear over the image."""
    height, width = inverse_depth.shape
    ax, ay, aw = projected[i, 0], projected[i, 1], projected[i, 2]
    bx, by, bw = projected[j, 0], projected[j, 1], projected[j, 2]
    cx, cy, cw = projected[k, 0], projected[k, 1], projected[k, 2]
    x0 = int(max(0.0, np.ceil(min(ax, bx, cx))))
    x1 = int(min(width - 1.0, np.floor(max(ax, bx, cx))))
    y0 = int(max(0.0, np.ceil(min(ay, by, cy))))
    y1 = int(min(height - 1.0, np.floor(max(ay, by, cy))))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    # Many triangles are so small that they hold no pixel centre.
    if x0 > x1 or y0 > y1 or area == 0:
        return
    share = 1 / area
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            # Barycentric coordinates; their signs agree with the area's inside, whichever way the face winds.
            u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) * share
            v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) * share
            # Not 1 - u - v: a pixel on an edge must get the same sign, or zero, from the triangles on both sides.
            w = ((ax - x) * (by - y) - (ay - y) * (bx - x)) * share
            if u >= 0 and v >= 0 and w >= 0:
                inverse_depth[y, x] = max(inverse_depth[y, x], u * aw + v * bw + w * cw)
