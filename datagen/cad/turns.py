"""Finite groups of rotations: closing them, making them exact, and the axes they turn about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from multicam.geometry import se3, so3
from multicam.geometry.symmetry import Axis, Symmetries
from multicam.types import FloatArray

MOST = 60
"""Largest group that is followed: the icosahedron's."""
_ALIKE = np.deg2rad(8)
"""Rotations nearer than this are one; those of a 12-fold axis are 30 degrees apart."""


@dataclass(frozen=True, eq=False)
class Turn:
    """An axis of symmetry: unit direction, a point on it (metres), how many turns make a circle; 0: any angle."""

    direction: FloatArray
    offset: FloatArray
    fold: int

    @property
    def name(self) -> str:
        """In words, with the axis as letters where it is one of the object's own."""
        axis = "(" + ", ".join(f"{v:.2f}" for v in np.round(self.direction, 2) + 0.0) + ")"
        for letter, unit in zip("xyz", np.eye(3), strict=True):
            if abs(self.direction @ unit) > 1 - 1e-9:
                axis = letter
        return f"any angle about {axis}" if self.fold == 0 else f"{360 / self.fold:.4g}° about {axis}"


def turn(direction: FloatArray, offset: FloatArray, angle: float) -> FloatArray:
    """(4, 4) rotation by an angle (radians) about an axis."""
    return Axis(direction, offset).rotation(np.asarray(angle))


def as_turn(transform: FloatArray, centre: FloatArray, fold: int) -> FloatArray:
    """The nearest pure rotation by a whole fraction of a circle; its axis passes as near as it can to `centre`."""
    vector = so3.log(transform[:3, :3])
    direction = vector / np.linalg.norm(vector)
    angle = 2 * np.pi * round(float(np.linalg.norm(vector)) * fold / (2 * np.pi)) / fold
    # The point of the axis next to the centre solves (1 - R) x = shift; along the axis nothing is known.
    shift = se3.act(transform, centre) - centre
    offset = np.linalg.pinv(np.eye(3) - transform[:3, :3], rcond=1e-3) @ shift
    return turn(direction, centre + offset - direction * (direction @ offset), angle)


def closed(rotations: Sequence[FloatArray]) -> FloatArray | None:
    """The finite group (n, 3, 3) that rotations generate, identity first, made exact; None if it is none of ours.

    Products of measured rotations miss each other by their errors. Each element is replaced by the mean of what the
    others say of it, R_i <- mean over j of R_j' R_(ji), which contracts to an exact group.
    """
    group = [np.eye(3)]
    index = 0
    while index < len(group):
        for generator in rotations:
            product = generator @ group[index]
            if _find(group, product) is None:
                group.append(product)
                if len(group) > MOST:
                    return None
        index += 1
    table = [[_find(group, a @ b) for b in group] for a in group]
    if any(entry is None for row in table for entry in row):
        return None
    exact, places = np.array(group), np.array(table, dtype=np.int64)
    for _ in range(8):
        exact = so3.project(np.einsum("jba,jibc->iac", exact, exact[places]) / len(exact))
    return exact


def _find(group: Sequence[FloatArray], rotation: FloatArray) -> int | None:
    cosines = (np.einsum("nij,ij->n", np.array(group), rotation) - 1) / 2
    best = int(cosines.argmax())
    return best if cosines[best] > np.cos(_ALIKE) else None


def turns_of(symmetries: Symmetries) -> list[Turn]:
    """The axes of a set of symmetries, each once with its greatest fold; continuous ones first."""
    found = [Turn(_upward(a.direction), a.offset, 0) for a in symmetries.axes]
    around: list[tuple[FloatArray, FloatArray, list[float]]] = []
    for transform in symmetries.discrete:
        vector = so3.log(transform[:3, :3])
        angle = float(np.linalg.norm(vector))
        if angle < 1e-6:
            continue
        direction = _upward(vector / angle)
        offset = np.linalg.pinv(np.eye(3) - transform[:3, :3], rcond=1e-3) @ transform[:3, 3]
        signed = angle if vector @ direction > 0 else 2 * np.pi - angle
        known = next((a for a in around if abs(a[0] @ direction) > 1 - 1e-4), None)
        if known is None:
            around.append((direction, offset, [signed]))
        else:
            known[2].append(signed)
    rows = [Turn(d, o, round(2 * np.pi / _least_step(angles))) for d, o, angles in around]
    return found + sorted(rows, key=lambda row: (-row.fold, -float(np.abs(row.direction).max().round(6))))


def from_turns(turns: Sequence[Turn]) -> Symmetries | None:
    """The closed set that some axes stand for, about the point next to all of them; None if it is no finite group.

    Beside a continuous axis, half turns across it are kept as they are: one of them swaps its ends, the rest follow.
    """
    axes = tuple(Axis(t.direction, t.offset) for t in turns if t.fold == 0)
    finite = [t for t in turns if t.fold > 0]
    if axes:
        return Symmetries(np.array([turn(t.direction, t.offset, np.pi) for t in finite if t.fold == 2]), axes)
    rotations = closed([so3.exp(2 * np.pi / t.fold * t.direction) for t in finite])
    if rotations is None:
        return None
    centre = common_point(finite) if finite else np.zeros(3)
    return Symmetries(se3.from_parts(rotations[1:], centre - rotations[1:] @ centre))


def generators(symmetries: Symmetries) -> list[Turn]:
    """As few axes as stand for all the others: `from_turns` of them gives the set back."""
    kept: list[Turn] = []
    count = 0
    for candidate in turns_of(symmetries):
        grown = from_turns([*kept, candidate])
        size = 0 if grown is None else len(grown.discrete) + len(grown.axes)
        if size > count:
            kept, count = [*kept, candidate], size
    return kept


def common_point(turns: Sequence[Turn]) -> FloatArray:
    """The point (metres) next to all axes; on a single axis, the one next to the origin."""
    blocks = [np.eye(3) - np.outer(t.direction, t.direction) for t in turns]
    shifts = [block @ t.offset for block, t in zip(blocks, turns, strict=True)]
    return np.linalg.pinv(np.concatenate(blocks), rcond=1e-3) @ np.concatenate(shifts)


def in_words(symmetries: Symmetries) -> str:
    """The set in a few words: its axes by fold, named where there are not too many."""
    turns = turns_of(symmetries)
    words = [t.name for t in turns if t.fold == 0]
    if len(words) == 3:
        return "any turn (a ball)"
    for fold in sorted({t.fold for t in turns if t.fold > 0}, reverse=True):
        same = [t for t in turns if t.fold == fold]
        listed = ", ".join(t.name.partition(" about ")[2] for t in same)
        words.append(f"{360 / fold:.4g}° about {listed if len(same) <= 3 else f'{len(same)} axes'}")
    return "; ".join(words) or "none"


def _least_step(angles: list[float]) -> float:
    """The step of which a set of angles about one axis are multiples."""
    return min(b - a for a, b in pairwise(sorted([0.0, *angles, 2 * np.pi])) if b - a > 1e-3)


def _upward(direction: FloatArray) -> FloatArray:
    """The one of a direction and its opposite whose last entry that is not zero is positive."""
    last = direction[np.abs(direction) > 1e-6][-1]
    return direction if last > 0 else -direction
