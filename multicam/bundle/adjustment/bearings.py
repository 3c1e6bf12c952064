"""Bearings between the cameras of a scene, from what their pictures show beside the objects."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from multicam.bundle.adjustment.scene import Scene
from multicam.bundle.bearing import BearingFactor
from multicam.bundle.problem import State
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import find_features, match_features
from multicam.bundle.scenery.motion import SeenMotion, see_motion
from multicam.geometry import se3
from multicam.matching.linear import congruent, inverse


def find_bearings(scene: Scene, state: State, config: SceneryConfig) -> tuple[BearingFactor, ...]:
    """One factor with all pairs of cameras whose motion their pictures show; none if there is no such pair.

    Poses to begin with, and how far they may be off, tell which matches can be right.
    """
    features = [find_features(each.image, each.camera, config) for each in scene.pictures]
    seen: list[tuple[int, int, SeenMotion]] = []
    for first, second in combinations(range(len(features)), 2):
        known = se3.inverse(state.world_from_camera[first]) @ state.world_from_camera[second]
        moved = congruent(se3.adjoint(se3.inverse(known)), scene.camera_covariance[first])
        matches = match_features(features[first], features[second], config)
        motion = see_motion(matches, known, scene.camera_covariance[second] + moved, config)
        if motion is not None:
            seen.append((first, second, motion))
    if not seen:
        return ()
    firsts, seconds, motions = zip(*seen, strict=True)
    # Pictures of n cameras know n - 1 motions; more bearings than that say the same again.
    joined = np.union1d(firsts, seconds)
    share = min(1.0, (len(joined) - 1) / len(seen))
    return (
        BearingFactor(
            np.array(firsts),
            np.array(seconds),
            np.array([motion.first_from_second for motion in motions]),
            share * inverse(np.array([motion.covariance for motion in motions])),
        ),
    )
