"""Recordings: how cameras move and stand, and what they see."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.recordings.config import DriftConfig, SequenceConfig
from datagen.recordings.record import Sight, record, verify_sight
from datagen.recordings.stage import CAMERAS, HEADSET, LEFT, RIGHT, sample_stage
from datagen.recordings.trajectories import exposure_times, sample_headset, tracked_poses
from datagen.scenes.stock import Stock
from multicam.dataset.sequence import group_by_time, load_recording
from multicam.errors import DataError
from multicam.geometry import se3, so3
from tests.toy_objects import PLATE, ROD

CONFIG = SequenceConfig(steps=12, rate_hz=2.0, width=64, height=48, samples=1)


def test_the_same_seed_gives_the_same_recording(stock: Stock) -> None:
    first, second, other = (sample_stage(replace(CONFIG, seed=seed), stock) for seed in (0, 0, 1))
    assert np.array_equal(first.scene.shots[5].world_from_camera, second.scene.shots[5].world_from_camera)
    assert first.cameras[0].frames[3].timestamp_ns == second.cameras[0].frames[3].timestamp_ns
    assert not np.array_equal(first.scene.shots[5].world_from_camera, other.scene.shots[5].world_from_camera)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("assembled", [False, True])
def test_no_class_and_no_vertex_is_in_sight_of_both_static_cameras(stock: Stock, seed: int, assembled: bool) -> None:
    stage = sample_stage(replace(CONFIG, seed=seed, assembled=assembled), stock)
    sight: dict[str, set[int]] = {LEFT: set(), RIGHT: set()}
    for name, seen in sight.items():
        shot = stage.scene.shots[CAMERAS.index(name) * CONFIG.steps]
        for index, item in enumerate(stage.scene.objects):
            pose = se3.inverse(shot.world_from_camera) @ item.world_from_object
            points = se3.act(pose, stock.meshes[item.obj_id].vertices)
            front = points[:, 2] > 0
            if shot.camera.contains(shot.camera.project(points[front])).any():
                seen.add(index)
    assert len(sight[LEFT]) >= 2
    assert len(sight[RIGHT]) >= 2
    assert not sight[LEFT] & sight[RIGHT]
    classes = {name: {stage.scene.objects[i].obj_id for i in seen} for name, seen in sight.items()}
    assert not classes[LEFT] & classes[RIGHT]
    if assembled:
        poses = {item.obj_id: item.world_from_object for item in stage.scene.objects}
        assert (se3.inverse(poses[PLATE]) @ poses[ROD])[2, 3] == pytest.approx(0.101)


def test_clusters_too_close_to_part_are_refused(stock: Stock) -> None:
    with pytest.raises(DataError, match="raise spacing"):
        sample_stage(replace(CONFIG, spacing=0.05), stock)


def test_the_headset_moves_like_a_head(rng: np.random.Generator) -> None:
    path = sample_headset(replace(CONFIG, steps=40, rate_hz=5.0), rng)
    times = np.arange(0, 8, 0.01)
    poses = np.stack([path.world_from_camera(float(t)) for t in times])
    steps = se3.minus(poses[1:], poses[:-1]) / 0.01
    speed, turning = np.linalg.norm(steps[:, 3:], axis=1), np.linalg.norm(steps[:, :3], axis=1)
    assert 0.01 < speed.mean() < speed.max() < 1.0
    assert turning.max() < np.deg2rad(120)
    # It begins at the left, is at the right in the middle, and never tilts far.
    assert poses[0][0, 3] < -0.2 < 0.2 < poses[400][0, 3]
    assert np.abs(poses[:, 2, 0]).max() < np.sin(np.deg2rad(12))


def test_without_errors_tracking_is_the_truth(rng: np.random.Generator) -> None:
    truth = se3.random(rng, 9)
    none = DriftConfig(0.0, 0.0, 0.0, 0.0)
    assert np.allclose(tracked_poses(truth, np.arange(9.0), none, rng), truth)


def test_drift_has_the_stated_size(rng: np.random.Generator) -> None:
    still, times = np.broadcast_to(np.eye(4), (12, 4, 4)), 0.2 * np.arange(12)
    walk = DriftConfig(0.0, 0.0, 0.0, translation_walk_mm=2.0)
    ends = np.stack([tracked_poses(still, times, walk, rng)[-1] for _ in range(150)])
    assert np.std(ends[:, :3, 3]) == pytest.approx(2e-3 * np.sqrt(times[-1]), rel=0.1)
    bias = DriftConfig(0.0, translation_bias_mm=1.0, rotation_walk_deg=0.0, translation_walk_mm=0.0)
    end = tracked_poses(still, times, bias, rng)[-1]
    assert np.linalg.norm(end[:3, 3]) == pytest.approx(1e-3 * times[-1])
    turn = DriftConfig(rotation_bias_deg=0.5, translation_bias_mm=0.0, rotation_walk_deg=0.0, translation_walk_mm=0.0)
    end = tracked_poses(still, times, turn, rng)[-1]
    assert np.linalg.norm(so3.log(end[:3, :3])) == pytest.approx(np.deg2rad(0.5) * times[-1])


def test_clocks_are_apart_but_group_into_steps(stock: Stock, rng: np.random.Generator) -> None:
    wild = replace(CONFIG, clock_jitter_ms=500.0)
    assert np.all(np.diff(exposure_times(wild, rng)) > 0)
    stage = sample_stage(CONFIG, stock)
    groups = group_by_time(stage.cameras, 20_000_000)
    assert [len(group) for group in groups] == [3] * CONFIG.steps
    starts = [camera.frames[0].timestamp_ns for camera in stage.cameras]
    assert len(set(starts)) == 3


def test_each_broken_promise_about_sight_is_named(stock: Stock) -> None:
    stage = sample_stage(CONFIG, stock)
    good: Sight = {
        HEADSET: [{0: 1.0, 1: 0.9}, {4: 0.8, 5: 0.9}],
        LEFT: [{0: 1.0, 1: 1.0}] * 2,
        RIGHT: [{4: 1.0, 5: 1.0}] * 2,
    }
    verify_sight(good, stage)
    with pytest.raises(DataError, match=r"both see objects of class .* at step 1"):
        verify_sight(good | {LEFT: [{0: 1.0, 1: 1.0}, {0: 1.0, 5: 0.001}]}, stage)
    with pytest.raises(DataError, match="at most 1 objects with camera right"):
        verify_sight(good | {HEADSET: [{0: 1.0, 1: 0.9}, {4: 0.8, 5: 0.2}]}, stage)
    with pytest.raises(DataError, match="camera left all the time"):
        verify_sight(good | {HEADSET: [{0: 1.0, 1: 0.9}, {0: 1.0, 1: 0.9, 4: 0.8, 5: 0.9}]}, stage)


@pytest.mark.blender
def test_a_recording_is_rendered_and_reads_back(models: Path, tmp_path: Path) -> None:
    config = replace(CONFIG, models=models, output=tmp_path / "recording", seed=1)
    record(config)
    recording = load_recording(config.output)
    assert [(c.camera_id, c.moving) for c in recording.cameras] == [(HEADSET, True), (LEFT, False), (RIGHT, False)]
    frame_sets = list(recording.frame_sets())
    assert len(frame_sets) == CONFIG.steps
    assert all(len(frame_set.frames) == 3 for frame_set in frame_sets)
    assert recording.catalogue[1].keypoints is not None
    headset, left, _ = recording.cameras
    start, end = headset.frames[0], headset.frames[-1]
    assert start.tracked_world_from_camera is not None
    assert end.tracked_world_from_camera is not None
    assert np.allclose(start.tracked_world_from_camera, recording.truth_of(HEADSET, start.im_id), atol=1e-9)
    off = np.linalg.norm((end.tracked_world_from_camera - recording.truth_of(HEADSET, end.im_id))[:3, 3])
    assert 1e-4 < off < 0.1
    # A static camera's pictures differ by their noise alone.
    first, second = (recording.load_frame(left, left.frames[i]).image.astype(int) for i in (0, 1))
    assert np.array_equal(recording.truth_of(LEFT, 0), recording.truth_of(LEFT, 11))
    assert 0 < np.abs(first - second).mean() < 6
    # Run again: nothing to do, nothing changes.
    before = (config.output / "sequence.json").read_bytes()
    record(config)
    assert (config.output / "sequence.json").read_bytes() == before
