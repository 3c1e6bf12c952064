"""Draws the points of one view of a model as M3T draws them, with its random numbers and its 16-bit depth buffer.

The models from which the stored gradients were computed are not among the published files; all that enters them is.
"""

from __future__ import annotations

import cv2
import numpy as np

from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from tests.bundle.m3t_files import CONTOUR_POINT, OFFSETS, SURFACE_POINT

SEED = 7
BORDER = 20
FAR = np.float32(np.finfo(np.float32).max)
LEVELS = 65535


class M3tView:
    """One rendered view from which points are drawn."""

    def __init__(
        self, mesh: Mesh, direction: np.ndarray, radius: float = 0.8, size: int = 2000, step: float = 0.002
    ) -> None:
        diameter = 2 * np.linalg.norm(mesh.vertices, axis=1).max()
        self.focal = 0.5 * (size - BORDER) / np.tan(np.arcsin(0.5 * diameter / radius))
        self.centre = size / 2
        self.radius, self.size, self.step = radius, size, step
        self.body_from_camera = _look(direction, radius)
        matrix = np.array([[self.focal, 0, self.centre], [0, self.focal, self.centre], [0, 0, 1.0]])
        depth = render_depth(mesh, Camera(matrix, size, size), se3.inverse(self.body_from_camera)).astype(float)
        self.silhouette = depth > 0
        near, far = radius - diameter / 2, radius + diameter / 2
        self._a, self._b = far * near * LEVELS / (far - near), far * LEVELS / (far - near)
        with np.errstate(divide="ignore"):
            self.levels = np.where(self.silhouette, np.round(self._b - self._a / depth), LEVELS)

    def depth(self, levels: np.ndarray) -> np.ndarray:
        """Metres of values of the depth buffer."""
        return self._a / (self._b - levels)

    def point(self, x: int, y: int) -> np.ndarray:
        """Point on the surface in the camera's frame."""
        z = self.depth(self.levels[y, x])
        return np.array([z * (x - self.centre) / self.focal, z * (y - self.centre) / self.focal, z])

    def contours(self) -> list[np.ndarray]:
        """Closed contours (n, 2) of the silhouette, pixels."""
        found, _ = cv2.findContours(self.silhouette.astype(np.uint8) * 255, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        return [c[:, 0] for c in found if len(c) >= 15]

    def offsets(self, x: int, y: int, metres_per_pixel: float) -> np.ndarray:
        """Depth of the point less the least depth within growing radii."""
        count = int(0.05 / self.step + 1)
        stride = self.step / metres_per_pixel
        pixel_stride = int(stride + 1)
        across = int(2 * count * stride / pixel_stride + 1) * pixel_stride
        low, high = across // 2, across - across // 2
        ys = np.arange(max(y - low, 0), min(y + high, self.size - 1) + 1, pixel_stride)
        xs = np.arange(max(x - low, 0), min(x + high, self.size - 1) + 1, pixel_stride)
        ring = (np.hypot(xs[None] - x, ys[:, None] - y) / stride).astype(int)
        values = self.levels[ys[:, None], xs[None]]
        least = np.full(OFFSETS, float(LEVELS))
        least[0] = self.levels[y, x]
        inside = ring < count
        np.minimum.at(least, ring[inside], values[inside])
        return self.depth(self.levels[y, x]) - self.depth(np.minimum.accumulate(least))


def contour_points(view: M3tView, count: int) -> tuple[np.ndarray, float]:
    """Records of CONTOUR_POINT and the contour's length, metres."""
    contours = view.contours()
    everything = np.concatenate(contours)
    owner = [(c, i) for c, contour in enumerate(contours) for i in range(len(contour))]
    first = {}
    for pixel, place in zip(map(tuple, everything), owner, strict=True):
        first.setdefault(pixel, place)
    draws = _draws()
    points = np.zeros(count, CONTOUR_POINT)
    filled = 0
    while filled < count:
        x, y = map(int, everything[next(draws) % len(everything)])
        c, i = first[x, y]
        contour = contours[c]
        ahead, behind = contour[(i + 3) % len(contour)], contour[i - 3]
        chord = (ahead - behind).astype(float)
        if np.hypot(*chord) <= 3:
            continue
        normal = np.array([-chord[1], chord[0]]) / np.hypot(*chord)
        centre = view.point(x, y)
        scale = centre[2] / view.focal
        foreground, background = _distances(view, everything, x, y, normal)
        points[filled] = (
            se3.act(view.body_from_camera, centre),
            view.body_from_camera[:3, :3] @ [*normal, 0],
            scale * foreground,
            min(scale * background, FAR),
            view.offsets(x, y, scale),
        )
        filled += 1
    return points, len(everything) * view.radius / view.focal


def surface_points(view: M3tView, mesh: Mesh, count: int) -> tuple[np.ndarray, float]:
    """Records of SURFACE_POINT and the visible area, square metres."""
    draws = _draws()
    points = np.zeros(count, SURFACE_POINT)
    filled = 0
    while filled < count:
        index = next(draws) % view.size**2
        # M3T's own order: the quotient is the column.
        x, y = index // view.size, index % view.size
        if not view.silhouette[y, x]:
            continue
        centre = view.point(x, y)
        in_body = se3.act(view.body_from_camera, centre)
        normal = _face_normal(mesh, in_body, view.body_from_camera)
        points[filled] = (in_body, normal, view.offsets(x, y, centre[2] / view.focal))
        filled += 1
    return points, view.silhouette.sum() * (view.radius / view.focal) ** 2


def geodesic_directions(divides: int) -> np.ndarray:
    """(V, 3) corners of an icosahedron whose faces were divided, ascending by x, y, z."""
    x, z = 0.525731112119133606, 0.850650808352039932
    corners = [(-x, 0, z), (x, 0, z), (-x, 0, -z), (x, 0, -z), (0, z, x), (0, z, -x)]
    corners += [(0, -z, x), (0, -z, -x), (z, x, 0), (-z, x, 0), (z, -x, 0), (-z, -x, 0)]
    faces = [(a, b, c) for a in range(12) for b in range(a) for c in range(b)]
    v = np.array(corners)
    faces = [f for f in faces if all(v[f[i]] @ v[f[j]] > 0.4 for i, j in ((0, 1), (1, 2), (0, 2)))]
    triangles = v[np.array(faces)]
    for _ in range(divides):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, ac, bc = (_unit(p + q) for p, q in ((a, b), (a, c), (b, c)))
        triangles = np.concatenate([np.stack(t, 1) for t in ((a, ab, ac), (b, ab, bc), (c, ac, bc), (ab, ac, bc))])
    points = np.unique(np.round(triangles.reshape(-1, 3), 6), axis=0)
    return _unit(points)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _look(direction: np.ndarray, radius: float) -> np.ndarray:
    """body_from_camera of a camera at a radius whose z axis is `direction`, its y axis turned to the body's."""
    z = _unit(np.asarray(direction, float))
    x = np.array([1.0, 0, 0]) if abs(z[0]) < 1e-6 and abs(z[2]) < 1e-6 else _unit(np.cross([0, 1.0, 0], z))
    pose = np.eye(4)
    pose[:3, :3] = np.stack((x, np.cross(z, x), z), axis=1)
    pose[:3, 3] = -radius * z
    return pose


def _draws():
    """The 32-bit numbers of a Mersenne twister seeded as in C++."""
    twister = np.random.RandomState(SEED)
    while True:
        yield int(twister.randint(0, 2**32, dtype=np.uint32))


def _distances(view, contour, x: int, y: int, normal: np.ndarray) -> tuple[float, float]:
    """Pixels along the line of the normal to the contour on the other side of the body, and to the next body part."""
    step = normal / np.abs(normal).max()
    start = np.array([x, y]) + 0.5

    def to_contour(place: np.ndarray) -> float:
        nearest = contour[np.argmin(np.hypot(*(contour - place).T))]
        return float(np.hypot(*(nearest - [x, y])))

    inward = start - step
    while view.silhouette[int(inward[1]), int(inward[0])]:
        inward = inward - step
    outward = start + step
    background = np.inf
    while np.all(outward >= 0) and np.all(outward < view.size):
        if view.silhouette[int(outward[1]), int(outward[0])]:
            background = to_contour(outward - 0.5)
            break
        outward = outward + step
    return to_contour(inward + step - 0.5), background


def _face_normal(mesh: Mesh, point: np.ndarray, body_from_camera: np.ndarray) -> np.ndarray:
    """Normal, as 8 bits a component keep it, of the face towards the camera that is nearest to a point on it."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    normals = _unit(np.cross(b - a, c - a))
    towards = np.sum(normals * (body_from_camera[:3, 3] - a), axis=1) > 0
    # Barycentric coordinates of the foot on each face's plane tell how far outside the face it lies.
    foot = point - np.sum((point - a) * normals, axis=1)[:, None] * normals
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    parts = [np.sum(np.cross(q - p, foot - p) * normals, axis=1) / area for p, q in ((a, b), (b, c), (c, a))]
    outside = np.maximum(-np.min(parts, axis=0), 0) * np.sqrt(area)
    height = np.abs(np.sum((point - a) * normals, axis=1))
    face = np.argmin(np.where(towards, outside + height, np.inf))
    in_camera = body_from_camera[:3, :3].T @ normals[face]
    kept = 1 - np.round(255 * (0.5 - 0.5 * in_camera)) / 127.5
    return body_from_camera[:3, :3] @ kept
