"""Random and plain looks: surfaces of objects and of what is around them, lamps, environment light."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from datagen.scenes.spec import Color, Light, Surface, Surroundings
from multicam.geometry import se3

HDRIS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
"""The environment maps that come with Blender (CC0)."""
PATTERNS = ("plain", "noise", "voronoi", "brick", "wave", "checker")
_SRGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)  # fmt: skip
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
FLOOR = Surface((0.32, 0.32, 0.31), (0.26, 0.26, 0.26), "checker", 2.0, roughness=0.6)
WALL = Surface((0.70, 0.70, 0.66), (0.66, 0.66, 0.63), "noise", 8.0, roughness=0.9)


def nominal_surface(color: Color, painted: bool = False) -> Surface:
    """The object as designed: its own colours, or a metal, unless its colour is too dark for one."""
    metal = max(color) > _DARKEST_METAL and not painted
    metallic, roughness = (0.9, 0.3) if metal else (0.0, 0.45)
    return Surface(color, color, metallic=metallic, roughness=roughness, original=painted)


def object_surface(color: Color, painted: bool, rng: np.random.Generator) -> Surface:
    """Mostly the nominal material with other wear and tint; now and then another metal, plastic, paint or a pattern.

    Args:
        painted: the mesh has colours of its own, which most of its looks keep.
    """
    kind, roughness = rng.uniform(), float(rng.uniform(0.05, 0.5))
    spread = float(rng.uniform(0, 0.08))
    if kind < 0.6 and painted:
        tint = _tinted((0.8, 0.8, 0.8), rng, 0.2)
        return Surface(tint, tint, "plain", 100.0, 0.0, roughness + 0.3, spread, original=True)
    if kind < 0.6:
        tint = _tinted(color, rng, 0.15)
        metallic = float(rng.uniform(0.6, 1.0)) if max(color) > _DARKEST_METAL else 0.0
        return Surface(tint, tint, "plain", 100.0, metallic, max(roughness, 0.12), spread)
    if kind < 0.75:
        grey = float(rng.uniform(0.3, 0.85))
        tint = _tinted((grey, grey, grey), rng, 0.12)
        return Surface(tint, tint, "plain", 100.0, float(rng.uniform(0.6, 1.0)), roughness, spread)
    if kind < 0.87:
        # Plastic is smooth, paint is not.
        paint = random_color(rng)
        return Surface(paint, paint, "plain", 100.0, 0.0, roughness + (0.4 if rng.uniform() < 0.5 else 0.0), spread)
    metallic = float(rng.uniform(0, 0.6))
    pattern, scale = str(rng.choice(PATTERNS)), _log_uniform(20, 200, rng)
    return Surface(random_color(rng), random_color(rng), pattern, scale, metallic, roughness + 0.2, spread)


def backdrop_surface(rng: np.random.Generator, pictures: Sequence[str] = ()) -> Surface:
    """Any pattern in any two colours, at any scale, or one of the pictures; tables, walls, distractors, backgrounds."""
    first = random_color(rng)
    second = random_color(rng) if rng.uniform() < 0.5 else _tinted(first, rng, 0.5)
    metallic = float(rng.uniform(0.3, 1.0)) if rng.uniform() < 0.2 else 0.0
    roughness, bump = float(rng.uniform(0.1, 1.0)), float(rng.uniform(0, 0.5))
    pattern, scale = str(rng.choice(PATTERNS)), _log_uniform(3, 120, rng)
    if pictures and rng.uniform() < 0.5:
        return Surface(first, second, "plain", scale, metallic, roughness, picture=str(rng.choice(pictures)))
    return Surface(first, second, pattern, scale, metallic, roughness, 0.0, bump)


def plain_table(rng: np.random.Generator) -> Surface:
    """Drapes, wood, steel or laminate."""
    return _TABLES[rng.integers(len(_TABLES))]


def plain_surroundings(rng: np.random.Generator) -> Surroundings:
    """The light of a studio or of a living room."""
    return Surroundings(1.0, str(rng.choice(("studio", "interior"))), float(rng.uniform(0, 2 * np.pi)))


def random_surroundings(rng: np.random.Generator, hdris: Sequence[str] = HDRIS) -> Surroundings:
    """An environment map turned any way, or in one of six scenes a gradient."""
    turn = float(rng.uniform(0, 2 * np.pi))
    strength = _log_uniform(0.4, 1.6, rng)
    if rng.uniform() < 1 / 6:
        return Surroundings(strength, None, turn, _pale(rng), _pale(rng))
    return Surroundings(strength, str(rng.choice(hdris)), turn)


def random_backdrop(rng: np.random.Generator, pictures: Sequence[str] = ()) -> Surface | None:
    """What is seen behind all: in half of the scenes the environment (None), else a picture or a pattern."""
    if rng.uniform() < 0.5:
        return None
    if pictures:
        return Surface(random_color(rng), picture=str(rng.choice(pictures)))
    return Surface(random_color(rng), random_color(rng), str(rng.choice(PATTERNS[1:])), _log_uniform(2, 30, rng))


def plain_lamps() -> tuple[Light, ...]:
    """One large white lamp above the table."""
    return (_lamp(np.array([0.4, -0.4, 1.6]), 0.4, 25.0, (1.0, 1.0, 1.0), point=False),)


def random_lamps(rng: np.random.Generator) -> tuple[Light, ...]:
    """Zero to three lamps around and above the table."""
    made: list[Light] = []
    for _ in range(rng.integers(0, 4)):
        angle, height, reach = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 2.0), rng.uniform(0.1, 1.5)
        position = np.array([reach * np.cos(angle), reach * np.sin(angle), height])
        radius = _log_uniform(0.02, 0.5, rng)
        watts, kelvin = _log_uniform(4, 60, rng), _log_uniform(2500, 9000, rng)
        made.append(_lamp(position, radius, watts, blackbody(kelvin), point=bool(rng.uniform() < 0.3)))
    return tuple(made)


def blackbody(kelvin: float) -> Color:
    """Linear sRGB of a black body between 2222 and 12000 K, the greatest channel 1.

    The Planckian locus as a cubic in 1/T (Kim et al., US patent 7024034), then CIE xyY to sRGB; what lies outside of it
    is clipped.
    """
    t = 1e3 / kelvin
    if kelvin < 4000:
        x = np.polyval([-0.2661239, -0.2343589, 0.8776956, 0.179910], t)
        cubic = [-0.9549476, -1.37418593, 2.09137015, -0.16748867]
    else:
        x = np.polyval([-3.0258469, 2.1070379, 0.2226347, 0.240390], t)
        cubic = [3.0817580, -5.87338670, 3.75112997, -0.37001483]
    y = np.polyval(cubic, x)
    linear = _SRGB_FROM_XYZ @ np.array([x / y, 1.0, (1 - x - y) / y])
    return _color(np.clip(linear / linear.max(), 0, 1))


def _lamp(position: NDArray[np.float64], radius: float, watts: float, color: Color, point: bool) -> Light:
    """A lamp at `position` that shines on the middle of the table."""
    z = position / np.linalg.norm(position)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack((x, np.cross(z, x), z), axis=1)
    return Light(se3.from_parts(rotation, position), radius, watts, color, point)


def random_color(rng: np.random.Generator) -> Color:
    """Any linear RGB, dark and greyish ones more often."""
    hue, saturation, value = rng.uniform(size=3)
    return _color(colorsys.hsv_to_rgb(hue, 0.9 * saturation**1.3, 0.02 + 0.88 * value**1.5))


def _pale(rng: np.random.Generator) -> Color:
    return _color(rng.uniform(0.55, 1.0, size=3))


def _tinted(color: Color, rng: np.random.Generator, spread: float) -> Color:
    return _color(np.clip(np.asarray(color) * rng.uniform(1 - spread, 1 + spread, size=3), 0.005, 0.95))


def _color(values: Iterable[float]) -> Color:
    r, g, b = (float(v) for v in values)
    return r, g, b


def _log_uniform(low: float, high: float, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
