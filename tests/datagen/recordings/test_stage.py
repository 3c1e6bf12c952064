"""Recordings before they are rendered: what lies where, what each camera can see, what is told of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.recordings import rehearsal
from datagen.recordings.board import solid_cloud
from datagen.recordings.config import BumpConfig, CarryConfig, ClockConfig, MoveConfig, SequenceConfig
from datagen.recordings.film import CAMERAS, HEADSET, LEFT, RIGHT
from datagen.recordings.foresight import foresee
from datagen.recordings.rehearsal import sample_stage
from datagen.recordings.sight import Sight, View, verify_sight
from datagen.recordings.stage import Stage
from datagen.scenes.stock import Stock
from multicam.dataset.sequence import group_by_time
from multicam.errors import ConfigError, DataError
from multicam.geometry import se3, so3
from tests.close import assert_close
from tests.toy_objects import PLATE, ROD

CONFIG = SequenceConfig(steps=12, rate_hz=2.0, width=64, height=48, samples=1)
NEAR = replace(CONFIG, layout="overlapping", distance=(0.35, 0.5), focal=0.75, width=960, height=540, board=True)
BUMPED = replace(NEAR, bump=BumpConfig(at_s=4.2, camera="right", shift_mm=25.0, turn_deg=2.0))


def in_picture(stage: Stage, stock: Stock, name: str, step: int) -> set[int]:
    """Objects of which a point of the surface lies in the picture; the points are 2 mm apart."""
    shot = CAMERAS.index(name) * stage.config.steps + step
    taken = stage.scene.shots[shot]
    found: set[int] = set()
    for index, item in enumerate(stage.scene.objects_in(shot)):
        pose = se3.inverse(taken.world_from_camera) @ item.world_from_object
        points = se3.act(pose, stock.bodies[item.obj_id].points)
        if taken.camera.contains(taken.camera.project(points[points[:, 2] > 0])).any():
            found.add(index)
    return found


def test_the_same_seed_gives_the_same_recording(stock: Stock) -> None:
    first, second, other = (sample_stage(replace(CONFIG, seed=seed), stock) for seed in (0, 0, 1))
    assert np.array_equal(first.scene.shots[5].world_from_camera, second.scene.shots[5].world_from_camera)
    assert first.cameras[0].frames[3].timestamp_ns == second.cameras[0].frames[3].timestamp_ns
    assert not np.array_equal(first.scene.shots[5].world_from_camera, other.scene.shots[5].world_from_camera)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("assembled", [False, True])
def test_no_class_and_no_vertex_is_in_sight_of_both_static_cameras(stock: Stock, seed: int, assembled: bool) -> None:
    stage = sample_stage(replace(CONFIG, seed=seed, assembled=assembled), stock)
    sight = {name: in_picture(stage, stock, name, 0) for name in (LEFT, RIGHT)}
    assert len(sight[LEFT]) >= 2
    assert len(sight[RIGHT]) >= 2
    assert not sight[LEFT] & sight[RIGHT]
    classes = {name: {stage.scene.objects[i].obj_id for i in seen} for name, seen in sight.items()}
    assert not classes[LEFT] & classes[RIGHT]
    if assembled:
        poses = {item.obj_id: item.world_from_object for item in stage.scene.objects}
        assert (se3.inverse(poses[PLATE]) @ poses[ROD])[2, 3] == pytest.approx(0.101)


def test_apart_holds_with_a_board_a_bump_and_things_in_motion(stock: Stock) -> None:
    events = {"bump": BumpConfig(at_s=3.0), "move": MoveConfig(at_s=2.0), "carry": CarryConfig(reach_mm=30.0)}
    stage = sample_stage(replace(NEAR, layout="apart", **events), stock)
    assert len(stage.motions) == 2
    for step in range(stage.config.steps):
        assert not in_picture(stage, stock, LEFT, step) & in_picture(stage, stock, RIGHT, step)


@pytest.mark.parametrize("distance", [(0.35, 0.5), (0.75, 1.0)])
def test_static_cameras_that_overlap_share_objects_at_their_distance(
    stock: Stock, distance: tuple[float, float]
) -> None:
    stage = sample_stage(replace(NEAR, distance=distance, focal=0.75 if distance[0] < 0.5 else 1.1), stock)
    assert len(in_picture(stage, stock, LEFT, 0) & in_picture(stage, stock, RIGHT, 0)) >= 2
    clouds = [se3.act(o.world_from_object, stock.meshes[o.obj_id].vertices) for o in stage.scene.objects]
    points = np.concatenate(clouds)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    eyes = [stage.scene.shots[k * stage.config.steps].world_from_camera[:3, 3] for k in range(3)]
    for eye in eyes[1:]:
        assert distance[0] - 1e-3 <= np.linalg.norm(eye - middle) <= distance[1] + 1e-3
    assert eyes[1][0] < eyes[2][0]
    # The head moves about; it keeps to the regime but for a hand's breadth.
    heads = [shot.world_from_camera[:3, 3] for shot in stage.scene.shots[: stage.config.steps]]
    nearest = [float(np.linalg.norm(points - eye, axis=1).min()) for eye in heads]
    assert distance[0] - 0.25 < min(nearest) < distance[1]


@pytest.mark.parametrize("seed", range(3))
def test_everything_lies_on_the_table_and_nothing_on_the_board(stock: Stock, seed: int) -> None:
    stage = sample_stage(replace(NEAR, seed=seed), stock)
    clouds = [se3.act(o.world_from_object, stock.bodies[o.obj_id].points) for o in stage.scene.objects]
    assert stage.board is not None
    clouds += [solid_cloud(solid) for solid in stage.scene.solids if solid_cloud(solid)[:, 2].max() > 0.005]
    for cloud in clouds:
        if np.abs(cloud).max() < 0.75:
            assert cloud[:, 2].min() == pytest.approx(0, abs=1e-6)
    panel = stage.board.solids[0]
    for item in stage.scene.objects:
        cloud = se3.act(item.world_from_object, stock.bodies[item.obj_id].points)
        local = np.abs(se3.act(se3.inverse(panel.world_from_solid), cloud))
        assert not (local < panel.size / 2).all(axis=1).any()


def test_a_bump_has_the_stated_size_and_time_and_stays(stock: Stock) -> None:
    stage = sample_stage(BUMPED, stock)
    poses = np.stack([shot.world_from_camera for shot in stage.scene.shots[2 * 12 :]])
    times = np.array([entry.timestamp_ns for entry in stage.cameras[2].frames])
    times = times - stage.truth.clock_offsets_ns[RIGHT]
    after = times >= 4_200_000_000
    assert 0 < after.sum() < 12
    for group in (poses[after], poses[~after]):
        assert_close(group, np.broadcast_to(group[0], group.shape), 0)
    knock = se3.inverse(poses[0]) @ poses[-1]
    assert np.linalg.norm(knock[:3, 3]) == pytest.approx(0.025)
    assert np.linalg.norm(so3.log(knock[:3, :3])) == pytest.approx(np.deg2rad(2.0))
    assert [(b.camera_id, b.timestamp_ns) for b in stage.truth.bumps] == [(RIGHT, 4_200_000_000)]
    # Rendered twice: before and after; the other static camera once.
    assert [len(set(stage.rendered_as[k * 12 : (k + 1) * 12])) for k in range(3)] == [12, 1, 2]


def test_a_static_picture_is_rendered_again_only_when_something_in_it_moved(stock: Stock) -> None:
    move = MoveConfig(at_s=2.2, seconds=1.0)
    stage = sample_stage(replace(NEAR, move=move), stock)
    (motion,) = stage.motions
    before = next(k for k in range(12) if stage.cameras[1].frames[k].timestamp_ns > 2.2e9)
    for name in (LEFT, RIGHT):
        shown = stage.rendered_as[CAMERAS.index(name) * 12 : (CAMERAS.index(name) + 1) * 12]
        assert len(set(shown[:before])) == 1
        assert len(set(shown)) in (3, 4, 5) if motion.index in in_picture(stage, stock, name, 0) else True
        assert all(shot == first for shot, first in zip(sorted(shown), shown, strict=True))
    # A lost frame is not written, but may stand for others.
    lossy = sample_stage(replace(NEAR, clocks=ClockConfig(lost=0.5)), stock)
    assert [len(camera.frames) for camera in lossy.cameras] == [6, 6, 6]
    assert len(lossy.scene.shots) == len(lossy.rendered_as) == 36


def test_clusters_too_close_to_part_are_refused(stock: Stock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "_ATTEMPTS", 2)
    with pytest.raises(DataError, match="raise"):
        sample_stage(replace(CONFIG, spacing=0.05), stock)


def test_clocks_are_apart_but_group_into_steps(stock: Stock) -> None:
    stage = sample_stage(CONFIG, stock)
    assert [len(group) for group in group_by_time(stage.cameras, 20_000_000)] == [3] * CONFIG.steps
    assert len({camera.frames[0].timestamp_ns for camera in stage.cameras}) == 3
    offsets = stage.truth.clock_offsets_ns
    assert offsets[HEADSET] == 0
    assert 0 < abs(offsets[LEFT]) <= 2_000_000


def test_what_is_foreseen_is_what_is_in_the_picture(stock: Stock) -> None:
    stage = sample_stage(BUMPED, stock)
    sight = foresee(stage, stock)
    for name in CAMERAS:
        for step in range(12):
            view = sight[name][step]
            # The small pictures miss what covers less than a pixel of theirs.
            assert view.objects.keys() <= in_picture(stage, stock, name, step)
            assert all(0 < fraction <= 1 for fraction in view.objects.values())
    assert max(view.corners for view in sight[HEADSET].values()) >= 8
    assert sight[LEFT][0].corners >= 8


def views(**steps: list[dict[int, float]]) -> Sight:
    return {name: {k: View(seen, 12) for k, seen in enumerate(row)} for name, row in steps.items()}


def test_each_broken_promise_about_sight_is_named(stock: Stock) -> None:
    stage = sample_stage(CONFIG, stock)
    seen: dict[str, list[dict[int, float]]] = {
        HEADSET: [{0: 1.0, 1: 0.9}, {4: 0.8, 5: 0.9}],
        LEFT: [{0: 1.0, 1: 1.0}] * 2,
        RIGHT: [{4: 1.0, 5: 1.0}] * 2,
    }
    verify_sight(views(**seen), stage)
    with pytest.raises(DataError, match=r"both see objects of class .* at step 1"):
        verify_sight(views(**seen | {LEFT: [{0: 1.0, 1: 1.0}, {0: 1.0, 5: 0.001}]}), stage)
    with pytest.raises(DataError, match="at most 1 objects with camera right"):
        verify_sight(views(**seen | {HEADSET: [{0: 1.0, 1: 0.9}, {4: 0.8, 5: 0.2}]}), stage)
    with pytest.raises(DataError, match="camera left all the time"):
        verify_sight(views(**seen | {HEADSET: [{0: 1.0, 1: 0.9}, {0: 1.0, 1: 0.9, 4: 0.8, 5: 0.9}]}), stage)


def test_each_broken_promise_about_overlap_board_and_events_is_named(stock: Stock) -> None:
    stage = sample_stage(replace(BUMPED, move=MoveConfig(at_s=2.2), carry=CarryConfig(reach_mm=20.0)), stock)
    everything = dict.fromkeys(range(len(stage.scene.objects)), 1.0)
    put, carried = (motion.index for motion in stage.motions)
    good: dict[str, list[dict[int, float]]] = {name: [everything] * 12 for name in CAMERAS}
    verify_sight(views(**good), stage)

    def refused(changed: Sight) -> str:
        with pytest.raises(DataError) as caught:
            verify_sight(changed, stage)
        return str(caught.value)

    little = {0: 1.0}
    some = [everything] * 9 + [little] * 3
    assert "left and right share 2 objects or more at only 9 of 12 steps" in refused(views(**good | {LEFT: some}))
    blind = {name: {k: View(v.objects, 5) for k, v in row.items()} for name, row in views(**good).items()}
    assert "camera headset sees at most 5 corners" in refused(blind)
    without = [{i: v for i, v in everything.items() if i != put}] * 6
    message = refused(views(**good | {LEFT: [everything] * 6 + without, RIGHT: [everything] * 6 + without}))
    assert "before and after it; change move.at_s" in message
    rarely = [everything] * 5 + [{i: v for i, v in everything.items() if i != carried}] * 7
    assert "well seen by a static camera at only 42%" in refused(views(**good | {LEFT: rarely, RIGHT: rarely}))


def test_the_bumped_camera_must_see_objects_before_and_after(stock: Stock) -> None:
    stage = sample_stage(BUMPED, stock)
    everything = dict.fromkeys(range(len(stage.scene.objects)), 1.0)
    sight = views(**{name: [everything] * 12 for name in CAMERAS})
    sight[RIGHT] = {step: view for step, view in sight[RIGHT].items() if step < 5}
    with pytest.raises(DataError, match="bumped camera right does not see 2 objects before and after"):
        verify_sight(sight, stage)


def test_impossible_configurations_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"move.at_s is 6.0; the recording lasts from 0 to 6 s"):
        replace(CONFIG, move=MoveConfig(at_s=6.0))
    with pytest.raises(ConfigError, match=r"move ends 1.2 s after 5 s; the recording is over at 6 s"):
        replace(CONFIG, move=MoveConfig(at_s=5.0))
    with pytest.raises(ConfigError, match=r"bump.at_s is -1"):
        replace(CONFIG, bump=BumpConfig(at_s=-1))
    with pytest.raises(ConfigError, match=r"clocks.lost is 1.0"):
        replace(CONFIG, clocks=ClockConfig(lost=1.0))
    with pytest.raises(ConfigError, match="distance must be two positive numbers"):
        replace(CONFIG, distance=(0.5, 0.4))


def test_the_standing_recordings_are_what_their_names_say() -> None:
    from multicam.config import load_config

    files = sorted((Path(__file__).parents[3] / "configs" / "datagen" / "rig").glob("*.yaml"))
    assert len(files) >= 6
    configs = {path.stem: load_config(SequenceConfig, path) for path in files}
    assert len({config.seed for config in configs.values()}) == len(files)
    for name, config in configs.items():
        assert (config.steps, config.width, config.height, config.board) == (40, 960, 540, True)
        assert config.distance == ((0.35, 0.5) if name.startswith("near") else (0.75, 1.0))
        assert config.layout in name
        assert ("bumped" in name) == (config.bump.at_s is not None)
        assert ("moved" in name) == (config.move.at_s is not None)
        assert ("carried" in name) == (config.carry.reach_mm > 0)
