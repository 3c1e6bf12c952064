"""The scene graph: cameras at places, objects at rest, and the looks that tie them. All values are frozen.

The world is the frame of the headset's tracking when it began; tracking drifts away from it since. A camera at one
place is a *stay*: that of a static camera lasts until somebody bumps it, that of the headset is a keyframe. An object
at one place is a *rest* until somebody moves it. Stays and rests that are over remain as long as they hold others
together: what was seen while they lasted stays true.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from multicam.errors import DataError
from multicam.scenegraph.config import GraphConfig
from multicam.scenegraph.edge import Edge
from multicam.scenegraph.uncertain import UncertainPose
from multicam.types import FloatArray

WORLD = "world"
"""Name of the world; no camera may bear it."""


@dataclass(frozen=True, eq=False)
class Stay:
    """A camera at one place.

    Attributes:
        since_ns: when it came there.
        seen_ns: when objects last confirmed the place.
        edges: what it saw there, by number of the rest.
        odometry: motion from the previous keyframe by tracking, previous_from_this; None for a static camera, for the
            first keyframe and where tracking broke.
    """

    camera_id: str
    since_ns: int
    seen_ns: int
    world_from_camera: FloatArray
    edges: Mapping[int, Edge] = field(default_factory=dict[int, Edge])
    odometry: UncertainPose | None = None


@dataclass(frozen=True, eq=False)
class Rest:
    """An object at one place.

    Attributes:
        instance: number of the object, unique in the graph; several may be of one class.
        centre: (3,) of the object, object frame.
        score: best detection score behind the last look.
        seen_ns: when any camera last confirmed the place.
        sightings: looks that agreed with it, each camera at each time counting once.
        contradictions: looks since then that saw the object elsewhere.
        over: the object is no longer there.
    """

    instance: int
    obj_id: int
    centre: FloatArray
    world_from_object: FloatArray
    score: float
    seen_ns: int
    sightings: int = 0
    contradictions: int = 0
    over: bool = False


@dataclass(frozen=True, eq=False)
class Mover:
    """An object in motion, or still for too short a time to help.

    Attributes:
        pose: world_from_object at `seen_ns`.
        place: where it was when it last moved.
        moved_ns: when.
        seen_by: cameras that saw it at `seen_ns`.
    """

    instance: int
    obj_id: int
    centre: FloatArray
    pose: UncertainPose
    place: UncertainPose
    score: float
    seen_ns: int
    moved_ns: int
    sightings: int
    seen_by: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Tracking:
    """The last tracked pose of the headset and what led to it.

    Attributes:
        tracking_from_headset: in the frame of the tracking, which drifts away from the world.
        since_keyframe: keyframe_from_headset by tracking since the last keyframe.
    """

    timestamp_ns: int
    tracking_from_headset: FloatArray
    since_keyframe: UncertainPose


@dataclass(frozen=True, eq=False)
class SceneGraph:
    """State of the runtime; a step returns a new one.

    Attributes:
        headset: the moving camera whose tracking defines the world.
        statics: cameras that stand still, in alphabetical order.
        keyframes: of the headset, oldest first.
        now: the headset at this step, if its pose is known; `keyframe.keep` decides what becomes of it.
        places: where each static camera of known pose stands now.
        former: stays of static cameras that are over.
        rests: objects at rest, by number.
        movers: objects in motion, by instance.
        suspects: cameras that may have been moved, and how many pictures in a row say so.
        drift_scale: how much larger the variance of the headset's drift is than the configuration says.
        next_number, next_instance: of the next rest and the next object.
    """

    headset: str
    statics: tuple[str, ...]
    config: GraphConfig = field(default_factory=GraphConfig)
    keyframes: tuple[Stay, ...] = ()
    now: Stay | None = None
    places: Mapping[str, Stay] = field(default_factory=dict[str, Stay])
    former: tuple[Stay, ...] = ()
    rests: Mapping[int, Rest] = field(default_factory=dict[int, Rest])
    movers: Mapping[int, Mover] = field(default_factory=dict[int, Mover])
    suspects: Mapping[str, int] = field(default_factory=dict[str, int])
    tracking: Tracking | None = None
    drift_scale: float = 1.0
    next_number: int = 0
    next_instance: int = 0

    def __post_init__(self) -> None:
        names = (self.headset, *self.statics)
        if WORLD in names or len(set(names)) != len(names):
            raise DataError(f'camera names must differ, and none may be "{WORLD}"; got {", ".join(sorted(names))}.')
        object.__setattr__(self, "statics", tuple(sorted(self.statics)))

    @property
    def path(self) -> tuple[Stay, ...]:
        """The headset's keyframes, and where it is now if that is known."""
        return self.keyframes if self.now is None else (*self.keyframes, self.now)

    @property
    def stays(self) -> tuple[Stay, ...]:
        """All stays: the headset's path, those of static cameras that are over, their present ones by name.

        The first does not move when poses are refined: it holds the world.
        """
        return (*self.path, *self.former, *(self.places[name] for name in sorted(self.places)))

    def with_stays(self, stays: tuple[Stay, ...]) -> SceneGraph:
        """The graph with all stays replaced, in the order of `stays`."""
        keyframes, path = len(self.keyframes), len(self.path)
        former = path + len(self.former)
        return replace(
            self,
            keyframes=stays[:keyframes],
            now=None if self.now is None else stays[keyframes],
            former=stays[path:former],
            places={stay.camera_id: stay for stay in stays[former:]},
        )

    def index_of(self, camera_id: str) -> int | None:
        """Position among `stays` of where a camera is now, or None if that is not known."""
        if camera_id == self.headset:
            return None if self.now is None else len(self.keyframes)
        if camera_id not in self.places:
            return None
        return len(self.path) + len(self.former) + sorted(self.places).index(camera_id)

    def stay_of(self, camera_id: str) -> Stay | None:
        """Where a camera is now, or None if that is not known."""
        return self.now if camera_id == self.headset else self.places.get(camera_id)

    def with_stay(self, stay: Stay) -> SceneGraph:
        """The graph with the present stay of its camera set."""
        if stay.camera_id == self.headset:
            return replace(self, now=stay)
        return replace(self, places={**self.places, stay.camera_id: stay})

    def with_rest(self, number: int, rest: Rest) -> SceneGraph:
        """The graph with a rest added or replaced."""
        return replace(self, rests={**self.rests, number: rest})

    def without_suspect(self, camera_id: str) -> SceneGraph:
        """The graph in which a camera is above suspicion."""
        return replace(self, suspects={name: s for name, s in self.suspects.items() if name != camera_id})
