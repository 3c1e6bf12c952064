"""The graph on a walk between two tables: two static cameras that never see a common object."""

from dataclasses import replace

import numpy as np
import pytest

from multicam.geometry import se3
from multicam.scenegraph.graph import SceneGraph
from multicam.scenegraph.keyframe import KeyframeConfig
from multicam.scenegraph.query import in_world, relative
from multicam.types import Component, Registration
from tests.scenegraph.oracle import ANY_SPEED, fold, register, walk_through
from tests.toy_walk import HEADSET, LEFT, RIGHT, ToyWalk, make_walk


def pair_error(graph: SceneGraph, walk: ToyWalk) -> tuple[float, float]:
    """(rad, m) of the relative pose of the two static cameras after the walk."""
    chain = relative(graph, LEFT, RIGHT, walk.steps[-1].timestamp_ns)
    assert chain is not None
    truth = se3.inverse(walk.world_from_static[LEFT]) @ walk.world_from_static[RIGHT]
    twist = se3.minus(chain.estimate.pose, truth)
    return float(np.linalg.norm(twist[:3])), float(np.linalg.norm(chain.estimate.pose[:3, 3] - truth[:3, 3]))


def test_the_two_tables_share_no_camera_but_the_headset(rng):
    for step in make_walk(rng).steps:
        left, right = (set(c.visible) for c in step.world.cameras if c.camera_id != HEADSET)
        assert not left & right


def test_without_noise_the_pair_that_never_overlaps_is_exact(rng):
    walk = make_walk(rng)
    graph = walk_through(walk, rng)
    assert pair_error(graph, walk) == pytest.approx((0, 0), abs=1e-6)
    for name, truth in walk.world_from_static.items():
        found = in_world(graph, name, walk.steps[-1].timestamp_ns)
        np.testing.assert_allclose(found.estimate.pose, truth, atol=1e-6)


def test_with_noise_the_pair_that_never_overlaps_is_found_within_bounds():
    errors = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        walk = make_walk(rng, num_steps=12)
        errors.append(pair_error(walk_through(walk, rng, scale=1.0), walk))
    rotation, translation = np.median(errors, axis=0)
    assert np.degrees(rotation) < 0.25
    assert translation < 0.006


def test_a_drifting_headset_still_links_the_two_within_its_stated_uncertainty():
    inside = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        walk = make_walk(rng, num_steps=12, rotation_drift=5e-4, translation_drift=1e-3, step_ns=500_000_000)
        graph = walk_through(walk, rng, scale=1.0)
        chain = relative(graph, LEFT, RIGHT, walk.steps[-1].timestamp_ns)
        truth = se3.inverse(walk.world_from_static[LEFT]) @ walk.world_from_static[RIGHT]
        twist = se3.minus(truth, chain.estimate.pose)
        inside.append(float(twist @ np.linalg.solve(chain.estimate.covariance, twist)) < 22.5)
        assert pair_error(graph, walk)[1] < 0.05
    assert np.mean(inside) >= 0.8


def test_a_static_camera_keeps_its_pose_when_nothing_is_seen(rng):
    walk = make_walk(rng)
    graph, first = SceneGraph(HEADSET, (LEFT, RIGHT)), walk.steps[0]
    graph, _ = fold(graph, first, register(first.world, rng))
    before = in_world(graph, LEFT, first.timestamp_ns)
    for step in walk.steps[1:]:
        graph, _ = fold(graph, step, Registration((), {}))
    after = in_world(graph, LEFT, walk.steps[-1].timestamp_ns)
    np.testing.assert_array_equal(after.estimate.pose, before.estimate.pose)
    assert after.updated_ns == before.updated_ns == first.timestamp_ns
    assert after.estimate.translation_std > before.estimate.translation_std


def test_the_order_of_cameras_changes_nothing(rng):
    walk = make_walk(rng, num_steps=6)
    graphs = []
    for order in ((0, 1, 2), (2, 1, 0), (1, 2, 0)):
        graph, noise = SceneGraph(HEADSET, (LEFT, RIGHT) if order[0] else (RIGHT, LEFT)), np.random.default_rng(5)
        for step in walk.steps:
            found = register(step.world, noise, scale=1.0)
            shuffled = tuple(
                replace(c, cameras=(c.cameras[0], *sorted(c.cameras[1:], key=lambda p: order[len(p.view_id) % 3])))
                for c in found.components[:: 1 if order[0] else -1]
            )
            graph, _ = fold(graph, step, replace(found, components=shuffled))
        graphs.append(graph)
    for name in (LEFT, RIGHT):
        poses = [in_world(graph, name, walk.steps[-1].timestamp_ns).estimate for graph in graphs]
        for other in poses[1:]:
            np.testing.assert_allclose(other.pose, poses[0].pose, atol=1e-12)
            np.testing.assert_allclose(other.covariance, poses[0].covariance, atol=1e-15)


