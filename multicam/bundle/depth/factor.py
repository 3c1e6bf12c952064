"""Factor of measured points: the distance of each from the plane of the surface near it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multicam.bundle.depth.compiled import PAIR, linearize_points
from multicam.bundle.depth.points import PairArray
from multicam.bundle.factor import Linearization
from multicam.bundle.groups import laid_out
from multicam.bundle.robust import PLAIN, Student
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class DepthFactor:
    """Pairs found once, at whatever pose they are then evaluated; one edge for each object in each picture.

    The energy of an edge is half the sum of r^2 over its pairs, r = n . (X - P) / std with the point X of the surface,
    its normal n and the measured point P, all in the object frame, into which the pose brings P.

    Attributes:
        camera, object: (e,) what each edge ties; the camera is the colour camera that carries the depth camera.
        pairs: of all edges, one edge after the other.
        start: (e + 1,) where the pairs of each edge begin, and the end.
        kernel: robust cost of one edge.
    """

    camera: IntArray
    object: IntArray
    pairs: PairArray
    start: IntArray
    kernel: Student = PLAIN

    @classmethod
    def of_edges(cls, camera: IntArray, obj: IntArray, pairs: Sequence[PairArray]) -> DepthFactor:
        """Edges with the pairs of each."""
        return cls(camera, obj, *laid_out(pairs, PAIR))

    def linearize(self, camera_from_object: FloatArray) -> Linearization:
        """See EdgeFactor. dr/dxi = [P x n, n] / std."""
        count = len(camera_from_object)
        energy, gradient, hessian = np.empty(count), np.empty((count, 6)), np.empty((count, 6, 6))
        linearize_points(self.pairs, self.start, camera_from_object, energy, gradient, hessian)
        return Linearization(energy, gradient, hessian)
