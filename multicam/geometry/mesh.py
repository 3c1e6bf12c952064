"""Triangle meshes in metres: loading, saving, size, surface samples."""

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
        uv: (V, 2) where each vertex lies in the picture `texture`: (0, 0) is its lower left corner, (1, 1) the upper
            right one, and beyond them it repeats; or None.
        texture: image file laid over the surface, or None; always together with `uv`.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None
    uv: NDArray[np.float64] | None = None
    texture: Path | None = None

    def __post_init__(self) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or not np.all(np.isfinite(self.vertices)):
            raise ValueError(f"mesh vertices must be a finite (V, 3) array; got shape {self.vertices.shape}")
        if len(self.faces) == 0 or self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise ValueError("a mesh needs faces, and they must point at existing vertices")
        if (self.uv is None) != (self.texture is None):
            raise ValueError("a textured mesh has both uv and texture")
        for name, values, width in (("colors", self.colors, 3), ("uv", self.uv, 2)):
            if values is not None and values.shape != (len(self.vertices), width):
                raise ValueError(f"mesh {name} must be ({len(self.vertices)}, {width}); got shape {values.shape}")

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
        faces, u, v = self.draw_surface(count, rng)
        chosen = self.vertices[self.faces[faces]]
        return chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])

    def draw_surface(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Points spread uniformly over the surface: face (count,) of each, weights (count, 1) of its last two corners.

        `sample_surface` is these weights applied to places; others apply them to colours.
        """
        corners = self.vertices[self.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        faces = rng.choice(len(areas), size=count, p=areas / areas.sum())
        u, v = rng.uniform(size=(2, count, 1))
        flip = u + v > 1
        return faces, np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)


def load_mesh(path: Path, metres_per_unit: float, pictures: Path | None = None) -> Mesh:
    """Reads PLY, OBJ, STL, GLB or OFF. The unit is never guessed: BOP's PLY files are 0.001, GLB files 1.

    Colours of vertices, faces and materials come as colours of vertices. A picture that lies beside the file, as
    OBJ and PLY have it, comes as `uv` and `texture`; where it is missing, a warning says so.

    Args:
        pictures: folder for a picture that is no file of its own (inside a GLB, or packed of several); it is written
            there as PNG under the name of the mesh. Without a folder such a picture becomes colours of vertices.

    Raises:
        DataError: missing or unreadable file, or one without triangles.
    """
    import trimesh

    from multicam.geometry.appearance import join_parts

    require_file(path, "mesh file")
    try:
        # The picture of a PLY is read later: here trimesh would put another in the place of one that it cannot read.
        options: dict[str, Any] = {"skip_materials": True} if path.suffix.lower() == ".ply" else {}
        loaded: Any = trimesh.load(path, process=False, **options)
        parts = [p for p in _parts(loaded) if isinstance(p, trimesh.Trimesh) and len(p.faces) > 0]
        if not parts:
            raise DataError(f"{path} holds no triangles; a mesh with faces is needed.")
        vertices, faces, look = join_parts(parts, path, pictures)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, NotImplementedError, OSError) as error:
        raise DataError(f"{path} cannot be read as a mesh: {error}.") from error
    return Mesh(vertices * metres_per_unit, faces, look.colors, look.uv, look.texture)


def _parts(loaded: Any) -> list[Any]:
    """The geometries of a file where its scene puts them, by name: trimesh's own order may change from run to run."""
    if not hasattr(loaded, "graph"):
        return [loaded]
    placed: list[Any] = []
    for node in sorted(loaded.graph.nodes_geometry):
        transform, name = loaded.graph[node]
        placed.append(loaded.geometry[name].copy())
        placed[-1].apply_transform(transform)
    return placed


def save_ply(mesh: Mesh, path: Path, units_per_metre: float) -> None:
    """Writes a binary PLY; BOP wants units_per_metre = 1000.

    A texture is written as PNG beside it, under the same name, and named in the header as BOP does.
    """
    from multicam.files import write_bytes

    columns = [(axis, "float", mesh.vertices[:, i] * units_per_metre) for i, axis in enumerate("xyz")]
    comment = ""
    if mesh.uv is not None and mesh.texture is not None:
        from multicam.geometry.appearance import png_bytes

        picture = path.with_suffix(".png")
        write_bytes(picture, png_bytes(mesh.texture))
        comment = f"comment TextureFile {picture.name}\n"
        columns += [("texture_u", "float", mesh.uv[:, 0]), ("texture_v", "float", mesh.uv[:, 1])]
    if mesh.colors is not None:
        columns += [(name, "uchar", mesh.colors[:, i]) for i, name in enumerate(("red", "green", "blue"))]
    kinds = {"float": "<f4", "uchar": "u1"}
    vertices = np.empty(len(mesh.vertices), dtype=[(name, kinds[kind]) for name, kind, _ in columns])
    for name, _, values in columns:
        vertices[name] = values
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    properties = "".join(f"property {kind} {name}\n" for name, kind, _ in columns)
    header = (
        f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    write_bytes(path, header.encode() + vertices.tobytes() + faces.tobytes())
