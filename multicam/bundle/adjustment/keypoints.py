"""Keypoints behind the estimates of a scene: what a detector said of some of its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from multicam.bundle.keypoint import KeypointFactor
from multicam.bundle.robust import PLAIN, Student
from multicam.matching.arrays import IntArray
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class EdgeKeypoints:
    """Keypoints (n,) of edges; several of them on one edge, and none on others.

    Attributes:
        edge: (n,).
        point: (n, 3) metres in the frame of the object, as the edge's estimate has it.
        pixel, std: (n, 2) pixels of an ideal lens.
        camera_matrix: (n, 3, 3).
    """

    edge: IntArray
    point: FloatArray
    pixel: FloatArray
    std: FloatArray
    camera_matrix: FloatArray

    @classmethod
    def none(cls) -> EdgeKeypoints:
        """No keypoint at all."""
        return cls(
            np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 3, 3))
        )  # fmt: skip

    @classmethod
    def joined(cls, parts: Sequence[EdgeKeypoints]) -> EdgeKeypoints:
        """All in one."""
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    def factor(self, camera: IntArray, obj: IntArray, kernel: Student) -> KeypointFactor:
        """As observations that tie the cameras (e,) and objects (e,) of the edges."""
        return KeypointFactor(
            camera[self.edge], obj[self.edge], self.point, self.pixel, self.std, self.camera_matrix, kernel
        )

    def widened(self, scale: FloatArray) -> EdgeKeypoints:
        """With the standard deviations of each edge (e,) grown by a factor."""
        return replace(self, std=self.std * scale[self.edge, None])

    def as_sure_as(self, estimated: FloatArray, covariance: FloatArray) -> EdgeKeypoints:
        """Widened until they know no more of the poses (e, 4, 4) than covariances (e, 6, 6) say.

        A covariance is that of least squares on these keypoints, made larger where they fit worse than they claim: with
        H their information, trace(C H) is six times by how much.
        """
        edges = np.arange(len(estimated))
        local = self.factor(edges, edges, PLAIN).linearize(estimated[self.edge])
        information = np.zeros_like(covariance)
        np.add.at(information, self.edge, local.hessian)
        inflation = np.trace(covariance @ information, axis1=1, axis2=2) / 6
        return self.widened(np.sqrt(np.maximum(inflation, 1)))
