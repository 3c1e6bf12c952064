"""Factor of a measured motion: two poses of one tracked camera, or any two whose relative pose is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.pair import PairLinearization, relative_poses
from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import apply, squared_norm
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class OdometryFactor:
    """r = log(measured^-1 first_from_second), weighted by the inverse covariance of the measurement.

    Attributes:
        first, second: (m,) which cameras.
        measured: (m, 4, 4) first_from_second.
        information: (m, 6, 6) inverse covariance of its right perturbation.
    """

    first: IntArray
    second: IntArray
    measured: FloatArray
    information: FloatArray

    def linearize(self, world_from_camera: FloatArray) -> PairLinearization:
        """See PairFactor. A motion of first_from_second moves r by left_jacobian_inverse(-r)."""
        relative, moves = relative_poses(world_from_camera, self.first, self.second)
        residual = se3.minus(relative, self.measured)
        jacobian = se3.left_jacobian_inverse(-residual) @ moves
        pulled = np.swapaxes(jacobian, -1, -2) @ self.information
        return PairLinearization(
            energy=squared_norm(residual, self.information) / 2,
            gradient=apply(pulled, residual),
            hessian=pulled @ jacobian,
        )
