"""Solids whose symmetries are known, as meshes in metres."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from datagen.cad.turns import Turn, from_turns
from multicam.geometry import se3
from multicam.geometry.mesh import Mesh
from multicam.geometry.symmetry import Axis, Symmetries
from tests.toy_objects import ROD, toy_meshes

X, Y, Z = np.eye(3)


def mesh_of(solid: Manifold) -> Mesh:
    """A solid drawn in millimetres."""
    made = solid.to_mesh()
    return Mesh(made.vert_properties[:, :3].astype(np.float64) / 1000, made.tri_verts.astype(np.int64))


def axes(*turns: tuple[NDArray[np.float64], int]) -> Symmetries:
    """The group of some axes through the origin; 0 stands for any angle."""
    found = from_turns([Turn(direction, np.zeros(3), fold) for direction, fold in turns])
    assert found is not None
    return found


def prism(radius: float, height: float, sides: int) -> Manifold:
    return Manifold.cylinder(height, radius, radius, sides, True)


def l_part() -> Manifold:
    """An L with a short peg on its side: no mirror image of it can be turned into itself either."""
    foot = Manifold.cube((60, 20, 12), True)
    return foot + Manifold.cube((14, 20, 50)).translate((-30, -10, 0)) + prism(4, 30, 24).translate((15, 4, 12))


def key_way() -> Manifold:
    """A shaft of 40 mm with a slot 5 mm wide and 4 mm deep along a third of it, nearer to one end."""
    return prism(20, 60, 64) - Manifold.cube((5, 8, 20), True).translate((0, 20, 12))


CASES: dict[str, tuple[Mesh, Symmetries]] = {
    "box": (mesh_of(Manifold.cube((60, 40, 20), True)), axes((X, 2), (Y, 2))),
    "cube": (mesh_of(Manifold.cube((50, 50, 50), True)), axes((X, 4), (Y, 4))),
    "square plate": (mesh_of(Manifold.cube((50, 50, 8), True)), axes((Z, 4), (X, 2))),
    "hexagonal prism": (mesh_of(prism(20, 60, 6)), axes((Z, 6), (X, 2))),
    "hexagonal rod": (mesh_of(prism(5, 200, 6)), axes((Z, 6), (X, 2))),
    "pentagonal pyramid": (mesh_of(Manifold.cylinder(40, 25, 0.01, 5, True)), axes((Z, 5))),
    "cylinder": (mesh_of(prism(20, 60, 32)), axes((Z, 0), (X, 2))),
    "rod": (toy_meshes()[ROD], axes((Z, 0), (X, 2))),
    "cone": (mesh_of(Manifold.cylinder(60, 25, 8, 32, True)), axes((Z, 0))),
    "chiral L": (mesh_of(l_part()), Symmetries()),
    "key way": (mesh_of(key_way()), Symmetries()),
}
"""Name to mesh and symmetries."""


def moved(mesh: Mesh, transform: NDArray[np.float64]) -> Mesh:
    return Mesh(se3.act(transform, mesh.vertices), mesh.faces)


def carried(symmetries: Symmetries, transform: NDArray[np.float64]) -> Symmetries:
    """The symmetries of an object moved by a transform."""
    rotation = transform[:3, :3]
    carried_axes = tuple(Axis(rotation @ a.direction, se3.act(transform, a.offset)) for a in symmetries.axes)
    return Symmetries(transform @ symmetries.discrete @ se3.inverse(transform), carried_axes)


def retriangulated(mesh: Mesh, rng: np.random.Generator, splits: int) -> Mesh:
    """The same surface in other triangles: some of them are split at a random point inside."""
    vertices, faces = list(mesh.vertices), [tuple(f) for f in mesh.faces]
    for _ in range(splits):
        a, b, c = faces.pop(int(rng.integers(len(faces))))
        vertices.append(rng.dirichlet((1, 1, 1)) @ np.array([vertices[a], vertices[b], vertices[c]]))
        new = len(vertices) - 1
        faces += [(a, b, new), (b, c, new), (c, a, new)]
    return Mesh(np.array(vertices), np.array(faces, dtype=np.int64))
