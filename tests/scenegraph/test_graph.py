"""The parts of the scene graph one by one."""

from dataclasses import replace

import numpy as np
import pytest

from multicam.errors import DataError
from multicam.geometry import se3
from multicam.scenegraph.config import GraphConfig, KeyframeConfig
from multicam.scenegraph.edge import Edge
from multicam.scenegraph.expectation import in_picture
from multicam.scenegraph.graph import Rest, SceneGraph, Stay
from multicam.scenegraph.keyframe import cull, haste, join, keep, track
from multicam.scenegraph.prune import is_whole, prune
from multicam.scenegraph.query import chain, relative
from multicam.scenegraph.solution import reached, solve
from multicam.scenegraph.uncertain import UncertainPose, isotropic

NOISE = isotropic(0.02, 0.004)
CONFIG = GraphConfig()
SECOND = 1_000_000_000
WORLD_FROM_OBJECT = se3.exp(np.array([0.1, -0.2, 0.3, 0.2, 0.1, 0.9]))


def sight(pose: np.ndarray, covariance: np.ndarray = NOISE, time: int = 0, config: GraphConfig = CONFIG) -> Edge:
    return Edge.of(UncertainPose(pose, covariance), time, config)


def rest(number: int, **options) -> Rest:
    pose = se3.plus(WORLD_FROM_OBJECT, np.array([0.2 * number, 0, 0, 0.1 * number, 0, 0]))
    return Rest(number, 1, np.zeros(3), pose, 0.9, 0, **options)


def seen_from(world_from_camera: np.ndarray, rests: dict[int, Rest], numbers: tuple[int, ...]) -> dict[int, Edge]:
    camera_from_world = se3.inverse(world_from_camera)
    return {n: sight(camera_from_world @ rests[n].world_from_object) for n in numbers}


def make_graph(rng: np.random.Generator) -> SceneGraph:
    """Two keyframes tied by tracking alone; one camera at each end; a third that shares objects with the second."""
    rests = {n: rest(n) for n in range(6)}
    poses = dict(zip("ABlmr", se3.random(rng, 5), strict=True))
    motion = UncertainPose(se3.inverse(poses["A"]) @ poses["B"], isotropic(0.003, 0.002))
    first = Stay("head", 0, 0, poses["A"], seen_from(poses["A"], rests, (0, 1)))
    second = Stay("head", SECOND, SECOND, poses["B"], seen_from(poses["B"], rests, (2, 3)), motion)
    places = {
        "left": Stay("left", 0, 0, poses["l"], seen_from(poses["l"], rests, (0, 1))),
        "middle": Stay("middle", 0, 0, poses["m"], seen_from(poses["m"], rests, (2, 3, 4, 5))),
        "right": Stay("right", 0, 0, poses["r"], seen_from(poses["r"], rests, (4, 5))),
    }
    return SceneGraph("head", ("left", "middle", "right"), keyframes=(first, second), places=places, rests=rests)


def test_camera_names_must_differ_and_leave_the_world_its_own():
    with pytest.raises(DataError, match="must differ"):
        SceneGraph("head", ("left", "left"))
    with pytest.raises(DataError, match='none may be "world"'):
        SceneGraph("head", ("world",))


def test_stays_come_back_as_they_were_given(rng):
    graph = make_graph(rng)
    graph = replace(graph, now=graph.keyframes[1], former=(graph.places["left"],))
    same = graph.with_stays(graph.stays)
    assert same.stays == graph.stays
    for name in ("head", "left", "middle", "right"):
        assert graph.stays[graph.index_of(name)] is graph.stay_of(name)
    assert replace(graph, now=None).index_of("head") is None
    assert graph.index_of("nobody") is None


@pytest.mark.parametrize("common", [0.0, 0.4])
def test_only_what_looks_do_not_share_is_averaged(common):
    config = replace(CONFIG, common=common)
    edge = sight(WORLD_FROM_OBJECT, config=config)
    for n in range(1, 10):
        edge = edge.joined(sight(WORLD_FROM_OBJECT, time=n * SECOND, config=config), config)
    np.testing.assert_allclose(edge.estimate.covariance, (common + (1 - common) / 10) * NOISE, rtol=1e-6, atol=1e-15)
    assert (edge.looks, edge.first_ns, edge.last_ns) == (10, 0, 9 * SECOND)


