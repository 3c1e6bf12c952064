"""Adjustment of a scene: the new poses, or the old ones and a reason."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multicam.bundle.adjustment.alone import observe_edges
from multicam.bundle.adjustment.bearings import find_bearings
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.descent import Participants, System
from multicam.bundle.adjustment.scene import Scene
from multicam.bundle.adjustment.search import Found, edge_poses, find_occluders, learn_colors
from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.pose import PoseFactor
from multicam.bundle.problem import Problem, State
from multicam.bundle.region.colors import ColorModel
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.linear import inverse, squared_norm
from multicam.types import FloatArray

NOT_SEEN = "no line of its contour and no point of its surface was found in any picture"
UNTRUSTED = "only cameras see it whose own poses the pictures contradict"
UNRELATED = "it shares no object with the cameras whose poses are known"
UNCONFIRMED = (
    "two objects must agree on where it is, or the depth of two cameras on one; without depth better than before"
)
BEYOND = "the pictures would move it further than the uncertainty of its old pose allows"
NOT_BETTER = "the pictures fit the poses found no better than the old ones"

AGREES = 0.5
"""Weight from which an edge agrees with the others."""

LAST_TRUST = 0.2
"""Share of the estimates' information that counts once lines and measured depth are searched at the poses that all
share: they are of the same pictures, which by then show more than they do."""


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Answer for a scene.

    Attributes:
        state: the poses; the old ones where there is a reason.
        camera_covariance (c, 6, 6), object_covariance (o, 6, 6): of right perturbations; zero for fixed cameras.
        energy: before and after.
        kept_cameras, kept_objects: why a camera or object has its old pose; fixed cameras are not among them.
        weight: (e,) how far each edge agrees with the others, 1 for entirely.
        information: (e, 6, 6) what picture and estimate say of each camera_from_object (right tangent).
        lines, points: (e,) how many were found where the poses began.
    """

    state: State
    camera_covariance: FloatArray
    object_covariance: FloatArray
    energy: tuple[float, float]
    kept_cameras: dict[int, str]
    kept_objects: dict[int, str]
    weight: FloatArray
    information: FloatArray
    lines: IntArray
    points: IntArray


@dataclass(frozen=True, eq=False)
class _Solution:
    """Where one run ended, before it is judged."""

    state: State
    camera_covariance: FloatArray
    object_covariance: FloatArray
    energy: tuple[float, float]
    weight: FloatArray
    information: FloatArray


