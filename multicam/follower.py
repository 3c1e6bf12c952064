"""Objects followed from picture to picture on contours and depth, so that the network need not look at every one.

a step with the network -> where it has the objects -> next steps: the headset's motion, search, search again
an object is lost -> the network looks at once
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from multicam.bundle.adjustment.descent import UNKNOWN
from multicam.bundle.adjustment.frames import ideal_picture
from multicam.bundle.adjustment.scene import Body
from multicam.bundle.adjustment.search import DRAWN
from multicam.bundle.cores import over_cores
from multicam.bundle.depth_image import draw_bodies
from multicam.bundle.occlusion import Occluders
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.region.config import RegionConfig
from multicam.bundle.tracking import Sight, Tracked, TrackingConfig, first_colors, shows, track, updated_colors
from multicam.dataset.runs import StepResult
from multicam.errors import ConfigError
from multicam.geometry import se3
from multicam.matching.linear import inverse
from multicam.types import FloatArray, Frame, ObjectEstimate


@dataclass(frozen=True)
class FollowConfig:
    """Following objects between detections (docs/bundle.md)."""

    every: int = 1
    """The network looks at one step of this many, and wherever an object is lost; at the others objects are followed.
    1: at every step."""
    tracking: TrackingConfig = field(
        default_factory=lambda: TrackingConfig(
            region=RegionConfig(scales=(4, 2, 1), deviations=(11.0, 7.0, 5.0)), searches=4
        )
    )
    """Search and steps."""
    least_lines: int = 20
    """Lines that a followed object needs in a picture; with fewer it is let go, as it may well be out of sight."""
    least_firm: float = 0.4
    """Share of its lines that must show the contour: an object with fewer is not followed to begin with, and is lost
    when it has been."""

    def __post_init__(self) -> None:
        if self.every < 1:
            raise ConfigError(f"follow.every is {self.every}; it must be at least 1.")
        if self.tracking.region is None:
            raise ConfigError("follow.tracking.region must not be null: contours tell whether an object is lost.")


@dataclass(frozen=True, eq=False)
class Followed:
    """One object in one camera.

    Attributes:
        camera_from_object: (4, 4) where it was last.
        colors: of it and about it.
    """

    obj_id: int
    score: float
    camera_from_object: FloatArray
    colors: ColorModel


@dataclass(frozen=True, eq=False)
class _Remembered:
    """What one camera followed in its last picture, and where tracking had the camera then."""

    tracked: FloatArray | None
    objects: tuple[Followed, ...]


class Follower:
    """Stands in for the network at steps at which it need not look."""

    def __init__(self, bodies: Mapping[int, Body], config: FollowConfig) -> None:
        self.bodies, self.config = bodies, config
        self._cameras: dict[str, _Remembered] = {}
        self._since = 0

    def look(self, frames: Sequence[Frame]) -> list[tuple[ObjectEstimate, ...]] | None:
        """The objects of each frame, or None where the network must look: it is due, or an object is lost.

        Objects that have left a picture or are hidden are let go.
        """
        self._since += 1
        if self._since >= self.config.every or not any(each.objects for each in self._cameras.values()):
            return None
        found: list[tuple[ObjectEstimate, ...]] = []
        for frame in frames:
            estimates = self._follow(frame)
            if estimates is None:
                return None
            found.append(estimates)
        return found

    def learn(self, frames: Sequence[Frame], result: StepResult, detected: bool) -> None:
        """Takes over where a step has the objects that each camera saw.

        Args:
            detected: whether the network looked at this step.
        """
        if detected:
            self._since = 0
        cameras = {camera.camera_id: camera.world_from_camera for camera in result.cameras}
        before, self._cameras = self._cameras, {}
        for frame in frames:
            world_from_camera = cameras[frame.camera_id]
            if world_from_camera is None:
                continue
            camera_from_world = se3.inverse(world_from_camera)
            seen = [o for o in result.objects if frame.camera_id in o.seen_by and o.obj_id in self.bodies]
            known = [] if detected or frame.camera_id not in before else list(before[frame.camera_id].objects)
            poses = [camera_from_world @ o.world_from_object for o in seen]
            colors = self._colors(frame, [o.obj_id for o in seen], poses, known)
            objects = [
                Followed(o.obj_id, o.score, pose, each)
                for o, pose, each in zip(seen, poses, colors, strict=True)
                if each is not None
            ]
            self._cameras[frame.camera_id] = _Remembered(frame.tracked_world_from_camera, tuple(objects))

    def _follow(self, frame: Frame) -> tuple[ObjectEstimate, ...] | None:
        """The objects followed into a frame; None if one is lost."""
        remembered = self._cameras.get(frame.camera_id)
        if remembered is None or not remembered.objects:
            return ()
        motion = np.eye(4)
        if remembered.tracked is not None and frame.tracked_world_from_camera is not None:
            motion = se3.inverse(frame.tracked_world_from_camera) @ remembered.tracked
        starts = [motion @ each.camera_from_object for each in remembered.objects]
        sight = self._sight(frame, [each.obj_id for each in remembered.objects], starts)

        def follow(index: int) -> Tracked:
            each = remembered.objects[index]
            model = self.bodies[each.obj_id].model
            return track(model, [sight], [each.colors], starts[index], self.config.tracking)

        estimates: list[ObjectEstimate] = []
        for each, found in zip(remembered.objects, over_cores(follow, range(len(starts))), strict=True):
            if found.lines < self.config.least_lines:
                continue
            if not self._is_shown(found.lines, found.firm):
                return None
            covariance = inverse(found.hessian + UNKNOWN * np.eye(6))
            estimates.append(ObjectEstimate(each.obj_id, each.score, found.world_from_object, covariance))
        return tuple(estimates)

    def _is_shown(self, lines: int, firm: int) -> bool:
        return firm >= self.config.least_firm * lines

    def _sight(self, frame: Frame, classes: Sequence[int], poses: Sequence[FloatArray]) -> Sight:
        """A frame in the camera's own coordinates, with what may hide objects of these classes at these poses."""
        picture = ideal_picture(frame)
        hiding = [] if picture.depth is None else [picture.depth]
        if len(poses) > 1:
            bodies = [(self.bodies[obj_id].mesh, pose) for obj_id, pose in zip(classes, poses, strict=True)]
            hiding.append(draw_bodies(bodies, picture.camera.scaled(DRAWN)))
        return Sight(picture.image, picture.camera, np.eye(4), picture.depth, Occluders(tuple(hiding)))

    def _colors(
        self, frame: Frame, classes: Sequence[int], poses: Sequence[FloatArray], known: Sequence[Followed]
    ) -> list[ColorModel | None]:
        """Colours of objects at poses: learnt anew, or those that were known, moved on a little.

        None for an object whose contour its new colours do not show.
        """
        region = self.config.tracking.region
        assert region is not None
        if not poses:
            return []
        sight = self._sight(frame, classes, poses)

        def learn(index: int) -> ColorModel | None:
            model = self.bodies[classes[index]].model
            before = _nearest(known, classes[index], poses[index])
            if before is not None:
                return updated_colors(before.colors, model, sight, poses[index], region)
            colors = first_colors(model, sight, poses[index], region)
            return colors if self._is_shown(*shows(model, sight, colors, poses[index], self.config.tracking)) else None

        return over_cores(learn, range(len(poses)))


def _nearest(known: Sequence[Followed], obj_id: int, pose: FloatArray) -> Followed | None:
    """The followed object of a class whose place is closest."""
    alike = [each for each in known if each.obj_id == obj_id]
    return min(alike, key=lambda each: np.linalg.norm(each.camera_from_object[:3, 3] - pose[:3, 3]), default=None)