def test_the_mean_of_looks_does_not_depend_on_how_they_were_joined(rng):
    looks = [sight(se3.plus(WORLD_FROM_OBJECT, 0.01 * rng.normal(size=6)), time=n) for n in range(4)]
    one_by_one = looks[0]
    for look in looks[1:]:
        one_by_one = one_by_one.joined(look, CONFIG)
    in_pairs = looks[0].joined(looks[1], CONFIG).joined(looks[2].joined(looks[3], CONFIG), CONFIG)
    np.testing.assert_allclose(in_pairs.mean.pose, one_by_one.mean.pose, atol=1e-5)
    np.testing.assert_allclose(in_pairs.estimate.covariance, one_by_one.estimate.covariance, rtol=1e-2, atol=1e-9)


def test_a_shift_shows_in_recent_looks_long_before_the_mean_follows():
    edge = sight(WORLD_FROM_OBJECT)
    for n in range(1, 30):
        edge = edge.joined(sight(WORLD_FROM_OBJECT, time=n), CONFIG)
    assert edge.shift() < 1e-6
    elsewhere = se3.plus(WORLD_FROM_OBJECT, np.array([0, 0, 0, 0.018, 0, 0]))
    shifts = []
    for n in range(30, 36):
        edge = edge.joined(sight(elsewhere, time=n), CONFIG)
        shifts.append(edge.shift())
    assert shifts == sorted(shifts)
    assert shifts[-1] > CONFIG.change.gate > shifts[0]
    assert se3.minus(edge.mean.pose, WORLD_FROM_OBJECT)[3] < 0.004


def test_a_solution_leaves_exact_poses_alone_and_mends_disturbed_ones(rng):
    graph = make_graph(rng)
    exact = solve(graph).graph
    for before, after in zip(graph.stays, exact.stays, strict=True):
        np.testing.assert_allclose(after.world_from_camera, before.world_from_camera, atol=1e-9)
    stays = tuple(
        replace(s, world_from_camera=se3.plus(s.world_from_camera, 0.05 * (n > 0) * rng.normal(size=6)))
        for n, s in enumerate(graph.stays)
    )
    patient = replace(CONFIG, solver=replace(CONFIG.solver, iterations=50, tolerance=1e-10))
    mended = solve(replace(graph.with_stays(stays), config=patient)).graph
    for before, after in zip(graph.stays, mended.stays, strict=True):
        np.testing.assert_allclose(after.world_from_camera, before.world_from_camera, atol=1e-6)


@pytest.mark.parametrize(
    ("common", "turn", "least", "most"), [(0.0, 0.1, 0.8, 0.9), (0.9, 0.1, 0.95, 1.0), (0.9, 1.0, 0.8, 0.9)]
)
def test_views_from_like_directions_count_as_fewer(common, turn, least, most):
    config, rests = replace(CONFIG, common=common), {n: rest(n) for n in range(3)}
    around = rests[1].world_from_object
    poses = [np.eye(4), around @ se3.exp(np.array([0, turn, 0, 0, 0, 0])) @ se3.inverse(around)]
    places = {"far": Stay("far", 0, 0, np.eye(4), seen_from(np.eye(4), rests, (0, 1, 2)))}
    # So far off that nothing but the two keyframes looks from a like direction.
    behind = around @ se3.exp(np.array([0, 3.0, 0, 0, 0, 0])) @ se3.inverse(around)
    places["far"] = replace(places["far"], world_from_camera=behind, edges=seen_from(behind, rests, (0, 1, 2)))
    sharp = isotropic(1e-4, 1e-4)
    views = [
        Stay("head", n, n, pose, seen_from(pose, rests, (0, 1, 2)), UncertainPose(pose, sharp) if n else None)
        for n, pose in enumerate(poses)
    ]
    spreads = []
    for keyframes in (views[:1], views):
        graph = SceneGraph("head", ("far",), config=config, keyframes=tuple(keyframes), places=places, rests=rests)
        cameras, _ = solve(graph).seen_from(0)
        # The far camera's own errors are the same in both, so that twice as many looks give a factor of 0.87.
        spreads.append(np.sqrt(np.trace(cameras[graph.index_of("far")])))
    assert least < spreads[1] / spreads[0] < most


