"""Proposes the symmetries of a mesh by comparing it with its turned self: geometry only, colours do not count.

Tolerances. A turn is a symmetry if 95 % of the surface, there and back, come to lie within 2.5 % of the diameter
and within 5 % of the object's slimmest width, and if no part of it stands out. The first leaves room for scans: noise
of standard deviation s gives a 95 % quantile of 2.8 s (two surfaces differ), and hand-held scanners of the LINEMOD
kind reach s = 0.5 to 0.8 % of the diameter. The egg box and the glue of LM-O come out at 2.2 and 1.8 %, the nearest
turn that BOP does not list at 4.0 %. The second counts what is small beside a long object's length: the corners of a
hexagonal rod (6.7 % of its width), the bend of a nail. The third finds small features: in noise the 99 % quantile is
3.8 times the median (11 on the glue, whose cap is askew); where it exceeds fifteen times the median, and 1.5 % of the
width, a notch, a flat or a hole is on one side only. An axis is continuous, not n-fold, if turns by odd angles do
within 2 % of the width (polygons of 12 sides and more do) or no worse than three times the best fold; folds about
one axis are judged against the best of them likewise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datagen.cad.directions import around, everywhere, face_directions
from datagen.cad.surface import Deviation, Surface
from datagen.cad.turns import Turn, as_turn, closed, common_point, turn, turns_of
from multicam.geometry import se3, so3
from multicam.geometry.mesh import Mesh
from multicam.geometry.symmetry import Axis, Symmetries
from multicam.types import FloatArray

MOST_OF_DIAMETER, MOST_OF_WIDTH = 0.025, 0.05
"""Bounds of the 95 % quantile."""
STANDS_OUT, TAIL_OF_WIDTH = 15.0, 0.015
"""The 99 % quantile may not exceed both: so many medians, and this share of the width."""
ROUND_OF_WIDTH, ROUND_OF_FOLD = 0.02, 3.0
"""The 95 % quantile at odd angles may not exceed both: this share of the width, and so many times that of a fold."""
FOLDS = tuple(range(2, 13))
"""Turns a circle that are tried about each axis."""

_SAMPLES = 2000
_ALIKE_MOMENTS = 0.1
"""Second moments that differ by less than this share may be equal; symmetry then allows more axes than three."""
_ROUGH = 0.045
"""Mean distance, in diameters, with which a candidate some degrees off its best place is still worth settling."""
_TRIED = 16
"""Candidates that are settled, the most promising ones of all directions."""
_STEPS = 12
"""Of ICP, at most."""
_ANGLES = tuple(float(a) for a in 2 * np.pi * (np.arange(1, 11) * (5**0.5 - 1) / 2 % 1))
"""Angles at which a continuous axis is tried: multiples of the golden ratio, in step with no fold."""
_SNAP = np.deg2rad(3.0)
"""Axes nearer than this to those of the object's own frame are moved onto them if the surface agrees."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """What a mesh looks like to be.

    Attributes:
        symmetries: the whole group.
        deviation: metres; within it 95 % of the surface meet themselves, at the worst of the symmetries; 0 for none.
        nearest: the best turn that was not accepted, and its deviation in metres, or None.
    """

    symmetries: Symmetries
    deviation: float
    nearest: tuple[Turn, float] | None


@dataclass(frozen=True, eq=False)
class _Trial:
    transform: FloatArray
    turn: Turn
    deviation: Deviation
    accepted: bool


def propose(mesh: Mesh) -> Proposal:
    """Finds the rotations that leave a surface where it is, continuous and discrete, as a closed group.

    Candidate axes come from the second moments of the surface, which every symmetry leaves alone: three different
    ones allow half turns about their axes only, two alike ones any fold about the third and half turns across, and
    three alike ones anything; then clusters of face normals and a grid of directions are tried too.
    """
    surface = Surface(mesh, _SAMPLES)
    trials: list[_Trial] = []
    axes: list[Axis] = []
    for direction, fold in _candidates(surface):
        if any(_adds_nothing(direction, axis, trials) for axis in axes):
            continue
        settled = surface.settled(turn(direction, surface.centre, 2 * np.pi / fold), _STEPS)
        trial = _tried(surface, settled, fold)
        is_new = not any(t.accepted and abs(t.turn.direction @ trial.turn.direction) > 0.99 for t in trials)
        if trial.accepted and is_new and _is_continuous(surface, trial):
            axes.append(Axis(trial.turn.direction, trial.turn.offset))
        trials.append(trial)
    passed = _best_about_each_axis(surface, [t for t in trials if t.accepted])
    symmetries = _with_axes(surface, axes, passed) if axes else _finite(surface, passed)
    symmetries = _snapped(surface, symmetries, mesh.box.mean(0))
    refused = [t for t in trials if not t.accepted]
    best = min(refused, key=lambda t: t.deviation.most, default=None)
    nearest = None if best is None else (best.turn, best.deviation.most)
    return Proposal(symmetries, _worst(surface, symmetries), nearest)


def measure(mesh: Mesh, symmetries: Symmetries) -> Proposal:
    """The same for symmetries that somebody stated: how far the surface is from having them."""
    return Proposal(symmetries, _worst(Surface(mesh, _SAMPLES), symmetries), None)


def _worst(surface: Surface, symmetries: Symmetries) -> float:
    return max((surface.deviation(member).most for member in _members(symmetries)), default=0.0)


def _candidates(surface: Surface) -> list[tuple[FloatArray, int]]:
    """Directions and folds worth a close look, the most promising first; of neighbouring ones the best."""
    first, _, third = surface.directions
    low, middle, high = surface.moments
    lower, upper = middle - low < _ALIKE_MOMENTS * high, high - middle < _ALIKE_MOMENTS * high
    pairs = [(direction, 2) for direction in surface.directions]
    if lower and upper:
        named = np.concatenate((surface.directions, np.eye(3), face_directions(surface)))
        pairs += [(d, fold) for d in named for fold in FOLDS]
        pairs += [(d, fold) for d in everywhere() for fold in (2, 3, 4, 5)]
    elif lower or upper:
        main = third if lower else first
        pairs += [(main, fold) for fold in FOLDS] + [(d, 2) for d in around(main)]
    scored: list[tuple[float, FloatArray, int]] = []
    for direction, fold in pairs:
        rough = surface.rough_distance(turn(direction, surface.centre, 2 * np.pi / fold))
        if rough < _ROUGH * surface.diameter:
            scored.append((rough, direction, fold))
    kept: list[tuple[FloatArray, int]] = []
    for _, direction, fold in sorted(scored, key=lambda row: row[0]):
        if not any(fold == f and abs(d @ direction) > np.cos(np.deg2rad(10)) for d, f in kept):
            kept.append((direction, fold))
    return kept[:_TRIED]


def _tried(surface: Surface, transform: FloatArray, fold: int) -> _Trial:
    """The pure rotation next to a settled transform, and how well it does."""
    transform = as_turn(transform, surface.centre, fold)
    (found,) = turns_of(Symmetries(transform[None])) or [Turn(np.array([0, 0, 1.0]), surface.centre, fold)]
    deviation = surface.deviation(transform)
    return _Trial(transform, Turn(found.direction, found.offset, fold), deviation, _fits(surface, deviation))


def _fits(surface: Surface, deviation: Deviation) -> bool:
    bulk = deviation.most <= min(MOST_OF_DIAMETER * surface.diameter, MOST_OF_WIDTH * surface.width)
    return bulk and deviation.tail <= max(STANDS_OUT * deviation.median, TAIL_OF_WIDTH * surface.width)


def _accepted(surface: Surface, transform: FloatArray) -> bool:
    return _fits(surface, surface.deviation(transform))


def _adds_nothing(direction: FloatArray, axis: Axis, trials: Sequence[_Trial]) -> bool:
    """Whether turns about a direction follow from a continuous axis: all about it, all but one half turn across."""
    along = abs(direction @ axis.direction)
    across = any(abs(t.turn.direction @ axis.direction) < 0.1 for t in trials)
    return bool(along > 0.99 or (along < 0.1 and across))


def _is_continuous(surface: Surface, trial: _Trial) -> bool:
    axis = Axis(trial.turn.direction, trial.turn.offset)
    limit = max(ROUND_OF_WIDTH * surface.width, ROUND_OF_FOLD * trial.deviation.most)
    return all(_is_round(surface, axis, angle, limit) for angle in _ANGLES)


def _is_round(surface: Surface, axis: Axis, angle: float, limit: float) -> bool:
    deviation = surface.deviation(axis.rotation(np.asarray(angle)))
    return deviation.most <= limit and _fits(surface, deviation)


def _best_about_each_axis(surface: Surface, accepted: Sequence[_Trial]) -> list[_Trial]:
    """Leaves out folds that do much worse than another about the same axis, as 12 on an octagon; best ones first."""
    passed: list[_Trial] = []
    for trial in sorted(accepted, key=lambda t: (t.deviation.most, -t.turn.fold)):
        better = [t.deviation.most for t in passed if abs(t.turn.direction @ trial.turn.direction) > 0.99]
        if not better or trial.deviation.most <= max(ROUND_OF_WIDTH * surface.width, ROUND_OF_FOLD * min(better)):
            passed.append(trial)
    return passed


def _with_axes(surface: Surface, axes: Sequence[Axis], passed: Sequence[_Trial]) -> Symmetries:
    """A continuous axis, and the half turn that swaps its ends if there is one; a ball has three axes."""
    first = axes[0]
    if len(axes) > 1:
        return Symmetries(axes=tuple(Axis(direction, surface.centre) for direction in np.eye(3)))
    for trial in passed:
        if trial.turn.fold == 2 and abs(trial.turn.direction @ first.direction) < 0.2:
            # All half turns across the axis are alike, so one about a direction of the frame is taken.
            crossing = trial.turn.offset - first.offset
            place = first.offset + first.direction * (first.direction @ crossing)
            across = _across(np.eye(3)[np.abs(first.direction).argmin()], first.direction)
            flip = turn(across / np.linalg.norm(across), place, np.pi)
            if _accepted(surface, flip):
                return Symmetries(flip[None], (first,))
    return Symmetries(axes=(first,))


def _finite(surface: Surface, passed: Sequence[_Trial]) -> Symmetries:
    """The group of the turns that passed, taken up one after the other while all their products pass too."""
    generators: list[_Trial] = []
    members = np.zeros((0, 4, 4))
    for trial in passed:
        if any(np.trace(m[:3, :3].T @ trial.transform[:3, :3]) > 2.97 for m in members):
            continue
        grown = _group(surface, [*generators, trial])
        if grown is not None and all(_accepted(surface, m) for m in grown):
            generators.append(trial)
            members = grown
    return Symmetries(members)


def _group(surface: Surface, generators: Sequence[_Trial]) -> FloatArray | None:
    """All products of some turns (n, 4, 4), without the identity, about the point that fits the measured ones best."""
    rotations = closed([g.transform[:3, :3] for g in generators])
    if rotations is None:
        return None
    rows = [np.eye(3) - g.transform[:3, :3] for g in generators]
    shifts = [se3.act(g.transform, surface.centre) - surface.centre for g in generators]
    centre = surface.centre + np.linalg.pinv(np.concatenate(rows), rcond=1e-3) @ np.concatenate(shifts)
    turned = rotations[1:]
    return se3.from_parts(turned, centre - turned @ centre)


def _snapped(surface: Surface, symmetries: Symmetries, middle: FloatArray) -> Symmetries:
    """The same with clean numbers, where the surface agrees: axes of the frame, through its origin or the box's middle.

    CAD is drawn in such frames; on a scan the fitted axis is not nearer to the truth than its error.
    """
    found = turns_of(symmetries)
    near = [(t.direction, u) for t in found for u in np.eye(3) if abs(t.direction @ u) > np.cos(_SNAP)]
    if not found:
        return symmetries
    own = np.array([d * np.sign(d @ u) for d, u in near]).reshape(-1, 3)
    frame = np.array([u for _, u in near]).reshape(-1, 3)
    q = _between(own[0], frame[0]) if len(near) == 1 else so3.project(frame.T @ own) if near else np.eye(3)
    centre = common_point(found)
    for target in (np.zeros(3), middle, centre):
        # Along a single axis the point may lie anywhere.
        away = target - centre if len(found) > 1 else _across(target - centre, found[0].direction)
        if np.linalg.norm(away) > 0.02 * surface.width:
            continue
        moved = _moved(symmetries, q, centre, target)
        if all(_accepted(surface, m) for m in _members(moved)):
            return moved
    return symmetries


def _moved(symmetries: Symmetries, q: FloatArray, centre: FloatArray, target: FloatArray) -> Symmetries:
    """Every symmetry turned by `q` and carried from `centre` to `target`; what is all but a whole number becomes it."""
    rotations = q @ symmetries.discrete[:, :3, :3] @ q.T
    rotations = np.where(np.abs(rotations - np.rint(rotations)) < 1e-6, np.rint(rotations) + 0.0, rotations)
    discrete = se3.from_parts(rotations, target - rotations @ target)
    axes = []
    for axis in symmetries.axes:
        direction = q @ axis.direction
        direction = np.where(np.abs(direction - np.rint(direction)) < 1e-6, np.rint(direction) + 0.0, direction)
        axes.append(Axis(direction, _across(target, direction)))
    return Symmetries(discrete, tuple(axes))


def _members(symmetries: Symmetries) -> list[FloatArray]:
    """The symmetries to judge a set by: all discrete ones, and some angles of the continuous axes."""
    turned = [axis.rotation(np.asarray(angle)) for axis in symmetries.axes for angle in _ANGLES]
    return [*symmetries.discrete, *turned]


def _across(vector: FloatArray, direction: FloatArray) -> FloatArray:
    return vector - direction * (direction @ vector)


def _between(a: FloatArray, b: FloatArray) -> FloatArray:
    """The least rotation that takes one unit direction to another near it."""
    normal = np.cross(a, b)
    sine = float(np.linalg.norm(normal))
    return np.eye(3) if sine < 1e-12 else so3.exp(normal / sine * np.arctan2(sine, a @ b))
