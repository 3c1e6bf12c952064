"""Config, seed and number to SceneSpec; NumPy only, so it runs and is tested without Blender."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from datagen.config import DatagenConfig
from datagen.scenes.clutter import ClutterKinds, sample_distractor, sample_occluder
from datagen.scenes.layout import Table, place, standing
from datagen.scenes.looks import (
    HDRIS,
    nominal_surface,
    object_surface,
    plain_lamps,
    plain_surroundings,
    random_backdrop,
    random_lamps,
    random_surroundings,
)
from datagen.scenes.places import KINDS, random_place
from datagen.scenes.primitives import mesh_of
from datagen.scenes.shots import sample_shots
from datagen.scenes.spec import PlacedInstance, SceneSpec, Solid
from datagen.scenes.stock import Stock
from multicam.dataset.objects import MESH_SUFFIXES
from multicam.errors import ConfigError, DataError
from multicam.geometry import se3
from multicam.types import FloatArray

_PICTURES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
_MAPS = (".hdr", ".exr")

Settle = Callable[[SceneSpec], SceneSpec]
"""Lets the objects of a scene fall."""


def sample_scene(config: DatagenConfig, stock: Stock, index: int, settle: Settle | None = None) -> SceneSpec:
    """Scene number `index` of the data set; same arguments, same scene.

    Every kind of randomisation has its own stream of numbers: switching one off leaves the others as they were.

    Args:
        settle: what `config.objects.settle` asks for.

    Raises:
        ConfigError: labelled classes that the models lack.
        DataError: a folder of assets that holds nothing of its kind.
    """
    streams = np.random.SeedSequence((config.seed, index)).spawn(9)
    lay, dress, texture, surround, light, distract, occlude, behind, shoot = (np.random.default_rng(s) for s in streams)
    randomize = config.randomize
    labelled = _labelled(config, stock)
    textures = _files(config.assets.textures, _PICTURES)
    # The kind of place is drawn in any case, so that the layout is the same with and without.
    kind = str(lay.choice(KINDS, p=_shares(config)))
    kind = kind if randomize.places else "table"
    table = Table()
    poses, mounted, centre, radius = _sample_poses(config, stock, labelled, table, lay, floating=kind == "air")
    clutter: tuple[Solid, ...] = ()
    if randomize.distractors:
        unlabelled = tuple(i for i in stock.catalogue.obj_ids if i not in labelled)
        kinds = ClutterKinds(_files(config.assets.distractors, MESH_SUFFIXES), unlabelled, textures)
        spread = radius if kind == "box" else radius + 0.25
        clutter = tuple(
            sample_distractor(table, centre, spread, distract, kinds, stock) for _ in range(distract.integers(0, 9))
        )
    solids = random_place(kind, _reach(stock, poses, clutter), texture, textures if randomize.textures else None)
    solids += clutter
    if randomize.occluders:
        solids += tuple(sample_occluder(table, centre, occlude, textures) for _ in range(occlude.integers(0, 4)))
    objects = tuple(
        PlacedInstance(
            obj_id,
            pose,
            object_surface(stock.colors[obj_id], obj_id in stock.painted, dress)
            if randomize.materials
            else nominal_surface(stock.colors[obj_id], obj_id in stock.painted),
            mounted=number < mounted,
        )
        for number, (obj_id, pose) in enumerate(poses)
    )
    hdris = _files(config.assets.hdris, _MAPS) or HDRIS
    surroundings = random_surroundings(surround, hdris) if randomize.surroundings else plain_surroundings(surround)
    if randomize.backgrounds:
        pictures = _files(config.assets.backgrounds, _PICTURES)
        surroundings = replace(surroundings, backdrop=random_backdrop(behind, pictures))
    scene = SceneSpec(
        name=f"seed {config.seed}, scene {index}",
        seed=int(shoot.integers(2**31)),
        objects=objects,
        solids=solids,
        lights=random_lamps(light) if randomize.lights else plain_lamps(),
        surroundings=surroundings,
    )
    if settle is not None and kind != "air":
        scene = settle(scene)
    shots = sample_shots(
        config, stock, scene.objects, solids, config.images_in_scene(index), textures, shoot, floating=kind == "air"
    )
    return replace(scene, shots=shots)


def _labelled(config: DatagenConfig, stock: Stock) -> tuple[int, ...]:
    known, wanted = stock.catalogue.obj_ids, config.objects.classes
    missing = sorted(set(wanted) - set(known))
    if missing:
        raise ConfigError(f"objects.classes names {missing}, which the models lack; they hold {list(known)}.")
    return tuple(sorted(set(wanted))) or known


def _shares(config: DatagenConfig) -> list[float]:
    shares = [float(getattr(config.places, kind)) for kind in KINDS]
    return [share / sum(shares) for share in shares]


@cache
def _files(folder: Path | None, suffixes: tuple[str, ...]) -> tuple[str, ...]:
    """Files of a kind in a folder and below, in the order of their names; none if no folder is given."""
    if folder is None:
        return ()
    found = sorted(p for p in folder.rglob("*") if p.suffix.lower() in suffixes and p.is_file())
    if not found:
        raise DataError(f"{folder} holds none of the files that are looked for ({', '.join(suffixes)}).")
    return tuple(str(p.resolve()) for p in found)


def _reach(stock: Stock, poses: list[tuple[int, FloatArray]], clutter: tuple[Solid, ...]) -> FloatArray:
    """(2, 2) least and greatest x and y of all that was put down, metres."""
    clouds = [se3.act(pose, stock.bodies[obj_id].points) for obj_id, pose in poses]
    clouds += [se3.act(item.world_from_solid, mesh_of(item).vertices) for item in clutter]
    flat = np.concatenate(clouds)[:, :2]
    return np.stack((flat.min(axis=0), flat.max(axis=0)))


def _sample_poses(
    config: DatagenConfig,
    stock: Stock,
    labelled: tuple[int, ...],
    table: Table,
    rng: np.random.Generator,
    floating: bool,
) -> tuple[list[tuple[int, FloatArray]], int, FloatArray, float]:
    """World poses of the labelled objects, how many of them (the first) are mounted, and the circle they lie in."""
    ranges = config.objects
    groups = [group for group in stock.groups if all(obj_id in labelled for obj_id, _ in group.parts)]
    assembled = bool(groups) and rng.uniform() < ranges.assembled_fraction
    low, high = ranges.loose_beside_groups if assembled else ranges.loose
    loose = _draw_classes(labelled, int(rng.integers(low, high + 1)), rng)
    centre = rng.uniform(-0.1, 0.1, size=2)
    stack = bool(rng.uniform() < ranges.pile_fraction)
    radius = float(rng.uniform(0.08, 0.16) if stack else rng.uniform(0.12, 0.32))
    poses: list[tuple[int, FloatArray]] = []
    if assembled:
        group = groups[rng.integers(len(groups))]
        pose = place(table, group.body, centre, 0.1, rng, stack=stack, air=floating)
        poses += [(obj_id, pose @ group_from_object) for obj_id, group_from_object in group.parts]
    mounted = len(poses)
    # Long parts first: a spread needs their places while there is room.
    for obj_id in sorted(loose, key=lambda i: -stock.bodies[i].radius):
        air = floating or bool(rng.uniform() < ranges.air_fraction)
        body = standing(stock.bodies[obj_id], ranges.upright_fraction)
        poses.append((obj_id, place(table, body, centre, radius, rng, stack=stack, air=air)))
    return poses, mounted, centre, radius


def _draw_classes(obj_ids: tuple[int, ...], count: int, rng: np.random.Generator) -> list[int]:
    """Every class once before any class twice."""
    drawn: list[int] = []
    while len(drawn) < count:
        drawn += [int(i) for i in rng.permutation(obj_ids)]
    return drawn[:count]
