"""What the cameras of a recording do: where each is at each of its times, and what it is told of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datagen.recordings.board import PlacedBoard
from datagen.recordings.clusters import Cluster
from datagen.recordings.config import SequenceConfig
from datagen.recordings.headset import sample_headset
from datagen.recordings.motions import Motion
from datagen.recordings.statics import Outlook, Unsuitable, bump, place_static_camera
from datagen.recordings.tracking import Clock, sample_clock, tracked_poses, tracking_errors
from datagen.scenes.spec import Moved, PlacedInstance, Shot
from datagen.scenes.stock import Stock
from multicam.dataset.sequence import CameraEntry, FrameEntry
from multicam.dataset.sequence_facts import Bump, ObjectMotion, SequenceTruth
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray

HEADSET, LEFT, RIGHT = "headset", "left", "right"
CAMERAS = (HEADSET, LEFT, RIGHT)
_NOISE = 0.006
_HEAD_CLEARANCE = 0.12
"""Metres that the headset keeps from everything."""
_PLACES = 12
"""Of an object in motion, at which it counts as an obstacle."""


@dataclass(frozen=True, eq=False)
class SetUp:
    """What is in front of the cameras; `still` are the clouds of all that is on the table at first, board apart."""

    config: SequenceConfig
    stock: Stock
    clusters: tuple[Cluster, ...]
    objects: tuple[PlacedInstance, ...]
    motions: tuple[Motion, ...]
    still: list[FloatArray]
    board: PlacedBoard | None

    def cloud(self, index: int, world_from_object: FloatArray) -> FloatArray:
        """Surface points of an object, world."""
        return se3.act(world_from_object, self.stock.bodies[self.objects[index].obj_id].points)

    def members(self, side: int) -> range:
        """Indices of the objects of a side's cluster; both sides have the same one if there is only one."""
        sizes = [len(cluster.objects) for cluster in self.clusters]
        own = side % len(sizes)
        return range(sum(sizes[:own]), sum(sizes[: own + 1]))

    def obstacles(self) -> FloatArray:
        """(n, 3) points to keep clear of, at whatever time something is there."""
        passed = [
            self.cloud(m.index, m.at(float(t))) for m in self.motions for t in np.linspace(m.start, m.end, _PLACES)
        ]
        clouds = self.still + passed + ([self.board.points] if self.board else [])
        return np.concatenate([cloud[::4] for cloud in clouds])

    def outlook(self, side: int) -> Outlook:
        """What the static camera of a side must and must not see."""
        own = self.members(side)
        other = [i for i in range(len(self.objects)) if i not in own]
        moving = [
            self.cloud(m.index, m.at(t))
            for m in self.motions
            if m.index in own
            for t in ((m.start - 1e-6, m.end) if m.end < self.config.duration else (m.start,))
        ]
        clouds = [self.cloud(i, item.world_from_object) for i, item in enumerate(self.objects)]
        never = [clouds[i] for i in other] + [
            self.cloud(m.index, m.at(float(t)))
            for m in self.motions
            if m.index in other
            for t in np.linspace(m.start, m.end, _PLACES)
        ]
        seen = np.concatenate([clouds[i] for i in own])
        return Outlook(seen, moving, never, self.obstacles(), self.board)


def film(
    set_up: SetUp,
    stand: np.random.Generator,
    walk: np.random.Generator,
    clocks: np.random.Generator,
    drift: np.random.Generator,
) -> tuple[tuple[CameraEntry, ...], tuple[Shot, ...], SequenceTruth]:
    """Where each camera is at each of its times, and what it is told of it."""
    config = set_up.config
    entries: list[CameraEntry] = []
    shots: list[Shot] = []
    offsets: dict[str, int] = {}
    for scene_id, name in enumerate(CAMERAS):
        camera = _sample_lens(config, stand)
        clock = sample_clock(config.clocks, config.steps, config.rate_hz, clocks, true=name == HEADSET)
        tracked: Sequence[FloatArray | None] = [None] * config.steps
        if name == HEADSET:
            poses = _headset_poses(set_up, clock, walk)
            tracked = list(tracked_poses(poses, clock.times, tracking_errors(config.drift), drift))
        else:
            poses = _static_poses(set_up, scene_id - 1, camera, clock, stand)
        frames = tuple(
            FrameEntry(step, clock.stamp_ns(step), tracked[step]) for step in range(config.steps) if clock.kept[step]
        )
        entries.append(CameraEntry(name, scene_id, name == HEADSET, frames, config.rate_hz))
        offsets[name] = round(clock.offset * 1e9)
        shots += [
            Shot(camera, pose, noise=_NOISE, moved=_moved(set_up, float(time)))
            for pose, time in zip(poses, clock.times, strict=True)
        ]
    bumps = (Bump(config.bump.camera, _ns(config.bump.at_s)),) if config.bump.at_s is not None else ()
    motions = tuple(ObjectMotion(set_up.objects[m.index].obj_id, _ns(m.start), _ns(m.end)) for m in set_up.motions)
    board = set_up.board.world_from_board if set_up.board else None
    return tuple(entries), tuple(shots), SequenceTruth(offsets, bumps, motions, board)


def _headset_poses(set_up: SetUp, clock: Clock, rng: np.random.Generator) -> FloatArray:
    config, board = set_up.config, set_up.board
    middles = np.stack([set_up.cloud(i, o.world_from_object).mean(axis=0) for i, o in enumerate(set_up.objects)])
    path = sample_headset(
        config,
        np.stack([set_up.clusters[side % len(set_up.clusters)].centre for side in (0, 1)]),
        [middles[list(set_up.members(side))] for side in (0, 1)],
        None if board is None else board.corners.mean(axis=0),
        rng,
    )
    poses = np.stack([path.world_from_camera(float(t)) for t in clock.times])
    gaps = np.linalg.norm(set_up.obstacles()[:, None] - poses[None, :, :3, 3], axis=2)
    if gaps.min() < _HEAD_CLEARANCE:
        raise Unsuitable(f"The headset comes within {gaps.min():.2f} m of things; raise distance.")
    return poses


def _static_poses(set_up: SetUp, side: int, camera: Camera, clock: Clock, rng: np.random.Generator) -> FloatArray:
    """(steps, 4, 4); two different poses if somebody knocks against this camera."""
    config, around = set_up.config, set_up.outlook(side)
    pose = place_static_camera(config, side, camera, around, rng)
    poses = np.repeat(pose[None], config.steps, axis=0)
    if config.bump.at_s is not None and config.bump.camera == CAMERAS[1 + side]:
        poses[clock.times >= config.bump.at_s] = bump(config.bump, pose, camera, around, config.distance[0] / 3, rng)
    return poses


def _moved(set_up: SetUp, time: float) -> tuple[Moved, ...]:
    """Objects that are not where the scene has them."""
    poses = ((m.index, m.at(time)) for m in set_up.motions)
    return tuple(
        Moved(index, pose) for index, pose in poses if not np.array_equal(pose, set_up.objects[index].world_from_object)
    )


def _sample_lens(config: SequenceConfig, rng: np.random.Generator) -> Camera:
    """The configured focal length, a few percent off, and a principal point within 1 % of the middle."""
    focal = config.focal * config.width * rng.uniform(0.97, 1.03)
    middle = np.array([config.width - 1, config.height - 1]) / 2
    cx, cy = middle + rng.uniform(-0.01, 0.01, size=2) * (config.width, config.height)
    return Camera(np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]), config.width, config.height)


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
