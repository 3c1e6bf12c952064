"""Cameras that look at things."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.config import CameraConfig
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera

_CLEARANCE = 0.12
"""Metres around a camera that must be free."""
_TRIES = 200


def look_at(position: NDArray[np.float64], target: NDArray[np.float64], roll: float = 0.0) -> NDArray[np.float64]:
    """world_from_camera of a camera at `position` with `target` on its axis; upright in a z-up world, then rolled."""
    z = target - position
    z = z / np.linalg.norm(z)
    right = np.cross(z, [0.0, 0.0, 1.0])
    # Straight above or below there is no upright; any turn will do.
    x = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    rotation = np.stack((x, np.cross(z, x), z), axis=1) @ so3.exp(np.array([0.0, 0.0, roll]))
    return se3.from_parts(rotation, np.asarray(position, dtype=np.float64))


def sample_camera(config: CameraConfig, width: int, height: int, rng: np.random.Generator) -> Camera:
    """A window of an image with square pixels, random focal length, and principal point within 2 % of its middle.

    Args:
        width, height: of the window, pixels.
    """
    image = np.array([width, height]) / config.window
    focal = rng.uniform(*config.focal) * image[0]
    corner = rng.uniform(0, 1, size=2) * (image - (width, height))
    cx, cy = (image - 1) / 2 + rng.uniform(-0.02, 0.02, size=2) * image - corner
    return Camera(np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]), width, height)


def sample_viewpoint(
    config: CameraConfig,
    camera: Camera,
    targets: NDArray[np.float64],
    clouds: list[NDArray[np.float64]],
    obstacles: NDArray[np.float64],
    rng: np.random.Generator,
    from_below: bool = False,
) -> NDArray[np.float64]:
    """world_from_camera with one of the targets at the configured distance and about the middle of the picture.

    Args:
        targets: (n, 3) points worth looking at, world.
        clouds: surface points of each object, world; none that is seen may reach behind the camera.
        obstacles: (m, 3) points to keep clear of, world.
        from_below: as often as from above.
    """
    low, high = np.sin(np.deg2rad(config.elevation_deg))
    half_picture = np.array([camera.width, camera.height]) / (2 * camera.matrix[0, 0])
    middle_from_camera = _onto_axis(camera)
    pose = np.eye(4)
    for _ in range(_TRIES):
        target = targets[rng.integers(len(targets))]
        distance = np.exp(rng.uniform(*np.log(config.distance)))
        height, azimuth = rng.uniform(low, high), rng.uniform(0, 2 * np.pi)
        if from_below and rng.uniform() < 0.5:
            height = -height
        flat = np.sqrt(1 - height**2)
        outward = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
        position = target + distance * outward
        shift = rng.uniform(-1, 1, size=2) * config.off_centre * half_picture * distance
        aim = target + look_at(position, target)[:3, :2] @ shift
        roll = np.deg2rad(rng.uniform(-config.roll_deg, config.roll_deg))
        pose = look_at(position, aim, roll) @ middle_from_camera
        free = np.linalg.norm(obstacles - position, axis=1).min() > _CLEARANCE
        if free and not any(_straddles(camera, pose, cloud) for cloud in clouds):
            break
    return pose


def _onto_axis(camera: Camera) -> NDArray[np.float64]:
    """The least turn (4, 4) that brings the ray through the middle of the picture onto the optical axis."""
    middle = np.array([camera.width - 1, camera.height - 1, 2]) / 2
    ray = np.linalg.solve(camera.matrix, middle)
    x, y, z = ray / np.linalg.norm(ray)
    flat = np.hypot(x, y)
    axis = np.array([y, -x, 0.0]) / flat if flat > 0 else np.zeros(3)
    return se3.from_parts(so3.exp(axis * np.arctan2(flat, z)), np.zeros(3))


def _straddles(camera: Camera, world_from_camera: NDArray[np.float64], cloud: NDArray[np.float64]) -> bool:
    """Whether part of an object is in the picture and part of it beside or behind the camera."""
    points = se3.act(se3.inverse(world_from_camera), cloud)
    front = points[:, 2] > _CLEARANCE / 4
    return not front.all() and bool(camera.contains(camera.project(points[front])).any())
