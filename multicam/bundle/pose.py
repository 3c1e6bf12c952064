"""Factor of an observed object pose with a covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.compiled import linearize_poses
from multicam.bundle.factor import Linearization
from multicam.bundle.robust import Student
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class PoseFactor:
    """r = log(observed^-1 camera_from_object), weighted by the inverse covariance of the observation.

    Symmetries are resolved before: `observed` is the twin that lies closest to the object.

    Attributes:
        camera, object: (e,) what each edge ties.
        observed: (e, 4, 4) camera_from_object.
        information: (e, 6, 6) inverse covariance of the right perturbation of `observed`.
        kernel: robust cost of one edge.
    """

    camera: IntArray
    object: IntArray
    observed: FloatArray
    information: FloatArray
    kernel: Student

    def linearize(self, camera_from_object: FloatArray) -> Linearization:
        """See EdgeFactor. dr/dxi = left_jacobian_inverse(-r)."""
        count = len(camera_from_object)
        energy, gradient, hessian = np.empty(count), np.empty((count, 6)), np.empty((count, 6, 6))
        linearize_poses(camera_from_object, self.observed, self.information, energy, gradient, hessian)
        return Linearization(energy, gradient, hessian)
