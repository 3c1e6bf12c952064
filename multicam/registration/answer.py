"""From a refinement to the public answer."""

from __future__ import annotations

import numpy as np

from multicam.geometry import se3
from multicam.matching.arrays import IntArray
from multicam.matching.linear import congruent
from multicam.registration.group import Group
from multicam.registration.refinement import Refinement
from multicam.types import Component, FloatArray, PlacedCamera, PlacedObject


def component_of(group: Group, found: Refinement, order: IntArray) -> Component:
    """Cameras in the given order (positions in the placement), and every object they see, best score first."""
    placement = found.placement
    cameras = tuple(
        PlacedCamera(
            group.views[int(placement.views[c])].view_id, placement.world_from_camera[c], placement.covariance[c]
        )
        for c in order.tolist()
    )
    fused = found.tracks.fused
    poses, covariances = _object_poses(group, found)
    objects = [
        PlacedObject(int(fused.obj_id[o]), float(fused.score[o]), poses[o], covariances[o], _supports(group, found, o))
        for o in range(len(fused))
    ]
    return Component(cameras, tuple(sorted(objects, key=lambda placed: -placed.score)))


def _object_poses(group: Group, found: Refinement) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 4, 4) and covariances (n, 6, 6) of all objects: refined, or from the one camera that sees them."""
    tracks, placement = found.tracks, found.placement
    poses, covariances = np.zeros((len(tracks.fused), 4, 4)), np.zeros((len(tracks.fused), 6, 6))
    position = np.full(len(group.views), -1)
    position[placement.views] = np.arange(len(placement.views))
    camera = position[group.estimates.frame[tracks.estimate]]
    poses[tracks.object] = placement.world_from_camera[camera] @ tracks.camera_from_object
    lever = se3.adjoint(se3.inverse(tracks.camera_from_object))
    covariances[tracks.object] = tracks.covariance + congruent(lever, placement.covariance[camera])
    poses[found.edges.shared] = found.world_from_object
    covariances[found.edges.shared] = found.object_covariance
    return poses, covariances


def _supports(group: Group, found: Refinement, index: int) -> tuple[tuple[str, int], ...]:
    estimates = np.sort(found.tracks.estimate[found.tracks.object == index])
    return tuple((view.view_id, n) for view, n in map(group.source, estimates.tolist()))
