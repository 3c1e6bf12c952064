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

    def whitened(self, first_from_second: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k,) r at poses (m, 4, 4), and (k, 6) its derivative by a motion of these on the right."""
        x, y = (np.concatenate((ray, np.ones((len(ray), 1))), axis=1) for ray in (self.first_ray, self.second_ray))
        rotation = first_from_second[:, :3, :3]
        cross = so3.hat(first_from_second[:, :3, 3])
        essential = cross @ rotation
        # d E = E [w]x + [R v]x R, one 3x3 for each of the six numbers of xi = (w, v).
        axes = so3.hat(np.eye(3))
        turned = essential[:, None] @ axes
        moved = so3.hat(np.swapaxes(rotation, -1, -2)) @ rotation[:, None]
        change = np.concatenate((turned, moved), axis=1)
        line_x, line_y = apply(essential[self.pair], y), apply(np.swapaxes(essential, -1, -2)[self.pair], x)
        change_x = np.einsum("knij,kj->kni", change[self.pair], y)
        change_y = np.einsum("knij,ki->knj", change[self.pair], x)
        variance_x, variance_y = self.std[:, :1] ** 2, self.std[:, 1:] ** 2
        norm = np.sum(variance_x * line_x[:, :2] ** 2 + variance_y * line_y[:, :2] ** 2, axis=1)
        half = np.einsum("kni,ki->kn", change_x[:, :, :2], variance_x * line_x[:, :2])
        half += np.einsum("kni,ki->kn", change_y[:, :, :2], variance_y * line_y[:, :2])
        value = np.sum(x * line_x, axis=1)
        root = np.sqrt(norm)
        slope = np.einsum("kni,ki->kn", change_x, x)
        return value / root, slope / root[:, None] - (value / (norm * root))[:, None] * half
