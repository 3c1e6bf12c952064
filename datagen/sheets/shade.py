"""Shaded pictures of meshes without Blender: a z-buffer, and light by the slope of its depths."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from multicam.dataset.bop_reader import read_image
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.types import FloatArray, ImageArray

_TELE = 40.0
"""Distance of the camera in diameters: lines that are parallel stay so within a pixel."""
_FINE = 2
"""Pixels drawn for each of the picture, along each side."""
_GREY = np.array([176.0, 184.0, 196.0])
_LIGHT = np.array([-0.45, -0.65, -0.9]) / np.linalg.norm([-0.45, -0.65, -0.9])
"""Towards the lamp, in camera axes: from the upper left, behind the camera."""
_COLOR_SAMPLES = 150_000


@dataclass(frozen=True, eq=False)
class View:
    """A parallel view of an object: right and down in the picture, and away from the viewer, are a rotation's rows.

    Attributes:
        rotation: (3, 3) view_from_object.
        middle: (3,) object point in the middle of the picture, metres.
        scale: pixels per metre.
        width, height: pixels.
    """

    rotation: FloatArray
    middle: FloatArray
    scale: float
    width: int
    height: int

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of object points (n, 3)."""
        return (points - self.middle) @ self.rotation[:2].T * self.scale + [(self.width - 1) / 2, (self.height - 1) / 2]

    def depth(self, points: FloatArray) -> FloatArray:
        """How far behind the middle points (n, 3) lie, metres."""
        return (points - self.middle) @ self.rotation[2]


class Shaded:
    """One mesh, ready to be drawn from several sides."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._diameter = mesh.diameter()

    @property
    def has_colors(self) -> bool:
        """Whether the mesh brings colours or a picture."""
        return self._mesh.colors is not None or self._mesh.uv is not None

    def draw(self, view: View, colored: bool) -> tuple[ImageArray, NDArray[np.float64]]:
        """Picture (h, w, 3) on white, and depth behind the view's middle (h, w) in metres, inf where nothing is seen.

        Args:
            colored: in the mesh's own colours instead of grey.
        """
        distance = _TELE * self._diameter
        camera = Camera.from_focal(view.scale * distance, view.width, view.height).scaled(float(_FINE))
        pose = se3.from_parts(view.rotation, np.array([0, 0, distance]) - view.rotation @ view.middle)
        depth = render_depth(self._mesh, camera, pose).astype(np.float64)
        seen = depth > 0
        step = 1 / (view.scale * _FINE)
        ys, xs = np.mgrid[0 : camera.height, 0 : camera.width]
        points = np.stack(
            ((xs - (camera.width - 1) / 2) * step, (ys - (camera.height - 1) / 2) * step, depth - distance), axis=-1
        )
        normals = _normals(points, seen)
        shade = 0.38 + 0.62 * np.clip(normals @ _LIGHT, 0, 1) ** 0.9
        base = np.broadcast_to(_GREY, (*depth.shape, 3))
        if colored:
            base = base.copy()
            base[seen] = self._colors_at(points[seen] @ view.rotation + view.middle)
        fine = np.where(seen[..., None], base * shade[..., None], 255.0)
        fine[_creases(normals, depth, seen, 0.02 * self._diameter)] *= 0.45
        size = (view.width, view.height)
        picture = cv2.resize(np.clip(fine, 0, 255).astype(np.uint8), size, interpolation=cv2.INTER_AREA)
        near = np.where(seen, depth - distance, np.inf)[::_FINE, ::_FINE]
        return picture.astype(np.uint8, copy=False), near

    def _colors_at(self, points: FloatArray) -> FloatArray:
        tree, colors = self._painted
        return colors[tree.query(points)[1]]

    @cached_property
    def _painted(self) -> tuple[cKDTree, FloatArray]:
        """Points of the surface and their colours (n, 3) in 0..255."""
        mesh = self._mesh
        faces, u, v = mesh.draw_surface(_COLOR_SAMPLES, np.random.default_rng(0))
        corners = mesh.faces[faces]

        def mixed(values: FloatArray) -> FloatArray:
            a, b, c = (values[corners[:, k]] for k in range(3))
            return a + u * (b - a) + v * (c - a)

        if mesh.uv is not None and mesh.texture is not None:
            picture = read_image(mesh.texture)
            height, width = picture.shape[:2]
            x, y = (mixed(mesh.uv) % 1.0).T
            colors = picture[((1 - y) * (height - 1)).round().astype(int), (x * (width - 1)).round().astype(int)]
        else:
            assert mesh.colors is not None
            colors = mixed(mesh.colors.astype(np.float64))
        return cKDTree(mixed(mesh.vertices)), np.asarray(colors, dtype=np.float64)


def _normals(points: FloatArray, seen: NDArray[np.bool_]) -> FloatArray:
    """(h, w, 3) unit normals towards the viewer, from the flatter of the slopes on either side of each pixel."""
    slopes = []
    for axis in (1, 0):
        ahead = np.roll(points, -1, axis) - points
        behind = points - np.roll(points, 1, axis)
        known_ahead, known_behind = seen & np.roll(seen, -1, axis), seen & np.roll(seen, 1, axis)
        steep_ahead = np.where(known_ahead, np.abs(ahead[..., 2]), np.inf)
        steep_behind = np.where(known_behind, np.abs(behind[..., 2]), np.inf)
        slopes.append(np.where((steep_ahead <= steep_behind)[..., None], ahead, behind))
    normals = np.cross(slopes[1], slopes[0])
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


def _creases(normals: FloatArray, depth: FloatArray, seen: NDArray[np.bool_], jump: float) -> NDArray[np.bool_]:
    """Pixels of an edge: silhouette, step in depth, or sharp bend."""
    found = np.zeros(seen.shape, dtype=bool)
    for axis in (0, 1):
        other = np.roll(seen, -1, axis)
        found |= seen ^ other
        both = seen & other
        found |= both & (np.abs(np.roll(depth, -1, axis) - depth) > jump)
        found |= both & ((np.roll(normals, -1, axis) * normals).sum(-1) < 0.8)
    return found