def test_what_hangs_together_is_found_over_objects_and_tracking(rng):
    graph = make_graph(rng)
    assert reached(graph) == set(range(5))
    broken = replace(graph, keyframes=(graph.keyframes[0], replace(graph.keyframes[1], odometry=None)))
    assert [graph.stays[n].camera_id for n in sorted(reached(broken))] == ["head", "left"]
    assert not is_whole(broken)


def test_the_chain_names_the_cameras_in_between(rng):
    graph = make_graph(rng)
    assert chain(graph, "left") == ("head", "left")
    assert chain(graph, "right") == ("head", "middle", "right")
    assert chain(graph, "nobody") == ()
    tracked = replace(graph, now=replace(graph.keyframes[1], since_ns=2 * SECOND))
    assert chain(tracked, "head") == ("head",)


def test_cameras_at_both_ends_are_less_sure_of_each_other_than_neighbours(rng):
    graph = make_graph(rng)
    pairs = {name: relative(graph, "left", name) for name in ("middle", "right")}
    near = relative(graph, "middle", "right")
    truth = se3.inverse(graph.places["left"].world_from_camera) @ graph.places["right"].world_from_camera
    np.testing.assert_allclose(pairs["right"].pose, truth, atol=1e-6)
    assert np.linalg.det(near.covariance) < np.linalg.det(pairs["middle"].covariance)
    assert np.linalg.det(pairs["middle"].covariance) < np.linalg.det(pairs["right"].covariance)
    assert relative(graph, "left", "nobody") is None


def test_a_relative_pose_seen_from_the_other_side_is_the_inverse(rng):
    graph = make_graph(rng)
    there, back = relative(graph, "left", "right"), relative(graph, "right", "left")
    np.testing.assert_allclose(there.inverse().pose, back.pose, atol=1e-9)
    np.testing.assert_allclose(there.inverse().covariance, back.covariance, rtol=1e-3, atol=1e-9)


def test_drift_gathers_while_the_headset_moves_and_lies_where_it_is():
    graph = SceneGraph("head", ())
    step = se3.exp(np.array([0, 0, 0, 0.1, 0, 0]))
    pose = np.eye(4)
    for n in range(5):
        graph, _ = track(graph, 2 * n * SECOND, pose)
        pose = pose @ step
    found = graph.tracking.since_keyframe
    np.testing.assert_allclose(found.pose, np.linalg.matrix_power(step, 4), atol=1e-12)
    rate = 2 * graph.config.tracking.drift_per_second
    levers = [se3.adjoint(se3.inverse(np.linalg.matrix_power(step, n))) for n in range(4)]
    np.testing.assert_allclose(found.covariance, sum(a @ rate @ a.T for a in levers), atol=1e-15)


def test_haste_is_told_in_plain_words():
    config = KeyframeConfig()
    assert haste(se3.exp(np.array([0, 0, 0, 0.02, 0, 0])), 0.1, config) == ""
    assert haste(se3.exp(np.array([0, 0, 0, 0.05, 0, 0])), 0.1, config) == (
        "the headset moves too fast (0.50 m/s, 0 deg/s)"
    )
    assert haste(se3.exp(np.array([0.1, 0, 0, 0, 0, 0])), 0.1, config) == (
        "the headset moves too fast (0.00 m/s, 57 deg/s)"
    )


def test_looks_from_nearby_join_a_keyframe_where_it_stands():
    into_from_other = se3.exp(np.array([0.05, 0, 0, 0.03, 0, 0]))
    into = Stay("head", 0, 0, np.eye(4), {0: sight(WORLD_FROM_OBJECT)})
    other = Stay("head", 1, 1, into_from_other, {
        0: sight(se3.inverse(into_from_other) @ WORLD_FROM_OBJECT), 1: sight(WORLD_FROM_OBJECT),
    })  # fmt: skip
    joined = join(into, other, UncertainPose(into_from_other, isotropic(1e-4, 1e-4)), CONFIG)
    np.testing.assert_allclose(joined.edges[0].mean.pose, WORLD_FROM_OBJECT, atol=1e-9)
    np.testing.assert_allclose(joined.edges[1].mean.pose, into_from_other @ WORLD_FROM_OBJECT, atol=1e-9)
    assert joined.edges[0].looks == 2
    # What is carried over is less certain by the motion.
    assert np.trace(joined.edges[1].mean.covariance) > np.trace(other.edges[1].mean.covariance)


