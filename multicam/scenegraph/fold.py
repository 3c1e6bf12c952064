"""Folding the registration of one time step into the graph: first cameras, then objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.scenegraph import query, update
from multicam.scenegraph.graph import WORLD, SceneGraph, TrackedPose
from multicam.scenegraph.keyframe import KeyframeConfig, haste, relative_in, weakness
from multicam.scenegraph.uncertain import UncertainPose
from multicam.scenegraph.update import Sighting
from multicam.types import Component, Registration, View


@dataclass(frozen=True, eq=False)
class CameraNow:
    """A camera's pose in the world at this step and the nodes it was found by, the world first."""

    world_from_camera: UncertainPose
    chain: tuple[str, ...]
    updated_ns: int | None


def fold_cameras(
    graph: SceneGraph,
    registration: Registration,
    tracked: TrackedPose | None,
    timestamp_ns: int,
    config: KeyframeConfig,
) -> tuple[SceneGraph, dict[str, str]]:
    """Fuses every static camera that the headset, or another static camera, was registered with.

    Args:
        tracked: the headset's own pose in this step, already in the graph, or None if its tracking gave none.

    Returns:
        The new graph, and for each static camera whose link to the world did not change the reason in words.
    """
    reasons = {name: text for name, text in registration.refusals.items() if name in graph.statics}
    hurry = haste(graph, config)
    for component in registration.components:
        names = {camera.view_id for camera in component.cameras}
        statics = [name for name in graph.statics if name in names]
        for name in statics:
            if graph.headset not in names:
                others = [n for n in statics if n != name]
                reasons[name] = f"it shares objects with {' and '.join(others) or 'no camera'}, not with the headset"
            elif tracked is None:
                reasons[name] = "the headset's tracking gave no pose"
            elif hurry:
                reasons[name] = hurry
            else:
                step = UncertainPose(tracked.world_from_headset, graph.config.tracking.jitter)
                measured = step @ relative_in(component, graph.headset, name)
                graph, reasons[name] = _fuse(graph, component, WORLD, name, measured, timestamp_ns, config)
        for a, b in combinations(statics, 2):
            measured = relative_in(component, a, b)
            graph, _ = _fuse(graph, component, a, b, measured, timestamp_ns, config)
    return graph, {name: text for name, text in reasons.items() if text}


def cameras_now(
    graph: SceneGraph, registration: Registration, tracked: TrackedPose | None, timestamp_ns: int
) -> dict[str, CameraNow]:
    """World poses of all cameras that have one: tracked, stored, or (a headset whose tracking is lost) by its view."""
    found: dict[str, CameraNow] = {}
    for name in graph.statics:
        chain = query.in_world(graph, name, timestamp_ns)
        if chain is not None:
            found[name] = CameraNow(chain.estimate, chain.nodes, chain.updated_ns)
    if tracked is not None:
        pose = UncertainPose(tracked.world_from_headset, graph.config.tracking.jitter)
        found[graph.headset] = CameraNow(pose, (WORLD, graph.headset), tracked.timestamp_ns)
        return found
    for component in registration.components:
        anchor = _anchor(component, found)
        if anchor is not None and any(c.view_id == graph.headset for c in component.cameras):
            start = found[anchor]
            pose = start.world_from_camera @ relative_in(component, anchor, graph.headset)
            found[graph.headset] = CameraNow(pose, (*start.chain, graph.headset), start.updated_ns)
    return found


def fold_objects(
    graph: SceneGraph,
    registration: Registration,
    views: Mapping[str, View],
    cameras: Mapping[str, CameraNow],
    catalogue: Catalogue,
    timestamp_ns: int,
) -> SceneGraph:
    """Adds the objects that views agree on, then what single cameras with a pose see besides; drops old ones."""
    for sightings in (*_agreed(registration, cameras), *_single(registration, views, cameras)):
        graph = update.insert_objects(graph, sightings, catalogue, timestamp_ns)
    return update.prune(graph, timestamp_ns)


def _fuse(
    graph: SceneGraph,
    component: Component,
    target: str,
    source: str,
    measured: UncertainPose,
    timestamp_ns: int,
    config: KeyframeConfig,
) -> tuple[SceneGraph, str]:
    refused = weakness(component, source, measured, config)
    if refused:
        return graph, refused
    graph, decision = update.insert_link(graph, target, source, measured, timestamp_ns)
    return graph, decision.reason()


def _anchor(component: Component, cameras: Mapping[str, CameraNow]) -> str | None:
    """The camera of a component whose world pose is known best."""
    known = [c.view_id for c in component.cameras if c.view_id in cameras]
    return min(known, key=lambda name: (query.spread(cameras[name].world_from_camera), name), default=None)


def _agreed(registration: Registration, cameras: Mapping[str, CameraNow]) -> list[Sequence[Sighting]]:
    """Per component with a camera of known pose: its objects in the world."""
    looks: list[Sequence[Sighting]] = []
    for component in registration.components:
        anchor = _anchor(component, cameras)
        if anchor is None:
            continue
        gauge = component.cameras[0]
        world_from_gauge = cameras[anchor].world_from_camera @ relative_in(component, anchor, gauge.view_id)
        gauge_from_component = se3.inverse(gauge.world_from_camera)
        looks.append(
            [
                Sighting(
                    placed.obj_id,
                    placed.score,
                    world_from_gauge
                    @ UncertainPose(gauge_from_component @ placed.world_from_object, placed.covariance),
                    tuple(sorted({view_id for view_id, _ in placed.supports})),
                )
                for placed in component.objects
            ]
        )
    return looks


def _single(
    registration: Registration, views: Mapping[str, View], cameras: Mapping[str, CameraNow]
) -> list[Sequence[Sighting]]:
    """Per camera of known pose, in alphabetical order: its estimates that no component uses, in the world."""
    used = {support for c in registration.components for placed in c.objects for support in placed.supports}
    looks: list[Sequence[Sighting]] = []
    for name in sorted(set(views) & set(cameras)):
        sightings: list[Sighting] = []
        for index, estimate in enumerate(views[name].estimates):
            if (name, index) in used or estimate.covariance is None:
                continue
            seen = UncertainPose(estimate.camera_from_object, estimate.covariance)
            pose = cameras[name].world_from_camera @ seen
            sightings.append(Sighting(estimate.obj_id, estimate.score, pose, (name,)))
        looks.append(sightings)
    return looks
