"""Factor of a motion between two cameras whose length nobody measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.pair import PairLinearization, relative_poses
from multicam.bundle.robust import Student
from multicam.geometry import so3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.linear import apply, squared_norm
from multicam.types import FloatArray

AGREES = 0.5
"""Weight from which a bearing agrees with the poses."""

_LEAST = 1e-9
"""Least distance, metres, and least of 1 + cosine, that are divided by: cameras at one place, or the opposite way."""

_KERNEL = Student(11.07, 0)
"""Bearings weigh 1 or less; half where they are as far off as one in twenty right ones is (five degrees of freedom)."""


@dataclass(frozen=True, eq=False)
class BearingFactor:
    """r = (log(measured^-1 first_from_second), s): turns and directions, whitened by their covariance.

    With d the direction of first_from_second's translation, d0 the measured one and B two unit vectors across d0,
    s = 2 B' d / (1 + d0' d), which is the angle between both while it is small and grows with it up to half a turn.

    Attributes:
        first, second: (m,) which cameras.
        measured: (m, 4, 4) first_from_second, its translation of length 1.
        information: (m, 5, 5) inverse covariance of its turn (right tangent) and of its direction along `across`.
    """

    first: IntArray
    second: IntArray
    measured: FloatArray
    information: FloatArray

    def linearize(self, world_from_camera: FloatArray) -> PairLinearization:
        """See PairFactor."""
        relative, moves = relative_poses(world_from_camera, self.first, self.second)
        residual, slope = bearing_residual(relative, self.measured)
        squared = squared_norm(residual, self.information)
        weight = _KERNEL.weight(squared)
        jacobian = slope @ moves
        pulled = weight[:, None, None] * (np.swapaxes(jacobian, -1, -2) @ self.information)
        return PairLinearization(_KERNEL.energy(squared), apply(pulled, residual), pulled @ jacobian)

    def agrees(self, world_from_camera: FloatArray) -> BoolArray:
        """(m,) which bearings fit the poses (c, 4, 4) of all cameras."""
        relative, _ = relative_poses(world_from_camera, self.first, self.second)
        residual, _ = bearing_residual(relative, self.measured)
        return _KERNEL.weight(squared_norm(residual, self.information)) >= AGREES


def bearing_residual(relative: FloatArray, measured: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m, 5) r of BearingFactor before it is whitened, and (m, 5, 6) its derivative by the right tangent of `relative`.

    Args:
        relative: (m, 4, 4) first_from_second.
        measured: (m, 4, 4), its translation of length 1.
    """
    rotation, shift = relative[:, :3, :3], relative[:, :3, 3]
    turn = so3.log(np.swapaxes(measured[:, :3, :3], -1, -2) @ rotation)
    length = np.maximum(np.linalg.norm(shift, axis=-1, keepdims=True), _LEAST)
    direction, target = shift / length, measured[:, :3, 3]
    basis = np.swapaxes(across(target), -1, -2)
    rise = np.maximum(1 + np.sum(direction * target, axis=-1, keepdims=True), _LEAST)
    sideways = 2 * apply(basis, direction) / rise
    of_direction = (2 * basis - sideways[:, :, None] * target[:, None, :]) / rise[:, :, None]
    flat = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    jacobian = np.zeros((len(relative), 5, 6))
    jacobian[:, :3, :3] = so3.left_jacobian_inverse(-turn)
    jacobian[:, 3:, 3:] = of_direction @ flat @ rotation / length[:, :, None]
    return np.concatenate((turn, sideways), axis=-1), jacobian


def across(direction: FloatArray) -> FloatArray:
    """(..., 3, 2) two unit vectors at right angles to directions (..., 3) and to each other."""
    *_, basis = np.linalg.svd(direction[..., None, :])
    return np.swapaxes(basis, -1, -2)[..., 1:]
