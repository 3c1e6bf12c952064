"""Factor of a measured motion: two poses of one tracked camera, or any two whose relative pose is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import apply, squared_norm
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class PairLinearization:
    """Second-order model of energies that depend on two poses each, in the right tangents of both.

    Attributes:
        energy: (m,).
        gradient: (m, 12), of the first pose and then of the second.
        hessian: (m, 12, 12) positive semidefinite (Gauss-Newton).
    """

    energy: FloatArray
    gradient: FloatArray
    hessian: FloatArray


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
        """At the poses (c, 4, 4) of all cameras.

        A motion of the second pose moves r by left_jacobian_inverse(-r), one of the first by minus that times
        Ad(second_from_first).
        """
        relative = se3.inverse(world_from_camera[self.first]) @ world_from_camera[self.second]
        residual = se3.minus(relative, self.measured)
        of_second = se3.left_jacobian_inverse(-residual)
        jacobian = np.concatenate((-of_second @ se3.adjoint(se3.inverse(relative)), of_second), axis=-1)
        pulled = np.swapaxes(jacobian, -1, -2) @ self.information
        return PairLinearization(
            energy=squared_norm(residual, self.information) / 2,
            gradient=apply(pulled, residual),
            hessian=pulled @ jacobian,
        )
