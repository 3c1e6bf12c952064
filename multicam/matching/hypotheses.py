"""Relative poses of two frames from pairs of objects of one class, symmetries included.

If a reference frame A and a query frame B hold poses of one object, `A_from_object @ S @ inverse(B_from_object)`
measures A_from_B for one symmetry S of the object; its covariance: docs/registration.md. A continuous symmetry leaves a
turn about its axis open: the measurement is then a family `pose @ exp(angle * axis)`, and a second object tells the
angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3, so3
from multicam.matching.arrays import BoolArray, IntArray, ragged, rank_in_group
from multicam.matching.compare import near_differences
from multicam.matching.linear import apply, inverse, invert
from multicam.matching.observations import PosedObjects
from multicam.matching.pairing import pair_up, relative_poses
from multicam.matching.symmetry import SymmetryTable
from multicam.types import FloatArray

PARTNERS = 3
"""Second objects tried for the angle of a measurement with an axis: those whose distances fit best."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Every way in which a query object may be a reference object; sorted by link.

    Attributes:
        frames: (links, 2) reference and query frame of each link.
        link: (m,) which pair of frames.
        reference, query: (m,) the two objects.
        variant: (m,) number of the discrete symmetry, 0 for the identity.
        pose: (m, 4, 4) measured reference_from_query of the frames.
        covariance, information: (m, 6, 6) of its right perturbation, and the inverse.
        log_determinant: (m,) of the covariance.
        axis: (m, 6) twist in the query frame about which the measurement may turn; zero for most objects.
        log_prior: (m,) logarithm of the probability that the pairing is right, from scores and number of rivals.
    """

    frames: IntArray
    link: IntArray
    reference: IntArray
    query: IntArray
    variant: IntArray
    pose: FloatArray
    covariance: FloatArray
    information: FloatArray
    log_determinant: FloatArray
    axis: FloatArray
    log_prior: FloatArray

    def __len__(self) -> int:
        return len(self.link)

    def range_of(self, link: IntArray) -> tuple[IntArray, IntArray]:
        """Where the measurements of each given link start and stop."""
        return np.searchsorted(self.link, link), np.searchsorted(self.link, link, side="right")

    def near(self, link: IntArray, pose: FloatArray, largest_turn: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Logarithms of the differences of poses (h, 4, 4) to all measurements of their links (h,).

        A measurement with an axis is turned about it to come closest.

        Returns:
            Pose and measurement (n,) and their difference (n, 6), where it turns by less than `largest_turn` radians.
        """
        start, stop = self.range_of(link)
        most = int(np.sum(stop - start))
        owner, member, residual = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 6))
        least_trace = 1 + 2 * np.cos(largest_turn)
        count = near_differences(
            np.ascontiguousarray(pose), start, stop, self.pose, self.axis, least_trace, owner, member, residual
        )
        return owner[:count], member[:count], residual[:count]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Candidate poses of query frames in reference frames; sorted by link.

    Attributes:
        link: (h,) which pair of frames.
        pose: (h, 4, 4) reference_from_query.
        covariance: (h, 6, 6) of its right perturbation.
    """

    link: IntArray
    pose: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.link)

    def __getitem__(self, chosen: IntArray | BoolArray) -> Hypotheses:
        return Hypotheses(self.link[chosen], self.pose[chosen], self.covariance[chosen])


def measure(
    reference: PosedObjects, query: PosedObjects, allowed: BoolArray, symmetries: SymmetryTable
) -> Measurements:
    """All allowed pairs of one class, each with every discrete symmetry.

    Args:
        allowed: (reference, query) which objects may be compared, such as those of different views.
    """
    a, b, link, rivals = pair_up(reference.frame, reference.obj_id, query.frame, query.obj_id, allowed)
    first_of_link = np.flatnonzero(rank_in_group(link) == 0)
    frames = np.stack((reference.frame[a[first_of_link]], query.frame[b[first_of_link]]), axis=1)
    row = symmetries.rows(query.obj_id[b])
    log_prior = np.log(reference.score[a] * query.score[b] / (rivals * symmetries.count[row]))
    pair, symmetry = ragged(symmetries.start[row], symmetries.count[row])
    a, b, row = a[pair], b[pair], row[pair]
    pose, covariance, move = np.empty((len(a), 4, 4)), np.empty((len(a), 6, 6)), np.empty((len(a), 6, 6))
    relative_poses(
        a, b, symmetry, reference.frame_from_object, reference.covariance, query.frame_from_object, query.covariance,
        symmetries.transforms, pose, covariance, move,
    )  # fmt: skip
    information, determinant = invert(covariance)
    return Measurements(
        frames=frames,
        link=link[pair],
        reference=a,
        query=b,
        variant=symmetry - symmetries.start[row],
        pose=pose,
        covariance=covariance,
        information=information,
        log_determinant=determinant,
        axis=apply(move, symmetries.axis[row]),
        log_prior=log_prior[pair],
    )


def propose(
    measurements: Measurements, reference: PosedObjects, query: PosedObjects, symmetries: SymmetryTable
) -> Hypotheses:
    """One hypothesis from each measurement without an axis; those with one get their angle from second objects.

    A measurement with an axis and no second object is a hypothesis too: it shows that the turn is open.
    """
    turning = np.any(measurements.axis, axis=-1)
    first, second, angle = _second_objects(
        measurements, np.flatnonzero(turning), _centres(reference, symmetries), _centres(query, symmetries)
    )
    turning[np.setdiff1d(np.flatnonzero(turning), first)] = False
    fixed = np.flatnonzero(~turning)
    turned = measurements.pose[first] @ se3.exp(angle[:, None] * measurements.axis[first])
    both = inverse(measurements.information[first] + measurements.information[second])
    link = np.concatenate((measurements.link[fixed], measurements.link[first]))
    pose = np.concatenate((measurements.pose[fixed], turned))
    covariance = np.concatenate((measurements.covariance[fixed], both))
    return Hypotheses(link, pose, covariance)[np.argsort(link, kind="stable")]


def _second_objects(
    measurements: Measurements, turning: IntArray, reference_centre: FloatArray, query_centre: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """For measurements with an axis: (first, second, angle) that bring the second object's centres together."""
    start, stop = measurements.range_of(measurements.link[turning])
    owner, second = ragged(start, stop - start)
    first = turning[owner]
    # Symmetric variants of the second object share its centre, so the first variant stands for all.
    fits = measurements.variant[second] == 0
    for side in (measurements.reference, measurements.query):
        fits &= side[first] != side[second]
    first, second = first[fits], second[fits]
    direction, moment = measurements.axis[first, :3], measurements.axis[first, 3:]
    on_axis = so3.cross(direction, moment)
    query_from_reference = se3.inverse(measurements.pose[first])
    target = se3.act(query_from_reference, reference_centre[measurements.reference[second], None])[:, 0]
    goal, goal_height = _across(target - on_axis, direction)
    start, start_height = _across(query_centre[measurements.query[second]] - on_axis, direction)
    angle = np.arctan2(np.sum(direction * so3.cross(start, goal), axis=-1), np.sum(start * goal, axis=-1))
    misfit = np.hypot(goal_height - start_height, np.linalg.norm(goal, axis=-1) - np.linalg.norm(start, axis=-1))
    order = np.lexsort((misfit, first))
    order = order[rank_in_group(first[order]) < PARTNERS]
    return first[order], second[order], angle[order]


def _centres(objects: PosedObjects, symmetries: SymmetryTable) -> FloatArray:
    """(n, 3) the points of the objects that no symmetry moves, in their frames."""
    return se3.act(objects.frame_from_object, symmetries.centre[symmetries.rows(objects.obj_id), None])[:, 0]


def _across(vector: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Part of vectors (n, 3) across unit directions (n, 3), and the coordinate (n,) along them."""
    along = np.sum(vector * direction, axis=-1)
    return vector - along[:, None] * direction, along
