"""Cameras and boxes adjusted on pictures of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from multicam.bundle.adjustment.adjust import BEYOND, NOT_SEEN, UNCONFIRMED, UNRELATED, UNTRUSTED, adjust
from multicam.bundle.adjustment.alone import observe_edges
from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.descent import Participants, System
from multicam.bundle.adjustment.scene import Body, Picture, Scene
from multicam.bundle.adjustment.search import edge_poses, find_occluders, learn_colors
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.problem import Problem, State
from multicam.bundle.robust import PLAIN
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.matching.linear import inverse, squared_norm
from tests.bundle.box_rig import (
    CAMERA,
    WALL,
    camera_errors,
    cameras,
    objects,
    only,
    picture,
    rig,
    shaken,
    with_keypoints,
)
from tests.bundle.box_world import box
from tests.bundle.scenery.room import draw

CONFIG = AdjustmentConfig()
RGB = replace(CONFIG, depth=None)


def test_depth_and_contours_bring_the_cameras_back(rng: np.random.Generator) -> None:
    start = shaken(rng)
    answer = adjust(rig(rng), start, CONFIG)
    assert camera_errors(start)[1:].min() > 10 and camera_errors(answer.state).max() < 3
    assert answer.energy[1] < answer.energy[0] and not answer.kept_cameras and not answer.kept_objects
    assert np.array_equal(answer.state.world_from_camera[0], start.world_from_camera[0])


def test_contours_bring_objects_nearer_than_their_estimates(rng: np.random.Generator) -> None:
    scene = rig(rng, depth=False)
    occluders = find_occluders(scene, shaken(rng), RGB)
    colors = learn_colors(scene, scene.estimated, occluders, RGB)
    observed = observe_edges(scene, cameras(), occluders, colors, RGB)[0].observed
    exact = se3.inverse(cameras())[scene.camera] @ objects()[scene.object]
    before, after = (np.linalg.norm(se3.minus(each, exact)[:, 3:], axis=1) for each in (scene.estimated, observed))
    assert after.mean() < 0.8 * before.mean()


def test_colours_learnt_anew_keep_estimates_from_counting_twice() -> None:
    """Contours found by colours that were learnt at wrong poses lean towards these."""
    worse = []
    for seed in range(3):
        scene = rig(np.random.default_rng(seed), depth=False)
        exact = se3.inverse(cameras())[scene.camera] @ objects()[scene.object]
        occluders = find_occluders(scene, shaken(np.random.default_rng(seed)), RGB)
        colors = learn_colors(scene, scene.estimated, occluders, RGB)
        error = []
        for config in (RGB, replace(RGB, relearn=0)):
            observed = observe_edges(scene, cameras(), occluders, colors, config)[0].observed
            error.append(np.linalg.norm(se3.minus(observed, exact)[:, 3:], axis=1).mean())
        worse.append(error[1] / error[0])
    assert np.mean(worse) > 1.05


def test_without_pictures_there_is_nothing_to_adjust(rng: np.random.Generator) -> None:
    start = shaken(rng)
    answer = adjust(rig(rng), start, replace(CONFIG, region=None, depth=None))
    assert set(answer.kept_objects.values()) == {NOT_SEEN} and set(answer.kept_cameras) == {1, 2}
    assert np.array_equal(answer.state.world_from_object, start.world_from_object)


def test_joint_steps_are_better_than_turns(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    joint, turns = (adjust(scene, start, replace(CONFIG, joint=each)) for each in (True, False))
    assert camera_errors(joint.state)[1:].mean() < camera_errors(turns.state)[1:].mean()


def test_stated_covariances_hold_the_truth(rng: np.random.Generator) -> None:
    answer = adjust(rig(rng), shaken(rng), CONFIG)
    shift = se3.minus(cameras()[1:], answer.state.world_from_camera[1:])
    assert np.all(squared_norm(shift, inverse(answer.camera_covariance[1:])) < 22.5)
    assert not answer.camera_covariance[0].any() and np.linalg.eigvalsh(answer.object_covariance).min() > 0


def test_moving_the_world_changes_nothing(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    world = se3.random(rng)
    moved = State(world @ start.world_from_camera, world @ start.world_from_object)
    here, there = adjust(scene, start, CONFIG), adjust(scene, moved, CONFIG)
    assert np.allclose(world @ here.state.world_from_camera, there.state.world_from_camera, atol=1e-6)


def test_an_object_that_one_camera_alone_sees_moves_no_camera(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    with_it = only(scene, ~((scene.object == 2) & (scene.camera != 1)))
    without = only(scene, scene.object != 2)
    a, b = (adjust(each, start, replace(CONFIG, modelled_occlusion=False)) for each in (with_it, without))
    # Not to the last digit: where searches begin differs by 1e-7, and a line more or less is found.
    assert np.allclose(a.state.world_from_camera, b.state.world_from_camera, atol=5e-4)
    truth = se3.inverse(cameras()[1]) @ objects()[2]
    seen = se3.inverse(a.state.world_from_camera[1]) @ a.state.world_from_object[2]
    assert np.linalg.norm(seen[:3, 3] - truth[:3, 3]) < 0.004
    assert b.kept_objects == {2: NOT_SEEN}


def test_an_object_moved_between_two_pictures_is_outvoted(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    away = objects().copy()
    away[2, :3, 3] += [0.0, 0.06, 0.03]
    pictures = [*scene.pictures[:1], picture(rng, se3.inverse(cameras()[1]), away), *scene.pictures[2:]]
    estimated = scene.estimated.copy()
    edge = np.flatnonzero((scene.camera == 1) & (scene.object == 2))
    estimated[edge] = se3.inverse(cameras()[1]) @ away[2]
    answer = adjust(replace(scene, pictures=pictures, estimated=estimated), start, CONFIG)
    assert camera_errors(answer.state).max() < 4
    assert answer.weight[edge] < 0.5 < np.delete(answer.weight, edge).mean()


def test_a_camera_that_shares_no_object_stays(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    apart = only(scene, (scene.camera < 2) & (scene.object < 2) | (scene.camera == 2) & (scene.object == 2))
    answer = adjust(apart, start, CONFIG)
    assert answer.kept_cameras == {2: UNRELATED}
    assert np.array_equal(answer.state.world_from_camera[2], start.world_from_camera[2])
    assert np.array_equal(answer.camera_covariance[2], scene.camera_covariance[2])


@pytest.mark.parametrize("measuring", [0, 2, 3])
def test_one_object_moves_a_camera_only_by_the_depth_of_both_sides(rng: np.random.Generator, measuring: int) -> None:
    """The third camera sees one box; that is enough if it measures depth, and others do."""
    start, scene = shaken(rng), rig(rng)
    pictures = [each if c < measuring else replace(each, depth=None) for c, each in enumerate(scene.pictures)]
    scene = only(replace(scene, pictures=pictures), (scene.camera < 2) | (scene.object == 1))
    answer = adjust(scene, start, CONFIG)
    stays = measuring < 3
    assert (answer.kept_cameras.get(2) == UNCONFIRMED) is stays
    assert np.array_equal(answer.state.world_from_camera[2], start.world_from_camera[2]) is stays


def before_a_room(scene: Scene, standing: np.ndarray | None = None) -> Scene:
    """The scene with a patterned table and wall, in shades of the background's colour, where no box stands; they are
    seen from the cameras, or from where these are said to stand."""
    pictures: list[Picture] = []
    for each, world_from_camera in zip(scene.pictures, cameras() if standing is None else standing, strict=True):
        background = np.abs(each.image.astype(int) - WALL).max(axis=-1) < 50
        shades = draw(world_from_camera)[..., :1] / 255
        patterned = np.where(background[..., None], (0.4 + 0.9 * shades) * WALL, each.image)
        pictures.append(replace(each, image=patterned.clip(0, 255).astype(np.uint8)))
    return replace(scene, pictures=pictures)


SCENERY = replace(RGB, scenery=SceneryConfig())


def test_what_lies_beside_the_objects_shows_where_cameras_stand(rng: np.random.Generator) -> None:
    scene, start = before_a_room(rig(rng, depth=False)), shaken(rng)
    without, answer = (adjust(scene, start, config) for config in (RGB, SCENERY))
    assert not answer.kept_cameras
    assert camera_errors(answer.state)[1:].mean() < 0.6 * camera_errors(without.state)[1:].mean()
    turned = se3.minus(answer.state.world_from_camera, cameras())[1:, :3]
    assert np.linalg.norm(turned, axis=1).max() < 0.012
    shift = se3.minus(cameras()[1:], answer.state.world_from_camera[1:])
    assert np.all(squared_norm(shift, inverse(answer.camera_covariance[1:])) < 22.5)


def test_a_camera_that_sees_one_object_moves_if_what_lies_beside_it_agrees(rng: np.random.Generator) -> None:
    scene, start = before_a_room(rig(rng, depth=False)), shaken(rng)
    one = only(scene, (scene.camera < 2) | (scene.object == 1))
    without, answer = (adjust(one, start, config) for config in (RGB, SCENERY))
    assert without.kept_cameras.get(2) == UNCONFIRMED and not answer.kept_cameras
    assert camera_errors(answer.state)[2] < 0.7 * camera_errors(start)[2]


def test_a_background_that_moved_along_with_a_camera_moves_no_camera_far(rng: np.random.Generator) -> None:
    """To the second camera the room stands as to the first: as if both stood at one place, which objects contradict."""
    scene, start = rig(rng, depth=False), shaken(rng)
    answer = adjust(before_a_room(scene, cameras()[[0, 0, 2]]), start, SCENERY)
    assert camera_errors(answer.state)[1:].max() < 1.2 * camera_errors(start)[1:].max()


def test_a_plain_background_changes_nothing(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    plain, asked = (adjust(scene, start, config) for config in (CONFIG, replace(CONFIG, scenery=SceneryConfig())))
    assert np.array_equal(plain.state.world_from_camera, asked.state.world_from_camera)


def test_a_camera_held_by_odometry_alone_follows_it(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    measured = se3.inverse(cameras()[1]) @ cameras()[2]
    tie = OdometryFactor(np.array([1]), np.array([2]), measured[None], 1e8 * np.eye(6)[None])
    answer = adjust(replace(only(scene, scene.camera < 2), motions=(tie,)), start, CONFIG)
    assert not answer.kept_cameras and camera_errors(answer.state)[2] < 6


def test_nothing_leaves_the_gate_of_its_old_pose(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    sure = replace(scene, camera_covariance=scene.camera_covariance * [[[1]], [[1e-4]], [[1]]])
    answer = adjust(sure, start, CONFIG)
    assert answer.kept_cameras == {1: BEYOND}
    assert np.array_equal(answer.state.world_from_camera[1], start.world_from_camera[1])
    assert camera_errors(answer.state)[2] < camera_errors(start)[2]


def test_an_object_that_only_a_strayed_camera_sees_stays(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    alone = only(scene, (scene.object != 2) | (scene.camera == 1))
    sure = replace(alone, camera_covariance=alone.camera_covariance * [[[1]], [[1e-4]], [[1]]])
    answer = adjust(sure, start, CONFIG)
    assert answer.kept_cameras == {1: BEYOND} and answer.kept_objects == {2: UNTRUSTED}


def test_an_object_that_no_picture_shows_stays_and_the_others_do_not_care(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    outside = start.world_from_object.copy()
    outside[2, :3, 3] = [3, 0, 0]
    estimated = scene.estimated.copy()
    estimated[scene.object == 2] = se3.inverse(cameras()) @ outside[2]
    answer = adjust(replace(scene, estimated=estimated), State(start.world_from_camera, outside), CONFIG)
    assert answer.kept_objects == {2: NOT_SEEN} and np.array_equal(answer.state.world_from_object[2], outside[2])
    assert camera_errors(answer.state).max() < 6


def test_bodies_that_hide_everything_leave_all_as_it_was(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    near = np.full((CAMERA.height, CAMERA.width), 0.1, np.float32)
    pictures = [replace(each, depth=DepthImage(near, CAMERA, np.eye(4))) for each in scene.pictures]
    answer = adjust(replace(scene, pictures=pictures), start, CONFIG)
    assert set(answer.kept_objects.values()) == {NOT_SEEN} and len(answer.kept_objects) == 3
    assert np.array_equal(answer.state.world_from_camera, start.world_from_camera)
    assert set(answer.kept_cameras) == {1, 2}


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_depth_without_a_number_is_no_depth(rng: np.random.Generator, value: float) -> None:
    scene, start = rig(rng), shaken(rng)
    empty = np.full((CAMERA.height, CAMERA.width), value, np.float32)
    pictures = [replace(each, depth=DepthImage(empty, CAMERA, np.eye(4))) for each in scene.pictures]
    answer = adjust(replace(scene, pictures=pictures), start, CONFIG)
    rgb = adjust(replace(scene, pictures=[replace(each, depth=None) for each in pictures]), start, CONFIG)
    assert not answer.points.any() and answer.lines.min() > 50
    assert np.allclose(answer.state.world_from_camera, rgb.state.world_from_camera, atol=1e-9)


def test_a_picture_without_texture_says_no_more_than_the_estimates(rng: np.random.Generator) -> None:
    scene, start = rig(rng, depth=False), shaken(rng)
    blank = [Picture(np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8), CAMERA)] * 3
    answer = adjust(replace(scene, pictures=blank), start, RGB)
    assert np.all(np.isfinite(answer.state.world_from_camera)) and camera_errors(answer.state).max() < 60


def test_two_cameras_of_one_place_stay_together(rng: np.random.Generator) -> None:
    scene, start = rig(rng), shaken(rng)
    twin = replace(
        scene,
        pictures=[scene.pictures[0], scene.pictures[0], scene.pictures[2]],
        estimated=scene.estimated[np.r_[0:3, 0:3, 6:9]],
    )
    together = start.world_from_camera.copy()
    together[1] = se3.plus(together[0], 0.005 * np.ones(6))
    answer = adjust(twin, State(together, start.world_from_object), CONFIG)
    first, second = answer.state.world_from_camera[:2]
    assert np.linalg.norm(se3.minus(second, first)) < 1e-3


def test_an_object_that_is_another_than_it_seems_moves_no_camera_far(rng: np.random.Generator) -> None:
    """The third box is taken for one twice as long: the others outvote it, and it gets little weight."""
    scene, start = rig(rng), shaken(rng)
    mesh = Mesh(box().vertices * [2, 1, 1], box().faces)
    long = Body(generate(mesh, ViewpointConfig(subdivisions=2, picture=120)), mesh)
    answer = adjust(replace(scene, bodies=[*scene.bodies[:2], long]), start, CONFIG)
    assert camera_errors(start)[1:].min() > 10 and camera_errors(answer.state).max() < 6


def test_a_camera_that_sees_one_symmetric_object_only_stays_uncertain_about_its_turn(rng: np.random.Generator) -> None:
    """Nothing says how far the camera has gone around the axis; all else is found."""
    drawn = trimesh.creation.cylinder(0.03, 0.1, sections=64)
    mesh = Mesh(np.asarray(drawn.vertices), np.asarray(drawn.faces))
    stands, upright = cameras()[:2], se3.exp(np.array([np.pi / 2, 0, 0, 0, 0, 0]))
    pictures = []
    for each in stands:
        depth = render_depth(mesh, CAMERA, se3.inverse(each) @ upright)
        image = np.where(depth[..., None] > 0, [200, 60, 40], [60, 90, 180]) + rng.normal(scale=8, size=(240, 320, 3))
        measured = DepthImage(np.where(depth > 0, depth, np.float32(1)), CAMERA, np.eye(4))
        pictures.append(Picture(image.clip(0, 255).astype(np.uint8), CAMERA, measured))
    std = np.array([0.05, 0.05, 1.5, 0.008, 0.008, 0.008])
    scene = Scene(
        pictures=pictures,
        bodies=[Body(generate(mesh, ViewpointConfig(subdivisions=3, picture=160)), mesh)],
        camera=np.array([0, 1]),
        object=np.array([0, 0]),
        estimated=se3.plus(
            se3.inverse(stands) @ upright, rng.normal(size=(2, 6)) * [0.05, 0.05, 0, 0.008, 0.008, 0.008]
        ),
        information=np.tile(np.diag(std**-2), (2, 1, 1)),
        fixed=np.array([True, False]),
        camera_covariance=np.stack((np.zeros((6, 6)), np.diag([4.0, 4, 4, 1, 1, 1]))),
        object_covariance=np.diag(std**2)[None],
    )
    around = se3.exp(np.array([0, 0.15, 0, 0, 0, 0]))
    answer = adjust(scene, State(np.stack((stands[0], around @ stands[1])), upright[None]), CONFIG)
    # In the object's frame the camera may turn about the axis; the other five directions are known.
    to_object = se3.adjoint(se3.inverse(answer.state.world_from_object[0]) @ answer.state.world_from_camera[1])
    deviation = np.sqrt(np.diag(to_object @ answer.camera_covariance[1] @ to_object.T))
    assert deviation[[0, 1]].max() < 0.05 and deviation[5] < 0.01
    assert deviation[2] > 5 * deviation[[0, 1]].max()
    # The same view of the object, whatever the turn.
    seen = se3.inverse(answer.state.world_from_camera[1]) @ answer.state.world_from_object[0]
    exact = se3.inverse(stands[1]) @ upright
    assert np.linalg.norm(seen[:3, 3] - exact[:3, 3]) < 0.003
    assert np.degrees(np.arccos(seen[:3, 2] @ exact[:3, 2])) < 1.5


@pytest.mark.parametrize("edges", [0, 4, 9])
def test_the_step_solves_the_system_that_problem_has(rng: np.random.Generator, edges: int) -> None:
    # Without pictures both know the estimates alone, some by their keypoints, but for the slight damping of the step.
    scene, start = with_keypoints(rig(rng), rng, edges), shaken(rng)
    config = AdjustmentConfig(region=None, depth=None, rotation_damping=0.0, translation_damping=0.0)
    taking = Participants(np.ones(3, np.bool_), np.ones(3, np.bool_), scene.fixed)
    occluders = find_occluders(scene, start, config)
    system = System(scene, taking, occluders, learn_colors(scene, scene.estimated, occluders, config), config)
    mine, _ = system.step(system.search(start, 0), start, np.ones(9))
    problem = Problem(scene.priors(config.tail), scene.fixed)
    theirs = problem.retract(start, problem.linearize(start)[1].solve(0.0))
    assert np.allclose(edge_poses(scene, mine), edge_poses(scene, theirs), atol=2e-3)


@pytest.mark.parametrize(("searches", "relearn"), [(0, 0), (3, 4)])
def test_colours_learnt_anew_leave_a_search_to_be_used_in(searches: int, relearn: int) -> None:
    with pytest.raises(ValueError, match=f"searches is {searches}.*relearn, {relearn}"):
        AdjustmentConfig(searches=searches, relearn=relearn)


def test_keypoints_bring_the_cameras_back_as_far_as_they_can(rng: np.random.Generator) -> None:
    start, blind = shaken(rng), AdjustmentConfig(region=None, depth=None)
    scene = with_keypoints(rig(rng), rng, 9, std=0.1)
    occluders = find_occluders(scene, start, blind)
    taking = Participants(np.ones(3, np.bool_), np.ones(3, np.bool_), scene.fixed)
    system = System(scene, taking, occluders, learn_colors(scene, scene.estimated, occluders, blind), blind)
    found = system.descend(start, range(6)).state
    assert camera_errors(start)[1:].min() > 10 and camera_errors(found).max() < 3


def test_an_edge_with_keypoints_has_no_other_estimate(rng: np.random.Generator) -> None:
    scene, state = with_keypoints(rig(rng), rng, 4), State(cameras(), objects())
    other = replace(scene, estimated=se3.random(rng, 9))

    def energies(some: Scene) -> list[float]:
        poses = [(prior, state.camera_from_object(prior.camera, prior.object)) for prior in some.priors(1.0)]
        return [float(prior.linearize(at).energy.sum()) for prior, at in poses]

    assert len(scene.priors(1.0)[0].camera) == 5
    assert energies(scene)[1] == energies(other)[1] > 0
    assert energies(scene)[0] != energies(other)[0]


def test_estimates_that_are_trusted_less_bring_less_energy(rng: np.random.Generator) -> None:
    scene, state = with_keypoints(rig(rng), rng, 4), State(cameras(), objects())
    for whole, part in zip(scene.priors(1.0), scene.trusted(0.05).priors(1.0), strict=True):
        at = state.camera_from_object(whole.camera, whole.object)
        assert np.allclose(part.linearize(at).energy, 0.05 * whole.linearize(at).energy)


def test_keypoints_know_no_more_than_the_covariance_of_their_estimate(rng: np.random.Generator) -> None:
    keypoints = with_keypoints(rig(rng), rng, 2).keypoints
    at, edges = se3.inverse(cameras())[[0, 0]] @ objects()[:2], np.arange(2)
    local = keypoints.factor(edges, edges, PLAIN).linearize(at[keypoints.edge])
    exact = np.array([np.linalg.inv(local.hessian[keypoints.edge == e].sum(axis=0)) for e in edges])
    sure = keypoints.as_sure_as(at, exact * np.array([9.0, 0.1])[:, None, None])
    # Three times the deviation where the covariance says so, and never less than the detector stated.
    assert np.allclose(sure.std / keypoints.std, np.where(keypoints.edge == 0, 3.0, 1.0)[:, None])


def test_a_picture_is_checked_when_it_is_made() -> None:
    with pytest.raises(ValueError, match=r"uint8 \(240, 320, 3\)"):
        Picture(np.zeros((240, 321, 3), np.uint8), CAMERA)
    with pytest.raises(ValueError, match="undistort"):
        Picture(np.zeros((2, 2, 3), np.uint8), Camera(np.eye(3), 2, 2, (0.1, 0.0, 0.0, 0.0)))