def adjust(scene: Scene, state: State, config: AdjustmentConfig) -> Adjusted:
    """Moves cameras and objects to where the pictures show them.

    Cameras move that share an object with others; an object that one camera alone sees follows it. A camera or object
    that would leave the gate of its old pose keeps that pose and says nothing about the others. A camera moves only if
    two objects agree on where it is, or one whose depth it and another camera measure; where nothing measures depth,
    they must agree better than their estimates did. If the energy does not fall, all stay.
    """
    if config.scenery:
        scene = replace(scene, bearings=find_bearings(scene, state, config.scenery))
    occluders = find_occluders(scene, state, config)
    colors: Sequence[ColorModel] = learn_colors(scene, scene.estimated, occluders, config)
    observed = None
    if config.joint:
        observed, colors = observe_edges(scene, state.world_from_camera, occluders, colors, config)
    everyone = Participants(np.ones_like(scene.fixed), np.ones(len(scene.bodies), dtype=np.bool_), scene.fixed)
    found = System(scene, everyone, occluders, colors, config.judging()).search(state, 0)
    seen = np.bincount(scene.object, found.lines + found.points, len(scene.bodies)) > 0
    strayed: dict[int, str] = {}
    unconfirmed: dict[int, str] = {}
    objects = dict.fromkeys(np.flatnonzero(~seen).tolist(), NOT_SEEN)
    while True:
        believed = ~_chosen(strayed, len(scene.fixed))
        trusted = np.bincount(scene.object, believed[scene.camera], len(scene.bodies)) > 0
        objects = dict.fromkeys(np.flatnonzero(~trusted).tolist(), UNTRUSTED) | objects
        placed = ~_chosen(objects, len(scene.bodies))
        unrelated = np.flatnonzero(scene.unrelated(believed, placed)).tolist()
        cameras = unconfirmed | dict.fromkeys(unrelated, UNRELATED) | strayed
        taking = Participants(believed, placed, scene.fixed | _chosen(cameras, len(scene.fixed)))
        solution = _solve(System(scene, taking, occluders, colors, config), state, observed, found)
        far_cameras, far_objects = _beyond(scene, taking, state, solution.state, config.gate)
        # A camera that strays takes along the objects it sees.
        if np.any(far_cameras):
            strayed |= dict.fromkeys(np.flatnonzero(far_cameras).tolist(), BEYOND)
        elif np.any(far_objects):
            objects |= dict.fromkeys(np.flatnonzero(far_objects).tolist(), BEYOND)
        elif observed is not None and np.any(
            doubtful := _doubtful(scene, taking, state, solution, observed, found.points)
        ):
            unconfirmed |= dict.fromkeys(np.flatnonzero(doubtful).tolist(), UNCONFIRMED)
        else:
            break
    before, after = solution.energy
    if not after < before:
        cameras |= dict.fromkeys(np.flatnonzero(~taking.fixed).tolist(), NOT_BETTER)
        objects |= dict.fromkeys(np.flatnonzero(taking.object).tolist(), NOT_BETTER)
    keep_camera, keep_object = scene.fixed | _chosen(cameras, len(scene.fixed)), _chosen(objects, len(scene.bodies))
    return Adjusted(
        state=State(
            _where(keep_camera, state.world_from_camera, solution.state.world_from_camera),
            _where(keep_object, state.world_from_object, solution.state.world_from_object),
        ),
        camera_covariance=_where(keep_camera, scene.camera_covariance, solution.camera_covariance),
        object_covariance=_where(keep_object, scene.object_covariance, solution.object_covariance),
        energy=solution.energy,
        kept_cameras=cameras,
        kept_objects=objects,
        weight=solution.weight,
        information=solution.information,
        lines=found.lines,
        points=found.points,
    )


def _solve(system: System, state: State, observed: PoseFactor | None, found: Found) -> _Solution:
    """The minimum over the poses that the pictures show one by one and, where depth is measured, over all at once.

    With contours alone, searches at poses that all cameras share lose objects that were moved, and end further off.
    """
    if observed is None:
        return _descend(system, state, state, found, range(system.config.searches))
    agreed = _agree(system, state, observed)
    if not found.points.any():
        return agreed
    system = replace(system, scene=system.scene.trusted(LAST_TRUST), believed=agreed.weight)
    together = _descend(system, agreed.state, state, found, system.config.last_searches)
    before, after = together.energy
    return together if after < before else agreed


def _agree(system: System, state: State, observed: PoseFactor) -> _Solution:
    """Cameras and objects that agree best with the poses (e,) that the pictures show one by one."""
    scene, taking = system.scene, system.participants
    taken = taking.both(scene.camera, scene.object)
    factor = replace(
        observed,
        camera=observed.camera[taken],
        object=observed.object[taken],
        observed=observed.observed[taken],
        information=observed.information[taken],
    )
    rest = State(state.world_from_camera, state.world_from_object[taking.object])
    factor = replace(factor, object=(np.cumsum(taking.object) - 1)[factor.object])
    problem = Problem((factor,), taking.fixed, scene.ties)
    minimum = minimize(problem, rest, LevenbergConfig())
    cameras, objects = problem.covariances(minimum.state, scene.kinship * problem.noise_scale(minimum.state))
    moved, covariance = state.world_from_object.copy(), scene.object_covariance.copy()
    moved[taking.object], covariance[taking.object] = minimum.state.world_from_object, objects
    result = State(minimum.state.world_from_camera, moved)
    squared = 2 * observed.linearize(edge_poses(scene, result)).energy
    weight = np.minimum(1, observed.kernel.weight(squared))
    energy = minimum.energies[0], minimum.energies[-1]
    return _Solution(result, cameras, covariance, energy, weight, observed.information)


