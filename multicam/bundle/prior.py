"""Factor of what is known of cameras beforehand: a pose with a covariance, from tracking or an earlier registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.factor import Linearization
from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import apply, squared_norm
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class CameraPrior:
    """r = log(expected^-1 world_from_camera), weighted by the inverse covariance.

    Attributes:
        camera: (p,) which cameras.
        expected: (p, 4, 4) world_from_camera.
        information: (p, 6, 6) inverse covariance of its right perturbation.
    """

    camera: IntArray
    expected: FloatArray
    information: FloatArray

    def linearize(self, world_from_camera: FloatArray) -> Linearization:
        """Energy, gradient and Hessian at the poses (p, 4, 4) of those cameras, in their right tangents."""
        residual = se3.minus(world_from_camera, self.expected)
        jacobian = se3.left_jacobian_inverse(-residual)
        pulled = np.swapaxes(jacobian, -1, -2) @ self.information
        return Linearization(
            energy=squared_norm(residual, self.information) / 2,
            gradient=apply(pulled, residual),
            hessian=pulled @ jacobian,
        )
