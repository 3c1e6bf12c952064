"""Bundle adjustment of one moment: estimates of objects, moved to where the pictures of all cameras show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from multicam.bundle.adjustment.adjust import AGREES, UNRELATED, Adjusted, adjust
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.frames import ideal_picture
from multicam.bundle.adjustment.registered import EstimateNoise, scene_of
from multicam.bundle.adjustment.scene import Body
from multicam.bundle.adjustment.search import edge_poses
from multicam.bundle.viewpoints.cache import load_viewpoints
from multicam.bundle.viewpoints.generate import ViewpointConfig
from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.linear import inverse
from multicam.matching.noise import NoiseConfig
from multicam.progress import Progress
from multicam.scenegraph.graph import SceneGraph, Stay
from multicam.scenegraph.keyframe import begins
from multicam.scenegraph.solution import Solution
from multicam.types import Component, FloatArray, Frame, ObjectEstimate, PlacedCamera, PlacedObject, View


@dataclass(frozen=True)
class BundleConfig:
    """Bundle adjustment on contours and depth, at keyframes and where a static camera is placed (docs/bundle.md)."""

    enabled: bool = True
    """Whether to adjust."""
    adjustment: AdjustmentConfig = field(default_factory=AdjustmentConfig)
    """Energy, steps and gates."""
    viewpoints: ViewpointConfig = field(default_factory=ViewpointConfig)
    """What is known of each object's contours and surface; drawn once, then kept on disk."""
    without_depth: bool = False
    """Also moments at which no camera measures depth; contours alone leave more than one camera in ten worse off."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """What became of the views of a moment.

    Attributes:
        views: with adjusted estimates; those that were not adjusted are as they were.
        energy: before and after.
        kept_cameras, kept_objects: by name and by instance, why they were not adjusted.
    """

    views: tuple[View, ...]
    energy: tuple[float, float]
    kept_cameras: dict[str, str]
    kept_objects: dict[int, str]


def is_due(before: SceneGraph, now: SceneGraph) -> bool:
    """Whether a moment is worth adjusting: the headset begins a keyframe, or a static camera has come to a new place.

    Args:
        before, now: the graph before the moment and at it, the headset still where it is now.
    """
    if any(name not in before.places or before.places[name].since_ns != p.since_ns for name, p in now.places.items()):
        return True
    return now.now is not None and bool(now.now.edges) and begins(now, now.now)


def load_bodies(catalogue: Catalogue, config: ViewpointConfig, progress: Progress) -> dict[int, Body]:
    """Reads meshes and viewpoint models of a catalogue; models that do not exist yet are drawn.

    Raises:
        DataError: a mesh cannot be read, or the models cannot be kept.
    """
    meshes = {obj_id: catalogue[obj_id].load_mesh() for obj_id in catalogue.obj_ids}
    models = load_viewpoints(meshes, config, progress)
    return {obj_id: Body(models[obj_id], mesh) for obj_id, mesh in meshes.items()}


@dataclass(frozen=True, eq=False)
class Adjuster:
    """Bundle adjustment with the objects' shapes at hand.

    Attributes:
        bodies: of each class.
    """

    bodies: Mapping[int, Body]
    config: BundleConfig

    def adjust(
        self,
        solution: Solution,
        views: Sequence[View],
        frames: Mapping[str, Frame],
        catalogue: Catalogue,
        noise: NoiseConfig,
        timestamp_ns: int,
    ) -> Adjustment | None:
        """Adjusts cameras and objects on the pictures of a moment that has been solved by estimates alone.

        Args:
            solution: the headset's stay is where it is now.
            views: the estimates behind it.
            frames: by camera.
            noise: of estimates that state none.
            timestamp_ns: of the moment.

        Returns:
            None where there is nothing to adjust: no camera sees a known object, or none measures depth.
        """
        graph = solution.graph
        stays = [stay for name in (graph.headset, *graph.statics) if name in frames and (stay := graph.stay_of(name))]
        stays = [stay for stay in stays if _seen_now(stay, graph, timestamp_ns)]
        pictures = {stay.camera_id: ideal_picture(frames[stay.camera_id]) for stay in stays}
        if not stays or not (self.config.without_depth or any(p.depth is not None for p in pictures.values())):
            return None
        component, numbers = _component(solution, stays, views, timestamp_ns)
        scene, state = scene_of(component, views, pictures, self.bodies, catalogue, EstimateNoise(noise))
        answer = adjust(scene, state, self.config.adjustment)
        instances = [graph.rests[number].instance for number in numbers]
        return Adjustment(
            _moved(views, component, answer, edge_poses(scene, answer.state)),
            answer.energy,
            {stays[c].camera_id: reason for c, reason in answer.kept_cameras.items()},
            {instances[o]: reason for o, reason in answer.kept_objects.items()},
        )


def _moved(views: Sequence[View], component: Component, answer: Adjusted, pose: FloatArray) -> tuple[View, ...]:
    """The views with the estimates behind the edges (e) at their new poses, camera_from_object (e, 4, 4).

    Edges are the supports of the objects, in their order; those that do not agree keep their estimates.
    """
    fresh: dict[tuple[str, int], ObjectEstimate] = {}
    given = {view.view_id: view.estimates for view in views}
    supports = [(o, support) for o, placed in enumerate(component.objects) for support in placed.supports]
    strays = {component.cameras[c].view_id for c, why in answer.kept_cameras.items() if why != UNRELATED}
    for e, (o, (name, index)) in enumerate(supports):
        if o not in answer.kept_objects and name not in strays and answer.weight[e] >= AGREES:
            fresh[name, index] = replace(
                given[name][index], camera_from_object=pose[e], covariance=inverse(answer.information[e])
            )
    return tuple(
        replace(view, estimates=tuple(fresh.get((view.view_id, n), each) for n, each in enumerate(view.estimates)))
        for view in views
    )


def _component(
    solution: Solution, stays: Sequence[Stay], views: Sequence[View], timestamp_ns: int
) -> tuple[Component, tuple[int, ...]]:
    """Cameras, and the objects that they see now, with the first camera as gauge; and the numbers of the rests."""
    graph, given = solution.graph, {view.view_id: view.estimates for view in views}
    index = [graph.stays.index(stay) for stay in stays]
    cameras, objects = solution.seen_from(index[0])
    supports: dict[int, list[tuple[str, int]]] = {}
    for stay in stays:
        for number, estimate in _behind(stay, given[stay.camera_id], graph, timestamp_ns).items():
            supports.setdefault(number, []).append((stay.camera_id, estimate))
    position = {number: n for n, number in enumerate(solution.numbers)}
    placed = [
        PlacedObject(rest.obj_id, rest.score, rest.world_from_object, objects[position[number]], tuple(seen))
        for number, seen in supports.items()
        for rest in (graph.rests[number],)
    ]
    standing = [
        PlacedCamera(stay.camera_id, stay.world_from_camera, cameras[n]) for stay, n in zip(stays, index, strict=True)
    ]
    return Component(tuple(standing), tuple(placed)), tuple(supports)


def _behind(stay: Stay, estimates: Sequence[ObjectEstimate], graph: SceneGraph, timestamp_ns: int) -> dict[int, int]:
    """Numbers of the rests that a camera sees now, and for each the estimate of its class whose centre is closest."""
    camera_from_world = se3.inverse(stay.world_from_camera)
    free, chosen = set(range(len(estimates))), dict[int, int]()
    for number in _seen_now(stay, graph, timestamp_ns):
        rest = graph.rests[number]
        centre = se3.act(camera_from_world @ rest.world_from_object, rest.centre)
        away = {
            n: float(np.linalg.norm(se3.act(estimates[n].camera_from_object, rest.centre) - centre))
            for n in free
            if estimates[n].obj_id == rest.obj_id
        }
        chosen[number] = min(away, key=away.__getitem__)
        free.remove(chosen[number])
    return chosen


def _seen_now(stay: Stay, graph: SceneGraph, timestamp_ns: int) -> list[int]:
    return [n for n, edge in sorted(stay.edges.items()) if edge.last_ns == timestamp_ns and not graph.rests[n].over]
