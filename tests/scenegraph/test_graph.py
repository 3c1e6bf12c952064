import numpy as np
import pytest

from multicam.errors import DataError
from multicam.geometry import se3
from multicam.scenegraph.graph import WORLD, GraphConfig, SceneGraph, key_of
from multicam.scenegraph.query import in_world, relative
from multicam.scenegraph.uncertain import UncertainPose, isotropic
from multicam.scenegraph.update import insert_link, track_headset

NOISE = isotropic(0.002, 0.003)
SECOND = 1_000_000_000


def test_camera_names_must_differ_and_leave_the_world_its_own():
    with pytest.raises(DataError, match="must differ"):
        SceneGraph("head", ("left", "left"))
    with pytest.raises(DataError, match='none may be "world"'):
        SceneGraph("head", ("world",))


def test_keys_put_the_world_first_and_the_rest_in_order():
    assert key_of("left", WORLD) == key_of(WORLD, "left") == (WORLD, "left")
    assert key_of("right", "left") == ("left", "right")


def test_tracked_poses_are_interpolated_and_not_extrapolated(rng):
    a, b = se3.random(rng), se3.random(rng)
    graph = track_headset(track_headset(SceneGraph("head", ()), 0, a), SECOND, b)
    np.testing.assert_allclose(graph.tracked(SECOND // 4), se3.interpolate(a, b, 0.25))
    np.testing.assert_array_equal(graph.tracked(SECOND), b)
    assert graph.tracked(SECOND + 1) is None
    assert graph.tracked(-1) is None


def test_old_packets_of_the_tracking_are_ignored_and_the_memory_is_bounded(rng):
    graph = SceneGraph("head", (), GraphConfig(remember=3))
    for time in (0, 1, 2, 3, 1):
        graph = track_headset(graph, time, se3.random(rng))
    assert [p.timestamp_ns for p in graph.trajectory] == [1, 2, 3]


def test_a_link_may_be_given_in_either_direction(rng):
    left_from_right = UncertainPose(se3.random(rng), NOISE)
    straight, _ = insert_link(SceneGraph("head", ("left", "right")), "left", "right", left_from_right, 0)
    turned, _ = insert_link(SceneGraph("head", ("left", "right")), "right", "left", left_from_right.inverse(), 0)
    one, other = (relative(graph, "left", "right", 0) for graph in (straight, turned))
    np.testing.assert_allclose(one.estimate.pose, other.estimate.pose, atol=1e-12)
    np.testing.assert_allclose(one.estimate.covariance, other.estimate.covariance, atol=1e-15)


def test_cameras_seen_by_the_headset_at_different_times_are_linked_through_it(rng):
    world_from_left, world_from_right = se3.random(rng), se3.random(rng)
    graph = SceneGraph("head", ("left", "right"))
    graph, _ = insert_link(graph, WORLD, "left", UncertainPose(world_from_left, NOISE), 0)
    graph, _ = insert_link(graph, WORLD, "right", UncertainPose(world_from_right, NOISE), 5 * SECOND)
    chain = relative(graph, "left", "right", 5 * SECOND)
    assert chain.nodes == ("left", WORLD, "right")
    assert chain.updated_ns == 0
    np.testing.assert_allclose(chain.estimate.pose, se3.inverse(world_from_left) @ world_from_right, atol=1e-12)


def test_a_chained_covariance_adds_what_drift_did_in_between(rng):
    world_from_left = se3.random(rng)
    graph = track_headset(SceneGraph("head", ("left",)), 0, np.eye(4))
    graph, _ = insert_link(graph, WORLD, "left", UncertainPose(world_from_left, NOISE), 0)
    adjoint = se3.adjoint(se3.inverse(world_from_left))
    drift = adjoint @ graph.config.tracking.drift_per_second @ adjoint.T
    found = in_world(graph, "left", 9 * SECOND).estimate.covariance
    np.testing.assert_allclose(found, NOISE + 9 * drift, rtol=1e-9, atol=1e-18)


def test_drift_moves_a_far_camera_by_its_lever_arm():
    graph = track_headset(SceneGraph("head", ("near", "far")), 0, np.eye(4))
    spreads = []
    for name, distance in (("near", 0.5), ("far", 5.0)):
        pose = np.eye(4)
        pose[2, 3] = distance
        graph, _ = insert_link(graph, WORLD, name, UncertainPose(pose, NOISE), 0)
        spreads.append(in_world(graph, name, 100 * SECOND).estimate.translation_std)
    tracking = graph.config.tracking
    arm = 5 * np.radians(tracking.drift_rotation_deg) * 10
    expected = np.sqrt(0.003**2 + 100 * tracking.drift_translation**2 + arm**2)
    np.testing.assert_allclose(spreads[1], expected, rtol=1e-6)
    assert spreads[0] < spreads[1]


def test_the_most_certain_chain_is_taken():
    graph = SceneGraph("head", ("a", "b", "c"))
    vague, sharp = isotropic(0.05, 0.05), isotropic(0.001, 0.001)
    for target, source, covariance in (("a", "b", vague), ("a", "c", sharp), ("c", "b", sharp)):
        graph, _ = insert_link(graph, target, source, UncertainPose(np.eye(4), covariance), 0)
    assert relative(graph, "a", "b", 0).nodes == ("a", "c", "b")


def test_two_static_cameras_keep_their_relative_pose_while_the_world_drifts():
    graph = SceneGraph("head", ("a", "b"))
    for target, source in ((WORLD, "a"), (WORLD, "b"), ("a", "b")):
        graph, _ = insert_link(graph, target, source, UncertainPose(np.eye(4), NOISE), 0)
    chain = relative(graph, "a", "b", 3600 * SECOND)
    assert chain.nodes == ("a", "b")
    np.testing.assert_allclose(chain.estimate.covariance, NOISE)


def test_nothing_is_said_of_cameras_that_nothing_links():
    graph = SceneGraph("head", ("a", "b"))
    assert relative(graph, "a", "b", 0) is None
    assert in_world(graph, "head", 0) is None


def test_the_headset_is_where_its_tracking_says(rng):
    pose = se3.random(rng)
    graph = track_headset(SceneGraph("head", ("a",)), 7, pose)
    chain = in_world(graph, "head", 7)
    np.testing.assert_allclose(chain.estimate.pose, pose, atol=1e-12)
    np.testing.assert_allclose(relative(graph, "head", WORLD, 7).estimate.pose, se3.inverse(pose), atol=1e-12)
