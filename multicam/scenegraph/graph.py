"""The scene graph: cameras and objects as nodes, what links them as timed edges. All values are frozen.

The world is the frame of the headset's own tracking. A static camera's pose is not stored as such: the graph holds
rigid links (world to static camera, static camera to static camera), each an information filter over keyframes, and
`query` chains them. A link to the world ages, for tracking drifts; a link between two static cameras does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from multicam.errors import DataError
from multicam.geometry import se3
from multicam.scenegraph.filter import FilterConfig, FilteredPose
from multicam.scenegraph.uncertain import UncertainPose, isotropic
from multicam.types import FloatArray

WORLD = "world"
"""Name of the world's node; no camera may bear it."""

Key = tuple[str, str]
"""(target, source) of a link: the world first, else in alphabetical order."""


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
class ObjectConfig:
    """How objects are remembered."""

    motion_rotation_deg: float = 3.0
    """Objects may be moved by hand: standard deviation after one second unseen."""
    motion_translation: float = 0.01
    """Metres after one second unseen."""
    forget_after: float = 10.0
    """Seconds after which an object that nobody sees is dropped."""
    min_sightings: int = 2
    """Looks that must agree (of several cameras, or at several times) before an object counts as known."""

    @property
    def motion_per_second(self) -> FloatArray:
        """(6, 6) covariance gathered per second, in the object's frame."""
        return isotropic(np.radians(self.motion_rotation_deg), self.motion_translation)


@dataclass(frozen=True)
class GraphConfig:
    """The scene graph's model of the world."""

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    objects: ObjectConfig = field(default_factory=ObjectConfig)
    remember: int = 512
    """Tracked headset poses and visibility edges are kept for this many time steps."""


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """Where the headset's tracking said it was."""

    timestamp_ns: int
    world_from_headset: FloatArray


@dataclass(frozen=True, eq=False)
class ObjectNode:
    """One physical object.

    Attributes:
        instance: number of the object, unique in the graph; several may be of one class.
        filtered: world_from_object over time.
        score: best detection score behind the last update.
        seen_ns: when it was last seen by any camera with a pose.
        sightings: looks that agreed with its pose, each camera at each time counting once.
    """

    instance: int
    obj_id: int
    filtered: FilteredPose
    score: float
    seen_ns: int
    sightings: int = 0


@dataclass(frozen=True)
class Edge:
    """r_pq: object p was seen by camera q at a time, and agreed with its stored pose (inlier) or did not."""

    instance: int
    camera_id: str
    timestamp_ns: int
    inlier: bool


@dataclass(frozen=True, eq=False)
class SceneGraph:
    """State of the runtime; updates return a new one.

    Attributes:
        headset: the moving camera whose tracking defines the world.
        statics: cameras that stand still, in alphabetical order.
        trajectory: the latest tracked poses, oldest first.
        links: rigid links by (target, source).
        objects: by instance number.
        edges: the latest visibility edges, oldest first.
        next_instance: the number the next new object gets.
    """

    headset: str
    statics: tuple[str, ...]
    config: GraphConfig = field(default_factory=GraphConfig)
    trajectory: tuple[TrackedPose, ...] = ()
    links: Mapping[Key, FilteredPose] = field(default_factory=dict[Key, FilteredPose])
    objects: Mapping[int, ObjectNode] = field(default_factory=dict[int, ObjectNode])
    edges: tuple[Edge, ...] = ()
    next_instance: int = 0

    def __post_init__(self) -> None:
        names = (self.headset, *self.statics)
        if WORLD in names or len(set(names)) != len(names):
            raise DataError(f'camera names must differ, and none may be "{WORLD}"; got {", ".join(sorted(names))}.')
        object.__setattr__(self, "statics", tuple(sorted(self.statics)))

    @property
    def known_objects(self) -> tuple[ObjectNode, ...]:
        """Objects seen often enough to be believed, by instance number."""
        needed = self.config.objects.min_sightings
        return tuple(node for _, node in sorted(self.objects.items()) if node.sightings >= needed)

    def with_link(self, key: Key, filtered: FilteredPose) -> SceneGraph:
        """A graph in which this link is replaced."""
        return replace(self, links={**self.links, key: filtered})

    def tracked(self, timestamp_ns: int) -> FloatArray | None:
        """(4, 4) world_from_headset at a time, interpolated between tracked poses; None outside what is remembered."""
        after = next((i for i, p in enumerate(self.trajectory) if p.timestamp_ns >= timestamp_ns), None)
        if after is None:
            return None
        later = self.trajectory[after]
        if later.timestamp_ns == timestamp_ns:
            return later.world_from_headset
        if after == 0:
            return None
        earlier = self.trajectory[after - 1]
        fraction = (timestamp_ns - earlier.timestamp_ns) / (later.timestamp_ns - earlier.timestamp_ns)
        return se3.interpolate(earlier.world_from_headset, later.world_from_headset, fraction)

    def drift_of(self, key: Key, world_from_camera: FloatArray) -> FloatArray:
        """(6, 6) covariance that a link gathers per second, in the frame of its source camera.

        Tracking drifts at the headset, so a camera far from it moves by a lever arm; static pairs do not drift.
        """
        if key[0] != WORLD:
            return np.zeros((6, 6))
        drift = self.config.tracking.drift_per_second
        if not self.trajectory:
            return drift
        headset = UncertainPose(np.eye(4), drift)
        camera = UncertainPose(
            se3.inverse(self.trajectory[-1].world_from_headset) @ world_from_camera, np.zeros((6, 6))
        )
        return (headset @ camera).covariance


def key_of(a: str, b: str) -> Key:
    """The key of the link between two nodes: the world first, else in alphabetical order."""
    if WORLD in (a, b):
        return WORLD, a if b == WORLD else b
    return (a, b) if a < b else (b, a)
