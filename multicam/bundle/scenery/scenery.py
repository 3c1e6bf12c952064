"""What the pictures of several cameras share beside the objects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from multicam.bundle.bearing import BearingFactor
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Features, find_features, match_features
from multicam.bundle.scenery.motion import SeenMotion, see_motion
from multicam.geometry.camera import Camera
from multicam.matching.linear import inverse
from multicam.types import ImageArray

Bearing = tuple[int, int, SeenMotion]
"""First and second camera, and the motion between them."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """The points of each camera's picture."""

    features: Sequence[Features]
    config: SceneryConfig

    @classmethod
    def of(cls, pictures: Iterable[tuple[ImageArray, Camera]], config: SceneryConfig) -> Scenery:
        """Finds the points of pictures (height, width, 3) RGB of ideal lenses."""
        return cls([find_features(image, camera, config) for image, camera in pictures], config)

    def motion(self, first: int, second: int) -> SeenMotion | None:
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
