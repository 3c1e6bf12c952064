"""Meshes whose contours can be worked out by hand."""

from __future__ import annotations

import numpy as np
import trimesh

from multicam.geometry.mesh import Mesh

RADIUS = 0.05
"""Of the ball, and of the circle through the torus's tube, metres."""

TUBE = 0.015
"""Radius of the torus's tube, metres."""

BOX = (0.06, 0.04, 0.02)
"""Edges of the box, metres."""


def ball() -> Mesh:
    return _mesh(trimesh.creation.icosphere(subdivisions=5, radius=RADIUS))


def torus() -> Mesh:
    return _mesh(trimesh.creation.torus(RADIUS, TUBE, major_sections=256, minor_sections=96))


def box(edges: tuple[float, float, float] = BOX) -> Mesh:
    return _mesh(trimesh.creation.box(edges))


def open_box() -> Mesh:
    """The box without its two upper triangles."""
    mesh = box()
    height = mesh.vertices[mesh.faces][:, :, 2].min(axis=1)
    return Mesh(mesh.vertices, mesh.faces[height < 0])


def moved(mesh: Mesh, offset: tuple[float, float, float], scale: float = 1.0) -> Mesh:
    return Mesh(scale * mesh.vertices + offset, mesh.faces)


def joined(*meshes: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(shape.vertices, dtype=np.float64), np.array(shape.faces, dtype=np.int64))
