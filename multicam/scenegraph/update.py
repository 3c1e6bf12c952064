"""Inserting what was measured; every function returns a new graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.geometry import se3
from multicam.scenegraph.filter import Decision, Outcome, absorb, start
from multicam.scenegraph.graph import Edge, ObjectNode, SceneGraph, TrackedPose, key_of
from multicam.scenegraph.uncertain import UncertainPose, mahalanobis, transport
from multicam.types import FloatArray

_IMPOSSIBLE = 1e12


@dataclass(frozen=True, eq=False)
class Sighting:
    """An object as one camera, or several that agree, saw it.

    Attributes:
        world_from_object: measured pose.
        camera_ids: the cameras behind it.
    """

    obj_id: int
    score: float
    world_from_object: UncertainPose
    camera_ids: tuple[str, ...]


def track_headset(graph: SceneGraph, timestamp_ns: int, world_from_headset: FloatArray) -> SceneGraph:
    """Adds a tracked pose of the headset; one that is not newer than the last is an old packet and is ignored."""
    if graph.trajectory and timestamp_ns <= graph.trajectory[-1].timestamp_ns:
        return graph
    poses = (*graph.trajectory, TrackedPose(timestamp_ns, world_from_headset))
    return replace(graph, trajectory=poses[-graph.config.remember :])


def insert_link(
    graph: SceneGraph, target: str, source: str, measured: UncertainPose, timestamp_ns: int
) -> tuple[SceneGraph, Decision]:
    """Fuses a measured target_from_source into the link between two rigid nodes (the world, static cameras)."""
    key = key_of(target, source)
    if key[0] != target:
        measured = measured.inverse()
    drift = graph.drift_of(key, measured.pose)
    filtered, decision = absorb(graph.links.get(key), measured, timestamp_ns, drift, graph.config.filter)
    return graph.with_link(key, filtered), decision


def insert_objects(
    graph: SceneGraph, sightings: Sequence[Sighting], catalogue: Catalogue, timestamp_ns: int
) -> SceneGraph:
    """Fuses objects that were seen at once and are therefore different ones: one-to-one with the stored instances.

    A sighting goes to the instance of its class at the least Mahalanobis distance. One that fits none but lies within
    a diameter of an instance contradicts it (two poses of one class that close are one object, unless a single look
    shows both); any other starts a new instance. Poses are compared at their closest symmetry.
    """
    instances = [node.instance for node in graph.objects.values()]
    costs = np.full((len(sightings), len(instances)), _IMPOSSIBLE)
    aligned: dict[tuple[int, int], UncertainPose] = {}
    for row, sighting in enumerate(sightings):
        model = catalogue[sighting.obj_id]
        for column, instance in enumerate(instances):
            node = graph.objects[instance]
            if node.obj_id == sighting.obj_id:
                prior = node.filtered.at(timestamp_ns, graph.config.objects.motion_per_second)
                aligned[row, column] = align(sighting.world_from_object, prior.pose, model)
                costs[row, column] = _cost(aligned[row, column], prior, model, graph.config.filter.gate)
    matched = {
        int(row): int(column)
        for row, column in zip(*linear_sum_assignment(costs), strict=True)
        if costs[row, column] < _IMPOSSIBLE
    }
    for row, sighting in enumerate(sightings):
        if row in matched:
            column = matched[row]
            graph = _update_object(graph, instances[column], sighting, aligned[row, column], timestamp_ns)
        else:
            graph = _add_object(graph, sighting, timestamp_ns)
    return graph


def prune(graph: SceneGraph, timestamp_ns: int) -> SceneGraph:
    """Drops objects that nobody has seen for long, and edges as old."""
    oldest = timestamp_ns - graph.config.objects.forget_after * 1e9
    objects = {number: node for number, node in graph.objects.items() if node.seen_ns >= oldest}
    return replace(graph, objects=objects, edges=tuple(e for e in graph.edges if e.timestamp_ns >= oldest))


def align(measured: UncertainPose, target: FloatArray, model: ObjectModel) -> UncertainPose:
    """The measured world_from_object times the symmetry that brings it closest to the target pose."""
    symmetry = model.symmetries.closest(target, measured.pose, model.diameter / 2)
    return UncertainPose(measured.pose @ symmetry, transport(measured.covariance, se3.inverse(symmetry)))


def _cost(measured: UncertainPose, prior: UncertainPose, model: ObjectModel, gate: float) -> float:
    squared = mahalanobis(prior, measured)
    if squared <= gate:
        return squared
    distance = np.linalg.norm(measured.pose[:3, 3] - prior.pose[:3, 3])
    # Beyond the gate nearness decides, and any match within the gate comes first.
    return gate * (10 + float(distance) / model.diameter) if distance < model.diameter else _IMPOSSIBLE


def _update_object(
    graph: SceneGraph, instance: int, sighting: Sighting, measured: UncertainPose, timestamp_ns: int
) -> SceneGraph:
    node = graph.objects[instance]
    motion = graph.config.objects.motion_per_second
    filtered, decision = absorb(node.filtered, measured, timestamp_ns, motion, graph.config.filter)
    score = sighting.score if decision.accepted else node.score
    agrees = decision.outcome is not Outcome.REJECTED
    updated = replace(node, filtered=filtered, score=score, seen_ns=timestamp_ns)
    return _with_object(graph, updated, sighting.camera_ids, timestamp_ns, agrees)


def _add_object(graph: SceneGraph, sighting: Sighting, timestamp_ns: int) -> SceneGraph:
    filtered = start(sighting.world_from_object, timestamp_ns, graph.config.filter.common)
    node = ObjectNode(graph.next_instance, sighting.obj_id, filtered, sighting.score, timestamp_ns)
    graph = replace(graph, next_instance=graph.next_instance + 1)
    return _with_object(graph, node, sighting.camera_ids, timestamp_ns, True)


def _with_object(
    graph: SceneGraph, node: ObjectNode, camera_ids: tuple[str, ...], timestamp_ns: int, inlier: bool
) -> SceneGraph:
    edges = tuple(Edge(node.instance, camera, timestamp_ns, inlier) for camera in camera_ids)
    node = replace(node, sightings=node.sightings + inlier * len(camera_ids))
    return replace(graph, objects={**graph.objects, node.instance: node}, edges=graph.edges + edges)
