"""Views in, cameras and objects out: exactness, invariances, refusals, and the real data at its edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.errors import DataError
from multicam.geometry import se3, so3
from multicam.registration import RegistrationConfig, register_views
from multicam.registration.config import PlacementConfig
from multicam.registration.group import Group
from multicam.registration.links import PARTNERS, Link, links_between_views
from multicam.registration.placement import seed
from multicam.types import Component, ObjectEstimate, Registration, View
from tests.strategies import seeds
from tests.toy_objects import BRACKET, PEG, PLATE, PYRAMID, ROD, WEDGE, random_symmetry, toy_catalogue
from tests.toy_world import ALL_CLASSES, ToyWorld, camera_error, make_world, misplaced, object_errors

CATALOGUE = toy_catalogue()


def register(views: tuple[View, ...] | list[View], config: RegistrationConfig | None = None) -> Registration:
    return register_views(views, CATALOGUE, config or RegistrationConfig())


def only(registration: Registration) -> Component:
    assert len(registration.components) == 1, registration.refusals
    return registration.components[0]


def relative_poses(component: Component) -> dict[str, np.ndarray]:
    first = min(component.cameras, key=lambda camera: camera.view_id)
    return {c.view_id: se3.inverse(first.world_from_camera) @ c.world_from_camera for c in component.cameras}


def assert_same_cameras(one: Component, other: Component, atol: float = 1e-9) -> None:
    a, b = relative_poses(one), relative_poses(other)
    assert a.keys() == b.keys()
    assert all(np.allclose(a[name], b[name], atol=atol) for name in a)


@settings(max_examples=15)
@given(seeds(), st.integers(2, 4), st.booleans())
def test_without_noise_the_truth_comes_back(rng: np.random.Generator, cameras: int, with_keypoints: bool) -> None:
    world = replace(make_world(rng, num_cameras=cameras), catalogue=CATALOGUE)
    registration = register(world.views(rng, with_detections=with_keypoints))
    component = only(registration)
    assert len(component.cameras) == cameras
    assert not registration.refusals
    assert max(camera_error(world.world_from_camera, component)) < 1e-6
    # The errors are taken over 64 turns of a round object, which leaves half a step of its rim.
    assert max(object_errors(world, component)) < 2e-3
    assert len(component.objects) == len(world.objects)


@settings(max_examples=10)
@given(seeds(), st.permutations(range(4)))
def test_the_order_of_views_changes_nothing(rng: np.random.Generator, order: list[int]) -> None:
    world = make_world(rng, num_cameras=4)
    views = world.views(rng, rotation_noise=0.02, translation_noise=0.003, outlier_fraction=0.2)
    one, other = register(views), register([views[i] for i in order])
    assert len(one.components) == len(other.components)
    assert one.refusals == other.refusals
    for a, b in zip(one.components, other.components, strict=True):
        assert_same_cameras(a, b)
    for component, given_views in ((other.components[0], [views[i] for i in order]),):
        names = [view.view_id for view in given_views]
        placed = [camera.view_id for camera in component.cameras]
        assert placed == sorted(placed, key=names.index)
        assert np.allclose(component.cameras[0].world_from_camera, np.eye(4))
        assert not np.any(component.cameras[0].covariance)


@settings(max_examples=10)
@given(seeds())
def test_a_symmetric_twin_of_an_estimate_changes_nothing(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET, PLATE, PEG, ROD, PYRAMID))
    views = world.views(rng, rotation_noise=0.01, translation_noise=0.002, with_detections=False)
    twins = [replace(view, estimates=tuple(_twin(e, rng) for e in view.estimates)) for view in views]
    one, other = only(register(views)), only(register(twins))
    assert_same_cameras(one, other, atol=1e-6)


def test_estimates_without_covariance_are_registered_too(rng: np.random.Generator) -> None:
    world = make_world(rng)
    views = world.views(rng, rotation_noise=0.02, translation_noise=0.003, with_detections=False)
    silent = [replace(v, estimates=tuple(replace(e, covariance=None) for e in v.estimates)) for v in views]
    for camera_matrix in (views[0].camera_matrix, None):
        component = only(register([replace(view, camera_matrix=camera_matrix) for view in silent]))
        rotation, position = camera_error(world.world_from_camera, component)
        assert rotation < 0.06
        assert position < 0.05


def test_keypoints_make_the_cameras_more_accurate(rng: np.random.Generator) -> None:
    coarse: list[float] = []
    fine: list[float] = []
    for _ in range(6):
        world = make_world(rng)
        views = world.views(rng, rotation_noise=0.03, translation_noise=0.01, keypoint_noise=0.5)
        blind = [replace(v, estimates=tuple(replace(e, detection=None) for e in v.estimates)) for v in views]
        fine.append(camera_error(world.world_from_camera, only(register(views)))[1])
        coarse.append(camera_error(world.world_from_camera, only(register(blind)))[1])
    assert np.mean(fine) < 0.5 * np.mean(coarse)


def test_several_instances_of_each_class(rng: np.random.Generator) -> None:
    world = make_world(rng, classes=(BRACKET, BRACKET, ROD, ROD, ROD, PLATE, PLATE))
    component = only(register(world.views(rng, rotation_noise=0.01, translation_noise=0.002)))
    rotation, position = camera_error(world.world_from_camera, component)
    assert rotation < 0.02
    assert position < 0.02
    assert sorted(len(placed.supports) for placed in component.objects) == [3] * 7
    assert len({support for placed in component.objects for support in placed.supports}) == 21


def _misplaced(estimate: ObjectEstimate, rng: np.random.Generator) -> ObjectEstimate:
    return replace(estimate, camera_from_object=misplaced(estimate.camera_from_object, rng))


def _confused(estimate: ObjectEstimate, rng: np.random.Generator) -> ObjectEstimate:
    """Taken for an object of another class."""
    others = [obj_id for obj_id in ALL_CLASSES if obj_id != estimate.obj_id]
    return replace(estimate, obj_id=int(rng.choice(others)))


def _flipped(estimate: ObjectEstimate, rng: np.random.Generator) -> ObjectEstimate:
    """Turned half about one of its axes."""
    turn = se3.from_parts(so3.exp(np.pi * np.eye(3)[rng.integers(3)]), np.zeros(3))
    return replace(estimate, camera_from_object=estimate.camera_from_object @ turn)


@pytest.mark.parametrize("fault", [_misplaced, _confused, _flipped])
def test_forty_percent_of_gross_errors_hardly_ever_place_a_camera_wrongly(rng: np.random.Generator, fault) -> None:
    placed = wrong = 0
    for _ in range(80):
        world = make_world(rng, num_cameras=3)
        views = world.views(rng, rotation_noise=0.02, translation_noise=0.003, with_detections=False)
        faulty = [
            replace(v, estimates=tuple(fault(e, rng) if rng.uniform() < 0.4 else e for e in v.estimates)) for v in views
        ]
        for component in register(faulty).components:
            for camera in component.cameras[1:]:
                pair = replace(component, cameras=(component.cameras[0], camera))
                rotation, position = camera_error(world.world_from_camera, pair)
                wrong += rotation > 0.175 or position > 0.1
                placed += 1
    assert placed > 80
    assert wrong <= 0.005 * placed


def test_cameras_that_share_nothing_are_linked_through_the_others(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=5, classes=(BRACKET, PEG, WEDGE), chain=True)
    component = only(register(world.views(rng, rotation_noise=0.003, translation_noise=0.0005)))
    assert len(component.cameras) == 5
    rotation, position = camera_error(world.world_from_camera, component)
    assert rotation < 0.02
    assert position < 0.02
    spread = [np.trace(camera.covariance) for camera in component.cameras]
    assert spread == sorted(spread)


def test_two_groups_of_cameras_become_two_worlds(rng: np.random.Generator) -> None:
    worlds = [make_world(rng, num_cameras=2, classes=classes) for classes in ((1, 2), (5, 6))]
    views: list[View] = []
    for number, world in enumerate(worlds):
        views += [replace(view, view_id=f"{number}-{view.view_id}") for view in world.views(rng)]
    registration = register(views)
    assert [[c.view_id for c in component.cameras] for component in registration.components] in (
        [["0-camera0", "0-camera1"], ["1-camera0", "1-camera1"]],
        [["1-camera0", "1-camera1"], ["0-camera0", "0-camera1"]],
    )


def test_an_object_of_one_camera_is_placed_as_well(rng: np.random.Generator) -> None:
    world = make_world(rng)
    views = list(world.views(rng))
    views[0] = replace(views[0], estimates=tuple(e for e in views[0].estimates if e.obj_id != WEDGE))
    views[1] = replace(views[1], estimates=tuple(e for e in views[1].estimates if e.obj_id != WEDGE))
    component = only(register(views))
    wedge = next(placed for placed in component.objects if placed.obj_id == WEDGE)
    assert [view_id for view_id, _ in wedge.supports] == ["camera2"]
    assert object_errors(world, replace(component, objects=(wedge,)))[0] < 1e-6
    assert wedge.score < min(placed.score for placed in component.objects if placed.obj_id != WEDGE)


def test_supports_name_the_estimates(rng: np.random.Generator) -> None:
    world = make_world(rng)
    views = {view.view_id: view for view in world.views(rng)}
    for placed in only(register(list(views.values()))).objects:
        assert {views[name].estimates[index].obj_id for name, index in placed.supports} == {placed.obj_id}


def test_stated_covariances_hold(rng: np.random.Generator) -> None:
    inside: list[bool] = []
    objects_inside: list[bool] = []
    object_variance: list[float] = []
    for _ in range(30):
        world = make_world(rng, classes=(BRACKET, PLATE, WEDGE, ROD))
        views = world.views(rng, rotation_noise=0.02, translation_noise=0.004, with_detections=False)
        truth = world.world_from_camera
        component = only(register(views))
        first = component.cameras[0].view_id
        for camera in component.cameras[1:]:
            error = se3.minus(se3.inverse(truth[first]) @ truth[camera.view_id], camera.world_from_camera)
            inside.append(error @ np.linalg.solve(camera.covariance, error) < 12.59)
        for placed in component.objects:
            if placed.obj_id in (BRACKET, WEDGE):
                true_pose = next(o.world_from_object for o in world.objects if o.obj_id == placed.obj_id)
                error = se3.minus(se3.inverse(truth[first]) @ true_pose, placed.world_from_object)
                objects_inside.append(error @ np.linalg.solve(placed.covariance, error) < 12.59)
                object_variance.append(float(np.trace(placed.covariance)))
    assert 0.85 < np.mean(inside) <= 1
    assert 0.85 < np.mean(objects_inside) <= 1
    assert np.mean(object_variance) < 0.9 * 3 * (0.02**2 + 0.004**2)


def test_the_covariance_of_a_chain_agrees_with_sampling(rng: np.random.Generator) -> None:
    poses, spread = se3.random(rng, 2), np.diag([2e-3] * 3 + [1e-3] * 3)
    links = [Link(n, n + 1, poses[n], spread**2, 9.0, 3, None) for n in range(2)]
    placement = seed(links[0]).extended(links[1])
    samples = se3.plus(poses[:, None], rng.normal(size=(2, 20_000, 6)) @ spread)
    deviation = se3.minus(samples[0] @ samples[1], placement.world_from_camera[2])
    assert np.allclose(np.cov(deviation.T), placement.covariance[2], atol=0.03 * placement.covariance[2].max())


def test_no_view_or_one_view_or_blind_views_are_answered(rng: np.random.Generator) -> None:
    views = make_world(rng, num_cameras=2).views(rng)
    assert register([]).components == ()
    alone = register(views[:1])
    assert alone.components == ()
    assert "no other view sees" in alone.refusals["camera0"]
    blind = register([views[0], View("blind", ())])
    assert blind.components == ()
    assert "no known object" in blind.refusals["blind"]


def test_a_single_shared_object_is_no_proof(rng: np.random.Generator) -> None:
    refusals = register(make_world(rng, num_cameras=2, classes=(BRACKET,)).views(rng)).refusals
    assert "two must agree" in refusals["camera0"]
    assert "bracket" in refusals["camera1"]


def test_objects_on_one_axis_leave_a_turn_open(rng: np.random.Generator) -> None:
    views = [_coaxial(view) for view in make_world(rng, num_cameras=2, classes=(PEG, ROD)).views(rng)]
    registration = register(views)
    assert registration.components == ()
    assert "turn" in registration.refusals["camera0"]


def test_two_equally_good_poses_are_refused(rng: np.random.Generator) -> None:
    views: list[View] = []
    for view in make_world(rng, num_cameras=2, classes=(PLATE,)).views(rng, symmetric_twins=False):
        plate = replace(view.estimates[0], detection=None)
        views.append(replace(view, estimates=(plate, replace(plate, obj_id=ROD))))
    registration = register(views)
    assert registration.components == ()
    assert "two different poses" in registration.refusals["camera0"]


def test_objects_that_moved_are_refused(rng: np.random.Generator) -> None:
    first, second = (make_world(rng, num_cameras=2, classes=(BRACKET, WEDGE)) for _ in range(2))
    registration = register([first.views(rng)[0], second.views(rng)[1]])
    assert registration.components == ()
    assert "did they move" in registration.refusals["camera0"]


def test_an_imprecise_camera_is_refused_with_its_error(rng: np.random.Generator) -> None:
    world = make_world(rng)
    views = world.views(rng, rotation_noise=0.05, translation_noise=0.02, with_detections=False)
    strict = RegistrationConfig(placement=PlacementConfig(max_rotation_error_deg=0.05, max_position_error=1e-3))
    registration = register(views, strict)
    assert registration.components == ()
    assert len(registration.refusals) == 3
    assert any("known to" in reason for reason in registration.refusals.values())


def test_an_unknown_class_is_an_error(rng: np.random.Generator) -> None:
    views = make_world(rng, num_cameras=2).views(rng)
    stranger = ObjectEstimate(99, 1.0, np.eye(4))
    with pytest.raises(DataError, match="unknown object class 99"):
        register([replace(views[0], estimates=(stranger,)), views[1]])


def test_views_need_names_of_their_own(rng: np.random.Generator) -> None:
    view = make_world(rng, num_cameras=2).views(rng)[0]
    with pytest.raises(ValueError, match="name of its own"):
        register([view, view])


def test_many_cameras_and_objects(rng: np.random.Generator) -> None:
    world: ToyWorld = make_world(rng, num_cameras=8, classes=(*ALL_CLASSES, BRACKET, ROD, PLATE))
    component = only(register(world.views(rng, rotation_noise=0.01, translation_noise=0.002, with_detections=False)))
    assert len(component.cameras) == 8
    assert max(camera_error(world.world_from_camera, component)) < 0.03


def test_many_views_are_compared_with_a_few_others_each(rng: np.random.Generator) -> None:
    world = make_world(rng, num_cameras=20)
    views = world.views(rng, rotation_noise=0.01, translation_noise=0.002, with_detections=False)
    group = Group.of(views, CATALOGUE, RegistrationConfig(), None)
    assert len(links_between_views(group)) <= 20 * PARTNERS
    assert len(only(register(views)).cameras) == 20


def _twin(estimate: ObjectEstimate, rng: np.random.Generator) -> ObjectEstimate:
    """The same statement about the same picture: pose times a symmetry, covariance moved along."""
    symmetry = random_symmetry(CATALOGUE[estimate.obj_id].symmetries, rng)
    moved = se3.adjoint(se3.inverse(symmetry))
    assert estimate.covariance is not None
    return replace(
        estimate,
        camera_from_object=estimate.camera_from_object @ symmetry,
        covariance=moved @ estimate.covariance @ moved.T,
    )


def _coaxial(view: View) -> View:
    peg, rod = sorted(view.estimates, key=lambda estimate: estimate.obj_id)
    shift = se3.from_parts(np.eye(3), CATALOGUE[PEG].symmetries.axes[0].offset + np.array([0, 0, 0.2]))
    return replace(view, estimates=(peg, replace(rod, camera_from_object=peg.camera_from_object @ shift)))
