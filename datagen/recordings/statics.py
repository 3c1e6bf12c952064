"""Where the static cameras stand, before and after somebody knocks against one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.board import PlacedBoard
from datagen.recordings.config import BumpConfig, SequenceConfig
from datagen.scenes.viewpoints import look_at
from multicam.errors import DataError
from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray

_TRIES = 400
_CHOICES = 5
_MARGIN = 12
"""Pixels outside the image that a static camera keeps free of the other cluster."""
_SEEN = 0.6
"""Share of its own cluster's points that a static camera must have in the image."""
_WHOLE = 0.95
"""Share of the points of an object in motion that must be in the image where it starts and ends."""
_ELEVATION_DEG = (32, 65)
_AZIMUTH_DEG = {"apart": (-100, 100), "overlapping": (20, 100)}
"""From the person's own direction of view; where they overlap, the left camera stands left, the right one right."""
BOARD_CORNERS = 6
"""Inner corners of the board that a camera must see at some time; four give a pose."""
SPARE_CORNERS = 2
"""So many more are foreseen, for OpenCV does not find all that are in the picture."""
_BOARD_SLANT = np.cos(np.deg2rad(68))
"""Least cosine between the board's normal and the line of sight to its middle."""


class Unsuitable(DataError):
    """A drawn scene does not keep what a recording promises; another draw may."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """What a static camera must see and must not see; points in the world, metres.

    Attributes:
        own: surface points of the objects of its cluster.
        moving: surface points of what moves there, at each place where it must be seen.
        other: surface points of each object that must not be seen.
        obstacles: (n, 3) points to keep clear of.
        board: None if there is none.
    """

    own: FloatArray
    moving: Sequence[FloatArray]
    other: Sequence[FloatArray]
    obstacles: FloatArray
    board: PlacedBoard | None

    def suit(self, camera: Camera, world_from_camera: FloatArray, clearance: float) -> bool:
        """Whether a camera could stand here."""
        position = world_from_camera[:3, 3]
        if np.linalg.norm(self.obstacles - position, axis=1).min() < clearance:
            return False
        if np.mean(in_image(camera, world_from_camera, self.own)) < _SEEN:
            return False
        if any(np.mean(in_image(camera, world_from_camera, cloud)) < _WHOLE for cloud in self.moving):
            return False
        if self.board is not None:
            sight = position - self.board.corners.mean(axis=0)
            if float(sight @ self.board.normal) < _BOARD_SLANT * float(np.linalg.norm(sight)):
                return False
            inside = in_image(camera, world_from_camera, self.board.patches.reshape(-1, 3))
            if inside.reshape(-1, 4).all(axis=1).sum() < BOARD_CORNERS + SPARE_CORNERS:
                return False
        return not any(in_image(camera, world_from_camera, cloud, _MARGIN).any() for cloud in self.other)


def place_static_camera(
    config: SequenceConfig, side: int, camera: Camera, outlook: Outlook, rng: np.random.Generator
) -> FloatArray:
    """world_from_camera of a camera that sees what it should; of several places that which shows most of its cluster.

    Args:
        side: 0 for the left camera, 1 for the right one.

    Raises:
        Unsuitable: no such place was found.
    """
    cluster = outlook.own
    centre = (cluster.min(0) + cluster.max(0)) / 2
    found: list[FloatArray] = []
    for _ in range(_TRIES):
        distance, elevation = rng.uniform(*config.distance), np.deg2rad(rng.uniform(*_ELEVATION_DEG))
        outward = np.deg2rad(rng.uniform(*_AZIMUTH_DEG[config.layout]))
        azimuth = -np.pi / 2 + (outward if side else -outward)
        flat = distance * np.cos(elevation)
        position = centre + np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)])
        aim = centre + rng.uniform(-0.03, 0.03, size=3)
        if outlook.board is not None:
            # A part of the picture is the board's.
            aim = aim + rng.uniform(0, 0.5) * (outlook.board.corners.mean(axis=0) - aim)
        pose = look_at(position, aim, np.deg2rad(rng.uniform(-6, 6)))
        if outlook.suit(camera, pose, config.distance[0] / 3):
            found.append(pose)
            if len(found) == _CHOICES:
                break
    if found:
        return max(found, key=lambda pose: float(np.mean(in_image(camera, pose, cluster))))
    what = "both clusters' objects apart" if config.layout == "apart" else "the cluster"
    board = " and the board" if config.board else ""
    raise Unsuitable(
        f"No place was found from which a static camera sees {what}{board} (seed {config.seed}): raise spacing (now "
        f"{config.spacing:g} m) or distance, or change focal (now {config.focal:g}): lower sees more, higher less."
    )


def bump(
    config: BumpConfig,
    world_from_camera: FloatArray,
    camera: Camera,
    outlook: Outlook,
    clearance: float,
    rng: np.random.Generator,
) -> FloatArray:
    """world_from_camera after the knock, from where the camera still sees what it should.

    Raises:
        Unsuitable: every knock of this size turns it away.
    """
    for _ in range(_TRIES):
        shift, axis = rng.normal(size=(2, 3))
        shift *= 1e-3 * config.shift_mm / np.linalg.norm(shift)
        turn = so3.exp(np.deg2rad(config.turn_deg) * axis / np.linalg.norm(axis))
        bumped = world_from_camera @ se3.from_parts(turn, shift)
        if outlook.suit(camera, bumped, clearance):
            return bumped
    raise Unsuitable(
        f"No knock of {config.shift_mm:g} mm and {config.turn_deg:g} degrees leaves the {config.camera} camera where "
        "it sees what it should; lower bump.shift_mm or bump.turn_deg."
    )


def in_image(
    camera: Camera, world_from_camera: FloatArray, points: FloatArray, margin: float = 0.0
) -> NDArray[np.bool_]:
    """(n,) whether each point projects into the image widened by `margin` pixels."""
    local = se3.act(se3.inverse(world_from_camera), points)
    front = local[:, 2] > 0.01
    pixels = camera.project(np.where(front[:, None], local, [0.0, 0.0, 1.0]))
    low, high = -0.5 - margin, np.array([camera.width, camera.height]) - 0.5 + margin
    return front & np.all((pixels > low) & (pixels < high), axis=1)
