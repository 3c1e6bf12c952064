"""Which estimates of placed cameras are one object: one-to-one within a class, over any number of views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.matching.compare import fuse
from multicam.matching.hypotheses import measure
from multicam.matching.likelihood import LikelihoodConfig
from multicam.matching.linear import congruent, invert, squared_norm
from multicam.matching.observations import PosedObjects
from multicam.matching.symmetry import SymmetryTable
from multicam.types import FloatArray

ANY_TURN = np.pi
"""Attitudes of a placed camera are compared whatever turn lies between them."""

SAME_TWIN = 0.05
"""Radians between two twins that count as the same symmetry; a turn about an axis changes a little in each round."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Identities of estimates.

    Attributes:
        estimate: (n,) index of an estimate.
        object: (n,) which of the fused objects it shows.
        camera_from_object: (n, 4, 4) the symmetric twin of the estimate that lies closest to the object.
        covariance: (n, 6, 6) of that twin.
        fused: the objects in the world, those that one camera alone sees included.
    """

    estimate: IntArray
    object: IntArray
    camera_from_object: FloatArray
    covariance: FloatArray
    fused: PosedObjects

    def same_identities(self, other: Tracks) -> bool:
        """Whether the other tracks join the same estimates, each with the same symmetry."""
        if not (np.array_equal(self.estimate, other.estimate) and np.array_equal(self.object, other.object)):
            return False
        shift = se3.minus(self.camera_from_object, other.camera_from_object)
        return bool(np.abs(shift[:, :3]).max(initial=0) < SAME_TWIN)


def associate(
    estimates: PosedObjects,
    cameras: IntArray,
    world_from_camera: FloatArray,
    camera_covariance: FloatArray,
    symmetries: SymmetryTable,
    likelihood: LikelihoodConfig,
) -> Tracks:
    """Adds the cameras one by one to a map of fused objects.

    Args:
        estimates: of all views; their frame is the index of the view.
        cameras: (c,) indices of the placed views, in the order in which they are added.
        world_from_camera, camera_covariance: (c, 4, 4) and (c, 6, 6).
    """
    fused = estimates[np.zeros(0, dtype=np.int64)]
    seen_by_camera = [np.flatnonzero(estimates.frame == camera) for camera in cameras]
    identities, twins = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 4, 4))]
    covariances = [np.zeros((0, 6, 6))]
    for chosen, pose, covariance in zip(seen_by_camera, world_from_camera, camera_covariance, strict=True):
        seen = estimates[chosen]
        identity, twin = recognise(fused, seen, pose, covariance, symmetries, likelihood)
        object_from_camera = se3.inverse(twin)
        # The twin is the estimate moved by a symmetry on the right; its tangent turns with it.
        twin_covariance = congruent(se3.adjoint(object_from_camera @ seen.frame_from_object), seen.covariance)
        in_world = twin_covariance + congruent(se3.adjoint(object_from_camera), covariance)
        fused = _fuse(
            fused, PosedObjects(np.zeros_like(seen.frame), seen.obj_id, seen.score, pose @ twin, in_world), identity
        )
        identities.append(identity)
        twins.append(twin)
        covariances.append(twin_covariance)
    return Tracks(
        np.concatenate([np.zeros(0, dtype=np.int64), *seen_by_camera]),
        np.concatenate(identities),
        np.concatenate(twins),
        np.concatenate(covariances),
        fused,
    )


def recognise(
    fused: PosedObjects,
    seen: PosedObjects,
    world_from_camera: FloatArray,
    covariance: FloatArray,
    symmetries: SymmetryTable,
    likelihood: LikelihoodConfig,
) -> tuple[IntArray, FloatArray]:
    """For each seen object which fused object it is (new ones are numbered on), and its closest twin.

    Args:
        fused: objects in the world.
        seen: estimates (n,) of one camera.
        world_from_camera, covariance: (4, 4), and (6, 6) of its right perturbation.

    Returns:
        (n,) position among the fused objects, from len(fused) on for strangers, and (n, 4, 4) camera_from_object, the
        symmetric twin of each estimate that lies closest to the object.
    """
    strangers = len(fused) + np.arange(len(seen)), seen.frame_from_object
    if not len(fused):
        return strangers
    pairs = measure(fused, seen, np.ones((len(fused), len(seen)), dtype=np.bool_), symmetries)
    if not len(pairs):
        return strangers
    _, member, residual = pairs.near(np.zeros(1, dtype=np.int64), world_from_camera[None], ANY_TURN)
    information, determinant = invert(pairs.covariance[member] + covariance)
    gain = likelihood.log_ratio(squared_norm(residual, information), determinant) + pairs.log_prior[member]
    order = np.argsort(gain, kind="stable")
    # Of the symmetric variants of a pair the last assignment stays, which has the greatest gain.
    gains, best = np.zeros((len(fused), len(seen))), np.zeros((len(fused), len(seen)), dtype=np.int64)
    pair = pairs.reference[member[order]], pairs.query[member[order]]
    gains[pair] = np.maximum(gain[order], 0)
    best[pair] = order
    row, column = linear_sum_assignment(gains, maximize=True)
    useful = gains[row, column] > 0
    row, column = row[useful], column[useful]
    is_new = np.ones(len(seen), dtype=np.bool_)
    is_new[column] = False
    identity = len(fused) + np.cumsum(is_new) - 1
    identity[column] = row
    twin = seen.frame_from_object.copy()
    turned = world_from_camera @ se3.exp(residual[best[row, column]])
    twin[column] = se3.inverse(turned) @ fused.frame_from_object[row]
    return identity, twin


def _fuse(fused: PosedObjects, seen: PosedObjects, identity: IntArray) -> PosedObjects:
    """The map with one more view: known objects move to the weighted mean (Kalman), new ones are appended."""
    known = identity < len(fused)
    row, again, new = identity[known], seen[known], seen[~known]
    pose, covariance, score = fused.frame_from_object.copy(), fused.covariance.copy(), fused.score.copy()
    if not fuse(pose, covariance, row, again.frame_from_object, again.covariance):
        raise np.linalg.LinAlgError("the covariance of an object is not positive definite")
    score[row] = 1 - (1 - score[row]) * (1 - again.score)
    return PosedObjects(
        np.concatenate((fused.frame, new.frame)),
        np.concatenate((fused.obj_id, new.obj_id)),
        np.concatenate((score, new.score)),
        np.concatenate((pose, new.frame_from_object)),
        np.concatenate((covariance, new.covariance)),
    )
