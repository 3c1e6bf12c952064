"""Cameras without a pose: registered with the map as if it were a view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.observations import PosedObjects
from multicam.registration import RegistrationConfig, register_views
from multicam.scenegraph.expectation import as_estimates, expect
from multicam.scenegraph.graph import WORLD, SceneGraph, Stay
from multicam.scenegraph.look import add_rest, aligned, confirmed, look_at
from multicam.scenegraph.solution import Solution
from multicam.types import Component, View

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
    at_rest = [(index, number) for index, number in enumerate(expected.numbers) if number is not None]
    known = expected.objects[np.array([index for index, _ in at_rest], dtype=np.int64)]
    numbers = {(MAP, n): number for n, (_, number) in enumerate(at_rest)}
    registration = register_views([View(MAP, as_estimates(known)), *views], catalogue, config)
    reasons = dict(registration.refusals)
    for component in registration.components:
        names = [camera.view_id for camera in component.cameras if camera.view_id != MAP]
        if len(names) == len(component.cameras):
            for name in names:
                others = " and ".join(other for other in names if other != name)
                reasons[name] = f"it shares objects with {others}, but with nothing whose place is known"
            continue
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


def _adopt(
    graph: SceneGraph,
    anchor: int,
    component: Component,
    numbers: dict[tuple[str, int], int],
    seen: dict[str, PosedObjects],
    catalogue: Catalogue,
    timestamp_ns: int,
) -> SceneGraph:
    """Gives the cameras of a component their places, with a look at every object they see.

    Args:
        component: its frame is that of the anchor.
        numbers: (MAP, position of its estimate) to the rest.
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
