"""A mesh made ready to be drawn thousands of times: closed shells show one side only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from multicam.geometry.mesh import Mesh
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class Shell:
    """Triangles whose order says which of them have a side that is never seen.

    Attributes:
        vertices: (V, 3) metres, each place once.
        faces: (F, 3) int32; the first `closed` belong to closed shells and are counter-clockwise seen from outside.
        closed: number of faces that cannot be seen from behind; the others are drawn from both sides.
    """

    vertices: FloatArray
    faces: NDArray[np.int32]
    closed: int

    def normals(self) -> FloatArray:
        """(F, 3) unit normals of the faces; zero for those without area."""
        across = _across(self.vertices, self.faces)
        length = np.linalg.norm(across, axis=1, keepdims=True)
        return np.divide(across, length, out=np.zeros_like(across), where=length > 0)


def find_shells(mesh: Mesh) -> Shell:
    """Finds the closed shells of a mesh, however its faces wind, and turns their faces outward.

    A mesh with seams in its texture or with faces that wind either way may well be closed. What is open, or has one
    side only, stays as it is.
    """
    used, corners = np.unique(mesh.faces, return_inverse=True)
    vertices, place = np.unique(mesh.vertices[used], axis=0, return_inverse=True)
    faces = place.ravel()[corners.reshape(-1, 3)]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    turned, shell = _orient(faces, len(vertices))
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    # Six times the volume under each face; a shell that encloses less than nothing is inside out.
    volume = np.sum(vertices[faces[:, 0]] * _across(vertices, faces), axis=1)
    inside_out = np.bincount(shell + 1, volume)[shell + 1] < 0
    faces = np.where(inside_out[:, None], faces[:, ::-1], faces)
    order = np.argsort(shell < 0, kind="stable")
    return Shell(vertices, np.ascontiguousarray(faces[order], np.int32), int(np.count_nonzero(shell >= 0)))


def _orient(faces: NDArray[Any], vertices: int) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which faces to turn so that all of a shell agree, and the shell of each; -1 (never turned) for open ones."""
    count = len(faces)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    _, edge, uses = np.unique(
        np.minimum(start, end) * vertices + np.maximum(start, end), return_inverse=True, return_counts=True
    )
    one, two = np.argsort(edge, kind="stable")[np.repeat(uses == 2, uses)].reshape(-1, 2).T
    # Each face twice, as it is and turned: two such nodes are tied if they agree on the edge between them. A shell with
    # two sides falls into two parts, one with each face as it is or turned, and their mirror images.
    differ = (start[one] == start[two]) * count
    one, two = one // 3, two // 3
    rows, columns = np.concatenate((one, one + count)), np.concatenate((two + differ, two + count - differ))
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    part = connected_components(graph, directed=False)[1].astype(np.int64)
    shell, turned = np.minimum(part[:count], part[count:]), part[:count] > part[count:]
    # A shell is closed if it runs along each edge as often one way as the other; one with a single side cannot.
    edge_of_shell = np.unique(edge * 2 * count + np.repeat(shell, 3), return_inverse=True)[1]
    balance = np.bincount(edge_of_shell, np.where((start < end) ^ np.repeat(turned, 3), 1, -1))
    open_faces = (balance[edge_of_shell] != 0).reshape(-1, 3).any(axis=1)
    shell[np.isin(shell, shell[open_faces])] = -1
    return turned & (shell >= 0), shell


def _across(vertices: FloatArray, faces: NDArray[Any]) -> FloatArray:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.cross(b - a, c - a)
