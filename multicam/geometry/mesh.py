"""Triangle meshes in metres: loading, size, surface samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multicam.errors import DataError
from multicam.files import require_file


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) metres, object frame.
        faces: (F, 3) indices, counter-clockwise seen from outside.
        colors: (V, 3) uint8 RGB, or None.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or not np.all(np.isfinite(self.vertices)):
            raise ValueError(f"mesh vertices must be a finite (V, 3) array; got shape {self.vertices.shape}")
        if len(self.faces) == 0 or self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise ValueError("a mesh needs faces, and they must point at existing vertices")

    @property
    def box(self) -> NDArray[np.float64]:
        """(2, 3): least and greatest corner of the axis-aligned box, metres."""
        return np.stack((self.vertices.min(0), self.vertices.max(0)))

    def diameter(self) -> float:
        """Greatest distance between two vertices, metres (BOP's definition)."""
        from scipy.spatial import ConvexHull
        from scipy.spatial.distance import pdist

        # Joggled input, for a flat object has no hull otherwise.
        hull = self.vertices[ConvexHull(self.vertices, qhull_options="QJ").vertices]
        return float(pdist(hull).max())

    def sample_surface(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """(count, 3) points spread uniformly over the surface, metres."""
        corners = self.vertices[self.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        chosen = corners[rng.choice(len(areas), size=count, p=areas / areas.sum())]
        u, v = rng.uniform(size=(2, count, 1))
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        return chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])


def load_mesh(path: Path, metres_per_unit: float) -> Mesh:
    """Reads PLY, OBJ, STL, GLB or OFF. The unit is never guessed: BOP's PLY files are 0.001, GLB files 1.

    Raises:
        DataError: missing or unreadable file, or one without triangles.
    """
    import trimesh

    require_file(path, "mesh file")
    try:
        loaded: Any = trimesh.load(path, force="mesh", process=False)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, NotImplementedError) as error:
        raise DataError(f"{path} cannot be read as a mesh: {error}.") from error
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise DataError(f"{path} holds no triangles; a mesh with faces is needed.")
    colors = None
    visual: Any = loaded.visual
    if visual.kind == "vertex":
        colors = np.asarray(visual.vertex_colors, dtype=np.uint8)[:, :3]
    vertices = np.asarray(loaded.vertices, dtype=np.float64) * metres_per_unit
    return Mesh(vertices, np.asarray(loaded.faces, dtype=np.int64), colors)


def save_ply(mesh: Mesh, path: Path, units_per_metre: float) -> None:
    """Writes a binary PLY; BOP wants units_per_metre = 1000."""
    import trimesh

    from multicam.files import write_bytes

    out: Any = trimesh.Trimesh(mesh.vertices * units_per_metre, mesh.faces, process=False)
    if mesh.colors is not None:
        out.visual.vertex_colors = mesh.colors
    data: Any = out.export(file_type="ply")
    write_bytes(path, data)
