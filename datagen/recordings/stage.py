"""The scene of a recording: two clusters on one table, a headset that wanders, a static camera before each cluster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.config import SequenceConfig
from datagen.recordings.trajectories import exposure_times, place_static_camera, sample_headset, tracked_poses
from datagen.scenes.layout import Table, place
from datagen.scenes.looks import nominal_surface, plain_lamps, plain_room, plain_surroundings
from datagen.scenes.sample import sample_distractor
from datagen.scenes.spec import PlacedInstance, SceneSpec, Shot
from datagen.scenes.stock import Group, Stock
from multicam.dataset.sequence import CameraEntry, FrameEntry
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray

HEADSET, LEFT, RIGHT = "headset", "left", "right"
CAMERAS = (HEADSET, LEFT, RIGHT)
_CLUSTER_RADIUS = 0.15
_LARGEST_GROUP = 5
"""Parts of a mounted group that leaves enough classes for the other cluster."""
_NOISE = 0.006


@dataclass(frozen=True, eq=False)
class Stage:
    """A recording before it is rendered.

    Attributes:
        scene: its shots are those of the first camera of `cameras`, then those of the second, and so on.
        cameras: times and tracking as they will be written; the scene id is the place in this tuple.
    """

    scene: SceneSpec
    cameras: tuple[CameraEntry, ...]


def sample_stage(config: SequenceConfig, stock: Stock) -> Stage:
    """The recording of a configuration; same arguments, same recording.

    Raises:
        DataError: too few classes for two clusters, or no place for a static camera.
    """
    streams = np.random.SeedSequence(config.seed).spawn(4)
    lay, look, cameras, motion = (np.random.default_rng(s) for s in streams)
    table = Table()
    centres = np.array([[-config.spacing / 2, 0.0], [config.spacing / 2, 0.0]])
    clusters = _sample_clusters(config, stock, table, centres, lay)
    objects = tuple(
        PlacedInstance(obj_id, pose, nominal_surface(stock.colors[obj_id]))
        for cluster in clusters
        for obj_id, pose in cluster
    )
    solids = plain_room(look)
    solids += tuple(sample_distractor(table, centre, 0.35, look) for centre in centres for _ in range(2))
    entries, shots = _film(config, stock, clusters, cameras, motion)
    scene = SceneSpec(
        name=f"recording with seed {config.seed}",
        seed=int(look.integers(2**31)),
        objects=objects,
        solids=solids,
        lights=plain_lamps(),
        surroundings=plain_surroundings(look),
        shots=shots,
    )
    return Stage(scene, entries)


Placed = list[tuple[int, FloatArray]]
"""(obj_id, world_from_object) of the objects of a cluster."""


def _sample_clusters(
    config: SequenceConfig, stock: Stock, table: Table, centres: FloatArray, rng: np.random.Generator
) -> tuple[Placed, Placed]:
    """Left and right cluster; no class is in both, so a class names the cluster."""
    if len(stock.catalogue.obj_ids) < 2:
        raise DataError("A recording needs at least two object classes, one for each of its clusters.")
    left: Placed = []
    mounted: set[int] = set()
    if config.assembled:
        group = _draw_group(stock, rng)
        pose = place(table, group.body, centres[0], 0.02, rng)
        left += [(obj_id, pose @ group_from_object) for obj_id, group_from_object in group.parts]
        mounted = {obj_id for obj_id, _ in group.parts}
    rest = [int(i) for i in rng.permutation([i for i in stock.catalogue.obj_ids if i not in mounted])]
    half = max(0, (len(rest) + len(left)) // 2 - len(left))
    sides = rest[:half], rest[half:]
    loose: tuple[Placed, Placed] = ([], [])
    for classes, centre, cluster in zip(sides, centres, loose, strict=True):
        for obj_id in sorted(classes, key=lambda i: -stock.bodies[i].radius):
            cluster.append((obj_id, place(table, stock.bodies[obj_id], centre, _CLUSTER_RADIUS, rng)))
    return left + loose[0], loose[1]


def _draw_group(stock: Stock, rng: np.random.Generator) -> Group:
    small = [group for group in stock.groups if len(group.parts) <= _LARGEST_GROUP]
    if not small:
        raise DataError(
            f"assembled is true, but the models folder has no group of at most {_LARGEST_GROUP} parts in its "
            "assemblies.json; set assembled to false."
        )
    return small[rng.integers(len(small))]


def _film(
    config: SequenceConfig,
    stock: Stock,
    clusters: tuple[Placed, Placed],
    rng: np.random.Generator,
    motion: np.random.Generator,
) -> tuple[tuple[CameraEntry, ...], tuple[Shot, ...]]:
    """Where each camera is at each of its times."""
    left, right = ([_cloud(stock, obj_id, pose) for obj_id, pose in cluster] for cluster in clusters)
    obstacles = np.concatenate(left + right)
    path = sample_headset(config, motion)
    entries: list[CameraEntry] = []
    shots: list[Shot] = []
    for scene_id, name in enumerate(CAMERAS):
        camera = _sample_lens(config, rng)
        times = exposure_times(config, motion)
        tracked: list[FloatArray | None] = [None] * config.steps
        if name == HEADSET:
            poses = np.stack([path.world_from_camera(float(t)) for t in times])
            tracked = list(tracked_poses(poses, times, config.drift, motion))
        else:
            own, other = (left, right) if name == LEFT else (right, left)
            pose = place_static_camera(config, camera, own, other, obstacles, rng)
            poses = np.broadcast_to(pose, (config.steps, 4, 4))
        frames = tuple(
            FrameEntry(step, round(float(t) * 1e9), belief)
            for step, (t, belief) in enumerate(zip(times, tracked, strict=True))
        )
        entries.append(CameraEntry(name, scene_id, name == HEADSET, frames))
        shots += [Shot(camera, pose, 0.0, _NOISE) for pose in poses]
    return tuple(entries), tuple(shots)


def _sample_lens(config: SequenceConfig, rng: np.random.Generator) -> Camera:
    """The configured focal length, a few percent off, and a principal point within 1 % of the middle."""
    focal = config.focal * config.width * rng.uniform(0.97, 1.03)
    middle = np.array([config.width - 1, config.height - 1]) / 2
    cx, cy = middle + rng.uniform(-0.01, 0.01, size=2) * (config.width, config.height)
    return Camera(np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]), config.width, config.height)


def _cloud(stock: Stock, obj_id: int, world_from_object: FloatArray) -> NDArray[np.float64]:
    return se3.act(world_from_object, stock.bodies[obj_id].points)
