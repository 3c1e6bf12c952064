"""Entering what cameras of known pose saw: looks at known objects, objects not seen before, objects that moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.observations import PosedObjects
from multicam.scenegraph.edge import Edge
from multicam.scenegraph.expectation import Sight, predicted
from multicam.scenegraph.graph import Mover, Rest, SceneGraph, Stay
from multicam.scenegraph.uncertain import UncertainPose, fuse, mahalanobis, transport
from multicam.types import FloatArray


def enter(
    graph: SceneGraph, camera_id: str, sight: Sight, seen: PosedObjects, catalogue: Catalogue, timestamp_ns: int
) -> SceneGraph:
    """Adds a camera's looks at objects at rest, and rests for what it sees for the first time."""
    stay = graph.stay_of(camera_id)
    assert stay is not None
    for index, (estimate, measured) in sorted(sight.matched.items()):
        number = sight.expected.numbers[index]
        if number is None:
            graph, number = _settle(graph, sight.expected.instances[index], _in_world(stay, measured), timestamp_ns)
        if number is not None:
            stay = replace(look_at(graph, stay, number, measured, timestamp_ns), seen_ns=timestamp_ns)
            graph = graph.with_rest(number, confirmed(graph.rests[number], float(seen.score[estimate]), timestamp_ns))
    for estimate in sight.strangers:
        measured = UncertainPose(seen.frame_from_object[estimate], seen.covariance[estimate])
        world_from_object = stay.world_from_camera @ measured.pose
        obj_id = int(seen.obj_id[estimate])
        graph, number = add_rest(graph, obj_id, catalogue[obj_id].box_centre(), world_from_object)
        stay = look_at(graph, stay, number, measured, timestamp_ns)
        graph = graph.with_rest(number, confirmed(graph.rests[number], float(seen.score[estimate]), timestamp_ns))
    return graph.with_stay(stay)


def look_at(graph: SceneGraph, stay: Stay, number: int, measured: UncertainPose, timestamp_ns: int) -> Stay:
    """A stay with one more look at a rest."""
    fresh, known = Edge.of(measured, timestamp_ns, graph.config), stay.edges.get(number)
    edge = fresh if known is None else known.joined(fresh, graph.config)
    return replace(stay, edges={**stay.edges, number: edge})


def add_rest(
    graph: SceneGraph, obj_id: int, centre: FloatArray, world_from_object: FloatArray, instance: int | None = None
) -> tuple[SceneGraph, int]:
    """The graph with one more rest, of a new object unless one is named, and its number."""
    number = graph.next_number
    if instance is None:
        instance = graph.next_instance
        graph = replace(graph, next_instance=instance + 1)
    rest = Rest(instance, obj_id, centre, world_from_object, 0.0, 0)
    return replace(graph.with_rest(number, rest), next_number=number + 1), number


def confirmed(rest: Rest, score: float, timestamp_ns: int) -> Rest:
    """A rest that one more look agrees with."""
    best = score if timestamp_ns > rest.seen_ns else max(score, rest.score)
    return replace(rest, score=best, seen_ns=timestamp_ns, sightings=rest.sightings + 1)


def aligned(
    pose: FloatArray, covariance: FloatArray, target: FloatArray, obj_id: int, catalogue: Catalogue
) -> UncertainPose:
    """A measured pose at the symmetric twin that lies closest to a target pose in the same frame."""
    model = catalogue[obj_id]
    symmetry = model.symmetries.closest(target, pose, model.diameter / 2)
    return UncertainPose(pose @ symmetry, transport(covariance, se3.inverse(symmetry)))