def test_a_hasty_headset_places_nobody_and_the_reason_says_so(rng):
    walk = make_walk(rng)
    graph = SceneGraph(HEADSET, (LEFT, RIGHT))
    for step in walk.steps[:2]:
        graph, reasons = fold(graph, step, register(step.world, rng), KeyframeConfig())
    assert reasons[LEFT].startswith("the headset moves too fast (0.90 m/s, 12 deg/s)")


def test_too_few_common_objects_are_refused(rng):
    walk = make_walk(rng)
    step = walk.steps[0]
    registration = register(step.world, rng)
    poor = Registration(tuple(replace(c, objects=c.objects[:1]) for c in registration.components))
    graph, reasons = fold(SceneGraph(HEADSET, (LEFT, RIGHT)), step, poor, ANY_SPEED)
    assert not graph.links
    assert reasons[LEFT] == "only 1 of the 2 objects needed agree with another camera"


def test_a_pose_with_an_unobserved_direction_is_refused(rng):
    walk = make_walk(rng)
    step = walk.steps[0]
    vague = np.diag([1e-5] * 5 + [0.2**2])
    components = [
        Component((c.cameras[0], *(replace(p, covariance=vague) for p in c.cameras[1:])), c.objects)
        for c in register(step.world, rng).components
    ]
    graph, reasons = fold(SceneGraph(HEADSET, (LEFT, RIGHT)), step, Registration(tuple(components)), ANY_SPEED)
    assert not graph.links
    assert reasons[LEFT].startswith("the measured pose is uncertain by 200 mm")


def test_a_static_camera_that_only_meets_another_static_one_is_placed_through_it(rng):
    walk = make_walk(rng)
    first = walk.steps[0]
    with_headset = register(first.world, rng)
    poses = walk.world_from_static
    component = with_headset.components[0]
    left = next(p for p in component.cameras if p.view_id == LEFT)
    right = replace(left, view_id=RIGHT, world_from_camera=se3.inverse(poses[LEFT]) @ poses[RIGHT])
    gauge = replace(left, world_from_camera=np.eye(4), covariance=np.zeros((6, 6)))
    objects = tuple(replace(o, supports=((LEFT, 0), (RIGHT, 0))) for o in component.objects)
    graph, _ = fold(SceneGraph(HEADSET, (LEFT, RIGHT)), first, with_headset)
    later = walk.steps[1]
    graph, reasons = fold(graph, later, Registration((Component((gauge, right), objects),)))
    chain = in_world(graph, RIGHT, later.timestamp_ns)
    assert chain.nodes == ("world", LEFT, RIGHT)
    np.testing.assert_allclose(chain.estimate.pose, poses[RIGHT], atol=1e-6)
    assert reasons[RIGHT] == f"it shares objects with {LEFT}, not with the headset"


def test_one_wrong_registration_does_not_move_a_camera(rng):
    walk = make_walk(rng)
    graph = SceneGraph(HEADSET, (LEFT, RIGHT))
    for step in walk.steps[:3]:
        graph, _ = fold(graph, step, register(step.world, rng, scale=1.0))
    step = walk.steps[3]
    off = np.array([0.3, 0, 0, 0.1, 0, 0])
    components = [
        replace(
            c,
            cameras=tuple(
                p if p.view_id == HEADSET else replace(p, world_from_camera=se3.plus(p.world_from_camera, off))
                for p in c.cameras
            ),
        )
        for c in register(step.world, rng).components
    ]
    wrong = Registration(tuple(components))
    after, reasons = fold(graph, step, wrong)
    before, now = (in_world(g, LEFT, step.timestamp_ns).estimate.pose for g in (graph, after))
    np.testing.assert_array_equal(before, now)
    assert "from the stored pose" in reasons[LEFT]
