"""Placed cameras and the objects they share, refined together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from multicam.bundle.bearing import BearingFactor
from multicam.bundle.factor import EdgeFactor
from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.problem import Problem, State
from multicam.bundle.scenery.scenery import bearing_factor
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray
from multicam.matching.assignment import Tracks, associate
from multicam.registration.edges import Edges, keypoint_factors, pose_factor, reachable, shared_edges
from multicam.registration.group import Group
from multicam.registration.kinship import count_alike, inflation
from multicam.registration.placement import Placement
from multicam.types import FloatArray

ROUNDS = 3
"""How often identities are revised with the refined cameras; they settle after one or two."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """Cameras and objects after a joint refinement.

    Attributes:
        placement: refined poses; covariances relative to the world camera.
        tracks: which estimates are one object.
        edges: those that tie cameras together.
        centre: (o, 3) of the shared objects, object frame.
        kinship: see NoiseModel.
        factors: what was minimised.
        bearings: the same, between cameras.
        world_from_object: (o, 4, 4) of the shared objects.
        object_covariance: (o, 6, 6).
    """

    placement: Placement
    tracks: Tracks
    edges: Edges
    centre: FloatArray
    kinship: float
    factors: tuple[EdgeFactor, ...]
    bearings: tuple[BearingFactor, ...]
    world_from_object: FloatArray
    object_covariance: FloatArray


def refine(group: Group, placement: Placement) -> Refinement:
    """Identifies objects and minimises over all poses, until the identities stay.

    Cameras that do not hang together with the first one over shared objects are dropped.
    """
    refinement = None
    for _ in range(ROUNDS):
        placement, tracks, edges = _identify(group, placement)
        if refinement is not None and tracks.same_identities(refinement.tracks):
            return replace(refinement, tracks=tracks)
        factors, shared = (pose_factor(group, tracks, edges),), tracks.fused[edges.shared]
        centre = np.array([group.catalogue[o].box_centre() for o in shared.obj_id.tolist()]).reshape(-1, 3)
        start = Refinement(
            placement, tracks, edges, centre, group.kinship, factors, _bearings(group, placement),
            shared.frame_from_object, shared.covariance,
        )  # fmt: skip
        refinement = _minimize(start, group.config.solver)
        placement = refinement.placement
    assert refinement is not None
    return refinement


def sharpen(group: Group, refinement: Refinement) -> Refinement:
    """Minimises once more with the keypoints behind the estimates, where there are any."""
    factors = keypoint_factors(group, refinement.tracks, refinement.edges)
    if not factors:
        return refinement
    return _minimize(replace(refinement, factors=factors), group.config.solver)


def seen_from(refinement: Refinement, camera: int) -> Refinement:
    """The same answer with another camera (position in the placement) as the world.

    Args:
        refinement: as `refine` and `sharpen` give it, its world being its first camera.
    """
    if camera == 0:
        return refinement
    change = se3.inverse(refinement.placement.world_from_camera[camera])
    state = State(change @ refinement.placement.world_from_camera, change @ refinement.world_from_object)
    return _conclude(refinement, state, world=camera)


def _identify(group: Group, placement: Placement) -> tuple[Placement, Tracks, Edges]:
    while True:
        tracks = associate(
            group.estimates, placement.views, placement.world_from_camera, placement.covariance,
            group.symmetries, group.config.consensus.likelihood,
        )  # fmt: skip
        edges = shared_edges(group, tracks, placement.views)
        connected = reachable(edges, len(placement.views))
        if np.all(connected):
            return placement, tracks, edges
        placement = placement.only(connected)


def _bearings(group: Group, placement: Placement) -> tuple[BearingFactor, ...]:
    """Those between placed cameras."""
    place = {view: camera for camera, view in enumerate(placement.views.tolist())}
    return bearing_factor(
        [(place[a], place[b], motion) for a, b, motion in group.bearings if a in place and b in place]
    )


def _problem(refinement: Refinement, fixed: BoolArray) -> Problem:
    return Problem(refinement.factors, fixed, refinement.bearings)


def _minimize(refinement: Refinement, config: LevenbergConfig) -> Refinement:
    """Moves the poses of a refinement to the minimum of its factors; the first camera is the world."""
    cameras = len(refinement.placement.views)
    start = State(refinement.placement.world_from_camera, refinement.world_from_object)
    minimum = minimize(_problem(refinement, np.arange(cameras) == 0), start, config)
    return _conclude(refinement, minimum.state, world=0)


def _conclude(refinement: Refinement, state: State, world: int) -> Refinement:
    """The refinement at another state, with covariances relative to the camera `world`."""
    problem = _problem(refinement, np.arange(len(state.world_from_camera)) == world)
    cameras, objects = problem.covariances(state, problem.noise_scale(state), _inflation(refinement, state))
    placement = replace(refinement.placement, world_from_camera=state.world_from_camera, covariance=cameras)
    return replace(
        refinement, placement=placement, world_from_object=state.world_from_object, object_covariance=objects
    )


def _inflation(refinement: Refinement, state: State) -> FloatArray | None:
    """(c, o) by how much to widen the edges of each camera and object; None if views count as independent."""
    if refinement.kinship == 1:
        return None
    camera, obj = refinement.edges.camera, refinement.edges.object
    pose = state.camera_from_object(camera, obj)
    widened = np.ones((len(state.world_from_camera), len(state.world_from_object)))
    widened[camera, obj] = inflation(refinement.kinship, count_alike(pose, refinement.centre[obj], obj))
    return widened
