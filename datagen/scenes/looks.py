"""Random and plain looks: surfaces of objects, table and room, lamps, surroundings."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from datagen.scenes.spec import Color, Light, Solid, Surface, Surroundings
from multicam.geometry import se3

HDRIS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
"""The environment maps that come with Blender (CC0)."""
PATTERNS = ("plain", "noise", "voronoi", "brick", "wave", "checker")
_DARKEST_METAL = 0.15
"""Metals reflect more than this; a darker nominal colour means plastic or carbon."""

_TABLES = (
    Surface((0.05, 0.20, 0.24), (0.04, 0.17, 0.21), "noise", 60.0, roughness=0.9, bump=0.3),
    Surface((0.10, 0.22, 0.45), (0.08, 0.19, 0.40), "noise", 50.0, roughness=0.9, bump=0.3),
    Surface((0.30, 0.17, 0.08), (0.20, 0.10, 0.05), "wave", 12.0, roughness=0.5, bump=0.1),
    Surface((0.55, 0.56, 0.58), (0.50, 0.51, 0.53), "noise", 30.0, metallic=0.9, roughness=0.4),
    Surface((0.75, 0.75, 0.72), (0.68, 0.68, 0.66), "noise", 15.0, roughness=0.7),
)
"""Drapes, wood, steel and laminate."""
_FLOOR = Surface((0.32, 0.32, 0.31), (0.26, 0.26, 0.26), "checker", 2.0, roughness=0.6)
_WALL = Surface((0.70, 0.70, 0.66), (0.66, 0.66, 0.63), "noise", 8.0, roughness=0.9)


def nominal_surface(color: Color) -> Surface:
    """The object as designed: a metal, unless its colour is too dark for one."""
    metal = max(color) > _DARKEST_METAL
    return Surface(color, color, metallic=0.9 if metal else 0.0, roughness=0.3 if metal else 0.45)


def object_surface(color: Color, rng: np.random.Generator) -> Surface:
    """Mostly the nominal material with other wear and tint; now and then another metal, or paint."""
    kind, roughness = rng.uniform(), float(rng.uniform(0.05, 0.5))
    spread = float(rng.uniform(0, 0.08))
    if kind < 0.65:
        tint = _tinted(color, rng, 0.15)
        metallic = float(rng.uniform(0.6, 1.0)) if max(color) > _DARKEST_METAL else 0.0
        return Surface(tint, tint, "plain", 100.0, metallic, max(roughness, 0.12), spread)
    if kind < 0.85:
        grey = float(rng.uniform(0.3, 0.85))
        tint = _tinted((grey, grey, grey), rng, 0.12)
        return Surface(tint, tint, "plain", 100.0, float(rng.uniform(0.6, 1.0)), roughness, spread)
    scale = float(np.exp(rng.uniform(np.log(20), np.log(200))))
    metallic = float(rng.uniform(0, 0.6))
    return Surface(_any(rng), _any(rng), str(rng.choice(PATTERNS)), scale, metallic, roughness + 0.2, spread)


def backdrop_surface(rng: np.random.Generator) -> Surface:
    """Any pattern in any two colours, at any scale; table, floor, walls and distractors."""
    first = _any(rng)
    second = _any(rng) if rng.uniform() < 0.5 else _tinted(first, rng, 0.5)
    scale = float(np.exp(rng.uniform(np.log(3), np.log(120))))
    metallic = float(rng.uniform(0.3, 1.0)) if rng.uniform() < 0.2 else 0.0
    roughness, bump = float(rng.uniform(0.1, 1.0)), float(rng.uniform(0, 0.5))
    return Surface(first, second, str(rng.choice(PATTERNS)), scale, metallic, roughness, 0.0, bump)


def plain_room(rng: np.random.Generator) -> tuple[Solid, ...]:
    """A realistic table in a realistic room."""
    return _room(rng, _TABLES[rng.integers(len(_TABLES))], _FLOOR, _WALL)


def random_room(rng: np.random.Generator) -> tuple[Solid, ...]:
    """Any surfaces, or in one of four cases a realistic room."""
    if rng.uniform() < 0.25:
        return plain_room(rng)
    return _room(rng, backdrop_surface(rng), backdrop_surface(rng), backdrop_surface(rng))


def _room(rng: np.random.Generator, table: Surface, floor: Surface, wall: Surface) -> tuple[Solid, ...]:
    """A table top at z = 0, a floor below it, and in half of the rooms four walls."""
    half = rng.uniform(0.8, 1.6, size=2)
    thickness, drop, far = rng.uniform(0.02, 0.06), rng.uniform(0.5, 0.9), rng.uniform(2.2, 4.0)
    parts = [
        _slab(np.array([*(2 * half), thickness]), np.array([0, 0, -thickness / 2]), table),
        _slab(np.array([2 * far, 2 * far, 0.1]), np.array([0, 0, -drop - 0.05]), floor),
    ]
    if rng.uniform() < 0.5:
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            size = np.array([0.1 if x else 2 * far, 0.1 if y else 2 * far, 3.0])
            parts.append(_slab(size, np.array([x * far, y * far, 1.5 - drop]), wall))
    return tuple(parts)


def plain_surroundings(rng: np.random.Generator) -> Surroundings:
    """The light of a studio or of a living room."""
    return Surroundings(1.0, str(rng.choice(("studio", "interior"))), float(rng.uniform(0, 2 * np.pi)))


def random_surroundings(rng: np.random.Generator) -> Surroundings:
    """An HDRI turned any way, or in one of six scenes a gradient."""
    turn = float(rng.uniform(0, 2 * np.pi))
    strength = float(np.exp(rng.uniform(np.log(0.4), np.log(1.6))))
    if rng.uniform() < 1 / 6:
        return Surroundings(strength, None, turn, _pale(rng), _pale(rng))
    return Surroundings(strength, str(rng.choice(HDRIS)), turn)


def plain_lamps() -> tuple[Light, ...]:
    """One large white lamp above the table."""
    return (_lamp(np.array([0.4, -0.4, 1.6]), 0.4, 25.0, (1.0, 1.0, 1.0), point=False),)


def random_lamps(rng: np.random.Generator) -> tuple[Light, ...]:
    """Zero to three lamps around and above the table."""
    made: list[Light] = []
    for _ in range(rng.integers(0, 4)):
        angle, height, reach = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 2.0), rng.uniform(0.1, 1.5)
        position = np.array([reach * np.cos(angle), reach * np.sin(angle), height])
        radius = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
        watts = float(np.exp(rng.uniform(np.log(4), np.log(60))))
        made.append(_lamp(position, radius, watts, _pale(rng), point=bool(rng.uniform() < 0.3)))
    return tuple(made)


def _lamp(position: NDArray[np.float64], radius: float, watts: float, color: Color, point: bool) -> Light:
    """A lamp at `position` that shines on the middle of the table."""
    z = position / np.linalg.norm(position)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack((x, np.cross(z, x), z), axis=1)
    return Light(se3.from_parts(rotation, position), radius, watts, color, point)


def _slab(size: NDArray[np.float64], centre: NDArray[np.float64], surface: Surface) -> Solid:
    return Solid("box", size, se3.from_parts(np.eye(3), centre), surface)


def _any(rng: np.random.Generator) -> Color:
    hue, saturation, value = rng.uniform(size=3)
    return _color(colorsys.hsv_to_rgb(hue, 0.9 * saturation**1.3, 0.02 + 0.88 * value**1.5))


def _pale(rng: np.random.Generator) -> Color:
    return _color(rng.uniform(0.55, 1.0, size=3))


def _tinted(color: Color, rng: np.random.Generator, spread: float) -> Color:
    return _color(np.clip(np.asarray(color) * rng.uniform(1 - spread, 1 + spread, size=3), 0.005, 0.95))


def _color(values: Iterable[float]) -> Color:
    r, g, b = (float(v) for v in values)
    return r, g, b
