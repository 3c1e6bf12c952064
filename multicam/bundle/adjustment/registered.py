"""A registered component and the pictures behind it, as a scene to adjust, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multicam.bundle.adjustment.adjust import Adjusted
from multicam.bundle.adjustment.keypoints import EdgeKeypoints
from multicam.bundle.adjustment.scene import Body, Picture, Scene
from multicam.bundle.problem import State
from multicam.dataset.objects import Catalogue
from multicam.geometry import se3
from multicam.matching.keypoints import keypoints_of
from multicam.matching.learned import NoiseModel
from multicam.matching.linear import congruent, inverse
from multicam.matching.noise import NoiseConfig
from multicam.matching.observations import observe
from multicam.types import Component, FloatArray, ObjectEstimate, View


@dataclass(frozen=True)
class EstimateNoise:
    """What the registration took for the noise of estimates: see `register_views`."""

    stated: NoiseConfig
    learned: NoiseModel | None = None


def scene_of(
    component: Component,
    views: Sequence[View],
    pictures: Mapping[str, Picture],
    bodies: Mapping[int, Body],
    catalogue: Catalogue,
    noise: EstimateNoise,
) -> tuple[Scene, State]:
    """Cameras and objects of a component in its own order; the first camera is fixed.

    The edges are the supports of the objects; the estimates behind them are priors.

    Args:
        views: those that were registered.
        pictures: of each view in the component, by its name.
        bodies: of each class in it.
    """
    place = {camera.view_id: n for n, camera in enumerate(component.cameras)}
    edges = [
        (place[view_id], o, view_id, index)
        for o, placed in enumerate(component.objects)
        for view_id, index in placed.supports
    ]
    state = State(
        np.array([camera.world_from_camera for camera in component.cameras]),
        np.array([placed.world_from_object for placed in component.objects]).reshape(-1, 4, 4),
    )
    camera, obj = (np.array([edge[k] for edge in edges], dtype=np.int64) for k in (0, 1))
    estimates = observe(views, catalogue, noise.stated, noise.learned)
    first = {view.view_id: int(np.searchsorted(estimates.frame, n)) for n, view in enumerate(views)}
    chosen = estimates[np.array([first[view_id] + index for _, _, view_id, index in edges], dtype=np.int64)]
    at = state.camera_from_object(camera, obj)
    turn = _turns(chosen.frame_from_object, at, chosen.obj_id.tolist(), catalogue)
    # T exp(xi) S = T S exp(Ad(S^-1) xi).
    twin = chosen.frame_from_object @ turn
    covariance = congruent(se3.adjoint(se3.inverse(turn)), chosen.covariance)
    kinship = 1.0 if noise.learned is None else noise.learned.kinship
    covariance = covariance / kinship
    taken = [pictures[each.view_id] for each in component.cameras]
    given = {view.view_id: view.estimates for view in views}
    behind = [given[view_id][index] for _, _, view_id, index in edges]
    keypoints = _keypoints(behind, [taken[c].camera.matrix for c in camera.tolist()], turn, catalogue)
    scene = Scene(
        pictures=taken,
        bodies=[bodies[placed.obj_id] for placed in component.objects],
        camera=camera,
        object=obj,
        estimated=twin,
        information=inverse(covariance),
        fixed=np.arange(len(component.cameras)) == 0,
        camera_covariance=np.array([each.covariance for each in component.cameras]),
        object_covariance=np.array([placed.covariance for placed in component.objects]).reshape(-1, 6, 6),
        keypoints=keypoints.as_sure_as(twin, covariance),
        kinship=kinship,
    )
    return scene, state


def component_of(component: Component, adjusted: Adjusted) -> Component:
    """The component with the poses and covariances of an adjustment."""
    state = adjusted.state
    return Component(
        tuple(
            replace(each, world_from_camera=state.world_from_camera[n], covariance=adjusted.camera_covariance[n])
            for n, each in enumerate(component.cameras)
        ),
        tuple(
            replace(each, world_from_object=state.world_from_object[n], covariance=adjusted.object_covariance[n])
            for n, each in enumerate(component.objects)
        ),
    )


def _turns(observed: FloatArray, at: FloatArray, classes: Sequence[int], catalogue: Catalogue) -> FloatArray:
    """(e, 4, 4) the symmetries that bring estimates (e, 4, 4) closest to poses `at`."""
    return np.array(
        [
            catalogue[each].symmetries.closest(target, source, catalogue[each].diameter / 2)
            for each, target, source in zip(classes, at, observed, strict=True)
        ]
    ).reshape(-1, 4, 4)


def _keypoints(
    behind: Sequence[ObjectEstimate], matrices: Sequence[FloatArray], turn: FloatArray, catalogue: Catalogue
) -> EdgeKeypoints:
    """What the detector saw of estimates (e,), for their twins."""
    parts = [EdgeKeypoints.none()]
    for edge, (estimate, matrix) in enumerate(zip(behind, matrices, strict=True)):
        seen = keypoints_of(estimate, matrix, catalogue)
        if seen is not None:
            count = len(seen.points)
            points = se3.act(se3.inverse(turn[edge]), seen.points)
            intrinsics = np.tile(seen.camera_matrix, (count, 1, 1))
            parts.append(EdgeKeypoints(np.full(count, edge), points, seen.pixels, seen.std, intrinsics))
    return EdgeKeypoints.joined(parts)
