"""Cameras that should stand still, or be where tracking says, and seem to be elsewhere: what all they see says so.

A camera was moved if a registration of what it sees with what it should see finds another place for it, on which more
objects agree than on the old one. Several such pictures in a row convict it: it is then placed anew, as a camera of
unknown pose. What is seen elsewhere is otherwise for the objects to answer (`look.revise_objects`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.matching.observations import PosedObjects
from multicam.registration import RegistrationConfig, register_views
from multicam.scenegraph.expectation import Sight, as_estimates
from multicam.scenegraph.graph import WORLD, SceneGraph
from multicam.scenegraph.uncertain import UncertainPose, mahalanobis
from multicam.types import View

HERE = UncertainPose(np.eye(4), np.zeros((6, 6)))


def has_moved(
    graph: SceneGraph, sight: Sight, seen: PosedObjects, catalogue: Catalogue, config: RegistrationConfig
) -> bool:
    """Whether a camera that sees too much elsewhere than expected was moved, by one picture."""
    agree = len(sight.matched)
    if sight.displaced < 2 or sight.displaced <= agree:
        return False
    at_rest = np.array([n for n, number in enumerate(sight.expected.numbers) if number is not None], dtype=np.int64)
    return _stands_elsewhere(graph, sight.expected.objects[at_rest], seen, agree, catalogue, config)


def has_crept(
    graph: SceneGraph, camera_id: str, catalogue: Catalogue, config: RegistrationConfig, timestamp_ns: int
) -> bool:
    """Whether a camera was moved by so little that each of its looks still fits: by recent looks against all of them.

    To be asked once this step's looks have been entered.
    """
    stay = graph.stay_of(camera_id)
    assert stay is not None
    edges = {n: e for n, e in stay.edges.items() if e.last_ns == timestamp_ns and not graph.rests[n].over}
    shifted = sum(edge.shift() > graph.config.change.gate for edge in edges.values())
    if shifted < 2 or 2 * shifted <= len(edges):
        return False
    before = _posed(graph, edges, [edge.mean for edge in edges.values()])
    recent = _posed(graph, edges, [edge.recent for edge in edges.values()])
    return _stands_elsewhere(graph, before, recent, 0, catalogue, config)


def suspect(graph: SceneGraph, camera_id: str) -> SceneGraph:
    """One more picture says that a camera was moved; enough of them end its stay, and it has no pose any more."""
    pictures = graph.suspects.get(camera_id, 0) + 1
    if pictures < graph.config.change.bump_looks:
        return replace(graph, suspects={**graph.suspects, camera_id: pictures})
    graph = graph.without_suspect(camera_id)
    if camera_id == graph.headset:
        return replace(graph, now=None)
    places = {name: stay for name, stay in graph.places.items() if name != camera_id}
    return replace(graph, places=places, former=(*graph.former, graph.places[camera_id]))


def _posed(graph: SceneGraph, numbers: Iterable[int], poses: Sequence[UncertainPose]) -> PosedObjects:
    rests = [graph.rests[n] for n in numbers]
    return PosedObjects(
        np.zeros(len(rests), dtype=np.int64),
        np.array([rest.obj_id for rest in rests], dtype=np.int64),
        np.array([rest.score for rest in rests]),
        np.array([pose.pose for pose in poses]),
        np.array([pose.covariance for pose in poses]),
    )


def _stands_elsewhere(
    graph: SceneGraph,
    expected: PosedObjects,
    seen: PosedObjects,
    agree: int,
    catalogue: Catalogue,
    config: RegistrationConfig,
) -> bool:
    """Whether more than `agree` objects agree on another place of the camera than the one they are expected from."""
    views = (View(WORLD, as_estimates(expected)), View("camera", as_estimates(seen)))
    for component in register_views(views, catalogue, config).components:
        support = sum(len(placed.supports) > 1 for placed in component.objects)
        camera = component.cameras[1]
        motion = UncertainPose(camera.world_from_camera, camera.covariance)
        if support > agree and mahalanobis(HERE, motion) > graph.config.change.gate:
            return True
    return False
