"""Bearings between the cameras of a scene, from what their pictures show beside the objects."""

from __future__ import annotations

from itertools import combinations

from multicam.bundle.adjustment.scene import Scene
from multicam.bundle.bearing import BearingFactor
from multicam.bundle.problem import State
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import find_features
from multicam.bundle.scenery.scenery import Bearing, Scenery, bearing_factor
from multicam.geometry import se3
from multicam.matching.linear import congruent


def find_bearings(scene: Scene, state: State, config: SceneryConfig) -> tuple[BearingFactor, ...]:
    """All pairs of cameras whose motion their pictures show, if it agrees with the poses to begin with."""
    features = (find_features(each.image, each.camera, config) for each in scene.pictures)
    scenery = Scenery(dict(enumerate(features)), config)
    found: list[Bearing] = []
    for first, second in combinations(range(len(scene.pictures)), 2):
        motion = scenery.motion(first, second)
        known = se3.inverse(state.world_from_camera[first]) @ state.world_from_camera[second]
        moved = congruent(se3.adjoint(se3.inverse(known)), scene.camera_covariance[first])
        covariance = scene.camera_covariance[second] + moved
        if motion is not None and motion.agrees(known[None], covariance[None])[0]:
            found.append((first, second, motion))
    return bearing_factor(found)
