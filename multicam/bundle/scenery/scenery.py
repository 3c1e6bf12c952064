"""What the pictures of several cameras share beside the objects."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multicam.bundle.bearing import BearingFactor
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Features, match_features
from multicam.bundle.scenery.motion import SeenMotion, see_motion
from multicam.matching.linear import inverse

Bearing = tuple[int, int, SeenMotion]
"""First and second camera, and the motion between them."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """The points of each camera's picture, by the camera's name or number."""

    features: Mapping[Hashable, Features]
    config: SceneryConfig

    def motion(self, first: Hashable, second: Hashable) -> SeenMotion | None:
        """first_from_second of two cameras, as their pictures show it; see `see_motion`."""
        return see_motion(match_features(self.features[first], self.features[second], self.config), self.config)


def bearing_factor(bearings: Sequence[Bearing]) -> tuple[BearingFactor, ...]:
    """One factor of all bearings; none if there is no bearing."""
    if not bearings:
        return ()
    firsts, seconds, motions = zip(*bearings, strict=True)
    # Pictures of n cameras know n - 1 motions; more bearings than that say the same again.
    share = min(1.0, (len(np.union1d(firsts, seconds)) - 1) / len(bearings))
    return (
        BearingFactor(
            np.array(firsts),
            np.array(seconds),
            np.array([motion.first_from_second for motion in motions]),
            share * inverse(np.array([motion.covariance for motion in motions])),
        ),
    )
