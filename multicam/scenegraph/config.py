"""Everything that can be set about the scene graph."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from multicam.bundle.levenberg import LevenbergConfig
from multicam.scenegraph.uncertain import isotropic
from multicam.types import FloatArray


@dataclass(frozen=True)
class TrackingConfig:
    """How well the headset tracks itself; each number is a standard deviation per axis."""

    jitter_rotation_deg: float = 0.05
    """Error of one tracked pose against its neighbours in time."""
    jitter_translation: float = 0.001
    """Metres."""
    drift_rotation_deg: float = 0.08
    """Drift after one second; it grows with the square root of time."""
    drift_translation: float = 0.002
    """Metres after one second."""

    @property
    def jitter(self) -> FloatArray:
        """(6, 6) covariance of one tracked pose in the headset's frame."""
        return isotropic(np.radians(self.jitter_rotation_deg), self.jitter_translation)

    @property
    def drift_per_second(self) -> FloatArray:
        """(6, 6) covariance gathered per second, in the headset's frame."""
        return isotropic(np.radians(self.drift_rotation_deg), self.drift_translation)


@dataclass(frozen=True)
class KeyframeConfig:
    """Which views of the headset are kept."""

    max_speed: float = 0.3
    """Metres per second; a faster headset (blur, time offsets) measures nothing."""
    max_turn_deg: float = 30.0
    """Degrees per second."""
    spacing: float = 0.15
    """Metres between two keyframes; a turn of this many radians counts as much, and so does the drift to be expected
    between them."""
    most: int = 24
    """Keyframes kept; of more, neighbours are joined."""


@dataclass(frozen=True)
class ChangeConfig:
    """When a camera or an object that should stand still has moved."""

    looks: int = 3
    """Looks in a row that must contradict the place of an object before it counts as moved."""
    bump_looks: int = 2
    """Pictures in a row that must agree on a camera's new place."""
    gate: float = 22.46
    """Squared Mahalanobis distance from which two places differ; 99.9 % of good measurements lie within."""
    memory: float = 0.7
    """Share of the recent looks' weight that is left after one more look."""
    settle_seconds: float = 1.0
    """An object that moved helps to place cameras again after it has been still for as long."""


@dataclass(frozen=True)
class ObjectConfig:
    """How objects are remembered."""

    motion_rotation_deg: float = 30.0
    """Turn of an object in motion within a second, standard deviation."""
    motion_translation: float = 0.1
    """Metres within a second."""
    forget_after: float = 60.0
    """Seconds after which an object that nobody sees is dropped."""
    remember: int = 32
    """Places where objects no longer are, kept for what they say of the cameras that saw them there."""
    min_sightings: int = 2
    """Looks that must agree (of several cameras, or at several times) before an object counts as known."""
    max_position_std: float = 0.2
    """Metres; an object whose place is less certain than that (root mean square) is not known."""
    doubt_after: float = 1.0
    """Seconds after which an object that is not yet known is dropped, unless it is seen again: a false detection."""

    @property
    def motion_per_second(self) -> FloatArray:
        """(6, 6) covariance gathered per second, in the object's frame."""
        return isotropic(np.radians(self.motion_rotation_deg), self.motion_translation)


@dataclass(frozen=True)
class GraphConfig:
    """The scene graph's model of the world."""

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    change: ChangeConfig = field(default_factory=ChangeConfig)
    objects: ObjectConfig = field(default_factory=ObjectConfig)
    common: float = 0.5
    """Share of an estimate's variance that it has in common with others from a like direction: a static camera before a
    still scene makes the same error again and again."""
    solver: LevenbergConfig = field(default_factory=lambda: LevenbergConfig(iterations=5))
    """The joint minimisation, which each step takes up where the last one ended."""
