"""From identities to factors: what each placed camera says about the objects it shares with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.bundle.factor import EdgeFactor
from multicam.bundle.keypoint import KeypointFactor
from multicam.bundle.pose import PoseFactor
from multicam.bundle.robust import Student
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.assignment import Tracks
from multicam.matching.linear import inverse
from multicam.registration.group import Group


@dataclass(frozen=True, eq=False)
class Edges:
    """Estimates of objects that two or more cameras see.

    Attributes:
        track: (e,) rows of the tracks.
        camera: (e,) position of the camera in the placement.
        object: (e,) position among the shared objects.
        shared: (o,) the shared objects, as indices of the map.
    """

    track: IntArray
    camera: IntArray
    object: IntArray
    shared: IntArray

    def only(self, chosen: IntArray) -> Edges:
        """Some of the edges, over the same objects."""
        return Edges(self.track[chosen], self.camera[chosen], self.object[chosen], self.shared)


def shared_edges(group: Group, tracks: Tracks, views: IntArray) -> Edges:
    """The edges of objects with at least two estimates; `views` are the placed ones in order."""
    count = np.bincount(tracks.object, minlength=len(tracks.fused))
    track = np.flatnonzero(count[tracks.object] >= 2)
    shared = np.flatnonzero(count >= 2)
    position = np.argsort(views)
    frame = group.estimates.frame[tracks.estimate[track]]
    camera = position[np.searchsorted(views, frame, sorter=position)]
    return Edges(track, camera, np.searchsorted(shared, tracks.object[track]), shared)


def reachable(edges: Edges, cameras: int) -> BoolArray:
    """(cameras,) whether a camera hangs together with the first one over shared objects."""
    sees = np.zeros((cameras, len(edges.shared)), dtype=np.bool_)
    sees[edges.camera, edges.object] = True
    reached = np.arange(cameras) == 0
    while True:
        wider = reached | (sees @ (reached @ sees))
        if np.array_equal(wider, reached):
            return reached
        reached = wider


def pose_factor(group: Group, tracks: Tracks, edges: Edges) -> PoseFactor:
    """The estimated poses as observations."""
    kernel = Student(group.config.consensus.likelihood.tail, dimension=6)
    # Estimates are compared with the noise of unlike views and weighed with that which is usual within a group.
    information = group.kinship * inverse(tracks.covariance[edges.track])
    return PoseFactor(edges.camera, edges.object, tracks.camera_from_object[edges.track], information, kernel)


def keypoint_factors(group: Group, tracks: Tracks, edges: Edges) -> tuple[EdgeFactor, ...]:
    """Keypoints as observations where an estimate carries them, its pose otherwise; empty if none does."""
    seen = [group.keypoints(estimate) for estimate in tracks.estimate[edges.track].tolist()]
    with_keypoints = [(n, keypoints) for n, keypoints in enumerate(seen) if keypoints is not None]
    if not with_keypoints:
        return ()
    rows = np.array([n for n, _ in with_keypoints])
    twins = tracks.camera_from_object[edges.track[rows]]
    # The detector meant the keypoints of the estimate; seen from the twin they stand elsewhere on the object.
    twin_from_estimate = se3.inverse(twins) @ group.estimates.frame_from_object[tracks.estimate[edges.track[rows]]]
    edge = np.repeat(rows, [len(k.points) for _, k in with_keypoints])
    points = [se3.act(twin, k.points) for twin, (_, k) in zip(twin_from_estimate, with_keypoints, strict=True)]
    factor = KeypointFactor(
        camera=edges.camera[edge],
        object=edges.object[edge],
        point=np.concatenate(points),
        pixel=np.concatenate([k.pixels for _, k in with_keypoints]),
        std=np.concatenate([k.std for _, k in with_keypoints]),
        camera_matrix=np.stack([k.camera_matrix for _, k in with_keypoints for _ in k.points]),
        kernel=Student(group.config.consensus.likelihood.tail, dimension=2),
    )
    if len(rows) == len(seen):
        return (factor,)
    rest = np.setdiff1d(np.arange(len(seen)), rows)
    return (pose_factor(group, tracks, edges.only(rest)), factor)
