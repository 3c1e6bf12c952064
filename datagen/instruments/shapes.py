"""Small vocabulary of workshop shapes on top of manifold3d: turned, drilled, milled and lofted solids."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from manifold3d import CrossSection, Manifold, Mesh64, OpType
from numpy.typing import NDArray

SEGMENTS = 48
"""Facets of a full turn: a multiple of four, so that quarter turns map a turned part to itself."""

Outline = Sequence[tuple[float, float]]
Point = tuple[float, float, float]


def turned(profile: Outline, segments: int = SEGMENTS) -> Manifold:
    """Solid of revolution about z. `profile` lists (radius, z) from the lowest to the highest point."""
    closed = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    return Manifold.revolve(CrossSection([closed]), segments)


def rod(radius: float, low: float, high: float, chamfer: float = 0.0, segments: int = SEGMENTS) -> Manifold:
    """Cylinder about z from `low` to `high` with both ends chamfered at 45 degrees."""
    if chamfer == 0.0:
        return turned([(radius, low), (radius, high)], segments)
    inner = radius - chamfer
    return turned([(inner, low), (radius, low + chamfer), (radius, high - chamfer), (inner, high)], segments)


def ridged(
    root: float, crest: float, low: float, high: float, count: int, crest_share: float = 0.3
) -> list[tuple[float, float]]:
    """Profile points of `count` equal annular ridges between `low` and `high`, roots at both ends.

    `crest_share` is the share of the pitch that the flat crest takes; the root takes as much.
    """
    pitch = (high - low) / count
    flank = (0.5 - crest_share) * pitch
    points: list[tuple[float, float]] = [(root, low)]
    for i in range(count):
        middle = low + (i + 0.5) * pitch
        half = crest_share * pitch / 2
        points += [
            (root, middle - half - flank),
            (crest, middle - half),
            (crest, middle + half),
            (root, middle + half + flank),
        ]
    return [*points, (root, high)]


def drill(
    radius: float,
    centre: Point,
    direction: Point,
    depth: float,
    sink: float = 0.0,
    sink_at: float = 0.0,
    segments: int = 32,
) -> Manifold:
    """Cutting tool: a cylinder of length `depth` through `centre` along `direction`.

    With `sink` > 0 the tool widens by `sink` at 45 degrees towards both ends, the conical mouths starting
    where the distance from the centre passes `sink_at` - `sink` (so a plate face at `sink_at` is chamfered).
    """
    half = depth / 2
    profile = [(radius, -half), (radius, half)]
    if sink > 0.0:
        wide = radius + sink
        profile = [
            (wide, -half),
            (wide, -sink_at),
            (radius, -sink_at + sink),
            (radius, sink_at - sink),
            (wide, sink_at),
            (wide, half),
        ]
    return along(turned(profile, segments), centre, direction)


def along(solid: Manifold, origin: Point, direction: Point) -> Manifold:
    """Moves a solid drawn about z so that its origin is at `origin` and its z axis along `direction`."""
    return solid.transform(frame(origin, direction)[:3])


def frame(origin: Point, z_axis: Point, x_hint: Point = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """4x4 transform whose z axis is `z_axis` and whose x axis is as near to `x_hint` as can be.

    Without a hint the x axis is the coordinate axis most nearly square to z.
    """
    z = np.asarray(z_axis, dtype=np.float64)
    z = z / np.linalg.norm(z)
    hint = np.asarray(x_hint, dtype=np.float64)
    if not hint.any():
        hint = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = hint - z * (hint @ z)
    x = x / np.linalg.norm(x)
    transform = np.eye(4)
    transform[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    transform[:3, 3] = origin
    return transform


def block(low: Point, high: Point, chamfer: float) -> Manifold:
    """Box between two corners with all edges chamfered."""
    low_corner, high_corner = np.asarray(low), np.asarray(high)
    points = []
    for full_axis in range(3):
        inset = np.full(3, chamfer)
        inset[full_axis] = 0.0
        corners = np.stack(
            np.meshgrid(*zip(low_corner + inset, high_corner - inset, strict=True), indexing="ij"), axis=-1
        )
        points.append(corners.reshape(-1, 3))
    return Manifold.hull_points(np.concatenate(points))


def slab(discs: Sequence[tuple[float, float, float]], low: float, high: float, chamfer: float) -> Manifold:
    """Plate with chamfered rims: the convex hull of `discs` (x, y, radius), z from `low` to `high`."""
    return Manifold.batch_hull([rod(r, low, high, chamfer, 40).translate((x, y, 0.0)) for x, y, r in discs])


def slot(radius: float, start: Point, end: Point, direction: Point, depth: float) -> Manifold:
    """Cutting tool for an oblong hole between two centres."""
    return Manifold.batch_hull(
        [
            drill(radius, start, direction, depth, segments=24),
            drill(radius, end, direction, depth, segments=24),
        ]
    )


def rounded_rectangle(
    half_width: float, half_height: float, corner: float, corner_points: int = 4
) -> NDArray[np.float64]:
    """Closed section (4 * corner_points, 2), counter-clockwise, with circular corners."""
    angles = np.linspace(0.0, np.pi / 2, corner_points)
    points = []
    for turn, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        centre = np.array([sx * (half_width - corner), sy * (half_height - corner)])
        arc = angles + turn * np.pi / 2
        points.append(centre + corner * np.column_stack([np.cos(arc), np.sin(arc)]))
    return np.concatenate(points)


def lofted(rings: Sequence[NDArray[np.float64]]) -> Manifold:
    """Solid through convex rings (k, 3), each counter-clockwise for one who looks back along the loft."""
    stacked = np.stack(rings)
    levels, k, _ = stacked.shape
    index = np.arange(levels * k).reshape(levels, k)
    following = np.roll(index, -1, axis=1)
    lower = np.stack([index[:-1], following[:-1], following[1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([index[:-1], following[1:], index[1:]], axis=-1).reshape(-1, 3)
    fan = np.column_stack([np.zeros(k - 2, dtype=int), np.arange(1, k - 1), np.arange(2, k)])
    triangles = np.concatenate([lower, upper, index[0][fan[:, ::-1]], index[-1][fan]])
    return Manifold(
        Mesh64(
            vert_properties=np.ascontiguousarray(stacked.reshape(-1, 3)),
            tri_verts=np.ascontiguousarray(triangles, dtype=np.uint64),
        )
    )


def union(solids: Sequence[Manifold]) -> Manifold:
    """Sum of solids."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def cut(body: Manifold, tools: Sequence[Manifold]) -> Manifold:
    """`body` less all `tools`."""
    return Manifold.batch_boolean([body, *tools], OpType.Subtract)
