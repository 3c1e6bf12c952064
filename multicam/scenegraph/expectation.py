"""What a camera of known pose should see, and what of it it does see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3
from multicam.matching.arrays import BoolArray
from multicam.matching.assignment import recognise
from multicam.matching.likelihood import LikelihoodConfig
from multicam.matching.linear import congruent
from multicam.matching.observations import PosedObjects
from multicam.matching.symmetry import SymmetryTable
from multicam.scenegraph.graph import Mover, Rest
from multicam.scenegraph.solution import Solution
from multicam.scenegraph.uncertain import UncertainPose, mahalanobis
from multicam.types import FloatArray, ObjectEstimate


@dataclass(frozen=True, eq=False)
class Expectation:
    """Objects as a camera should see them.

    Attributes:
        numbers: of the rest, or None for an object in motion.
        instances: of the object.
        objects: their poses and covariances in the camera's frame.
    """

    numbers: tuple[int | None, ...]
    instances: tuple[int, ...]
    objects: PosedObjects

    def pose(self, index: int) -> UncertainPose:
        """camera_from_object of one of them."""
        return UncertainPose(self.objects.frame_from_object[index], self.objects.covariance[index])


@dataclass(frozen=True, eq=False)
class Sight:
    """What a camera saw of what it should have seen.

    Attributes:
        expected: what it should have seen.
        matched: position among the expected objects to (position among the estimates, the pose measured).
        strangers: positions of the other estimates.
        contradicted: position among the expected objects to the estimate of its class that stands elsewhere.
        displaced: how many estimates are of classes of which an expected object is missing, these included.
    """

    expected: Expectation
    matched: dict[int, tuple[int, UncertainPose]]
    strangers: tuple[int, ...]
    contradicted: dict[int, int]
    displaced: int


def expect(solution: Solution, stay: int, timestamp_ns: int) -> Expectation:
    """All objects at rest and in motion, in the frame of a camera at one of the graph's stays."""
    graph = solution.graph
    camera_from_world = se3.inverse(solution.state.world_from_camera[stay])
    present = [n for n, number in enumerate(solution.numbers) if not graph.rests[number].over]
    numbers = [solution.numbers[n] for n in present]
    _, covariances = solution.seen_from(stay)
    movers = [graph.movers[instance] for instance in sorted(graph.movers)]
    moving = [predicted(mover, timestamp_ns, graph.config.objects.motion_per_second) for mover in movers]
    nodes: list[Rest | Mover] = [*(graph.rests[number] for number in numbers), *movers]
    poses = [*(solution.state.world_from_object[present]), *(pose.pose for pose in moving)]
    return Expectation(
        (*numbers, *(None for _ in movers)),
        tuple(node.instance for node in nodes),
        PosedObjects(
            frame=np.zeros(len(nodes), dtype=np.int64),
            obj_id=np.array([node.obj_id for node in nodes], dtype=np.int64),
            score=np.array([node.score for node in nodes], dtype=np.float64),
            frame_from_object=camera_from_world @ np.array(poses).reshape(-1, 4, 4),
            covariance=np.array([*covariances[present], *(pose.covariance for pose in moving)]).reshape(-1, 6, 6),
        ),
    )


def predicted(mover: Mover, timestamp_ns: int, motion_per_second: FloatArray) -> UncertainPose:
    """world_from_object of an object in motion some time after its last sighting."""
    return mover.pose.inflated((timestamp_ns - mover.seen_ns) * 1e-9 * motion_per_second)


def as_estimates(objects: PosedObjects) -> tuple[ObjectEstimate, ...]:
    """Objects in a frame as the estimates of a view, for a registration."""
    return tuple(
        ObjectEstimate(int(obj_id), float(score), pose, covariance)
        for obj_id, score, pose, covariance in zip(
            objects.obj_id, objects.score, objects.frame_from_object, objects.covariance, strict=True
        )
    )


def compare(
    expected: Expectation,
    seen: PosedObjects,
    diameters: FloatArray,
    camera_matrix: FloatArray | None,
    symmetries: SymmetryTable,
    likelihood: LikelihoodConfig,
    gate: float,
) -> Sight:
    """Recognises estimates one-to-one, and finds those that tell of an object elsewhere than expected.

    An estimate contradicts an expected object if it is most likely that object but lies beyond the gate; also if both
    are left over, are of one class, and the object should be in the picture or lies within its own diameter of the
    estimate.

    Args:
        seen: estimates of the camera.
        diameters: (n,) of the expected objects, metres.
        gate: largest squared Mahalanobis distance of an estimate that agrees.
    """
    identity, twin = recognise(expected.objects, seen, np.eye(4), np.zeros((6, 6)), symmetries, likelihood)
    known = len(expected.objects)
    matched: dict[int, tuple[int, UncertainPose]] = {}
    far: dict[int, int] = {}
    for index in np.flatnonzero(identity < known).tolist():
        turned = se3.adjoint(se3.inverse(twin[index]) @ seen.frame_from_object[index])
        measured = UncertainPose(twin[index], congruent(turned, seen.covariance[index]))
        if mahalanobis(expected.pose(int(identity[index])), measured) <= gate:
            matched[int(identity[index])] = index, measured
        else:
            far[int(identity[index])] = index
    strangers = np.flatnonzero(identity >= known)
    missing = np.setdiff1d(np.arange(known), identity)
    contradicted = far | _contradictions(
        expected.objects, missing.tolist(), seen, strangers.tolist(), diameters, camera_matrix
    )
    left = tuple(index for index in strangers.tolist() if index not in contradicted.values())
    absent = set(expected.objects.obj_id[missing].tolist())
    displaced = len(contradicted) + sum(int(seen.obj_id[index]) in absent for index in left)
    return Sight(expected, matched, left, contradicted, displaced)


def _contradictions(
    expected: PosedObjects,
    missing: list[int],
    seen: PosedObjects,
    strangers: list[int],
    diameters: FloatArray,
    camera_matrix: FloatArray | None,
) -> dict[int, int]:
    centre = expected.frame_from_object[:, :3, 3]
    shown = in_picture(centre, camera_matrix)
    pairs = sorted(
        (float(np.linalg.norm(centre[e] - seen.frame_from_object[s, :3, 3])), e, s)
        for e in missing
        for s in strangers
        if expected.obj_id[e] == seen.obj_id[s]
    )
    found: dict[int, int] = {}
    for distance, e, s in pairs:
        if (shown[e] or distance < diameters[e]) and e not in found and s not in found.values():
            found[e] = s
    return found


def in_picture(points: FloatArray, camera_matrix: FloatArray | None) -> BoolArray:
    """(n,) whether points (n, 3) of the camera frame lie before the camera and within twice its principal point."""
    if camera_matrix is None:
        return np.zeros(len(points), dtype=np.bool_)
    centre = camera_matrix[:2, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = points @ camera_matrix.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        return (points[:, 2] > 0) & np.all((pixels > 0) & (pixels < 2 * centre), axis=1)
