"""Sparse viewpoint models from meshes: every view is drawn, its contour followed, its points measured."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from multicam.bundle.viewpoints import sampling
from multicam.bundle.viewpoints.model import Float32Array, ViewpointModel
from multicam.bundle.viewpoints.offsets import Circles, DepthOffsets
from multicam.bundle.viewpoints.picture import Picture, draw_picture
from multicam.bundle.viewpoints.shell import Shell, find_shells
from multicam.errors import DataError
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray


@dataclass(frozen=True)
class ViewpointConfig:
    """What a viewpoint model holds; the defaults are M3T's, but for the size of the pictures."""

    subdivisions: int = 4
    """Of the icosahedron whose corners the cameras stand on: 4 for 2562 views."""
    distance: float = 0.8
    """Metres from the camera to the origin of the object, but at least twice as far as the object reaches."""
    picture: int = 400
    """Pixels of the longer side of each picture; the silhouette fills it."""
    contour_points: int = 200
    """Of each view."""
    surface_points: int = 200
    """Of each view."""
    offset_step: float = 0.002
    """Metres of radius between two depth offsets."""
    offsets: int = 6
    """Number of depth offsets: up to the radius at which occlusion is looked for (M3T keeps 26)."""
    seed: int = 0
    """Of the choice of points."""


_VIEWS_AT_ONCE = 32


def generate(mesh: Mesh, config: ViewpointConfig) -> ViewpointModel:
    """Draws the mesh from all around and samples its contours and surfaces, on all cores.

    Mesh and configuration decide every bit of the model. The mesh may be open and wind either way; each of its views
    fills the picture, however small the object is or far from its origin.

    Raises:
        DataError: no triangle of the mesh has an area.
    """
    from trimesh.creation import icosphere

    shell = find_shells(mesh)
    if not shell.normals().any():
        raise DataError("The mesh has no triangle with an area, so that no camera can see it; a surface is needed.")
    # With two axes exchanged these are the very directions that M3T has.
    direction = np.asarray(icosphere(subdivisions=config.subdivisions).vertices)[:, [1, 0, 2]]
    work = _Work.plan(shell, look_along(direction), config)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        # Results are asked for, so that an error in a thread is raised here.
        list(threads.map(work.fill, range(0, len(direction), _VIEWS_AT_ONCE)))
    return work.model()


def look_along(direction: FloatArray) -> FloatArray:
    """Rotations (V, 3, 3) of camera_from_object whose optical axes are the directions (V, 3) and x axes level.

    Level is across the object's y axis, as in M3T: the number of pixels on a contour depends on how the picture lies.
    """
    z = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    x = np.cross([0.0, 1.0, 0.0], z)
    x[np.linalg.norm(x, axis=1) < 1e-9] = [1.0, 0.0, 0.0]
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack((x, np.cross(z, x), z), axis=1)


@dataclass(frozen=True, eq=False)
class _Work:
    """What the views share.

    Attributes:
        normals: (F, 3) of the faces.
        rotation: (V, 3, 3) of camera_from_object.
        distance: metres from the cameras to the origin.
        contour_share, surface_share: (V, N) which of the pixels on contour and surface become points, in [0, 1).
        arrays: those of the model, to be filled.
    """

    config: ViewpointConfig
    shell: Shell
    normals: FloatArray
    circles: Circles
    rotation: FloatArray
    distance: float
    contour_share: FloatArray
    surface_share: FloatArray
    arrays: dict[str, Float32Array]

    @classmethod
    def plan(cls, shell: Shell, rotation: FloatArray, config: ViewpointConfig) -> _Work:
        views, contour, surface = len(rotation), config.contour_points, config.surface_points
        rng = np.random.default_rng(config.seed)
        shapes: dict[str, tuple[int, ...]] = {
            "contour_length": (),
            "contour_point": (contour, 3),
            "contour_normal": (contour, 3),
            "foreground": (contour,),
            "background": (contour,),
            "contour_offset": (contour, config.offsets),
            "surface_area": (),
            "surface_point": (surface, 3),
            "surface_normal": (surface, 3),
            "surface_offset": (surface, config.offsets),
        }
        return cls(
            config=config,
            shell=shell,
            normals=shell.normals(),
            circles=Circles(config.picture),
            rotation=rotation,
            distance=max(config.distance, 2 * float(np.linalg.norm(shell.vertices, axis=1).max())),
            contour_share=_spread(views, contour, rng),
            surface_share=_spread(views, surface, rng),
            arrays={name: np.zeros((views, *shape), np.float32) for name, shape in shapes.items()},
        )

    def fill(self, first: int) -> None:
        """Draws and measures a run of views."""
        for index in range(first, min(first + _VIEWS_AT_ONCE, len(self.rotation))):
            picture = draw_picture(self.shell, self.rotation[index], self.distance, self.config.picture)
            offsets = self.circles.over(picture, self.config.offset_step)
            self._add_contour(index, picture, offsets)
            self._add_surface(index, picture, offsets)

    def _add_contour(self, index: int, picture: Picture, offsets: DepthOffsets) -> None:
        border, normal = np.empty_like(picture.chain), np.empty(picture.chain.shape)
        count, length = sampling.find_border(picture.chain, picture.start, picture.inverse_depth, border, normal)
        if count == 0:
            return
        pixel = np.empty((self.config.contour_points, 2), np.int64)
        names = ("contour_point", "contour_normal", "foreground", "background")
        sampling.sample_contour(
            self.contour_share[index],
            border[:count],
            normal[:count],
            picture.inverse_depth,
            picture.view,
            pixel,
            *(self.arrays[name][index] for name in names),
        )
        offsets.measure(pixel, self.arrays["contour_offset"][index])
        self.arrays["contour_length"][index] = length * picture.view.pixel_size

    def _add_surface(self, index: int, picture: Picture, offsets: DepthOffsets) -> None:
        if len(picture.seen) == 0:
            return
        pixel = np.empty((self.config.surface_points, 2), np.int64)
        sampling.sample_surface(
            self.surface_share[index],
            picture.seen,
            picture.inverse_depth,
            picture.face,
            self.normals,
            picture.view,
            pixel,
            *(self.arrays[name][index] for name in ("surface_point", "surface_normal")),
        )
        offsets.measure(pixel, self.arrays["surface_offset"][index])
        self.arrays["surface_area"][index] = len(picture.seen) * picture.view.pixel_size**2

    def model(self) -> ViewpointModel:
        """The arrays as a model, read-only."""
        arrays = {"direction": self.rotation[:, 2].astype(np.float32), **self.arrays}
        for values in arrays.values():
            values.flags.writeable = False
        return ViewpointModel(offset_step=self.config.offset_step, **arrays)


def _spread(views: int, points: int, rng: np.random.Generator) -> FloatArray:
    """(views, points) of [0, 1): one in each of as many equal parts, in random order."""
    order = rng.permuted(np.tile(np.arange(points), (views, 1)), axis=1)
    return (order + rng.random(order.shape)) / points
