"""Normal equations of cameras and objects: blocks, elimination of the objects, marginal covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.compiled import add_edges, eliminate
from multicam.bundle.factor import Linearization
from multicam.bundle.pair import PairLinearization
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.linear import apply, congruent, inverse, solve
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton system of cameras (c) and objects (o); no block ties two objects.

    Attributes:
        camera_hessian (c, 6, 6), object_hessian (o, 6, 6): diagonal blocks.
        coupling: (o, c, 6, 6), rows of the object and columns of the camera.
        motion: (c, c, 6, 6) blocks between two cameras; zero on the diagonal.
        camera_gradient (c, 6), object_gradient (o, 6).
    """

    camera_hessian: FloatArray
    object_hessian: FloatArray
    coupling: FloatArray
    motion: FloatArray
    camera_gradient: FloatArray
    object_gradient: FloatArray

    @classmethod
    def zeros(cls, cameras: int, objects: int) -> NormalEquations:
        """An empty system, to be added to."""
        return cls(
            np.zeros((cameras, 6, 6)), np.zeros((objects, 6, 6)), np.zeros((objects, cameras, 6, 6)),
            np.zeros((cameras, cameras, 6, 6)), np.zeros((cameras, 6)), np.zeros((objects, 6)),
        )  # fmt: skip

    def add_edges(
        self,
        camera: IntArray,
        obj: IntArray,
        camera_from_object: FloatArray,
        local: Linearization,
        weight: FloatArray,
    ) -> None:
        """Adds edges (e,) at poses (e, 4, 4) with robust weights (e,)."""
        add_edges(
            camera, obj, camera_from_object, local.gradient, local.hessian, weight,
            self.camera_hessian, self.object_hessian, self.coupling, self.camera_gradient, self.object_gradient,
        )  # fmt: skip

    def add_motions(self, first: IntArray, second: IntArray, local: PairLinearization) -> None:
        """Adds what ties two cameras, (m,) first and (m,) second."""
        np.add.at(self.camera_gradient, first, local.gradient[:, :6])
        np.add.at(self.camera_gradient, second, local.gradient[:, 6:])
        np.add.at(self.camera_hessian, first, local.hessian[:, :6, :6])
        np.add.at(self.camera_hessian, second, local.hessian[:, 6:, 6:])
        np.add.at(self.motion, (first, second), local.hessian[:, :6, 6:])
        np.add.at(self.motion, (second, first), local.hessian[:, 6:, :6])

    def without(self, fixed: BoolArray) -> NormalEquations:
        """The system in which some cameras do not move."""
        (free,) = (~fixed).nonzero()
        return NormalEquations(
            self.camera_hessian[free], self.object_hessian, self.coupling.take(free, axis=1),
            self.motion[free[:, None], free], self.camera_gradient[free], self.object_gradient,
        )  # fmt: skip

    def solve(self, damping: float) -> FloatArray:
        """Levenberg-Marquardt step (6 (c + o),), cameras first; the diagonal grows by the factor 1 + damping."""
        eliminated, pulled, schur = self._reduce(damping)
        camera = solve(schur, self.object_gradient.reshape(-1) @ pulled - self.camera_gradient.reshape(-1))
        follow = apply(eliminated, self.object_gradient).reshape(-1) + pulled @ camera
        return np.concatenate((camera, -follow))

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Marginal covariances of the cameras (c, 6, 6) and the objects (o, 6, 6)."""
        eliminated, pulled, schur = self._reduce()
        count = len(self.camera_hessian)
        joint = inverse(schur)
        camera = joint.reshape(count, 6, count, 6)[np.arange(count), :, np.arange(count), :]
        return camera, eliminated + congruent(pulled.reshape(len(eliminated), 6, 6 * count), joint)

    def joint_covariance(self) -> FloatArray:
        """(6 c, 6 c) covariance of all cameras together, the objects being free."""
        return inverse(self._reduce()[2])

    def edge_covariances(self, camera: IntArray, obj: IntArray, jacobian: FloatArray) -> FloatArray:
        """Covariances (e, 6, 6) of xi_object + jacobian xi_camera for edges (e,), with all correlations.

        Args:
            camera, obj: (e,) indices of blocks.
            jacobian: (e, 6, 6).
        """
        eliminated, pulled, schur = self._reduce()
        # An object follows the cameras by -(H_oo)^-1 H_oc and varies by (H_oo)^-1 beside.
        follow = -pulled.reshape(len(eliminated), 6, len(schur))[obj]
        edges = np.arange(len(obj))
        follow.reshape(len(obj), 6, len(self.camera_hessian), 6)[edges, :, camera, :] += jacobian
        return eliminated[obj] + congruent(follow, inverse(schur))

    def _reduce(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inverse object blocks (o, 6, 6), those times the coupling (6 o, 6 c), and the Schur complement (6 c, 6 c).

        Raises:
            numpy.linalg.LinAlgError: an object's block is not positive definite.
        """
        objects, cameras = self.coupling.shape[:2]
        eliminated, pulled = np.empty((objects, 6, 6)), np.empty((6 * objects, 6 * cameras))
        schur = np.empty((6 * cameras, 6 * cameras))
        blocks = (self.camera_hessian, self.object_hessian, self.coupling, self.motion)
        if not eliminate(*blocks, damping, eliminated, pulled, schur):
            raise np.linalg.LinAlgError("the information about an object is not positive definite")
        return eliminated, pulled, schur
