"""What the scene graph promises over time, each in the toy world with exact truth and noisy estimates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from multicam.geometry import se3
from multicam.scenegraph.prune import is_whole
from multicam.scenegraph.query import relative
from tests.scenegraph.walking import CONFIG, NOISE, SLOW, Walked, go
from tests.strategies import seeds
from tests.toy_walk import HEADSET, LEFT, RIGHT, ToyWalk, make_walk

THERE_AND_BACK = [*np.linspace(0, 1, 8), 1.0, *np.linspace(1, 0, 8), 0.0]


def loiter(seed: int, steps: int = 20) -> tuple[np.random.Generator, ToyWalk]:
    """The headset stays at the left table."""
    rng = np.random.default_rng(seed)
    return rng, make_walk(rng, path=[0.0] * steps, step_ns=SLOW // 10)


def median(values: list[tuple[float, float]]) -> np.ndarray:
    return np.median(values, axis=0)


def test_evidence_accumulates_and_the_newest_pose_does_not_win():
    first, last, newest = [], [], []
    for seed in range(12):
        rng, walk = loiter(seed)
        walked = go(walk, rng, config=independent(), **NOISE)
        first.append(walked.in_headset(0, LEFT))
        last.append(walked.in_headset(19, LEFT))
        alone = replace(walk, steps=walk.steps[-1:])
        newest.append(go(alone, rng, **NOISE).in_headset(0, LEFT))
    # Twenty looks of independent errors, in theory 4.5 times better.
    assert np.all(median(last) < 0.4 * median(first))
    assert np.all(median(last) < 0.4 * median(newest))


def test_looks_that_err_alike_are_not_taken_for_independent_ones():
    for common, shrinks in ((0.0, True), (0.9, False)):
        rng, walk = loiter(3)
        config = replace(CONFIG, graph=replace(CONFIG.graph, common=common))
        walked = go(walk, rng, config=config, **NOISE)
        before, after = (np.trace(walked.results[n].camera(LEFT).covariance) for n in (0, 19))
        assert (after < 0.2 * before) == shrinks


def independent():
    """The configuration for estimates whose errors have nothing in common, as those of the toy world."""
    return replace(CONFIG, graph=replace(CONFIG.graph, common=0.0))


@pytest.mark.parametrize("drift", [0.0, 1.0, 3.0])
def test_error_bars_hold_whatever_the_drift_once_it_is_learnt(drift):
    squared = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        tracking = CONFIG.graph.tracking
        walk = make_walk(
            rng, path=np.tile(THERE_AND_BACK, 2), step_ns=SLOW,
            rotation_drift=drift * np.radians(tracking.drift_rotation_deg) * np.sqrt(2),
            translation_drift=drift * tracking.drift_translation * np.sqrt(2),
        )  # fmt: skip
        walked = go(walk, rng, **NOISE)
        squared += [walked.squared(n, name) for n in (19, 24, 29, 34) for name in (LEFT, RIGHT)]
    # 95 % of a chi-square variable with 6 degrees of freedom.
    assert 0.82 < np.mean(np.array(squared) < 12.59) <= 1.0


def test_cameras_that_never_share_an_object_are_linked_through_the_headset():
    errors = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        walk = make_walk(rng, path=np.linspace(0, 1, 12), step_ns=SLOW)
        walked = go(walk, rng, **NOISE)
        assert walked.results[-1].camera(RIGHT).chain == (HEADSET, RIGHT)
        errors.append(walked.pair(-1))
        pair = relative(walked.graphs[-1], LEFT, RIGHT)
        assert pair is not None
        poses = walked.results[-1].camera
        expected = se3.inverse(poses(LEFT).world_from_camera) @ poses(RIGHT).world_from_camera
        np.testing.assert_allclose(pair.pose, expected, atol=0.005)
    # They stand 2.4 m apart, so half a degree is worth 20 mm.
    rotation, translation = median(errors)
    assert np.degrees(rotation) < 1.0
    assert translation < 0.04


def test_the_drift_of_the_headset_is_estimated():
    drifted, left = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        walk = make_walk(rng, path=THERE_AND_BACK, step_ns=SLOW, rotation_drift=0.01, translation_drift=0.02)
        walked = go(walk, rng, **NOISE)
        drifted.append(walked.tracked(-1))
        left.append(walked.headset(-1))
        moment, drift = walk.steps[-1], walked.results[-1].world_from_tracking
        true = moment.world.world_from_camera[HEADSET] @ se3.inverse(moment.tracked_world_from_headset)
        found = walked.results[-1].camera(HEADSET).world_from_camera
        np.testing.assert_allclose(drift @ moment.tracked_world_from_headset, found, atol=1e-9)
        assert np.linalg.norm(se3.minus(drift, true)) < np.linalg.norm(se3.log(true))
    # Back at the first table, the headset knows where it is again, up to the noise of its looks.
    assert np.all(median(left) < (0.5 * median(drifted)[0], 0.3 * median(drifted)[1]))


def test_how_much_the_headset_drifts_is_learnt():
    scales = {}
    for drift in (0.0, 4.0):
        rng = np.random.default_rng(1)
        tracking = CONFIG.graph.tracking
        walk = make_walk(
            rng, path=np.tile(THERE_AND_BACK, 2), step_ns=SLOW,
            rotation_drift=drift * np.radians(tracking.drift_rotation_deg) * np.sqrt(2),
            translation_drift=drift * tracking.drift_translation * np.sqrt(2),
        )  # fmt: skip
        scales[drift] = go(walk, rng, **NOISE).graphs[-1].drift_scale
    assert scales[0.0] < 1
    assert scales[4.0] > 4


@pytest.mark.parametrize(
    ("bump", "patience"),
    [((0.15, 0.05, 0.0, 0.1, 0.05, 0.0), 2), ((0.0, 0.08, 0.0, 0.05, 0.0, 0.02), 2), ((0.02, 0, 0, 0.01, 0, 0), 6)],
    ids=["10 cm", "5 cm", "1 cm and 1 deg"],
)
def test_a_bumped_camera_is_noticed_and_placed_anew(bump, patience):
    for seed in range(4):
        rng, walk = loiter(seed, 30)
        walked = go(walk.with_bump(LEFT, 12, bump), rng, config=independent(), **NOISE)
        truth = walked.graphs[11].places[LEFT]
        noticed = next(n for n, graph in enumerate(walked.graphs) if LEFT in graph.places and n >= 12
                       and graph.places[LEFT].since_ns > truth.since_ns)  # fmt: skip
        assert noticed < 12 + patience
        assert walked.in_headset(-1, LEFT)[1] < 0.005
        assert walked.status(LEFT)[noticed + 1 :] == ["placed"] * (29 - noticed)


def test_a_bump_that_hides_in_the_noise_of_every_look_is_noticed_by_many():
    noticed = 0
    for seed in range(4):
        rng, walk = loiter(seed, 40)
        walked = go(walk.with_bump(LEFT, 20, (0.02, 0, 0, 0.01, 0, 0)), rng, **NOISE)
        noticed += walked.graphs[-1].places[LEFT].since_ns > walked.graphs[19].places[LEFT].since_ns
        assert walked.in_headset(-1, LEFT)[1] < 0.008
    assert noticed >= 3


def test_before_a_bump_is_certain_the_old_place_is_kept_and_the_reason_says_so():
    rng, walk = loiter(0, 14)
    walked = go(walk.with_bump(LEFT, 12, (0.15, 0.05, 0.0, 0.1, 0.05, 0.0)), rng, **NOISE)
    suspected = walked.results[12].camera(LEFT)
    assert suspected.status == "kept"
    assert suspected.reason.startswith("it seems to have been moved")
    before = walked.results[11].camera(LEFT).world_from_camera
    np.testing.assert_allclose(suspected.world_from_camera, before, atol=6e-3)
    assert walked.results[13].camera(LEFT).status == "placed"


def test_a_bump_while_the_headset_is_elsewhere_is_noticed_all_the_same():
    errors = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        walk = make_walk(rng, path=[*np.linspace(0, 1, 10), *[1.0] * 6], step_ns=SLOW)
        walked = go(walk.with_bump(LEFT, 12, (0.15, 0.05, 0.0, 0.1, 0.05, 0.0)), rng, **NOISE)
        errors.append(walked.pair(-1))
        assert walked.results[-1].camera(LEFT).chain == (HEADSET, LEFT)
    assert median(errors)[1] < 0.04


def moved_and_not(seed: int, indices: tuple[int, ...], first: int, last: int, twist: tuple[float, ...]) -> list[Walked]:
    """The same walk twice, with some objects moved and with all left where they are."""
    walks = []
    for moving in (True, False):
        _, walk = loiter(seed, 30)
        noise = np.random.default_rng(1000 + seed)
        walks.append(go(walk.with_motion(indices, first, last, twist) if moving else walk, noise, **NOISE))
    return walks


@pytest.mark.parametrize("twist", [(0.3, 0.2, 0.5, 0.12, 0.0, 0.05), (0.0, 0.0, 0.0, 0.025, 0.0, 0.0)])
def test_a_moved_object_is_noticed_and_followed_and_places_nobody_meanwhile(twist):
    for seed in range(4):
        walked, still = moved_and_not(seed, (0,), 12, 12, twist)
        before = next(o for o in walked.results[11].objects if o.obj_id == walked.walk.steps[0].world.objects[0].obj_id)
        noticed = next(n for n, graph in enumerate(walked.graphs) if before.instance in graph.movers)
        assert noticed <= 15
        for n in (13, 16, 29):
            assert walked.in_headset(n, LEFT)[1] < still.in_headset(n, LEFT)[1] + 0.004
        after = next(o for o in walked.results[-1].objects if o.instance == before.instance)
        truth = walked.walk.steps[-1].world.objects[0]
        assert after.obj_id == truth.obj_id
        assert np.linalg.norm(after.world_from_object[:3, 3] - truth.world_from_object[:3, 3]) < 0.012
        # It was still for long enough to help again.
        assert before.instance not in walked.graphs[-1].movers


def test_an_object_in_hand_is_followed_and_places_nobody():
    for seed in range(4):
        walked, still = moved_and_not(seed, (2,), 10, 24, (0.05, 0.02, 0.0, 0.02, 0.01, 0.0))
        instance = next(
            o.instance for o in walked.results[9].objects if o.obj_id == walked.walk.steps[0].world.objects[2].obj_id
        )
        assert all(instance in graph.movers for graph in walked.graphs[14:25])
        for n in (14, 19, 24):
            carried = next(o for o in walked.results[n].objects if o.instance == instance)
            truth = walked.walk.steps[n].world.objects[2].world_from_object
            assert np.linalg.norm(carried.world_from_object[:3, 3] - truth[:3, 3]) < 0.03
            assert walked.in_headset(n, LEFT)[1] < still.in_headset(n, LEFT)[1] + 0.004


def test_a_camera_whose_objects_were_all_moved_one_by_one_stays_where_it_is():
    rng, walk = loiter(0, 60)
    for index in range(5):
        walk = walk.with_motion((index,), 8 + 10 * index, 8 + 10 * index, (0.0, 0.3, 0.0, 0.08, 0.0, 0.03))
    walked = go(walk, rng, **NOISE)
    assert set(walked.status(LEFT)) == {"placed"}
    assert len(walked.graphs[-1].places) == 1
    assert walked.in_headset(-1, LEFT)[1] < 0.012
    assert sum(not rest.over for rest in walked.graphs[-1].rests.values()) == 5


def test_tracking_that_jumps_is_noticed_and_the_headset_finds_itself_again():
    for seed in range(4):
        rng, walk = loiter(seed, 20)
        walked = go(walk.with_jump(10, (0.2, 0.0, 0.1, 0.3, 0.1, 0.0)), rng, **NOISE)
        assert walked.tracked(12)[1] > 0.2
        for n in (9, 12, 19):
            assert walked.headset(n)[1] < 0.02


def test_a_headset_that_lost_its_tracking_for_a_while_finds_itself_again():
    rng, walk = loiter(0, 20)
    walked = go(walk.with_jump(12, (0.2, 0.0, 0.1, 0.3, 0.1, 0.0)), rng, untracked=(8, 9, 10, 11), **NOISE)
    assert walked.status(HEADSET)[7:13] == ["tracked"] + ["placed"] * 4 + ["tracked"]
    # Without tracking it is known by one look at a time.
    for n, most in ((9, 0.03), (11, 0.03), (14, 0.03), (19, 0.015)):
        assert walked.headset(n)[1] < most


def test_a_third_of_gross_errors_hardly_moves_a_camera():
    rng, walk = loiter(0, 8)
    walked = go(walk, rng, outlier_fraction=0.0, **NOISE)
    wild = go(walk, np.random.default_rng(0), outlier_fraction=0.3, **NOISE)
    for n in range(2, 8):
        assert wild.in_headset(n, LEFT)[1] < 0.03
        assert walked.in_headset(n, LEFT)[1] < 0.03


def test_memory_does_not_grow_with_time():
    rng = np.random.default_rng(0)
    walk = make_walk(rng, path=np.tile(THERE_AND_BACK, 6), step_ns=SLOW)
    for n in range(12):
        walk = walk.with_motion((n % 5,), 4 + 8 * n, 4 + 8 * n, (0.0, 0.3, 0.0, 0.05, 0.0, 0.02))
    config = replace(CONFIG, graph=replace(
        CONFIG.graph, keyframes=replace(CONFIG.graph.keyframes, most=8),
        objects=replace(CONFIG.graph.objects, remember=4),
    ))  # fmt: skip
    walked = go(walk, rng, config=config, **NOISE)
    assert max(len(graph.keyframes) for graph in walked.graphs) <= 8
    assert max(sum(rest.over for rest in graph.rests.values()) for graph in walked.graphs) <= 5
    assert walked.pair(-1)[1] < 0.06


@settings(max_examples=6, deadline=None)
@given(seeds())
def test_whatever_happens_the_graph_holds_together(rng):
    path = np.clip(np.cumsum(rng.normal(scale=0.15, size=20)) + rng.uniform(), 0, 1)
    walk = make_walk(rng, path=path, step_ns=SLOW, rotation_drift=0.003, translation_drift=0.005)
    for at in rng.integers(1, 20, size=4).tolist():
        twist = np.concatenate((0.3 * rng.normal(size=3), 0.1 * rng.normal(size=3)))
        match rng.integers(4):
            case 0:
                walk = walk.with_bump(LEFT, at, twist)
            case 1:
                walk = walk.with_bump(RIGHT, at, 0.1 * twist)
            case 2:
                walk = walk.with_motion(rng.integers(10, size=3).tolist(), at, at + int(rng.integers(3)), twist)
            case _:
                walk = walk.with_jump(at, twist)
    untracked = tuple(rng.integers(20, size=4).tolist())
    walked = go(walk, rng, untracked=untracked, outlier_fraction=0.2, **NOISE)
    for graph, result in zip(walked.graphs, walked.results, strict=True):
        assert is_whole(graph)
        for camera in result.cameras:
            assert (camera.world_from_camera is None) == (camera.status == "not placed")
            if camera.covariance is not None and camera.camera_id != HEADSET:
                assert np.linalg.eigvalsh(camera.covariance).min() > 0
