"""Objects that do not stay where they are: one is put elsewhere, one is carried about."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from datagen.recordings.config import CarryConfig, MoveConfig
from datagen.recordings.headset import Sway, minimum_jerk
from datagen.recordings.statics import Unsuitable
from datagen.scenes.layout import Body, Table, place
from multicam.geometry import se3, so3
from multicam.types import FloatArray

_TRIES = 60
CLEARANCE = 0.02
"""Metres between what is carried and the tops of what it is carried over."""
_UP = 0.3
"""Share of the time that lifting takes, and as much that putting down takes; between, it moves sideways."""


class Motion(Protocol):
    """The way of one object.

    Attributes:
        index: its place in `SceneSpec.objects`.
        start, end: seconds; before and after, it stands still.
    """

    index: int
    start: float
    end: float

    def at(self, time: float) -> FloatArray:
        """world_from_object (4, 4) at a time."""
        ...


@dataclass(frozen=True, eq=False)
class Move:
    """Lifted straight up, moved and turned about the vertical, put down straight: it cannot pass through anything."""

    index: int
    start: float
    end: float
    before: FloatArray
    after: FloatArray
    height: float

    def at(self, time: float) -> FloatArray:
        """world_from_object (4, 4) at a time."""
        if time < self.start:
            return self.before
        if time >= self.end:
            return self.after
        share = (time - self.start) / (self.end - self.start)
        lifted = minimum_jerk(np.array(share / _UP)) - minimum_jerk(np.array((share - 1 + _UP) / _UP))
        across = minimum_jerk(np.array((share - _UP) / (1 - 2 * _UP)))
        turn = so3.log(self.after[:3, :3] @ self.before[:3, :3].T)
        place = self.before[:3, 3] + across * (self.after[:3, 3] - self.before[:3, 3])
        place = place + np.array([0.0, 0.0, self.height * float(lifted)])
        return se3.from_parts(so3.exp(across * turn) @ self.before[:3, :3], place)


@dataclass(frozen=True, eq=False)
class Carry:
    """Swaying about a place above the table all the time."""

    index: int
    start: float
    end: float
    middle: FloatArray
    sway: Sway

    def at(self, time: float) -> FloatArray:
        """world_from_object (4, 4) at a time."""
        moved = self.sway.at(time)
        turned = so3.exp(np.array([0.0, 0.0, moved[5]])) @ so3.exp(np.array([moved[3], moved[4], 0.0]))
        return se3.from_parts(turned @ self.middle[:3, :3], self.middle[:3, 3] + moved[:3])


def sample_move(
    config: MoveConfig, index: int, body: Body, before: FloatArray, top: float, table: Table, rng: np.random.Generator
) -> Move:
    """A new place for an object, in the same rest, on bare table.

    Args:
        top: height of the highest thing that it may have to be lifted over, metres.

    Raises:
        Unsuitable: there is no room for it at the configured distance.
    """
    assert config.at_s is not None
    low, high = config.distance
    as_it_lies = Body(body.points, before[None, :3, :3], np.ones(1))
    for _ in range(_TRIES):
        trial = copy.deepcopy(table)
        after = place(trial, as_it_lies, before[:2, 3], high, rng, tries=1)
        if is_on_table(body, after) and low <= np.linalg.norm((after - before)[:2, 3]) <= high:
            table.put(as_it_lies, after)
            return Move(index, config.at_s, config.at_s + config.seconds, before, after, top + CLEARANCE)
    raise Unsuitable(f"There is no room to put an object {low:g} to {high:g} m from its place; raise move.distance.")


def sample_carry(
    config: CarryConfig,
    index: int,
    body: Body,
    centre: FloatArray,
    top: float,
    duration: float,
    rng: np.random.Generator,
) -> Carry:
    """A way above a cluster; never lower than its things, however the object is turned.

    Args:
        centre: (2,) x and y of the cluster.
        top: height of the cluster's highest thing, metres.
    """
    reach, tilt = 1e-3 * config.reach_mm, np.deg2rad(config.tilt_deg)
    sway = Sway.sample(np.array([reach, reach, reach / 4, tilt, tilt, 4 * tilt]), rng)
    deepest = float(np.abs(sway.amplitude[:, 2]).sum())
    middle = se3.from_parts(so3.random(rng), np.array([*centre, top + CLEARANCE + body.radius + deepest]))
    return Carry(index, 0.0, duration, middle, sway)


def is_on_table(body: Body, world_from_body: FloatArray) -> bool:
    """Whether a body that was put down touches the table, and not only what lies on it."""
    return bool(se3.act(world_from_body, body.points)[:, 2].min() < 1e-6)
