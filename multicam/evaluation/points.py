"""The points over which pose errors of an object are taken."""

from __future__ import annotations

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.evaluation import pose_error
from multicam.types import FloatArray

MOST_POINTS = 1000
"""Vertices of larger meshes are thinned evenly to about this many."""


class PointSets:
    """Mesh vertices (n, 3) in metres by class, read when first asked for.

    Raises:
        DataError: on access, for a class that is unknown or has no mesh.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self.catalogue = catalogue
        self._points: dict[int, FloatArray] = {}

    def __getitem__(self, obj_id: int) -> FloatArray:
        if obj_id not in self._points:
            vertices = np.unique(self.catalogue[obj_id].load_mesh().vertices, axis=0)
            self._points[obj_id] = vertices[:: -(-len(vertices) // MOST_POINTS)]
        return self._points[obj_id]

    def add_or_add_s(self, obj_id: int, estimated: FloatArray, true: FloatArray) -> float:
        """ADD(-S): ADD-S where the catalogue declares a symmetry, else ADD; metres."""
        measure = pose_error.add_s if self.catalogue[obj_id].symmetries else pose_error.add
        return measure(estimated, true, self[obj_id])
