"""Factor of points that nobody knows, seen by two cameras each: the background between and around the objects.

Such matches fix the rotation between two cameras and the direction from one to the other, but not how far apart they
are: that, objects of known size tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.pair import PairLinearization, relative_poses
from multicam.bundle.robust import Student
from multicam.geometry import so3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import apply
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class EpipolarFactor:
    """Sampson distances of matches from their epipolar lines, whitened; all matches of two cameras are one energy.

    With rays x, y (third coordinate 1) of a match in the first and second camera and E = [t]x R of first_from_second,
    r = x' E y / sqrt(std_x^2 |(E y)_12|^2 + std_y^2 |(E' x)_12|^2): Hartley, Zisserman, "Multiple View Geometry", 2nd
    edition, eq. 11.9, for two cameras of different focal lengths. r does not depend on the length of t.

    Attributes:
        first, second: (m,) which cameras.
        pair: (k,) index into them of each match.
        first_ray, second_ray: (k, 2) x / z and y / z in an ideal camera.
        std: (k, 2) deviations of both rays.
        kernel: robust cost of one match.
    """

    first: IntArray
    second: IntArray
    pair: IntArray
    first_ray: FloatArray
    second_ray: FloatArray
    std: FloatArray
    kernel: Student

    def linearize(self, world_from_camera: FloatArray) -> PairLinearization:
        """See PairFactor."""
        relative, moves = relative_poses(world_from_camera, self.first, self.second)
        residual, slope = self.whitened(relative)
        squared = residual**2
        weight = self.kernel.weight(squared)
        count = len(self.first)
        energy = np.bincount(self.pair, self.kernel.energy(squared), count).astype(np.float64)
        gradient, hessian = np.zeros((count, 6)), np.zeros((count, 6, 6))
        np.add.at(gradient, self.pair, (weight * residual)[:, None] * slope)
        np.add.at(hessian, self.pair, weight[:, None, None] * slope[:, :, None] * slope[:, None, :])
        pulled = np.swapaxes(moves, -1, -2)
        return PairLinearization(energy, apply(pulled, gradient), pulled @ hessian @ moves)

    def residuals(self, first_from_second: FloatArray) -> FloatArray:
        """(n, k) r of matches of two cameras only, at many poses (n, 4, 4) of these."""
        essential = so3.hat(first_from_second[:, :3, 3]) @ first_from_second[:, :3, :3]
        value, norm, *_ = self._lines(essential[:, None])
        return value / np.sqrt(norm)

    def whitened(self, first_from_second: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k,) r at poses (m, 4, 4), and (k, 6) its derivative by a motion of these on the right."""
        rotation = first_from_second[:, :3, :3]
        essential = so3.hat(first_from_second[:, :3, 3]) @ rotation
        # d E = E [w]x + [R v]x R, one 3x3 for each of the six numbers of xi = (w, v).
        turned = essential[:, None] @ so3.hat(np.eye(3))
        moved = so3.hat(np.swapaxes(rotation, -1, -2)) @ rotation[:, None]
        change = np.concatenate((turned, moved), axis=1)[self.pair]
        value, norm, line_x, line_y = self._lines(essential[self.pair])
        x, y = _homogeneous(self.first_ray), _homogeneous(self.second_ray)
        change_x, change_y = np.einsum("knij,kj->kni", change, y), np.einsum("knij,ki->knj", change, x)
        variance = self.std**2
        half = np.einsum("kni,ki->kn", change_x[:, :, :2], variance[:, :1] * line_x)
        half += np.einsum("kni,ki->kn", change_y[:, :, :2], variance[:, 1:] * line_y)
        root = np.sqrt(norm)
        slope = np.einsum("kni,ki->kn", change_x, x)
        return value / root, slope / root[:, None] - (value / (norm * root))[:, None] * half

    def _lines(self, essential: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """x' E y (..., k), its variance, and the normals (..., k, 2) of the lines, for E (..., k or 1, 3, 3)."""
        x, y = _homogeneous(self.first_ray), _homogeneous(self.second_ray)
        line_x = np.einsum("...ij,...j->...i", essential, y)
        line_y = np.einsum("...ij,...i->...j", essential, x)
        value = np.sum(x * line_x, axis=-1)
        line_x, line_y = line_x[..., :2], line_y[..., :2]
        variance = self.std**2
        norm = variance[:, 0] * np.sum(line_x**2, axis=-1) + variance[:, 1] * np.sum(line_y**2, axis=-1)
        return value, norm, line_x, line_y


def _homogeneous(rays: FloatArray) -> FloatArray:
    return np.concatenate((rays, np.ones((len(rays), 1))), axis=1)
