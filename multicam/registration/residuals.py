"""Estimates against the places where all of their group put them: what the noise is learnt from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multicam.bundle.problem import Problem, State
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.learned import BLOCKS, NoiseModel, centre_in_camera, viewing_axes
from multicam.matching.linear import congruent, inverse
from multicam.registration.edges import pose_factor
from multicam.registration.group import Group
from multicam.registration.kinship import count_alike
from multicam.registration.refinement import Refinement
from multicam.types import FloatArray

FREE = 1.0
"""Variance of an attitude, rad^2, from which a direction is free (a turn about a symmetry axis) and tells nothing."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of many edges in the coordinates of `viewing_axes`.

    Attributes:
        obj_id: (e,).
        deviation: (e, 6) estimate less place.
        expected: (e, 6, 6) covariance of an estimate with all factors 1.
        place: (e, 6, 6) covariance of its place.
        factors: (e, 6) the factors used.
        distance: (e,) of the object, metres.
        unlike: (e,) whether the object was seen from no like direction in the group.
    """

    obj_id: IntArray
    deviation: FloatArray
    expected: FloatArray
    place: FloatArray
    factors: FloatArray
    distance: FloatArray
    unlike: BoolArray

    @classmethod
    def of(cls, group: Group, found: Refinement, noise: NoiseModel) -> Residuals:
        """The residuals of a refinement.

        Args:
            noise: with which the group was prepared.
        """
        factor = pose_factor(group, found.tracks, found.edges)
        state = State(found.placement.world_from_camera, found.world_from_object)
        problem = Problem((factor,), np.arange(len(state.world_from_camera)) == 0)
        pose = state.camera_from_object(factor.camera, factor.object)
        obj_id = group.estimates.obj_id[found.tracks.estimate[found.edges.track]]
        centre = found.centre[factor.object]
        axes, factors = viewing_axes(pose, centre), noise.factors(obj_id)
        return cls(
            obj_id=obj_id,
            deviation=np.einsum("eij,ej->ei", axes, se3.minus(factor.observed, pose)),
            expected=congruent(axes / factors[:, :, None], inverse(factor.information)),
            place=congruent(axes, problem.edge_covariances(state, factor)),
            factors=factors,
            distance=np.linalg.norm(centre_in_camera(pose, centre), axis=-1),
            unlike=count_alike(pose, centre, factor.object) == 1,
        )

    @classmethod
    def joined(cls, parts: Sequence[Residuals]) -> Residuals:
        """All in one."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))

    def relative_to(self, noise: NoiseModel) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Squared deviation, variance of the place and count of directions, (e, 3) each: per block.

        Squares are in units of the variances that a noise model expects, variances of places in units of those in use.
        Free directions count nowhere.
        """
        squared, place, count = (np.zeros((len(self.obj_id), 3)) for _ in range(3))
        factors = noise.factors(self.obj_id)
        for n, block in enumerate(BLOCKS):
            variances, directions = np.linalg.eigh(self.expected[:, block, block])
            bound = variances <= FREE
            deviation = np.einsum("eij,ei->ej", directions, self.deviation[:, block])
            variance = np.einsum("eki,ekl,eli->ei", directions, self.place[:, block, block], directions)
            squared[:, n] = np.sum(bound * deviation**2 / variances, axis=1) / factors[:, block.start] ** 2
            place[:, n] = np.sum(bound * variance / variances, axis=1) / self.factors[:, block.start] ** 2
            count[:, n] = np.sum(bound, axis=1)
        return squared, place, count
