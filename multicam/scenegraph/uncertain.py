"""Poses with covariance: composing, comparing and fusing them on SE(3).

A covariance is that of the right perturbation: the true pose is `pose @ exp(xi)` with xi ~ N(0, covariance).
Formulas: Barfoot and Furgale, "Associating uncertainty with three-dimensional poses" (2014), to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3
from multicam.matching.linear import inverse, solve
from multicam.types import FloatArray

_ITERATIONS = 20
_CONVERGED = 1e-8


@dataclass(frozen=True, eq=False)
class UncertainPose:
    """A transform target_from_source and how well it is known.

    Attributes:
        pose: (4, 4).
        covariance: (6, 6) of the right perturbation [rotation rad; translation m], expressed in the source frame.
    """

    pose: FloatArray
    covariance: FloatArray

    def __matmul__(self, other: UncertainPose) -> UncertainPose:
        """a_from_c of a_from_b and b_from_c with independent errors: Ad(c_from_b) Cov_ab Ad(c_from_b)^T + Cov_bc."""
        carried = transport(self.covariance, se3.inverse(other.pose))
        return UncertainPose(self.pose @ other.pose, carried + other.covariance)

    def inverse(self) -> UncertainPose:
        """source_from_target; its covariance is expressed in the target frame."""
        return UncertainPose(se3.inverse(self.pose), transport(self.covariance, self.pose))

    def inflated(self, covariance: FloatArray) -> UncertainPose:
        """The same pose with independent noise (6, 6) added in the source frame."""
        return UncertainPose(self.pose, self.covariance + covariance)


def transport(covariance: FloatArray, transform: FloatArray) -> FloatArray:
    """Ad(T) Cov Ad(T)^T: a tangent's covariance seen from the frame that T leads to."""
    adjoint = se3.adjoint(transform)
    return adjoint @ covariance @ adjoint.T


def isotropic(rotation: float, translation: float) -> FloatArray:
    """(6, 6) covariance of equal standard deviations on all axes: rad and m."""
    return np.diag(np.square(np.repeat(np.array([rotation, translation], dtype=np.float64), 3)))


def mahalanobis(a: UncertainPose, b: UncertainPose) -> float:
    """Squared distance of two independent measurements of one pose; chi-square with 6 degrees of freedom."""
    twist = se3.minus(b.pose, a.pose)
    jacobian = se3.left_jacobian_inverse(-twist)
    return float(twist @ solve(a.covariance + jacobian @ b.covariance @ jacobian.T, twist))


def fuse(a: UncertainPose, b: UncertainPose) -> UncertainPose:
    """The most likely pose given two independent measurements of it, by Gauss-Newton; information adds.

    Minimises the sum of r^T Cov^-1 r with r = minus(x, measured). The order of the two does not matter.

    Raises:
        numpy.linalg.LinAlgError: a covariance is singular: nobody knows a pose exactly.
    """
    measured = np.stack((a.pose, b.pose))
    weights = inverse(np.stack((a.covariance, b.covariance)))
    pose, hessian = a.pose, weights.sum(axis=0)
    for _ in range(_ITERATIONS):
        residuals = se3.minus(np.broadcast_to(pose, measured.shape), measured)
        jacobians = se3.left_jacobian_inverse(-residuals)
        pull = np.swapaxes(jacobians, -1, -2) @ weights
        hessian = (pull @ jacobians).sum(axis=0)
        step = -solve(hessian, (pull @ residuals[..., None]).sum(axis=0)[:, 0])
        pose = se3.plus(pose, step)
        if np.linalg.norm(step) < _CONVERGED:
            break
    return UncertainPose(pose, inverse(hessian))


def spread(estimate: UncertainPose) -> float:
    """Standard deviation, metres, of a point a metre away, of rotation and translation together."""
    variances = np.diag(estimate.covariance)
    return float(np.sqrt(variances.sum()))
