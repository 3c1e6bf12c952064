"""What is wrong with foreign meshes and can be put right without changing their shape."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from multicam.errors import DataError
from multicam.geometry.mesh import Mesh

_FLAT = 1e-14
"""A face with less than this share of the squared diameter as area has none."""


def cleaned(mesh: Mesh, path: Path) -> Mesh:
    """The same surface without faces of no area, without vertices of no face, and with each vertex once.

    Vertices are one only if place, colour and texture agree to the last bit. A closed surface that is inside out is
    turned; an open one is left as it is.

    Raises:
        DataError: no face has an area.
    """
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    extent = float(np.ptp(mesh.vertices[mesh.faces.ravel()], axis=0).max())
    faces = mesh.faces[areas > _FLAT * extent**2]
    if len(faces) == 0:
        raise DataError(f"{path} holds {len(mesh.faces)} triangles, and all of them are without area.")
    columns = [mesh.vertices, *(v for v in (mesh.colors, mesh.uv) if v is not None)]
    rows = np.concatenate(columns, axis=1)
    used, inverse = np.unique(faces, return_inverse=True)
    _, first, group = np.unique(rows[used], axis=0, return_index=True, return_inverse=True)
    # In the order of the file, not in that of the numbers.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    kept = used[first[order]]
    faces = rank[group.ravel()][inverse.reshape(-1, 3)]
    made = Mesh(
        mesh.vertices[kept],
        faces.astype(np.int64),
        None if mesh.colors is None else mesh.colors[kept],
        None if mesh.uv is None else mesh.uv[kept],
        mesh.texture,
    )
    shell = _welded(made)
    inside_out = shell.is_watertight and shell.is_winding_consistent and shell.volume < 0
    return replace(made, faces=made.faces[:, ::-1].copy()) if inside_out else made


def is_watertight(mesh: Mesh) -> bool:
    """Whether each edge of the surface has a face on both sides; seams of textures do not count as gaps."""
    return bool(_welded(mesh).is_watertight)


def _welded(mesh: Mesh) -> Any:
    import trimesh

    places, inverse = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(places, inverse.ravel()[mesh.faces], process=False)
