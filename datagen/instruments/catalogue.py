"""The nine instruments as data: class id, name, drawing, symmetries and material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from datagen.instruments.aiming_arm import ArmDimensions, aiming_arm
from datagen.instruments.insertion_handle import HandleDimensions, insertion_handle
from datagen.instruments.nail import NailDimensions, nail
from datagen.instruments.plate_parts import (
    BarDimensions,
    GearDimensions,
    SpacerDimensions,
    bar,
    gear,
    spacer,
)
from datagen.instruments.turned_parts import (
    RollerDimensions,
    ScrewDimensions,
    StickDimensions,
    roller,
    screw,
    stick,
)
from multicam.geometry import se3, so3
from multicam.geometry.mesh import Mesh
from multicam.geometry.symmetry import Axis, Symmetries

ARM = ArmDimensions()
BAR = BarDimensions()
GEAR = GearDimensions()
HANDLE = HandleDimensions()
NAIL = NailDimensions()
ROLLER = RollerDimensions()
SCREW = ScrewDimensions()
SPACER = SpacerDimensions()
STICK = StickDimensions()


@dataclass(frozen=True)
class Material:
    """Nominal surface: linear RGB base colour, metal or plastic, roughness in 0..1."""

    color: tuple[float, float, float]
    metallic: bool
    roughness: float


STEEL = Material((0.62, 0.62, 0.64), metallic=True, roughness=0.28)
BRUSHED_STEEL = Material((0.50, 0.51, 0.53), metallic=True, roughness=0.42)
TITANIUM_GREEN = Material((0.28, 0.42, 0.30), metallic=True, roughness=0.30)
TITANIUM_GOLD = Material((0.72, 0.52, 0.22), metallic=True, roughness=0.28)
ANODISED_BLUE = Material((0.10, 0.22, 0.50), metallic=True, roughness=0.35)
CARBON = Material((0.022, 0.022, 0.025), metallic=False, roughness=0.38)
PEEK_GREY = Material((0.075, 0.085, 0.10), metallic=False, roughness=0.45)


@dataclass(frozen=True, eq=False)
class Instrument:
    """One part: `draw` gives it in its drawing frame; symmetries are about the object frame's origin."""

    obj_id: int
    name: str
    draw: Callable[[], Manifold]
    material: Material
    symmetries: Symmetries = field(default_factory=Symmetries)


def _turns(count: int, axis: int) -> NDArray[np.float64]:
    """(count - 1, 4, 4) rotations about a coordinate axis by whole shares of a turn, without the identity."""
    angles = 2 * np.pi * np.arange(1, count) / count
    return se3.from_parts(so3.exp(angles[:, None] * np.eye(3)[axis]), np.zeros((count - 1, 3)))


_ABOUT_Z = Symmetries(axes=(Axis(np.array([0.0, 0.0, 1.0])),))
_HALF_TURNS = Symmetries(discrete=np.concatenate([_turns(2, axis) for axis in range(3)]))
_GEAR_TURNS = Symmetries(discrete=_turns(GEAR.lightening_holes, 2))

INSTRUMENTS: tuple[Instrument, ...] = (
    Instrument(1, "aiming_arm", lambda: aiming_arm(ARM, HANDLE, NAIL), CARBON),
    Instrument(2, "bar", lambda: bar(BAR), ANODISED_BLUE, _HALF_TURNS),
    Instrument(3, "gear", lambda: gear(GEAR), STEEL, _GEAR_TURNS),
    Instrument(4, "insertion_handle", lambda: insertion_handle(HANDLE, NAIL), PEEK_GREY),
    Instrument(5, "nail", lambda: nail(NAIL), TITANIUM_GREEN),
    Instrument(6, "roller", lambda: roller(ROLLER), BRUSHED_STEEL, _ABOUT_Z),
    Instrument(7, "screw", lambda: screw(SCREW), TITANIUM_GOLD, _ABOUT_Z),
    Instrument(8, "spacer", lambda: spacer(SPACER), STEEL),
    Instrument(9, "stick", lambda: stick(STICK), STEEL, _ABOUT_Z),
)


def instrument(name: str) -> Instrument:
    """The instrument of that name."""
    return next(i for i in INSTRUMENTS if i.name == name)


@cache
def drawn(name: str) -> Manifold:
    """The part in its drawing frame, metres."""
    return instrument(name).draw()


def drawing_from_object(name: str) -> NDArray[np.float64]:
    """4x4: the object frame has the drawing's axes and sits in the middle of the part's box, as in BOP."""
    bounds = np.asarray(drawn(name).bounding_box()).reshape(2, 3)
    # Rounding to a nanometre keeps symmetry axes, known to be at zero, exactly there.
    return se3.from_parts(np.eye(3), np.round(bounds.mean(0), 9) + 0.0)


def solid(name: str) -> Manifold:
    """The part in its object frame, metres."""
    return drawn(name).transform(se3.inverse(drawing_from_object(name))[:3])


def mesh(name: str) -> Mesh:
    """The part's triangles in its object frame, metres, all vertices in the material's colour."""
    triangles = solid(name).to_mesh64()
    vertices = np.array(triangles.vert_properties[:, :3], dtype=np.float64)
    # Linear to sRGB: viewers take vertex colours as they come.
    color = np.asarray(instrument(name).material.color) ** (1 / 2.2)
    colors = np.tile(np.rint(255 * color).astype(np.uint8), (len(vertices), 1))
    return Mesh(vertices, np.array(triangles.tri_verts, dtype=np.int64), colors)
