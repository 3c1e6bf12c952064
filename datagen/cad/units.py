"""Units of length of CAD files, and whether a size in them is plausible."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np

from multicam.errors import DataError

Unit = Literal["mm", "cm", "m", "inch"]

METRES: dict[Unit, float] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}

LEAST, MOST = 5e-3, 3.0
"""Metres across: parts of other sizes are not seen by the cameras that this package is for, or their unit is wrong."""
SPREAD = 300.0
"""Parts of one folder that differ in size by more than this factor are not in one unit."""
_USUAL = 0.15
"""Metres across; of several plausible units the one that brings a part nearest to this is named first."""


def likely_units(diameter: float) -> list[Unit]:
    """Units in which a diameter (file units) is plausible, the likeliest first."""
    fitting = [unit for unit in get_args(Unit) if LEAST <= diameter * METRES[unit] <= MOST]
    return sorted(fitting, key=lambda unit: abs(np.log(diameter * METRES[unit] / _USUAL)))


def in_every_unit(diameter: float) -> str:
    """What a diameter (file units) would be in every unit, and which of them are plausible."""
    sizes = ", ".join(f"{length(diameter * METRES[unit])} if in {unit}" for unit in get_args(Unit))
    units = likely_units(diameter)
    likely = f"plausible: {' or '.join(units)}" if units else "none of them is plausible"
    return f"{sizes}; {likely}"


def length(metres: float) -> str:
    """A length in the unit people would say it in."""
    return f"{metres * 1000:.3g} mm" if metres < 1 else f"{metres:.3g} m"


def require_plausible(diameters: Mapping[str, tuple[float, Unit]], source: str) -> None:
    """Checks diameters (file units) and stated units, by file, against reason and against each other.

    Raises:
        DataError: a part would be smaller than 5 mm or larger than 3 m, or two differ by a factor of more than 300.
    """
    for name, (diameter, unit) in diameters.items():
        size = diameter * METRES[unit]
        if LEAST <= size <= MOST:
            continue
        likely = likely_units(diameter)
        advice = (
            f"its unit is probably {likely[0]} ({length(diameter * METRES[likely[0]])})" if likely else "no unit fits"
        )
        raise DataError(
            f"{name} would be {length(size)} across in {unit}, and parts must measure 5 mm to 3 m: {advice}; correct "
            f"`unit` in {source}, at the top for all parts or beside this one."
        )
    sizes = {name: diameter * METRES[unit] for name, (diameter, unit) in diameters.items()}
    small, large = min(sizes, key=lambda name: sizes[name]), max(sizes, key=lambda name: sizes[name])
    if sizes[large] > SPREAD * sizes[small]:
        raise DataError(
            f"{small} is {length(sizes[small])} across and {large} {length(sizes[large])}, "
            f"{sizes[large] / sizes[small]:.0f} times as much: they are not in one unit; give one of them a `unit` of "
            f"its own in {source}."
        )
