"""The headset's tracking and the cameras' clocks: what they say, and how wrong it is. Times in seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.config import ClockConfig, DriftConfig
from multicam.dataset.sequence_facts import TrackingErrors
from multicam.geometry import se3
from multicam.types import FloatArray

_MILLI = 1e-3


def tracking_errors(drift: DriftConfig) -> TrackingErrors:
    """The configured drift in radians and metres."""
    return TrackingErrors(
        float(np.deg2rad(drift.rotation_bias_deg)),
        drift.translation_bias_mm * _MILLI,
        float(np.deg2rad(drift.rotation_walk_deg)),
        drift.translation_walk_mm * _MILLI,
    )


def tracked_poses(
    world_from_camera: FloatArray, times: NDArray[np.float64], errors: TrackingErrors, rng: np.random.Generator
) -> FloatArray:
    """What the headset believes: its true motion from frame to frame, each step off by a small twist.

    The step over dt is multiplied from the right by exp(bias dt + walk sqrt(dt) n), n standard normal. The first
    pose is true: the headset's world is the world.

    Args:
        world_from_camera: (n, 4, 4); times: (n,) seconds, ascending.
    """
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bias = np.concatenate((directions[0] * errors.rotation_bias, directions[1] * errors.translation_bias))
    walk = np.repeat([errors.rotation_walk, errors.translation_walk], 3)
    tracked = [world_from_camera[0]]
    for index in range(1, len(times)):
        passed = times[index] - times[index - 1]
        step = se3.inverse(world_from_camera[index - 1]) @ world_from_camera[index]
        error = bias * passed + walk * np.sqrt(passed) * rng.normal(size=6)
        tracked.append(tracked[-1] @ se3.plus(step, error))
    return np.stack(tracked)


@dataclass(frozen=True, eq=False)
class Clock:
    """When a camera takes its pictures and what its clock says then.

    Attributes:
        times: (n,) true seconds of the exposures, ascending, from 0 on.
        offset: seconds that its time stamps are late.
        kept: (n,) bool, frames that were not lost.
    """

    times: NDArray[np.float64]
    offset: float
    kept: NDArray[np.bool_]

    def stamp_ns(self, step: int) -> int:
        """The time stamp of a frame; the recording's own zero keeps it from being negative."""
        return round((float(self.times[step]) + self.offset) * 1e9)


def sample_clock(
    config: ClockConfig, steps: int, rate_hz: float, rng: np.random.Generator, *, true: bool = False
) -> Clock:
    """A camera's clock.

    Args:
        true: its time stamps have no error.
    """
    phase = rng.uniform(0, 2 * config.phase_ms) * _MILLI
    jitter = rng.normal(0, config.jitter_ms * _MILLI, size=steps)
    # A camera never answers earlier than half a period after its last picture.
    limit = 0.25 / rate_hz
    # Late enough that neither a time nor a time stamp is negative.
    beginning = config.offset_ms * _MILLI
    times = beginning + np.arange(steps) / rate_hz + np.maximum(phase + np.clip(jitter, -limit, limit), 0)
    offset = rng.uniform(-1, 1) * config.offset_ms * _MILLI
    kept = np.ones(steps, dtype=np.bool_)
    if steps > 1:
        kept[1 + rng.permutation(steps - 1)[: round(config.lost * steps)]] = False
    return Clock(times, 0.0 if true else offset, kept)