def _descend(system: System, state: State, first: State, found: Found, searches: Sequence[int]) -> _Solution:
    """Cameras and objects after searches at poses that they share.

    Energies are of `first` and of the end, by what was `found` at `first` and what is found likewise at the end.
    """
    end = system.descend(state, searches)
    judge = replace(system, config=system.config.judging())
    ends = found, judge.search(end.state, 0)
    before, after = (sum(system.energy(each, at, end.weight) for each in ends) for at in (first, end.state))
    cameras, objects = system.covariances(end.state, end.seen, end.weight)
    information = end.seen.hessian + system.scene.information
    return _Solution(end.state, cameras, objects, (before, after), end.weight, information)


def _doubtful(
    scene: Scene, taking: Participants, before: State, solution: _Solution, observed: PoseFactor, points: IntArray
) -> BoolArray:
    """(c,) free cameras that too few objects confirm, or whose objects agree less as contours alone show them."""
    taken = taking.both(scene.camera, scene.object)

    def disagreement(poses: FloatArray, state: State) -> FloatArray:
        squared = squared_norm(se3.minus(poses, edge_poses(scene, state)), scene.information)
        return np.bincount(scene.camera, taken * observed.kernel.energy(squared), len(scene.pictures)).astype(float)

    doubtful = _confirming(scene, taking, solution.weight, points > 0) < 2
    # A camera that sees nothing goes where measured motions put it.
    doubtful &= np.bincount(scene.camera, taken, len(scene.pictures)) > 0
    if not points.any():
        doubtful |= disagreement(observed.observed, solution.state) >= disagreement(scene.estimated, before)
    return ~taking.fixed & doubtful & ~_borne_out(scene, taking, solution.state)


def _borne_out(scene: Scene, taking: Participants, state: State) -> BoolArray:
    """(c,) cameras that a bearing from another one agrees with."""
    borne_out = np.zeros(len(scene.pictures), dtype=np.bool_)
    for bearings in scene.bearings:
        holds = bearings.agrees(state.world_from_camera)
        holds &= taking.camera[bearings.first] & taking.camera[bearings.second]
        borne_out[bearings.first[holds]] = borne_out[bearings.second[holds]] = True
    return borne_out


def _confirming(scene: Scene, taking: Participants, weight: FloatArray, measured: BoolArray) -> IntArray:
    """(c,) how many objects each camera sees as at least one other camera does, by the weights (e,) of the edges.

    One counts for two where the depth of both cameras shows it: `measured` (e,).
    """
    agrees = (weight >= AGREES) & taking.both(scene.camera, scene.object)

    def shared(edges: BoolArray) -> BoolArray:
        return edges & (np.bincount(scene.object, edges, len(scene.bodies))[scene.object] >= 2)

    count = shared(agrees).astype(np.int64) + shared(agrees & measured)
    return np.bincount(scene.camera, count, len(scene.pictures)).astype(np.int64)


def _chosen(indices: Iterable[int], count: int) -> BoolArray:
    chosen = np.zeros(count, dtype=np.bool_)
    chosen[list(indices)] = True
    return chosen


def _where(kept: BoolArray, old: FloatArray, new: FloatArray) -> FloatArray:
    """Old matrices (n, ...) where they are kept, new ones elsewhere."""
    return np.where(kept[:, None, None], old, new)


def _beyond(scene: Scene, taking: Participants, old: State, new: State, gate: float) -> tuple[BoolArray, BoolArray]:
    """Which cameras (c,) and objects (o,) left the gate of their old poses."""
    far: list[BoolArray] = []
    for moves, before, after, covariance in (
        (~taking.fixed, old.world_from_camera, new.world_from_camera, scene.camera_covariance),
        (taking.object, old.world_from_object, new.world_from_object, scene.object_covariance),
    ):
        shift = se3.minus(after[moves], before[moves])
        beyond = np.zeros(len(moves), dtype=np.bool_)
        beyond[moves] = ~(squared_norm(shift, inverse(covariance[moves])) <= gate)
        far.append(beyond)
    return far[0], far[1]
