"""What the objects lie on and stand in: a table in a room, a floor, a bin, or nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datagen.scenes.looks import FLOOR, WALL, backdrop_surface, plain_table
from datagen.scenes.spec import Solid, Surface
from multicam.geometry import se3

KINDS = ("table", "floor", "box", "air")
"""As in PlacesConfig."""

_BIN_WALL = 0.004
_WALL_HEIGHT = 3.0


def plain_room(rng: np.random.Generator) -> tuple[Solid, ...]:
    """A realistic table in a realistic room."""
    return _table(rng, plain_table(rng), FLOOR, WALL)


def random_place(
    kind: str, reach: NDArray[np.float64], rng: np.random.Generator, pictures: Sequence[str] | None
) -> tuple[Solid, ...]:
    """The solids of a place whose ground is z = 0.

    Args:
        kind: one of KINDS.
        reach: (2, 2) least and greatest x and y of what lies on the ground; a bin is made to fit.
        pictures: what surfaces may be covered with, or None for realistic surfaces.
    """
    plain = pictures is None or rng.uniform() < 0.25

    def surface(realistic: Surface) -> Surface:
        return realistic if plain or pictures is None else backdrop_surface(rng, pictures)

    if kind == "air":
        return ()
    if kind == "floor":
        half = rng.uniform(1.2, 3.0, size=2)
        walls = surface(WALL)
        return (_slab([*(2 * half), 0.1], [0, 0, -0.05], surface(FLOOR)), *_walls(half, 0.0, walls))
    room = _table(rng, surface(plain_table(rng)), surface(FLOOR), surface(WALL))
    return room + _bin(reach, rng, surface(plain_table(rng))) if kind == "box" else room


def _table(rng: np.random.Generator, table: Surface, floor: Surface, wall: Surface) -> tuple[Solid, ...]:
    """A table top at z = 0, a floor below it, and in half of the rooms four walls."""
    half = rng.uniform(0.8, 1.6, size=2)
    thickness, drop, far = rng.uniform(0.02, 0.06), rng.uniform(0.5, 0.9), rng.uniform(2.2, 4.0)
    parts = (
        _slab([*(2 * half), thickness], [0, 0, -thickness / 2], table),
        _slab([2 * far, 2 * far, 0.1], [0, 0, -drop - 0.05], floor),
    )
    return parts + _walls(np.array([far, far]), -drop, wall) if rng.uniform() < 0.5 else parts


def _walls(half: NDArray[np.float64], ground: float, surface: Surface) -> tuple[Solid, ...]:
    made: list[Solid] = []
    for axis in (0, 1):
        for side in (-1, 1):
            size, centre = np.array([*(2 * half), _WALL_HEIGHT]), np.array([0, 0, ground + _WALL_HEIGHT / 2])
            size[axis], centre[axis] = 0.1, side * half[axis]
            made.append(_slab(size, centre, surface))
    return tuple(made)


def _bin(reach: NDArray[np.float64], rng: np.random.Generator, surface: Surface) -> tuple[Solid, ...]:
    """Four upright boards just outside of everything that lies on the ground."""
    low, high = reach[0] - rng.uniform(0.005, 0.05, 2), reach[1] + rng.uniform(0.005, 0.05, 2)
    height = rng.uniform(0.02, 0.09)
    middle, size = (low + high) / 2, high - low + 2 * _BIN_WALL
    boards: list[Solid] = []
    for axis in (0, 1):
        for edge in (low[axis] - _BIN_WALL / 2, high[axis] + _BIN_WALL / 2):
            extent, centre = np.array([*size, height]), np.array([*middle, height / 2])
            extent[axis], centre[axis] = _BIN_WALL, edge
            boards.append(_slab(extent, centre, surface))
    return tuple(boards)


def _slab(
    size: Sequence[float] | NDArray[np.float64], centre: Sequence[float] | NDArray[np.float64], surface: Surface
) -> Solid:
    return Solid(
        "box",
        np.asarray(size, dtype=np.float64),
        se3.from_parts(np.eye(3), np.asarray(centre, dtype=np.float64)),
        surface,
    )
