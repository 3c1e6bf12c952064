"""How the cameras of a recording stand and move: poses, drift, clocks. NumPy only; times in seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.config import DriftConfig, SequenceConfig
from datagen.scenes.viewpoints import look_at
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray

_TRIES = 500
_MARGIN = 12
"""Pixels outside the image that a static camera keeps free of the other cluster."""
_SEEN = 0.6
"""Share of its own cluster's points that a static camera must have in the image."""


@dataclass(frozen=True, eq=False)
class Sway:
    """Smooth random motion: a sum of slow sines, so it has a value at any time.

    Attributes:
        amplitude: (n, axes); frequency: (n, 1) hertz; phase: (n, axes) radians.
    """

    amplitude: FloatArray
    frequency: FloatArray
    phase: FloatArray

    @classmethod
    def sample(cls, scale: FloatArray, rng: np.random.Generator) -> Sway:
        """Hand-held motion with a standard deviation of `scale` (axes,), mostly below 0.5 Hz."""
        frequency = np.array([[0.07], [0.13], [0.24], [0.43], [0.9]]) * rng.uniform(0.8, 1.2, size=(5, 1))
        weight = np.array([[1.0], [0.8], [0.6], [0.35], [0.12]])
        weight = weight * np.sqrt(2 / np.sum(weight**2))
        return cls(weight * scale, frequency, rng.uniform(0, 2 * np.pi, size=(5, len(scale))))

    def at(self, time: float) -> FloatArray:
        """(axes,) displacement."""
        return np.sum(self.amplitude * np.sin(2 * np.pi * self.frequency * time + self.phase), axis=0)


@dataclass(frozen=True, eq=False)
class HeadsetPath:
    """A person before the table who looks from the left cluster to the right one and back.

    Attributes:
        duration: seconds of the recording.
        turns: how often there and back.
        reach: metres from the middle of the table to either cluster.
        distance: metres from the eyes to what they look at.
    """

    duration: float
    turns: float
    reach: float
    distance: float
    body: Sway
    gaze: Sway

    def world_from_camera(self, time: float) -> FloatArray:
        """(4, 4) pose at any time."""
        # A flattened cosine: the eyes rest on a cluster, then move on.
        swing = np.tanh(2 * np.cos(2 * np.pi * self.turns * time / self.duration)) / np.tanh(2)
        side = -self.reach * swing
        gaze = self.gaze.at(time)
        target = np.array([side, 0.0, 0.02]) + gaze[:3]
        # The head follows the eyes half of the way.
        away = self.distance * np.array([0.0, -np.cos(np.deg2rad(48)), np.sin(np.deg2rad(48))])
        return look_at(np.array([0.75 * side, 0.0, 0.0]) + away + self.body.at(time), target, float(gaze[3]))


def sample_headset(config: SequenceConfig, rng: np.random.Generator) -> HeadsetPath:
    """A path that lasts as long as the recording."""
    return HeadsetPath(
        duration=config.steps / config.rate_hz,
        turns=config.turns,
        reach=config.spacing / 2,
        distance=float(np.mean(config.distance)),
        body=Sway.sample(np.array([0.025, 0.02, 0.02]), rng),
        gaze=Sway.sample(np.array([0.02, 0.02, 0.01, np.deg2rad(2)]), rng),
    )


def place_static_camera(
    config: SequenceConfig,
    camera: Camera,
    own: list[NDArray[np.float64]],
    other: list[NDArray[np.float64]],
    obstacles: NDArray[np.float64],
    rng: np.random.Generator,
) -> FloatArray:
    """world_from_camera of a camera that sees one cluster, and not a point of the other.

    Args:
        own, other: surface points of the objects of each cluster, world.
        obstacles: (n, 3) points to keep clear of, world.

    Raises:
        DataError: no such place was found.
    """
    cluster = np.concatenate(own)
    centre = (cluster.min(0) + cluster.max(0)) / 2
    for _ in range(_TRIES):
        distance, elevation = rng.uniform(*config.distance), np.deg2rad(rng.uniform(32, 65))
        # Up to 100 degrees to either side of the person's own direction of view.
        azimuth = -np.pi / 2 + np.deg2rad(rng.uniform(-100, 100))
        flat = distance * np.cos(elevation)
        position = centre + np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)])
        pose = look_at(position, centre + rng.uniform(-0.03, 0.03, size=3), np.deg2rad(rng.uniform(-6, 6)))
        clear = np.linalg.norm(obstacles - position, axis=1).min() > config.distance[0] / 3
        seen = np.mean(_in_image(camera, pose, cluster, 0))
        if clear and seen > _SEEN and not any(_in_image(camera, pose, cloud, _MARGIN).any() for cloud in other):
            return pose
    raise DataError(
        "No place was found from which a static camera sees one cluster and nothing of the other "
        f"(seed {config.seed}): raise spacing (now {config.spacing:g} m) or focal (now {config.focal:g}), or lower "
        "distance."
    )


def tracked_poses(
    world_from_camera: FloatArray, times: NDArray[np.float64], drift: DriftConfig, rng: np.random.Generator
) -> FloatArray:
    """What the headset believes: its true motion from frame to frame, each step off by a small twist.

    The step over dt is multiplied from the right by exp(bias dt + walk sqrt(dt) n), n standard normal. The first
    pose is true: the headset's world is the world.

    Args:
        world_from_camera: (n, 4, 4); times: (n,) seconds, ascending.
    """
    degrees, millimetres = np.deg2rad(1.0), 1e-3
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bias = np.concatenate(
        (
            directions[0] * drift.rotation_bias_deg * degrees,
            directions[1] * drift.translation_bias_mm * millimetres,
        )
    )
    walk = np.repeat([drift.rotation_walk_deg * degrees, drift.translation_walk_mm * millimetres], 3)
    tracked = [world_from_camera[0]]
    for index in range(1, len(times)):
        passed = times[index] - times[index - 1]
        step = se3.inverse(world_from_camera[index - 1]) @ world_from_camera[index]
        error = bias * passed + walk * np.sqrt(passed) * rng.normal(size=6)
        tracked.append(tracked[-1] @ se3.plus(step, error))
    return np.stack(tracked)


def exposure_times(config: SequenceConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """(steps,) times of one camera: the common rhythm, shifted by a constant, each a little off; never negative."""
    offset = rng.uniform(0, 2 * config.clock_offset_ms) * 1e-3
    jitter = rng.normal(0, config.clock_jitter_ms * 1e-3, size=config.steps)
    # A camera never answers earlier than half a period after its last picture.
    limit = 0.25 / config.rate_hz
    return np.arange(config.steps) / config.rate_hz + np.maximum(offset + np.clip(jitter, -limit, limit), 0)


def _in_image(
    camera: Camera, world_from_camera: FloatArray, points: NDArray[np.float64], margin: float
) -> NDArray[np.bool_]:
    """(n,) whether each point projects into the image widened by `margin` pixels."""
    local = se3.act(se3.inverse(world_from_camera), points)
    front = local[:, 2] > 0.01
    pixels = camera.project(np.where(front[:, None], local, [0.0, 0.0, 1.0]))
    low, high = -0.5 - margin, np.array([camera.width, camera.height]) - 0.5 + margin
    return front & np.all((pixels > low) & (pixels < high), axis=1)
