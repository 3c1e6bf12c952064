"""Where things lie: bodies are lowered onto a height map of the table, so nothing can interpenetrate.

Each body is a cloud of surface points, denser than the cells of the map. Lowered straight down, it stops when one of
its points meets what is there already; everything on the map is grown by a cell on each side, which fills the gaps
between points and leaves about a cell of air. A body on the bare table touches it exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from multicam.geometry import se3, so3
from multicam.geometry.mesh import Mesh

CELL = 0.003
"""Edge of a height map cell, metres."""
HALF_TABLE = 0.75
"""The height map covers [-HALF_TABLE, HALF_TABLE] in x and y."""
_POINTS_PER_CELL = 2
_LEAST_POINTS = 1_000
_CONTACT = 1e-9


@dataclass(frozen=True, eq=False)
class Body:
    """Something rigid that can be put down.

    Attributes:
        points: (n, 3) surface points in the body's frame, metres.
        rests: (r, 3, 3) rotations in which it lies stably on a plane.
        likelihoods: (r,) of the rests.
    """

    points: NDArray[np.float64]
    rests: NDArray[np.float64]
    likelihoods: NDArray[np.float64]

    @property
    def radius(self) -> float:
        """Greatest distance of a point from the body's origin."""
        return float(np.linalg.norm(self.points, axis=1).max())


def standing(body: Body, share: float) -> Body:
    """The body resting as it was modelled, z up, in this share of all cases."""
    rests = np.concatenate((np.eye(3)[None], body.rests))
    return replace(body, rests=rests, likelihoods=np.concatenate(([share], (1 - share) * body.likelihoods)))


def body_of(meshes: list[Mesh], rng: np.random.Generator) -> Body:
    """The body made of meshes that all stand in its frame, with the rests of its convex hull."""
    import trimesh

    whole = trimesh.util.concatenate([trimesh.Trimesh(m.vertices, m.faces, process=False) for m in meshes])
    transforms, likelihoods = trimesh.poses.compute_stable_poses(whole, sigma=0, n_samples=1)
    rests = np.asarray(transforms)[:, :3, :3]
    return Body(np.concatenate([_cloud(mesh, rng) for mesh in meshes]), rests, likelihoods / likelihoods.sum())


def block_of(mesh: Mesh, rng: np.random.Generator) -> Body:
    """A body that rests on any side of its box: right for primitives, and far quicker than its stable poses."""
    quarter = np.pi / 2
    turns = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0.0]]) * quarter
    return Body(_cloud(mesh, rng), so3.exp(turns), np.full(len(turns), 1 / len(turns)))


def _cloud(mesh: Mesh, rng: np.random.Generator) -> NDArray[np.float64]:
    """Vertices and enough surface points for the height map."""
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    count = max(_LEAST_POINTS, int(_POINTS_PER_CELL * area / CELL**2))
    return np.concatenate((mesh.vertices, mesh.sample_surface(count, rng)))


class Table:
    """Height map of a table and of what was put on it so far."""

    def __init__(self) -> None:
        cells = 2 * round(HALF_TABLE / CELL)
        self._height = np.zeros((cells, cells))

    def lower(self, body: Body, rotation: NDArray[np.float64], xy: NDArray[np.float64]) -> tuple[float, bool]:
        """Height of the body's origin when it touches down at xy, and whether on nothing but the table."""
        points = body.points @ rotation.T
        lowest = -float(points[:, 2].min())
        row, column = self._cells(points[:, :2] + xy)
        height = float((self._height[row, column] - points[:, 2]).max())
        return max(height, lowest), height < lowest + _CONTACT

    def put(self, body: Body, world_from_body: NDArray[np.float64]) -> None:
        """Marks the place of a body as taken, up to its top."""
        points = se3.act(world_from_body, body.points)
        added = np.zeros_like(self._height)
        np.maximum.at(added, self._cells(points[:, :2]), points[:, 2])
        np.maximum(self._height, maximum_filter(added, size=3), out=self._height)

    def _cells(self, xy: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        index = np.floor((xy + HALF_TABLE) / CELL).astype(np.int64)
        np.clip(index, 0, len(self._height) - 1, out=index)
        return index[:, 0], index[:, 1]


def place(
    table: Table,
    body: Body,
    centre: NDArray[np.float64],
    radius: float,
    rng: np.random.Generator,
    *,
    stack: bool = False,
    air: bool = False,
    tries: int = 40,
) -> NDArray[np.float64]:
    """Puts a body on the table within `radius` (metres) of `centre` (x, y) and returns its world_from_body.

    Args:
        stack: takes the first place, on top of whatever is there; otherwise bare table is looked for, in a circle
            that grows with every try.
        air: hangs above the touch-down height, turned any way.
    """
    limit = HALF_TABLE - body.radius
    rotation, xy, height = np.eye(3), np.zeros(2), 0.0
    for attempt in range(1 if stack or air else tries):
        rotation = so3.random(rng) if air else _rest(body, rng)
        reach = radius * (1 + attempt / tries)
        angle, share = rng.uniform(0, 2 * np.pi), np.sqrt(rng.uniform())
        xy = np.clip(centre + reach * share * np.array([np.cos(angle), np.sin(angle)]), -limit, limit)
        height, on_table = table.lower(body, rotation, xy)
        if on_table:
            break
    height += rng.uniform(0.01, 0.25) if air else 0.0
    world_from_body = se3.from_parts(rotation, np.array([*xy, height]))
    table.put(body, world_from_body)
    return world_from_body


def _rest(body: Body, rng: np.random.Generator) -> NDArray[np.float64]:
    """A stable rotation, turned any way about the vertical."""
    turn = so3.exp(np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
    return turn @ body.rests[rng.choice(len(body.rests), p=body.likelihoods)]
