"""Unit shapes for tables, walls and distractors: scaled to fill the unit cube, centred, scaled again by their user."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.scenes.spec import Solid
from multicam.geometry.mesh import Mesh, load_mesh

SHAPES = ("box", "cylinder", "cone", "sphere", "torus", "tube", "capsule", "gear")
_TEETH = 14
_FLATTEST = 1e-6


@cache
def unit_shape(shape: str) -> Mesh:
    """The mesh of a shape in SHAPES, or of a file; its bounding box is the unit cube about the origin.

    Raises:
        DataError: the file is missing or holds no triangles.
    """
    if shape not in SHAPES:
        return _unit(load_mesh(Path(shape), 1.0))
    from trimesh import creation

    makers: dict[str, Callable[[], Any]] = {
        "box": lambda: creation.box((1, 1, 1)),
        "cylinder": lambda: creation.cylinder(radius=0.5, height=1, sections=32),
        "cone": lambda: creation.cone(radius=0.5, height=1, sections=32),
        "sphere": lambda: creation.icosphere(subdivisions=3, radius=0.5),
        "torus": lambda: creation.torus(major_radius=0.375, minor_radius=0.125),
        "tube": lambda: creation.annulus(r_min=0.35, r_max=0.5, height=1),
        "capsule": lambda: creation.capsule(height=1, radius=0.4),
        "gear": _gear,
    }
    made = makers[shape]()
    return _unit(Mesh(np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int64)))


@cache
def proportions(file: str) -> NDArray[np.float64]:
    """(3,) edges of the bounding box of a mesh file, the longest being 1."""
    edges = extents(load_mesh(Path(file), 1.0))
    return edges / edges.max()


def mesh_of(solid: Solid) -> Mesh:
    """The shape in the size of a solid, about its own origin."""
    unit = unit_shape(solid.shape)
    return replace(unit, vertices=unit.vertices * solid.size)


def extents(mesh: Mesh) -> NDArray[np.float64]:
    """(3,) edges of the bounding box; never quite 0."""
    return np.maximum(np.ptp(mesh.box, axis=0), _FLATTEST)


def _unit(mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=(mesh.vertices - mesh.box.mean(axis=0)) / extents(mesh))


def _gear() -> Any:
    """A flat wheel with straight teeth: a star-shaped outline, fanned from its middle."""
    import trimesh

    turn = 2 * np.pi * (np.arange(4 * _TEETH) + 0.5) / (4 * _TEETH)
    radius = np.where(np.arange(4 * _TEETH) % 4 < 2, 0.5, 0.4)
    rim = np.stack((radius * np.cos(turn), radius * np.sin(turn)), axis=1)
    count = len(rim)
    layers = [np.column_stack((rim, np.full(count, height))) for height in (-0.5, 0.5)]
    vertices = np.concatenate((*layers, [[0, 0, -0.5], [0, 0, 0.5]]))
    here, after = np.arange(count), np.roll(np.arange(count), -1)
    bottom, top = np.full(count, 2 * count), np.full(count, 2 * count + 1)
    faces = np.concatenate(
        (
            np.stack((bottom, after, here), axis=1),
            np.stack((top, here + count, after + count), axis=1),
            np.stack((here, after, after + count), axis=1),
            np.stack((here, after + count, here + count), axis=1),
        )
    )
    return trimesh.Trimesh(vertices, faces, process=False)
