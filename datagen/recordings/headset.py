"""How a person with a headset looks around: fixations, quick turns of the head between them, sway, breath, tremor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.config import SequenceConfig
from datagen.scenes.viewpoints import look_at
from multicam.types import FloatArray

_ELEVATION = np.deg2rad(48)
"""From which a person standing at a table looks at what lies on it."""
_TURN_SPEED = np.deg2rad(80)
"""Greatest speed of an unhurried turn of the head, rad/s; larger turns take longer, their speed hardly grows."""
_LEAST_TURN = 0.25
_STEP_SPEED = 0.45
"""Greatest speed at which the body leans over to another place, m/s."""
_LEAST_STEP = 0.8
_DWELL = (0.6, 1.6)
"""Seconds from one turn of the head to the next, while working with the hands."""
_PEAK = 1.875
"""Greatest over mean speed of a minimum-jerk motion."""
_SWAY = np.array([0.018, 0.014, 0.01])
"""Metres along x, y, z; people lean and shift their weight, mostly below half a hertz."""
_GAZE = np.array([0.012, 0.012, 0.006])
"""Metres at the place looked at."""
_ROLL = np.deg2rad(2)
_BREATH_HZ, _BREATH = 0.27, np.array([0.0, 0.0015, 0.002])
"""Sixteen breaths a minute lift the head by some millimetres."""
_TREMOR_HZ, _TREMOR, _TREMOR_ROLL = 8.5, 0.00015, np.deg2rad(0.02)
"""Physiological tremor, 8 to 12 Hz."""


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
class Stations:
    """From place to place, each change along a minimum-jerk curve (Flash and Hogan 1985); never a jump of speed.

    Attributes:
        places: (n, 3); middles, durations: (n - 1,) seconds, of the changes between them. Changes may overlap.
    """

    places: FloatArray
    middles: NDArray[np.float64]
    durations: NDArray[np.float64]

    def at(self, time: float) -> FloatArray:
        """(3,) place at a time."""
        passed = minimum_jerk((time - self.middles) / self.durations + 0.5)
        return self.places[0] + passed @ np.diff(self.places, axis=0)


def minimum_jerk(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the way, 0 to 1, after a share of the time; still before 0 and after 1."""
    s = np.clip(share, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


@dataclass(frozen=True, eq=False)
class HeadsetPath:
    """A person before the table; all at any time.

    Attributes:
        gaze: what is looked at; stand: where the head is above the table, less `away`.
        away: (3,) from the table to the eyes.
    """

    gaze: Stations
    stand: Stations
    away: FloatArray
    body: Sway
    restless: Sway
    tremor: FloatArray

    def world_from_camera(self, time: float) -> FloatArray:
        """(4, 4) pose at any time."""
        wander = self.restless.at(time)
        breath = _BREATH * np.sin(2 * np.pi * _BREATH_HZ * time + self.tremor[0])
        shiver = np.sin(2 * np.pi * _TREMOR_HZ * time + self.tremor)
        eyes = self.stand.at(time) + self.away + self.body.at(time) + breath + _TREMOR * shiver[:3]
        roll = float(wander[3] + _TREMOR_ROLL * shiver[3])
        return look_at(eyes, self.gaze.at(time) + wander[:3], roll)


def sample_headset(
    config: SequenceConfig,
    centres: FloatArray,
    things: Sequence[FloatArray],
    board: FloatArray | None,
    rng: np.random.Generator,
) -> HeadsetPath:
    """A path that lasts as long as the recording: from the left cluster to the right one and back, `turns` times.

    Args:
        centres: (2, 2) x and y of the clusters; they may be the same.
        things: (n, 3) places worth looking at, for each cluster.
        board: (3,) another one, looked at on every way from one cluster to the other, or None.
    """
    distance = float(np.mean(config.distance))
    gazes: list[FloatArray] = []
    stands: list[FloatArray] = []
    starts: list[float] = []
    time, side = 0.0, 0
    while time < config.duration:
        wanted = int(np.cos(2 * np.pi * config.turns * time / config.duration) < 0)
        centre = np.array([*centres[wanted], 0.0])
        if wanted != side and board is not None:
            centre = np.array([*centres.mean(axis=0), 0.0])
            target = board
        else:
            target = things[wanted][rng.integers(len(things[wanted]))]
            # The head turns less than the eyes: it stays nearer to the middle of what there is to see.
            target = centre + 0.7 * (target - centre)
        side = wanted
        gazes.append(target)
        stands.append(0.75 * centre + 0.25 * (target - centre) * (1.0, 0.0, 0.0))
        starts.append(time)
        time += float(rng.uniform(*_DWELL))
    # The body follows more slowly, so at first the head turns all the way.
    turns = np.linalg.norm(np.diff(np.stack(gazes), axis=0), axis=1) / distance
    steps = np.linalg.norm(np.diff(np.stack(stands), axis=0), axis=1)
    middles = np.array(starts[1:])
    return HeadsetPath(
        Stations(np.stack(gazes), middles, np.maximum(_LEAST_TURN, _PEAK * turns / _TURN_SPEED)),
        Stations(np.stack(stands), middles, np.maximum(_LEAST_STEP, _PEAK * steps / _STEP_SPEED)),
        away=distance * np.array([0.0, -np.cos(_ELEVATION), np.sin(_ELEVATION)]),
        body=Sway.sample(_SWAY, rng),
        restless=Sway.sample(np.array([*_GAZE, _ROLL]), rng),
        tremor=rng.uniform(0, 2 * np.pi, size=4),
    )
