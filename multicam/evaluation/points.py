"""What pose errors of an object are taken over: its mesh, points and symmetries."""

from __future__ import annotations

from functools import cache

from scipy.spatial import KDTree

from multicam.dataset.objects import Catalogue
from multicam.evaluation import pose_error
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray

MOST_POINTS = 50_000
"""Vertices of larger meshes are thinned evenly to about this many."""

TURNS = 315
"""Turns into which a continuous symmetry is cut: between two, no point moves by more than 1 % of the diameter (BOP)."""


class PointSets:
    """Mesh vertices (n, 3) in metres by class, as the file has them, read when first asked for.

    Raises:
        DataError: on access, for a class that is unknown or has no mesh.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self.catalogue = catalogue
        self.mesh = cache(self._mesh)
        self.symmetries = cache(self._symmetries)
        self._points = cache(self._thinned)
        self._tree = cache(self._indexed)

    def __getitem__(self, obj_id: int) -> FloatArray:
        return self._points(obj_id)

    def add(self, obj_id: int, estimated: FloatArray, true: FloatArray) -> float:
        """ADD, metres."""
        return pose_error.add(estimated, true, self[obj_id])

    def add_s(self, obj_id: int, estimated: FloatArray, true: FloatArray) -> float:
        """ADD-S, metres."""
        return pose_error.add_s(estimated, true, self[obj_id], self._tree(obj_id))

    def add_or_add_s(self, obj_id: int, estimated: FloatArray, true: FloatArray) -> float:
        """ADD(-S): ADD-S where the catalogue declares a symmetry, else ADD; metres."""
        measure = self.add_s if self.catalogue[obj_id].symmetries else self.add
        return measure(obj_id, estimated, true)

    def _mesh(self, obj_id: int) -> Mesh:
        """Mesh in metres."""
        return self.catalogue[obj_id].load_mesh()

    def _symmetries(self, obj_id: int) -> FloatArray:
        """(count, 4, 4) object_from_object, the identity first."""
        return self.catalogue[obj_id].symmetries.transforms(TURNS)

    def _thinned(self, obj_id: int) -> FloatArray:
        vertices = self.mesh(obj_id).vertices
        return vertices[:: -(-len(vertices) // MOST_POINTS)]

    def _indexed(self, obj_id: int) -> KDTree:
        return KDTree(self[obj_id])
