"""A registered component as a scene, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multicam.bundle.adjustment.adjust import Adjusted
from multicam.bundle.adjustment.registered import EstimateNoise, component_of, scene_of
from multicam.bundle.adjustment.scene import Picture, Scene
from multicam.bundle.problem import State
from multicam.geometry import se3
from multicam.matching.linear import squared_norm
from multicam.matching.noise import NoiseConfig
from multicam.types import Component, Detection, ObjectEstimate, PlacedCamera, PlacedObject, View
from tests.bundle.box_rig import CAMERA, body
from tests.toy_objects import BRACKET, PLATE, toy_catalogue

PICTURE = Picture(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), CAMERA)
COVARIANCE = (np.diag([1, 2, 3, 4, 5, 6.0]) + 0.5) * 1e-4
CAMERAS = {"left": np.eye(4), "right": se3.exp(np.array([0, 0.3, 0, -0.2, 0, 0.1]))}
PLACES = [se3.exp(np.array([0.1, 0.2, 0.3, 0, 0, 0.7])), se3.exp(np.array([1, 0, 0, 0.1, 0, 0.8]))]


def registered() -> tuple[Component, list[View]]:
    """Two cameras; both see the plate, the right one as its half-turned twin, and one of them the bracket."""
    half_turn = toy_catalogue()[PLATE].symmetries.discrete[1]
    plate = [se3.inverse(pose) @ PLACES[0] for pose in CAMERAS.values()]
    bracket = se3.inverse(CAMERAS["right"]) @ PLACES[1]
    views = [
        View("right", (estimate(BRACKET, bracket), estimate(PLATE, plate[1] @ half_turn)), CAMERA.matrix),
        View("left", (estimate(PLATE, plate[0]),), CAMERA.matrix),
    ]
    cameras = tuple(PlacedCamera(name, pose, np.eye(6) * (name != "left")) for name, pose in CAMERAS.items())
    objects = (
        PlacedObject(PLATE, 0.9, PLACES[0], np.eye(6), (("left", 0), ("right", 1))),
        PlacedObject(BRACKET, 0.8, PLACES[1], np.eye(6), (("right", 0),)),
    )
    return Component(cameras, objects), views


def estimate(obj_id: int, pose: np.ndarray) -> ObjectEstimate:
    return ObjectEstimate(obj_id, 0.9, pose, COVARIANCE)


def scene(component: Component | None = None, views: Sequence[View] = ()) -> tuple[Scene, State]:
    if component is None:
        component, views = registered()
    bodies = {PLATE: body(), BRACKET: body()}
    noise = EstimateNoise(NoiseConfig())
    return scene_of(component, views, {"left": PICTURE, "right": PICTURE}, bodies, toy_catalogue(), noise)


def test_supports_become_edges_with_the_estimates_behind_them() -> None:
    made, state = scene()
    assert made.camera.tolist() == [0, 1, 1] and made.object.tolist() == [0, 0, 1]
    assert made.fixed.tolist() == [True, False] and not made.camera_covariance[0].any()
    expected = se3.inverse(state.world_from_camera)[made.camera] @ state.world_from_object[made.object]
    assert np.allclose(made.estimated, expected, atol=1e-12)


def test_a_twin_knows_what_its_estimate_knew() -> None:
    made, _ = scene()
    half_turn = toy_catalogue()[PLATE].symmetries.discrete[1]
    xi = np.array([0.01, -0.02, 0.03, 0.001, 0.002, -0.003])
    twin, other = made.estimated[1], made.estimated[1] @ half_turn
    # One pose, moved from either twin: its distance must not depend on the twin.
    shift = se3.minus(se3.plus(other, xi) @ np.linalg.inv(half_turn), twin)
    assert np.isclose(squared_norm(shift, made.information[1]), squared_norm(xi, np.linalg.inv(COVARIANCE)))


def test_keypoints_of_a_twin_stand_where_the_detector_saw_them() -> None:
    component, views = registered()
    points = toy_catalogue()[PLATE].keypoints
    assert points is not None
    seen = CAMERA.project(se3.act(views[0].estimates[1].camera_from_object, points))
    std = np.full(seen.shape, 2.0)
    lost = np.where(np.arange(len(seen)) == 3, np.nan, 1.0)[:, None]
    detection = Detection(PLATE, 0.9, np.zeros(4), seen * lost, np.ones(len(seen)), std)
    views[0] = replace(views[0], estimates=(views[0].estimates[0], replace(views[0].estimates[1], detection=detection)))
    made, _ = scene(component, views)
    assert made.keypoints.edge.tolist() == [1] * (len(points) - 1)
    assert np.allclose(CAMERA.project(se3.act(made.estimated[1], made.keypoints.point)), np.delete(seen, 3, axis=0))
    # A detector that claims more than the estimate's covariance is not believed.
    assert np.all(made.keypoints.std >= 2) and np.ptp(made.keypoints.std) < 1e-12


def test_an_adjustment_goes_back_into_the_component() -> None:
    component, _ = registered()
    made, state = scene()
    moved = State(state.world_from_camera + 0.0, se3.plus(state.world_from_object, np.full(6, 0.01)))
    answer = Adjusted(
        moved, 2 * made.camera_covariance, 3 * made.object_covariance, (2.0, 1.0), {}, {},
        np.ones(3), made.information, np.zeros(3, np.int64), np.zeros(3, np.int64),
    )  # fmt: skip
    back = component_of(component, answer)
    assert [each.view_id for each in back.cameras] == ["left", "right"]
    assert np.array_equal(back.objects[1].world_from_object, moved.world_from_object[1])
    assert np.array_equal(back.objects[0].covariance, 3 * np.eye(6))
    assert replace(back.objects[0], world_from_object=PLACES[0]).supports == component.objects[0].supports
