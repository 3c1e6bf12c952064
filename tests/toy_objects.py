"""Invented objects with every kind of symmetry, as meshes and as a catalogue; all are convex hulls of points."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3, so3
from multicam.geometry.keypoints import sample_keypoints
from multicam.geometry.mesh import Mesh
from multicam.geometry.symmetry import Axis, Symmetries

BRACKET, PLATE, PEG, ROD, PYRAMID, WEDGE = 1, 2, 3, 4, 5, 6

PEG_OFFSET = np.array([0.012, -0.005, 0.0])
"""A point of the peg's axis, metres: off the origin, so that forgetting the offset shows."""


def toy_meshes() -> dict[int, Mesh]:
    """Meshes in metres: two irregular ones, a brick, a cone on a shifted axis, a cylinder, a square pyramid."""
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    circle = _circle(64)
    rim = np.column_stack((0.02 * circle, np.full(64, -0.06)))
    ends = [np.column_stack((0.012 * circle, np.full(64, z))) for z in (-0.09, 0.09)]
    square = np.array([[-0.04, -0.04, 0], [0.04, -0.04, 0], [0.04, 0.04, 0], [-0.04, 0.04, 0.0]])
    return {
        BRACKET: _hull(np.random.default_rng(1).uniform(-1, 1, (14, 3)) * [0.06, 0.04, 0.03]),
        PLATE: _hull(signs * [0.06, 0.03, 0.01]),
        PEG: _hull(np.vstack((rim, [[0, 0, 0.08]])) + PEG_OFFSET),
        ROD: _hull(np.vstack(ends)),
        PYRAMID: _hull(np.vstack((square, [[0, 0, 0.07]]))),
        WEDGE: _hull(np.random.default_rng(2).uniform(-1, 1, (9, 3)) * [0.03, 0.05, 0.05]),
    }


def toy_symmetries() -> dict[int, Symmetries]:
    """The symmetries that the meshes have."""
    half_turns = se3.from_parts(so3.exp(np.pi * np.eye(3)), np.zeros((3, 3)))
    quarter_turns = Axis(np.array([0, 0, 1.0])).rotation(np.pi / 2 * np.arange(1, 4))
    return {
        BRACKET: Symmetries(),
        PLATE: Symmetries(half_turns),
        PEG: Symmetries(axes=(Axis(np.array([0, 0, 1.0]), PEG_OFFSET),)),
        ROD: Symmetries(half_turns[:1], (Axis(np.array([0, 0, 1.0])),)),
        PYRAMID: Symmetries(quarter_turns),
        WEDGE: Symmetries(),
    }


@cache
def toy_catalogue() -> Catalogue:
    """The objects with box, diameter and eight keypoints; no files."""
    names = {1: "bracket", 2: "plate", 3: "peg", 4: "rod", 5: "pyramid", 6: "wedge"}
    symmetries = toy_symmetries()
    objects: dict[int, ObjectModel] = {}
    for obj_id, mesh in toy_meshes().items():
        keypoints = sample_keypoints(mesh, 8, np.random.default_rng(obj_id))
        objects[obj_id] = ObjectModel(obj_id, names[obj_id], mesh.diameter(), symmetries[obj_id], mesh.box, keypoints)
    return Catalogue(objects)


def random_symmetry(symmetries: Symmetries, rng: np.random.Generator) -> NDArray[np.float64]:
    """One member of the set, (4, 4): any angle about a continuous axis, times any discrete symmetry."""
    discrete = np.concatenate((np.eye(4)[None], symmetries.discrete))
    chosen = discrete[rng.integers(len(discrete))]
    if symmetries.axes:
        axis = symmetries.axes[rng.integers(len(symmetries.axes))]
        chosen = axis.rotation(np.asarray(rng.uniform(0, 2 * np.pi))) @ chosen
    return chosen


def _circle(count: int) -> NDArray[np.float64]:
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack((np.cos(angle), np.sin(angle)))


def _hull(points: NDArray[np.float64]) -> Mesh:
    hull = ConvexHull(points)
    faces = np.asarray(hull.simplices, dtype=np.int64)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(points, faces)
