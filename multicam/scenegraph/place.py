"""Cameras without a pose, and cameras that seem to have been moved: registered with the map as if it were a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.observations import PosedObjects
from multicam.registration import RegistrationConfig, register_views
from multicam.scenegraph.expectation import Expectation, Sight, expect
from multicam.scenegraph.graph import WORLD, SceneGraph, Stay
from multicam.scenegraph.look import add_rest, aligned, confirmed, look_at
from multicam.scenegraph.solution import Solution
from multicam.scenegraph.uncertain import UncertainPose, mahalanobis
from multicam.types import Component, ObjectEstimate, View

MAP = WORLD
"""Name of the view that holds what is known already."""


def place_cameras(
    solution: Solution,
    views: Sequence[View],
    seen: dict[str, PosedObjects],
    catalogue: Catalogue,
    config: RegistrationConfig,
    timestamp_ns: int,
) -> tuple[SceneGraph, dict[str, str]]:
    """Registers cameras of unknown pose with each other and with the map.

    Covariances of the map are relative to the stay that saw most objects of the classes that these cameras see.

    Returns:
        The graph with the cameras that hang together with the map, and for each of the others the reason in words.
    """
    graph = solution.graph
    anchor = _anchor(graph, {e.obj_id for view in views for e in view.estimates})
    if anchor is None:
        return graph, {view.view_id: _stranded(view, catalogue) for view in views}
    expected = expect(solution, anchor, timestamp_ns)
    at_rest = [n for n, number in enumerate(expected.numbers) if number is not None]
    known = expected.objects[np.array(at_rest, dtype=np.int64)]
    registration = register_views([View(MAP, _estimates(known)), *views], catalogue, config)
    reasons = dict(registration.refusals)
    for component in registration.components:
        names = [camera.view_id for camera in component.cameras if camera.view_id != MAP]
        if len(names) == len(component.cameras):
            for name in names:
                others = " and ".join(other for other in names if other != name)
                reasons[name] = f"it shares objects with {others}, but with nothing whose place is known"
            continue
        numbers = {(MAP, n): expected.numbers[index] for n, index in enumerate(at_rest)}
        graph = _adopt(graph, anchor, component, numbers, seen, catalogue, timestamp_ns)
    reasons.pop(MAP, None)
    return graph, reasons


def _anchor(graph: SceneGraph, classes: set[int]) -> int | None:
    """The stay that saw most present objects of these classes; of several the last."""
    useful = {number for number, rest in graph.rests.items() if rest.obj_id in classes and not rest.over}
    counts = [len(useful & set(stay.edges)) for stay in graph.stays]
    if not any(counts):
        return None
    return max(range(len(counts)), key=lambda n: (counts[n], n))


def _stranded(view: View, catalogue: Catalogue) -> str:
    names = sorted({catalogue[estimate.obj_id].name for estimate in view.estimates})
    if not names:
        return "no known object was found in it; point it at objects that other cameras see"
    return f"it sees {', '.join(names)}, which no camera of known pose has seen yet; let the headset look at them"


def _estimates(objects: PosedObjects) -> tuple[ObjectEstimate, ...]:
    return tuple(
        ObjectEstimate(int(obj_id), float(score), pose, covariance)
        for obj_id, score, pose, covariance in zip(
            objects.obj_id, objects.score, objects.frame_from_object, objects.covariance, strict=True
        )
    )


def _adopt(
    graph: SceneGraph,
    anchor: int,
    component: Component,
    numbers: dict[tuple[str, int], int | None],
    seen: dict[str, PosedObjects],
    catalogue: Catalogue,
    timestamp_ns: int,
) -> SceneGraph:
    """Gives the cameras of a component their places, with a look at every object they see.

    Args:
        component: its frame is that of the anchor.
        numbers: (view, position of an estimate) to the rest it shows.
    """
    world_from_anchor = graph.stays[anchor].world_from_camera
    stays = {
        camera.view_id: Stay(camera.view_id, timestamp_ns, timestamp_ns, world_from_anchor @ camera.world_from_camera)
        for camera in component.cameras
        if camera.view_id != MAP
    }
    for placed in component.objects:
        number = next((numbers[s] for s in placed.supports if s in numbers), None)
        supports = [(name, index) for name, index in placed.supports if name in stays]
        if not supports:
            continue
        if number is None:
            pose = world_from_anchor @ placed.world_from_object
            graph, number = add_rest(graph, placed.obj_id, catalogue[placed.obj_id].box_centre(), pose)
        for name, index in supports:
            rest = graph.rests[number]
            target = se3.inverse(stays[name].world_from_camera) @ rest.world_from_object
            estimates = seen[name]
            measured = aligned(
                estimates.frame_from_object[index], estimates.covariance[index], target, rest.obj_id, catalogue
            )
            stays[name] = look_at(graph, stays[name], number, measured, timestamp_ns)
            graph = graph.with_rest(number, confirmed(rest, float(estimates.score[index]), timestamp_ns))
    for name in sorted(stays):
        graph = graph.with_stay(stays[name])
    return graph


def inspect(
    graph: SceneGraph,
    camera_id: str,
    sight: Sight,
    seen: PosedObjects,
    catalogue: Catalogue,
    config: RegistrationConfig,
) -> tuple[SceneGraph, bool]:
    """Whether a camera that sees too much elsewhere than expected was itself moved.

    A camera is suspected when a registration of what it sees with what it should see finds another place for it, on
    which more objects agree than on the old one. Several such pictures in a row convict it: the camera
    is then placed anew, as one of unknown pose. What it sees elsewhere is otherwise for the objects to answer.

    Returns:
        The graph, and whether the camera is above suspicion (its looks count).
    """
    agree = len(sight.matched)
    if sight.displaced < 2 or sight.displaced <= agree:
        return graph.without_suspect(camera_id), True
    moved = _has_moved(sight.expected, seen, agree, catalogue, config, graph.config.change.gate)
    return _suspect(graph, camera_id, moved)


def inspect_recent(
    graph: SceneGraph, camera_id: str, catalogue: Catalogue, config: RegistrationConfig, timestamp_ns: int
) -> tuple[SceneGraph, bool]:
    """As `inspect`, for motions so small that every look still fits: by the recent looks against all before.

    To be called once this step's looks have been entered.
    """
    stay = graph.stay_of(camera_id)
    assert stay is not None
    numbers = sorted(n for n, edge in stay.edges.items() if edge.last_ns == timestamp_ns and not graph.rests[n].over)
    shifted = [n for n in numbers if stay.edges[n].shift() > graph.config.change.gate]
    if len(shifted) < 2 or 2 * len(shifted) <= len(numbers):
        return graph, True
    before = _posed(graph, numbers, [stay.edges[n].mean for n in numbers])
    recent = _posed(graph, numbers, [stay.edges[n].recent for n in numbers])
    expected = Expectation(tuple(numbers), tuple(graph.rests[n].instance for n in numbers), before)
    moved = _has_moved(expected, recent, 0, catalogue, config, graph.config.change.gate)
    return _suspect(graph, camera_id, moved)


def _posed(graph: SceneGraph, numbers: list[int], poses: Sequence[UncertainPose]) -> PosedObjects:
    rests = [graph.rests[n] for n in numbers]
    return PosedObjects(
        np.zeros(len(rests), dtype=np.int64),
        np.array([rest.obj_id for rest in rests], dtype=np.int64),
        np.array([rest.score for rest in rests]),
        np.array([pose.pose for pose in poses]),
        np.array([pose.covariance for pose in poses]),
    )


def _has_moved(
    expected: Expectation,
    seen: PosedObjects,
    agree: int,
    catalogue: Catalogue,
    config: RegistrationConfig,
    gate: float,
) -> bool:
    """Whether more than `agree` objects agree on another place of the camera than the one it is expected at."""
    present = np.array([n for n, number in enumerate(expected.numbers) if number is not None], dtype=np.int64)
    views = (View(MAP, _estimates(expected.objects[present])), View("camera", _estimates(seen)))
    for component in register_views(views, catalogue, config).components:
        support = sum(len(placed.supports) > 1 for placed in component.objects)
        camera = component.cameras[1]
        motion = UncertainPose(camera.world_from_camera, camera.covariance)
        if support > agree and mahalanobis(UncertainPose(np.eye(4), np.zeros((6, 6))), motion) > gate:
            return True
    return False


def _suspect(graph: SceneGraph, camera_id: str, moved: bool) -> tuple[SceneGraph, bool]:
    if not moved:
        return graph.without_suspect(camera_id), True
    return replace(graph, suspects={**graph.suspects, camera_id: graph.suspects.get(camera_id, 0) + 1}), False


def convict(graph: SceneGraph, camera_id: str) -> SceneGraph:
    """Ends the stay of a camera that was surely moved: it has no pose until it is placed anew."""
    if graph.suspects[camera_id] < graph.config.change.bump_looks:
        return graph
    graph = graph.without_suspect(camera_id)
    if camera_id == graph.headset:
        return replace(graph, now=None)
    places = {name: stay for name, stay in graph.places.items() if name != camera_id}
    return replace(graph, places=places, former=(*graph.former, graph.places[camera_id]))
