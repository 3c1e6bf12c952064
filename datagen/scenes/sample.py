"""Config, seed and number to SceneSpec; NumPy only, so it runs and is tested without Blender."""

from __future__ import annotations

import numpy as np

from datagen.config import DatagenConfig
from datagen.scenes.layout import Table, block_of, place
from datagen.scenes.looks import (
    backdrop_surface,
    nominal_surface,
    object_surface,
    plain_lamps,
    plain_room,
    plain_surroundings,
    random_lamps,
    random_room,
    random_surroundings,
)
from datagen.scenes.primitives import SHAPES, primitive
from datagen.scenes.spec import PlacedInstance, SceneSpec, Shot, Solid
from datagen.scenes.stock import Stock
from datagen.scenes.viewpoints import sample_camera, sample_viewpoint
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray


def sample_scene(config: DatagenConfig, stock: Stock, index: int) -> SceneSpec:
    """Scene number `index` of the data set; same arguments, same scene.

    Every kind of randomisation has its own stream of numbers: switching one off leaves the others as they were.
    """
    streams = np.random.SeedSequence((config.seed, index)).spawn(7)
    lay, dress, texture, surround, light, distract, shoot = (np.random.default_rng(s) for s in streams)
    table = Table()
    poses, centre, radius = _sample_poses(config, stock, table, lay)
    randomize = config.randomize
    solids = random_room(texture) if randomize.textures else plain_room(texture)
    if randomize.distractors:
        count = int(distract.integers(0, 9))
        solids += tuple(sample_distractor(table, centre, radius + 0.25, distract) for _ in range(count))
    objects = tuple(
        PlacedInstance(
            obj_id,
            pose,
            object_surface(stock.colors[obj_id], dress)
            if randomize.materials
            else nominal_surface(stock.colors[obj_id]),
        )
        for obj_id, pose in poses
    )
    return SceneSpec(
        name=f"seed {config.seed}, scene {index}",
        seed=int(shoot.integers(2**31)),
        objects=objects,
        solids=solids,
        lights=random_lamps(light) if randomize.lights else plain_lamps(),
        surroundings=random_surroundings(surround) if randomize.surroundings else plain_surroundings(surround),
        shots=_sample_shots(config, stock, objects, solids, config.images_in_scene(index), shoot),
    )


def _sample_poses(
    config: DatagenConfig, stock: Stock, table: Table, rng: np.random.Generator
) -> tuple[list[tuple[int, FloatArray]], FloatArray, float]:
    """World poses of the labelled objects, and the circle they lie in."""
    ranges = config.objects
    assembled = bool(stock.groups) and rng.uniform() < ranges.assembled_fraction
    low, high = ranges.loose_beside_groups if assembled else ranges.loose
    loose = _draw_classes(stock.catalogue.obj_ids, int(rng.integers(low, high + 1)), rng)
    centre = rng.uniform(-0.1, 0.1, size=2)
    stack = bool(rng.uniform() < ranges.pile_fraction)
    radius = float(rng.uniform(0.08, 0.16) if stack else rng.uniform(0.12, 0.32))
    poses: list[tuple[int, FloatArray]] = []
    if assembled:
        group = stock.groups[rng.integers(len(stock.groups))]
        pose = place(table, group.body, centre, 0.1, rng, stack=stack)
        poses += [(obj_id, pose @ group_from_object) for obj_id, group_from_object in group.parts]
    # Long parts first: a spread needs their places while there is room.
    for obj_id in sorted(loose, key=lambda i: -stock.bodies[i].radius):
        air = bool(rng.uniform() < ranges.air_fraction)
        poses.append((obj_id, place(table, stock.bodies[obj_id], centre, radius, rng, stack=stack, air=air)))
    return poses, centre, radius


def _draw_classes(obj_ids: tuple[int, ...], count: int, rng: np.random.Generator) -> list[int]:
    """Every class once before any class twice."""
    drawn: list[int] = []
    while len(drawn) < count:
        drawn += [int(i) for i in rng.permutation(obj_ids)]
    return drawn[:count]


def sample_distractor(table: Table, centre: FloatArray, radius: float, rng: np.random.Generator) -> Solid:
    """A primitive of 1 to 15 cm within `radius` metres of (x, y) `centre`; one of five hangs in the air."""
    shape = str(rng.choice(SHAPES))
    size = np.exp(rng.uniform(np.log(0.01), np.log(0.15), size=3))
    unit = primitive(shape)
    body = block_of(Mesh(unit.vertices * size, unit.faces), rng)
    pose = place(table, body, centre, radius, rng, air=bool(rng.uniform() < 0.2), tries=15)
    return Solid(shape, size, pose, backdrop_surface(rng))


def _sample_shots(
    config: DatagenConfig,
    stock: Stock,
    objects: tuple[PlacedInstance, ...],
    solids: tuple[Solid, ...],
    count: int,
    rng: np.random.Generator,
) -> tuple[Shot, ...]:
    targets = np.stack([o.world_from_object[:3, 3] for o in objects])
    clouds = [se3.act(o.world_from_object, stock.bodies[o.obj_id].points[::4]) for o in objects]
    obstacles = np.concatenate(
        clouds + [se3.act(s.world_from_solid, primitive(s.shape).vertices * s.size) for s in solids]
    )
    shots: list[Shot] = []
    for _ in range(count):
        camera = sample_camera(config.camera, config.width, config.height, rng)
        pose = sample_viewpoint(config.camera, camera, targets, clouds, obstacles, rng)
        exposure, noise = rng.normal(0, 0.35), rng.uniform(0, 0.012)
        shots.append(
            Shot(camera, pose, float(exposure), float(noise)) if config.randomize.exposure else Shot(camera, pose)
        )
    return tuple(shots)
