"""How far a surface is from its moved self."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from multicam.geometry import se3, so3
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray

_DENSE = 100_000
"""Samples that stand for the surface when the nearest faces are looked up."""
_COARSE = 300
"""Points of a first, rough comparison."""
_SETTLING = 600
"""Points that ICP moves."""
_NEIGHBOURS = 12
"""Samples whose faces may hold the closest point; a surface bends little between neighbouring samples."""
_SETTLED = 1e-6
"""Radians, and radii of the object; a smaller step of ICP is the last."""


@dataclass(frozen=True)
class Deviation:
    """Distances between a surface and its moved self, metres; each the larger of there and back.

    Attributes:
        median, most, tail: quantiles 0.5, 0.95 and 0.99 over the surface.
    """

    median: float
    most: float
    tail: float


class Surface:
    """A mesh prepared for being compared with itself.

    Attributes:
        centre: (3,) centroid of the surface; every symmetry leaves it in place.
        moments: (3,) second moments of the surface about it, ascending, m^2.
        directions: (3, 3) their unit directions, as rows.
        diameter: metres.
        width: metres across the slimmest of the directions: twice the distance from that axis through the centroid
            within which 99 % of the surface lie; the thickness of a rod, the diameter of a disc.
        points: (n, 3) samples of the surface.
        normals: (n, 3) of the faces at the samples.
    """

    def __init__(self, mesh: Mesh, samples: int) -> None:
        self._corners = mesh.vertices[mesh.faces]
        crosses = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0])
        areas = np.linalg.norm(crosses, axis=1)
        self._face_normals = crosses / np.maximum(areas, 1e-300)[:, None]
        weights = areas / areas.sum()
        self.centre: FloatArray = weights @ self._corners.mean(1)
        around = self._corners - self.centre
        # Integral of x x' over a triangle: area / 12 (sum of corners' outer products + that of their sum).
        total = around.sum(1)
        outer = np.einsum("fki,fkj->fij", around, around) + total[:, :, None] * total[:, None, :]
        values, vectors = np.linalg.eigh(np.einsum("f,fij->ij", weights / 12, outer))
        self.moments: FloatArray = values
        self.directions: FloatArray = vectors.T
        self.diameter = mesh.diameter()
        # One seed for all: a proposal must not change from run to run.
        rng = np.random.default_rng(0)
        self._faces, u, v = mesh.draw_surface(_DENSE, rng)
        chosen = self._corners[self._faces]
        dense = chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])
        self._tree = cKDTree(dense)
        self._known: dict[bytes, Deviation] = {}
        self.points: FloatArray = dense[:samples]
        self.normals: FloatArray = self._face_normals[self._faces[:samples]]
        away = np.linalg.norm(np.cross((self.points - self.centre)[:, None], self.directions), axis=-1)
        self.width = 2 * float(np.quantile(away, 0.99, axis=0).min())

    def rough_distance(self, transform: FloatArray) -> float:
        """Mean distance from a few moved points to the samples; a quick guess, never less than about 0.2 %."""
        distance, _ = self._tree.query(se3.act(transform, self.points[:_COARSE]))
        return float(distance.mean())

    def deviation(self, transform: FloatArray) -> Deviation:
        """Compares the surface with itself moved by a transform (4, 4)."""
        key = transform.tobytes()
        if key not in self._known:
            self._known[key] = self._compare(transform)
        return self._known[key]

    def _compare(self, transform: FloatArray) -> Deviation:
        quantiles = np.zeros(3)
        for moved in (transform, se3.inverse(transform)):
            points = se3.act(moved, self.points)
            distance = np.linalg.norm(self._closest(points)[0] - points, axis=1)
            quantiles = np.maximum(quantiles, np.quantile(distance, (0.5, 0.95, 0.99)))
        return Deviation(*(float(q) for q in quantiles))

    def settled(self, transform: FloatArray, steps: int) -> FloatArray:
        """The transform after some steps of point-to-plane ICP (Chen and Medioni 1992) of the surface onto itself."""
        radius = self.diameter / 2
        points = self.points[:_SETTLING]
        for _ in range(steps):
            moved = se3.act(transform, points)
            closest, faces = self._closest(moved)
            normals = self._face_normals[faces]
            residual = np.einsum("ij,ij->i", closest - moved, normals) / radius
            lever = (moved - self.centre) / radius
            rows = np.concatenate((np.cross(lever, normals), normals), axis=1)
            # A feature without a partner must not bend the rest; a direction that slides freely must not run away.
            keep = np.abs(residual) <= np.quantile(np.abs(residual), 0.95)
            system = rows[keep].T @ rows[keep] + 1e-4 * len(points) * np.eye(6)
            change = np.linalg.solve(system, rows[keep].T @ residual[keep])
            rotation = so3.exp(change[:3])
            shift = self.centre - rotation @ self.centre + radius * change[3:]
            transform = se3.from_parts(rotation, shift) @ transform
            if np.linalg.norm(change) < _SETTLED:
                break
        return transform

    def _closest(self, points: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Closest points on the surface, and the faces they lie on."""
        from trimesh.triangles import closest_point

        _, nearest = self._tree.query(points, k=_NEIGHBOURS)
        faces = self._faces[nearest]
        repeated = np.repeat(points, _NEIGHBOURS, axis=0)
        found = closest_point(self._corners[faces.ravel()], repeated).reshape(-1, _NEIGHBOURS, 3)
        best = np.linalg.norm(found - points[:, None], axis=-1).argmin(axis=1)
        rows = np.arange(len(points))
        return found[rows, best], faces[rows, best]
