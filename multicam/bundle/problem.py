"""Cameras and objects that vary together: from factors to one damped Gauss-Newton step, and to covariances.

Edges know only camera_from_object. Moving the camera by xi on the right moves that pose, seen from the object, by
-Ad(object_from_camera) xi, so each edge adds [[H, H J], [J' H, J' H J]] and [g; J' g] with
J = -Ad(object_from_camera). No edge ties two objects: their blocks are eliminated one by one (Schur complement).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from multicam.bundle.compiled import edge_poses, move_cameras
from multicam.bundle.factor import EdgeFactor, Linearization
from multicam.bundle.normal import NormalEquations
from multicam.bundle.pair import PairFactor
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.types import FloatArray

SCALE_ROUNDS = 30
"""Most fixed-point rounds for the noise scale, which rises to within a few percent; no more is needed of it."""

PRIOR_REDUNDANCY = 12.0
"""How many redundant measurements the stated noise counts for against what the residuals say of it."""


@dataclass(frozen=True, eq=False)
class State:
    """Poses that vary: world_from_camera (c, 4, 4) and world_from_object (o, 4, 4)."""

    world_from_camera: FloatArray
    world_from_object: FloatArray

    def camera_from_object(self, camera: IntArray, obj: IntArray) -> FloatArray:
        """(e, 4, 4) poses of objects (e,) seen from cameras (e,)."""
        poses = np.empty((len(camera), 4, 4))
        edge_poses(self.world_from_camera, self.world_from_object, camera, obj, poses)
        return poses


@dataclass(frozen=True, eq=False)
class Problem:
    """Factors over cameras and objects; some cameras are fixed.

    Attributes:
        factors: edges between cameras and objects.
        fixed: (c,) cameras that do not move. Each set of cameras and objects that hang together needs one.
        motions: what ties two cameras each: measured motions, and what they see beside the objects.
    """

    factors: Sequence[EdgeFactor]
    fixed: BoolArray
    motions: Sequence[PairFactor] = ()

    def linearize(self, state: State) -> tuple[float, NormalEquations]:
        """Robust energy and Gauss-Newton system at a state."""
        system = NormalEquations.zeros(len(state.world_from_camera), len(state.world_from_object))
        energy = 0.0
        for factor, pose, local in self._edges(state):
            squared = 2 * local.energy
            energy += float(factor.kernel.energy(squared).sum())
            system.add_edges(factor.camera, factor.object, pose, local, factor.kernel.weight(squared))
        for motion in self.motions:
            local = motion.linearize(state.world_from_camera)
            energy += float(local.energy.sum())
            system.add_motions(motion.first, motion.second, local)
        return energy, system.without(self.fixed)

    def retract(self, state: State, step: FloatArray) -> State:
        """The state moved by a step (6 (f + o),) on the right."""
        tangents = step.reshape(-1, 6)
        cameras, objects = np.empty_like(state.world_from_camera), state.world_from_object
        move_cameras(state.world_from_camera, self.fixed, tangents, cameras)
        return State(cameras, se3.plus(objects, tangents[len(tangents) - len(objects) :]))

    def noise_scale(self, state: State) -> float:
        """How much larger the variances of the edges are than stated, by their residuals at a minimum; at least 1.

        The scale at which the Student likelihood of the residuals is greatest, with the redundancy (measured numbers
        less estimated ones, odometry apart) as the count and PRIOR_REDUNDANCY numbers in favour of the stated noise.
        """
        edges = [(factor.kernel, 2 * local.energy) for factor, _, local in self._edges(state)]
        measured = sum(kernel.dimension * len(squared) for kernel, squared in edges)
        moved = sum(len(motion.first) for motion in self.motions)
        estimated = 6 * (np.count_nonzero(~self.fixed) + len(state.world_from_object) - moved)
        count, scale = PRIOR_REDUNDANCY + max(measured - estimated, 0), 1.0
        for _ in range(SCALE_ROUNDS):
            misfit = sum(float(np.sum(kernel.weight(squared / scale) * squared)) for kernel, squared in edges)
            before, scale = scale, max(1.0, (PRIOR_REDUNDANCY + misfit) / count)
            if scale < 1.02 * before:
                break
        return scale

    def covariances(
        self, state: State, noise_scale: float = 1.0, inflation: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Covariances of the cameras (c, 6, 6; zero where fixed) and the objects (o, 6, 6) at a minimum.

        An edge counts for no more than its stated information: residuals that happen to be small, because estimates of
        one network err alike in every view, raise its robust weight but are no proof of precision.

        Args:
            noise_scale: how much larger the variances of the edges are than stated.
            inflation: (c, o) how much larger again to take those between a camera and an object; 1 where left out.
        """
        free, objects = self._capped(state, noise_scale, inflation).covariances()
        cameras = np.zeros((len(self.fixed), 6, 6))
        cameras[~self.fixed] = free
        return cameras, objects

    def expected_motion(self, state: State, noise_scale: float = 1.0) -> FloatArray:
        """(m,) expected squared norm of each motion's whitened error, at a minimum; 6 if the stated noise is right.

        The squared residual and what the uncertainty of both poses adds to it: the E step for the motions' variance.
        """
        free = np.flatnonzero(np.repeat(~self.fixed, 6))
        joint = np.zeros((6 * len(self.fixed), 6 * len(self.fixed)))
        joint[np.ix_(free, free)] = self._capped(state, noise_scale).joint_covariance()
        expected = [np.zeros(0)]
        for motion in self.motions:
            local = motion.linearize(state.world_from_camera)
            rows = 6 * np.stack((motion.first, motion.second), axis=1)[:, :, None] + np.arange(6)
            rows = rows.reshape(-1, 12)
            both = joint[rows[:, :, None], rows[:, None, :]]
            expected.append(2 * local.energy + np.sum(local.hessian * both, axis=(1, 2)))
        return np.concatenate(expected)

    def edge_covariances(self, state: State, factor: EdgeFactor) -> FloatArray:
        """(e, 6, 6) covariances, at a minimum, of the poses camera_from_object of a factor's edges (right tangent)."""
        object_from_world = se3.inverse(state.world_from_object)
        jacobian = -se3.adjoint(object_from_world[factor.object] @ state.world_from_camera[factor.camera])
        # A fixed camera has no block; any will do, for its edges do not depend on it.
        jacobian[self.fixed[factor.camera]] = 0
        block = np.maximum(np.cumsum(~self.fixed) - 1, 0)[factor.camera]
        return self._capped(state).edge_covariances(block, factor.object, jacobian)

    def _capped(self, state: State, noise_scale: float = 1.0, inflation: FloatArray | None = None) -> NormalEquations:
        """The system at a minimum in which no edge counts for more than its information; without the fixed cameras."""
        system = NormalEquations.zeros(len(state.world_from_camera), len(state.world_from_object))
        for factor, pose, local in self._edges(state):
            weight = factor.kernel.information(2 * local.energy / noise_scale) / noise_scale
            if inflation is not None:
                weight = weight / inflation[factor.camera, factor.object]
            system.add_edges(factor.camera, factor.object, pose, local, weight)
        for motion in self.motions:
            system.add_motions(motion.first, motion.second, motion.linearize(state.world_from_camera))
        return system.without(self.fixed)

    def _edges(self, state: State) -> Iterator[tuple[EdgeFactor, FloatArray, Linearization]]:
        """Each factor with the poses camera_from_object of its edges and its energy there."""
        for factor in self.factors:
            pose = state.camera_from_object(factor.camera, factor.object)
            yield factor, pose, factor.linearize(pose)