def revise_objects(
    graph: SceneGraph, sights: Mapping[str, tuple[Sight, PosedObjects]], catalogue: Catalogue, timestamp_ns: int
) -> SceneGraph:
    """Ends the rest of an object that enough looks saw elsewhere, and follows objects in motion."""
    agreed, contested = set[int](), set[int | None]()
    for camera_id, (sight, seen) in sorted(sights.items()):
        stay = graph.stay_of(camera_id)
        assert stay is not None
        for index, estimate in sight.contradicted.items():
            elsewhere = aligned(
                seen.frame_from_object[estimate], seen.covariance[estimate],
                sight.expected.objects.frame_from_object[index], int(seen.obj_id[estimate]), catalogue,
            )  # fmt: skip
            found = _Found(sight.expected.instances[index], _in_world(stay, elsewhere), camera_id, timestamp_ns)
            contested.add(sight.expected.numbers[index])
            graph = _contradict(graph, sight.expected.numbers[index], found)
        for index, (_, measured) in sight.matched.items():
            number = sight.expected.numbers[index]
            found = _Found(sight.expected.instances[index], _in_world(stay, measured), camera_id, timestamp_ns)
            if number is None:
                graph = _follow(graph, found)
            elif number in stay.edges and stay.edges[number].shift() > graph.config.change.gate:
                contested.add(number)
                recent = _in_world(stay, stay.edges[number].recent)
                graph = _contradict(graph, number, replace(found, pose=recent))
            else:
                agreed.add(number)
    for number in agreed - contested:
        graph = graph.with_rest(number, replace(graph.rests[number], contradictions=0))
    return graph


@dataclass(frozen=True, eq=False)
class _Found:
    """An object as a camera sees it now, world_from_object."""

    instance: int
    pose: UncertainPose
    camera_id: str
    timestamp_ns: int


def _in_world(stay: Stay, measured: UncertainPose) -> UncertainPose:
    return UncertainPose(stay.world_from_camera @ measured.pose, measured.covariance)


def _contradict(graph: SceneGraph, number: int | None, found: _Found) -> SceneGraph:
    """One more look that saw an object elsewhere; enough of them end its rest."""
    if number is None or graph.rests[number].over:
        return _follow(graph, found)
    rest = graph.rests[number]
    rest = replace(rest, contradictions=rest.contradictions + 1)
    if rest.contradictions < graph.config.change.looks:
        return graph.with_rest(number, rest)
    mover = Mover(
        rest.instance, rest.obj_id, rest.centre, found.pose, found.pose, rest.score, found.timestamp_ns,
        found.timestamp_ns, rest.sightings, (found.camera_id,),
    )  # fmt: skip
    graph = graph.with_rest(number, replace(rest, over=True))
    return replace(graph, movers={**graph.movers, rest.instance: mover})


def _follow(graph: SceneGraph, found: _Found) -> SceneGraph:
    """One more look at an object in motion, which may have stopped; one that has just come to rest is left alone."""
    mover = graph.movers.get(found.instance)
    if mover is None:
        return graph
    now = found.timestamp_ns
    if mahalanobis(mover.place, found.pose) > graph.config.change.gate:
        mover = replace(mover, pose=found.pose, place=found.pose, moved_ns=now)
    else:
        prior = predicted(mover, now, graph.config.objects.motion_per_second)
        mover = replace(mover, pose=fuse(prior, found.pose))
    before = mover.seen_by if mover.seen_ns == now else ()
    mover = replace(mover, seen_ns=now, sightings=mover.sightings + 1, seen_by=(*before, found.camera_id))
    return replace(graph, movers={**graph.movers, found.instance: mover})


def _settle(graph: SceneGraph, instance: int, found: UncertainPose, timestamp_ns: int) -> tuple[SceneGraph, int | None]:
    """An object that is seen still for long enough comes to rest, and helps to place cameras again."""
    mover = graph.movers[instance]
    still = (timestamp_ns - mover.moved_ns) * 1e-9
    if still < graph.config.change.settle_seconds or mahalanobis(mover.place, found) > graph.config.change.gate:
        return graph, None
    graph, number = add_rest(graph, mover.obj_id, mover.centre, found.pose, instance)
    graph = graph.with_rest(number, replace(graph.rests[number], sightings=mover.sightings))
    return replace(graph, movers={i: m for i, m in graph.movers.items() if i != instance}), number
