"""Registration with the pictures of the views: what they show beside the objects confirms, sharpens and contradicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import find_features
from multicam.bundle.scenery.scenery import Scenery
from multicam.geometry import se3
from multicam.registration import RegistrationConfig, register_views
from multicam.types import Registration, View
from tests.bundle.scenery.room import CAMERA, draw, standing
from tests.toy_objects import BRACKET, PLATE, PYRAMID, WEDGE, toy_catalogue
from tests.toy_world import ToyCamera, ToyWorld, camera_error, place_objects

CATALOGUE = toy_catalogue()
STANDING = [standing(angle) for angle in (-0.25, 0.1, 0.45)]
NOISE = {"rotation_noise": 0.03, "translation_noise": 0.008, "symmetric_twins": False, "with_detections": False}


@pytest.fixture(scope="module")
def scenery() -> Scenery:
    """Of the pictures that three cameras take of a room."""
    config = SceneryConfig()
    features = {f"camera{k}": find_features(draw(pose), CAMERA, config) for k, pose in enumerate(STANDING)}
    return Scenery(features, config)


def world(rng: np.random.Generator, classes: Sequence[int], cameras: int) -> ToyWorld:
    objects = place_objects(rng, tuple(classes))
    seen = tuple(range(len(objects)))
    placed = tuple(ToyCamera(f"camera{k}", pose, seen, CAMERA) for k, pose in enumerate(STANDING[:cameras]))
    return ToyWorld(CATALOGUE, placed, objects)


def register(views: Sequence[View], scenery: Scenery | None = None) -> Registration:
    return register_views(views, CATALOGUE, RegistrationConfig(), scenery=scenery)


def moved(view: View, shift: np.ndarray) -> View:
    """The view of the same objects after all were moved alike, by a motion in the camera's frame."""
    estimates = [replace(each, camera_from_object=shift @ each.camera_from_object) for each in view.estimates]
    return replace(view, estimates=tuple(estimates))


def test_one_object_is_enough_where_pictures_agree_with_it(rng: np.random.Generator, scenery: Scenery) -> None:
    scene = world(rng, (BRACKET,), 2)
    views = scene.views(rng, **NOISE)
    assert not register(views).components
    (component,) = register(views, scenery).components
    assert camera_error(scene.world_from_camera, component)[1] < 0.1


def test_pictures_sharpen_what_objects_tell(rng: np.random.Generator, scenery: Scenery) -> None:
    before, after = [], []
    for _ in range(3):
        scene = world(rng, (BRACKET, PLATE, WEDGE), 3)
        views = scene.views(rng, **NOISE)
        for given, errors in ((None, before), (scenery, after)):
            (component,) = register(views, given).components
            assert len(component.cameras) == 3
            errors.append(camera_error(scene.world_from_camera, component)[1])
    assert np.mean(after) < 0.6 * np.mean(before)


def test_objects_that_all_moved_alike_are_found_out(rng: np.random.Generator, scenery: Scenery) -> None:
    scene = world(rng, (BRACKET, PLATE, WEDGE, PYRAMID), 2)
    one, other = scene.views(rng, **NOISE)
    views = [one, moved(other, se3.exp(np.array([0, 0.35, 0, 0.1, 0, 0.05])))]
    (wrong,) = register(views).components
    assert camera_error(scene.world_from_camera, wrong)[1] > 0.1
    answer = register(views, scenery)
    assert not answer.components and all("beside them" in reason for reason in answer.refusals.values())


def test_a_camera_whose_bearings_its_objects_overrule_is_refused(rng: np.random.Generator, scenery: Scenery) -> None:
    """All that the third camera sees was moved alike before it looked."""
    scene = world(rng, (BRACKET, PLATE, WEDGE, PYRAMID), 3)
    first, second, third = scene.views(rng, **NOISE)
    away = moved(third, se3.exp(np.array([0, 0.35, 0, 0.1, 0, 0.05])))
    answer = register([first, second, away], scenery)
    for component in answer.components:
        assert "camera2" not in {camera.view_id for camera in component.cameras}
    assert "camera2" in answer.refusals and "beside them" in answer.refusals["camera2"]


def test_pictures_without_texture_change_nothing(rng: np.random.Generator) -> None:
    blank = find_features(np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8), CAMERA, SceneryConfig())
    views = world(rng, (BRACKET, PLATE, WEDGE), 3).views(rng, **NOISE)
    nothing = Scenery({view.view_id: blank for view in views}, SceneryConfig())
    (without,), (given,) = (register(views, each).components for each in (None, nothing))
    for a, b in zip(without.cameras, given.cameras, strict=True):
        assert np.array_equal(a.world_from_camera, b.world_from_camera)


def test_the_order_of_views_changes_nothing(rng: np.random.Generator, scenery: Scenery) -> None:
    views = world(rng, (BRACKET, PLATE), 3).views(rng, **NOISE)
    (one,), (other,) = (register(order, scenery).components for order in (views, views[::-1]))
    poses = {camera.view_id: camera.world_from_camera for camera in one.cameras}
    change = poses[other.cameras[0].view_id]
    for camera in other.cameras:
        assert np.allclose(change @ camera.world_from_camera, poses[camera.view_id], atol=1e-7)