def test_a_new_view_becomes_a_keyframe_and_much_the_same_joins_the_last():
    graph, count = SceneGraph("head", ()), []
    rests = {n: rest(n) for n in range(3)}
    graph = replace(graph, rests=rests)
    for n, x in enumerate((0.0, 0.02, 0.04, 0.3)):
        pose = np.eye(4)
        pose[0, 3] = x
        graph, _ = track(graph, n * SECOND, pose)
        graph = replace(graph, now=replace(graph.now, edges=seen_from(pose, rests, (0, 1, 2))))
        graph = keep(graph, tracked=True)
        count.append((len(graph.keyframes), graph.keyframes[-1].edges[0].looks))
    assert count == [(1, 1), (1, 2), (1, 3), (2, 1)]
    np.testing.assert_allclose(graph.keyframes[1].odometry.pose[0, 3], 0.3, atol=1e-12)


def test_joined_keyframes_lose_no_look_and_the_path_stays_whole(rng):
    rests = {n: rest(n) for n in range(8)}
    keyframes, before = [], np.eye(4)
    for n, x in enumerate((0.0, 0.5, 0.52, 1.0, 1.5, 2.0)):
        pose = se3.exp(np.array([0.1 * n, 0, 0, x, 0, 0]))
        odometry = UncertainPose(se3.inverse(before) @ pose, isotropic(0.001, 0.001)) if n else None
        keyframes.append(Stay("head", n, n, pose, seen_from(pose, rests, (n, n + 1)), odometry))
        before = pose
    few = replace(CONFIG, keyframes=KeyframeConfig(most=4))
    graph = SceneGraph("head", (), config=few, keyframes=tuple(keyframes), rests=rests)
    culled = cull(graph)
    assert len(culled.keyframes) == 4
    assert culled.keyframes[0].since_ns == 0
    assert culled.keyframes[-1] is keyframes[-1]
    assert sum(e.looks for k in culled.keyframes for e in k.edges.values()) == 12
    for earlier, later in zip(culled.keyframes, culled.keyframes[1:], strict=False):
        motion = se3.inverse(earlier.world_from_camera) @ later.world_from_camera
        np.testing.assert_allclose(later.odometry.pose, motion, atol=1e-9)
    assert is_whole(replace(culled, rests={n: r for n, r in rests.items() if n < 7}))


def test_places_that_are_over_are_kept_while_they_hold_others_together(rng):
    graph = make_graph(rng)
    over = {n: replace(r, over=n in (0, 1), seen_ns=SECOND) for n, r in graph.rests.items()}
    # The left camera hangs on two rests that are over; one of them would do.
    little = replace(CONFIG, objects=replace(CONFIG.objects, remember=0))
    kept = prune(replace(graph, rests=over, config=little), SECOND)
    assert len(set(kept.rests) & {0, 1}) == 1
    assert is_whole(kept)


def test_an_object_that_nobody_sees_for_long_is_no_longer_expected(rng):
    graph = make_graph(rng)
    wait = int(CONFIG.objects.forget_after) * SECOND
    known = replace(graph, rests={n: replace(r, sightings=2) for n, r in graph.rests.items()})
    assert not any(r.over for r in prune(known, wait).rests.values())
    assert all(r.over for r in prune(known, wait + SECOND).rests.values())


def test_a_false_detection_is_soon_forgotten(rng):
    graph = make_graph(rng)
    stay = replace(graph.places["left"], edges={**graph.places["left"].edges, 9: sight(WORLD_FROM_OBJECT)})
    graph = replace(graph.with_rest(9, rest(9)), places={**graph.places, "left": stay})
    wait = int(CONFIG.objects.doubt_after * SECOND)
    assert 9 in prune(graph, wait).rests
    assert 9 not in prune(graph, wait + 1).rests
    assert 9 not in prune(graph, wait + 1).places["left"].edges


def test_a_point_is_in_the_picture_if_it_lies_before_the_camera_and_projects_into_it():
    matrix = np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]])
    points = np.array([[0, 0, 1.0], [0.5, 0, 1.0], [0.6, 0, 1.0], [0, 0.45, 1.0], [0, 0, -1.0]])
    assert in_picture(points, matrix).tolist() == [True, True, False, False, False]
    assert not in_picture(points, None).any()
