"""One step in time: what every camera sees now is entered into the graph, and everything is solved together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.matching.observations import PosedObjects, observe
from multicam.matching.symmetry import SymmetryTable
from multicam.registration import RegistrationConfig
from multicam.scenegraph.expectation import Sight, compare, expect
from multicam.scenegraph.graph import SceneGraph
from multicam.scenegraph.keyframe import track
from multicam.scenegraph.look import enter, revise_objects
from multicam.scenegraph.place import place_cameras
from multicam.scenegraph.prune import prune
from multicam.scenegraph.solution import Solution, assess, solve
from multicam.scenegraph.suspicion import has_crept, has_moved, suspect
from multicam.types import FloatArray, View

MOVED = "it seems to have been moved: what it sees lies elsewhere than before, in one and the same way"


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """Where the headset's tracking said it was."""

    timestamp_ns: int
    tracking_from_headset: FloatArray


def advance(
    graph: SceneGraph,
    views: Sequence[View],
    tracked: TrackedPose | None,
    catalogue: Catalogue,
    config: RegistrationConfig,
    timestamp_ns: int,
) -> tuple[Solution | None, dict[str, str]]:
    """Enters the views of one moment. The solution's graph still holds the headset as it is now; `keyframe.keep` ends
    the step.

    Cameras of known pose go first: each look is compared with what the camera should see, and tells of known objects,
    of new ones, of objects that moved, or of itself having been moved. Then cameras without a pose are registered with
    all that is known.

    Args:
        tracked: the headset's pose by its tracking, or None if that gave none.

    Returns:
        The solution, or None while nothing has a pose; and for each camera that measured nothing the reason in words.
    """
    views = sorted(views, key=lambda view: (view.view_id != graph.headset, view.view_id))
    seen = {view.view_id: observe((view,), catalogue, config.noise) for view in views}
    reasons: dict[str, str] = {}
    graph, hurry = replace(graph, now=None), ""
    if tracked is not None:
        graph, hurry = track(graph, tracked.timestamp_ns, tracked.tracking_from_headset)
    if hurry:
        reasons[graph.headset] = hurry
    solution = assess(graph) if graph.stays else None
    sights: dict[str, tuple[Sight, PosedObjects]] = {}
    for view in views:
        name = view.view_id
        if solution is None or graph.stay_of(name) is None or name in reasons:
            continue
        if _structure(graph) != _structure(solution.graph):
            solution = assess(graph)
        index = graph.index_of(name)
        assert index is not None
        sight = _compare(solution, index, view, seen[name], catalogue, config, timestamp_ns)
        moved = has_moved(graph, sight, seen[name], catalogue, config)
        if not moved:
            graph = enter(graph, name, sight, seen[name], catalogue, timestamp_ns)
            moved = has_crept(graph, name, catalogue, config, timestamp_ns)
        if moved:
            graph = suspect(graph, name)
            reasons[name] = MOVED
        else:
            graph = graph.without_suspect(name)
            sights[name] = sight, seen[name]
    graph = revise_objects(graph, sights, catalogue, timestamp_ns)
    graph = prune(graph, timestamp_ns)
    lost = [view for view in views if graph.stay_of(view.view_id) is None]
    if not graph.stays:
        return None, reasons
    if lost:
        graph, refusals = place_cameras(assess(graph), lost, seen, catalogue, config, timestamp_ns)
        for name in (view.view_id for view in lost):
            reasons.pop(name, None)
        # A headset that measures nothing is the first thing to mend.
        reasons |= dict.fromkeys(refusals, hurry) if hurry else refusals
    return solve(graph), reasons


def _structure(graph: SceneGraph) -> tuple[int, frozenset[int]]:
    """What a solution must have in common with a graph to say what cameras should see."""
    return len(graph.stays), frozenset(graph.rests)


def _compare(
    solution: Solution,
    stay: int,
    view: View,
    seen: PosedObjects,
    catalogue: Catalogue,
    config: RegistrationConfig,
    timestamp_ns: int,
) -> Sight:
    expected = expect(solution, stay, timestamp_ns)
    classes = expected.objects.obj_id
    diameters = np.array([catalogue[int(obj_id)].diameter for obj_id in classes])
    symmetries = SymmetryTable.of(catalogue)
    gate = solution.graph.config.change.gate
    return compare(expected, seen, diameters, view.camera_matrix, symmetries, config.consensus.likelihood, gate)
