"""Unlabelled things beside the objects and before them: primitives, meshes, classes that are not labelled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datagen.scenes.layout import Table, block_of, place
from datagen.scenes.looks import backdrop_surface, object_surface
from datagen.scenes.primitives import SHAPES, extents, proportions, unit_shape
from datagen.scenes.spec import Solid, Surface
from datagen.scenes.stock import Stock
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray


@dataclass(frozen=True)
class ClutterKinds:
    """What distractors are made of.

    Attributes:
        meshes: files of any unit, taken for half of them if there are some.
        parts: classes of the stock that are not labelled; three of ten distractors are one of these.
        pictures: image files that surfaces may be covered with.
    """

    meshes: tuple[str, ...] = ()
    parts: tuple[int, ...] = ()
    pictures: tuple[str, ...] = ()


def sample_distractor(
    table: Table, centre: FloatArray, radius: float, rng: np.random.Generator,
    kinds: ClutterKinds | None = None, stock: Stock | None = None,
) -> Solid:  # fmt: skip
    """A thing of 1 to 15 cm within `radius` metres of (x, y) `centre`; one of five hangs in the air."""
    kinds = kinds or ClutterKinds()
    air = bool(rng.uniform() < 0.2)
    if kinds.parts and stock is not None and rng.uniform() < 0.3:
        return _part(table, centre, radius, air, rng, kinds.parts, stock)
    surface = backdrop_surface(rng, kinds.pictures)
    if kinds.meshes and rng.uniform() < 0.5:
        shape = str(rng.choice(kinds.meshes))
        size = proportions(shape) * np.exp(rng.uniform(np.log(0.03), np.log(0.15)))
        surface = replace(surface, original=bool(rng.uniform() < 0.7))
    else:
        shape = str(rng.choice(SHAPES))
        size = np.exp(rng.uniform(np.log(0.01), np.log(0.15), size=3))
    return _put(table, shape, size, surface, centre, radius, rng, air)


def sample_occluder(table: Table, centre: FloatArray, rng: np.random.Generator, pictures: Sequence[str] = ()) -> Solid:
    """A bar, plate or ball that hangs above the objects, 1 to 30 cm long."""
    shape = str(rng.choice(("box", "cylinder", "sphere", "capsule")))
    size = np.exp(rng.uniform(np.log(0.008), np.log(0.06), size=3))
    size[rng.integers(3)] *= rng.uniform(1, 5)
    return _put(table, shape, size, backdrop_surface(rng, pictures), centre, 0.25, rng, air=True)


def _put(
    table: Table, shape: str, size: FloatArray, surface: Surface, centre: FloatArray, radius: float,
    rng: np.random.Generator, air: bool,
) -> Solid:  # fmt: skip
    unit = unit_shape(shape)
    body = block_of(Mesh(unit.vertices * size, unit.faces), rng)
    return Solid(shape, size, place(table, body, centre, radius, rng, air=air), surface)


def _part(
    table: Table,
    centre: FloatArray,
    radius: float,
    air: bool,
    rng: np.random.Generator,
    parts: tuple[int, ...],
    stock: Stock,
) -> Solid:
    """One of the models as a thing without a label."""
    obj_id = int(rng.choice(parts))
    mesh, model = stock.meshes[obj_id], stock.catalogue[obj_id]
    assert model.mesh_path is not None, "the stock has loaded its mesh"
    pose = place(table, stock.bodies[obj_id], centre, radius, rng, air=air)
    middle = se3.from_parts(np.eye(3), mesh.box.mean(axis=0))
    surface = object_surface(stock.colors[obj_id], obj_id in stock.painted, rng)
    return Solid(str(model.mesh_path.resolve()), extents(mesh), pose @ middle, surface)
