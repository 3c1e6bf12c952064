"""Factor of keypoints seen in an image: reprojection, whitened by the predicted standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.factor import Linearization
from multicam.bundle.robust import Student
from multicam.geometry import so3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import apply
from multicam.types import FloatArray

NEAR = 1e-3
"""Depth, metres, in front of which a point is projected; a point behind the camera pulls no further than this."""


@dataclass(frozen=True, eq=False)
class KeypointFactor:
    """r = (pi(camera_from_object X) - u) / std; one edge for each keypoint, so that each has a weight of its own.

    Attributes:
        camera, object: (e,) what each edge ties.
        point: (e, 3) X in the object frame, metres; of the symmetric twin that the detector meant.
        pixel: (e, 2) u, pixels of an ideal lens.
        std: (e, 2) pixels.
        camera_matrix: (e, 3, 3).
        kernel: robust cost of one keypoint.
    """

    camera: IntArray
    object: IntArray
    point: FloatArray
    pixel: FloatArray
    std: FloatArray
    camera_matrix: FloatArray
    kernel: Student

    def linearize(self, camera_from_object: FloatArray) -> Linearization:
        """See EdgeFactor. dr/dxi = J_pi R [-hat(X), I]."""
        rotation = camera_from_object[:, :3, :3]
        in_camera = apply(rotation, self.point) + camera_from_object[:, :3, 3]
        depth = np.maximum(in_camera[:, 2], NEAR)
        normalized = in_camera[:, :2] / depth[:, None]
        focal = self.camera_matrix[:, :2, :2]
        projected = apply(focal, normalized) + self.camera_matrix[:, :2, 2]
        residual = (projected - self.pixel) / self.std
        of_point = np.zeros((len(depth), 2, 3))
        of_point[:, 0, 0] = of_point[:, 1, 1] = 1 / depth
        of_point[:, :, 2] = -normalized / depth[:, None]
        lever = np.concatenate((-so3.hat(self.point), np.broadcast_to(np.eye(3), (len(depth), 3, 3))), axis=-1)
        jacobian = (focal @ of_point @ rotation @ lever) / self.std[:, :, None]
        transposed = np.swapaxes(jacobian, -1, -2)
        return Linearization(
            energy=np.sum(residual**2, axis=-1) / 2,
            gradient=apply(transposed, residual),
            hessian=transposed @ jacobian,
        )
