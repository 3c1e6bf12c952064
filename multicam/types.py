"""Values that cross package borders; frozen, validated when made."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from multicam.geometry.camera import Camera

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of one camera.

    Attributes:
        camera_id: name of the camera in the rig.
        timestamp_ns: time of exposure on the common clock, nanoseconds.
        image: (height, width, 3) uint8, RGB.
        camera: intrinsics of this very picture (autofocus changes them from frame to frame).
        tracked_world_from_camera: (4, 4) pose by the device's own tracking (a headset), or None.
        depth: (height, width) float32 metres along the optical axis, 0 where unknown, or None.
    """

    camera_id: str
    timestamp_ns: int
    image: ImageArray
    camera: Camera
    tracked_world_from_camera: FloatArray | None = None
    depth: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        expected = (self.camera.height, self.camera.width, 3)
        if self.image.shape != expected or self.image.dtype != np.uint8:
            raise ValueError(
                f"frame of camera {self.camera_id}: image is {self.image.dtype} {self.image.shape}, "
                f"its camera says uint8 {expected}"
            )


@dataclass(frozen=True, eq=False)
class FrameSet:
    """Frames of several cameras taken at about one time; at most one of each camera."""

    timestamp_ns: int
    frames: tuple[Frame, ...]

    def __post_init__(self) -> None:
        names = [frame.camera_id for frame in self.frames]
        if len(set(names)) != len(names):
            raise ValueError(f"a frame set holds each camera once; got {names}")


@dataclass(frozen=True, eq=False)
class Detection:
    """One object found by the network in one image; pixels of the original image.

    Attributes:
        obj_id: class.
        score: probability in [0, 1].
        box: (4,) amodal box, x0 y0 x1 y1.
        keypoints: (K, 2) projections of the object's keypoints.
        visibility: (K,) probability that the keypoint is not hidden.
        std: (K, 2) predicted standard deviation of each keypoint coordinate.
    """

    obj_id: int
    score: float
    box: FloatArray
    keypoints: FloatArray
    visibility: FloatArray
    std: FloatArray


@dataclass(frozen=True, eq=False)
class ObjectEstimate:
    """Pose of one object seen by one camera.

    Attributes:
        obj_id: class.
        score: detection score in [0, 1].
        camera_from_object: (4, 4).
        covariance: (6, 6) of the right perturbation [rotation rad; translation m] of `camera_from_object`, or
            None where the source states none (published result files); the registration then models it.
        detection: the keypoints behind the pose, if it came from our network.
    """

    obj_id: int
    score: float
    camera_from_object: FloatArray
    covariance: FloatArray | None = None
    detection: Detection | None = None

    def __post_init__(self) -> None:
        if self.camera_from_object.shape != (4, 4) or not np.all(np.isfinite(self.camera_from_object)):
            raise ValueError(f"pose of object {self.obj_id} is not a finite 4x4 matrix")


@dataclass(frozen=True, eq=False)
class View:
    """What one camera contributes to a registration.

    Attributes:
        camera_matrix: (3, 3) pixels, or None where unknown; a noise model for estimates without covariance uses
            its focal length.
    """

    view_id: str
    estimates: tuple[ObjectEstimate, ...]
    camera_matrix: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class PlacedCamera:
    """A camera with a pose in the world of its component.

    Attributes:
        covariance: (6, 6) of the right perturbation of `world_from_camera`, with the component's first camera
            as gauge; zero for that camera.
    """

    view_id: str
    world_from_camera: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object with a pose in the world of its component.

    Attributes:
        supports: (view_id, index into that view's estimates) of each estimate that agrees with the pose.
    """

    obj_id: int
    score: float
    world_from_object: FloatArray
    covariance: FloatArray
    supports: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, eq=False)
class Component:
    """Cameras and objects whose poses are known in one common world."""

    cameras: tuple[PlacedCamera, ...]
    objects: tuple[PlacedObject, ...]


@dataclass(frozen=True, eq=False)
class Registration:
    """Answer for a group of views: components, and for each unplaced view the reason in words."""

    components: tuple[Component, ...]
    refusals: dict[str, str] = field(default_factory=dict[str, str])
