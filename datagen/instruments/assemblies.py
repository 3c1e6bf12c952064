"""Which parts are mounted together, and where: the states of the set during an operation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.instruments.aiming_arm import outer_face
from datagen.instruments.catalogue import (
    ARM,
    BAR,
    HANDLE,
    NAIL,
    STICK,
    drawing_from_object,
    instrument,
)
from datagen.instruments.shapes import frame


@dataclass(frozen=True, eq=False)
class Mount:
    """A part in its place: `group_from_drawing` maps the part's drawing frame to the group's frame."""

    name: str
    group_from_drawing: NDArray[np.float64]

    @property
    def obj_id(self) -> int:
        """Class id of the part."""
        return instrument(self.name).obj_id

    @property
    def group_from_object(self) -> NDArray[np.float64]:
        """4x4, metres: maps object coordinates to the group's frame."""
        return self.group_from_drawing @ drawing_from_object(self.name)


@dataclass(frozen=True)
class Assembly:
    """Parts that move as one; the group frame is the frame of the mounted set."""

    name: str
    mounts: tuple[Mount, ...]


_LATERAL = (1.0, 0.0, 0.0)
_IN_PLACE = np.eye(4)
_NAIL_SIDE = NAIL.proximal_diameter / 2
_ARM_SIDE = outer_face(ARM, HANDLE)
_BAR_HOLE = BAR.length / 2 - BAR.end_hole_inset
_LOWEST_GUIDE = ARM.spare_heights[-1]

_HANDLE = Mount("insertion_handle", _IN_PLACE)
_NAIL = Mount("nail", _IN_PLACE)
_ARM = Mount("aiming_arm", _IN_PLACE)
_ROLLER = Mount("roller", frame((0.0, 0.0, HANDLE.head_height), (0.0, 0.0, 1.0)))
_GEAR = Mount("gear", frame((HANDLE.pad_centre[0], HANDLE.pad_height, HANDLE.pad_centre[1]), (0.0, 1.0, 0.0)))
# The stick's shoulder stops at the nail, its pilot inside the locking hole.
_STICK = Mount("stick", frame((_NAIL_SIDE - STICK.pilot_length, 0.0, NAIL.static_height), _LATERAL))
_SPACER = Mount("spacer", frame((_ARM_SIDE, 0.0, NAIL.static_height), _LATERAL, x_hint=(0.0, -1.0, 0.0)))
_STATIC_SCREW = Mount("screw", frame((_NAIL_SIDE, 0.0, NAIL.static_height), _LATERAL))
_DYNAMIC_SCREW = Mount("screw", frame((_NAIL_SIDE, 0.0, NAIL.dynamic_heights[0]), _LATERAL))
_BAR = Mount(
    "bar",
    frame((_ARM_SIDE + BAR.thickness / 2, 0.0, _LOWEST_GUIDE - _BAR_HOLE), _LATERAL, x_hint=(0.0, 0.0, 1.0)),
)
_BAR_SCREW = Mount("screw", frame((_ARM_SIDE + BAR.thickness, 0.0, _LOWEST_GUIDE), _LATERAL))

ASSEMBLIES: tuple[Assembly, ...] = (
    Assembly("insertion", (_HANDLE, _NAIL, _ROLLER, _GEAR)),
    Assembly("targeting", (_HANDLE, _NAIL, _ARM, _ROLLER, _GEAR, _STICK, _SPACER, _DYNAMIC_SCREW)),
    Assembly("extended_arm", (_ARM, _BAR, _BAR_SCREW, _STICK, _SPACER)),
    Assembly("locked_nail", (_NAIL, _STATIC_SCREW, _DYNAMIC_SCREW)),
)
