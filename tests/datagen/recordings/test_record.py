"""A recording rendered, read back and continued."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.recordings.config import BumpConfig, ClockConfig, MoveConfig, SequenceConfig
from datagen.recordings.film import HEADSET, LEFT, RIGHT
from datagen.recordings.record import record
from datagen.recordings.tracking import tracking_errors
from multicam.dataset.bop_reader import read_depth
from multicam.dataset.sequence import Recording, load_recording
from multicam.types import FloatArray

pytestmark = pytest.mark.blender

CONFIG = SequenceConfig(
    steps=8,
    rate_hz=2.0,
    layout="overlapping",
    distance=(0.5, 0.7),
    width=64,
    height=48,
    samples=1,
    clocks=ClockConfig(lost=0.25),
    bump=BumpConfig(at_s=3.1),
    move=MoveConfig(at_s=1.1, seconds=0.0),
)


@pytest.fixture(scope="module")
def rendered(models: Path, tmp_path_factory: pytest.TempPathFactory) -> SequenceConfig:
    config = replace(CONFIG, models=models, output=tmp_path_factory.mktemp("rendered") / "recording")
    record(config)
    return config


def test_a_recording_reads_back(rendered: SequenceConfig) -> None:
    recording = load_recording(rendered.output)
    assert [(c.camera_id, c.moving, c.rate_hz) for c in recording.cameras] == [
        (HEADSET, True, 2.0),
        (LEFT, False, 2.0),
        (RIGHT, False, 2.0),
    ]
    # Two of eight frames of each camera were lost: neither listed nor rendered.
    for camera in recording.cameras:
        assert len(camera.frames) == 6
        assert len(list((rendered.output / "test" / f"{camera.scene_id:06d}" / "rgb").iterdir())) == 6
    assert sum(len(group.frames) for group in recording.frame_sets()) == 18
    assert recording.tracking == tracking_errors(rendered.drift)
    assert recording.board is None
    headset = recording.cameras[0]
    start, end = headset.frames[0], headset.frames[-1]
    assert start.tracked_world_from_camera is not None
    assert end.tracked_world_from_camera is not None
    assert np.allclose(start.tracked_world_from_camera, recording.truth_of(HEADSET, start.im_id), atol=1e-9)
    off = np.linalg.norm((end.tracked_world_from_camera - recording.truth_of(HEADSET, end.im_id))[:3, 3])
    assert 1e-4 < off < 0.1


def test_events_are_in_the_labels_and_in_the_truth_alone(rendered: SequenceConfig) -> None:
    recording = load_recording(rendered.output)
    truth = recording.truth
    assert truth is not None
    (bump,), (motion,) = truth.bumps, truth.motions
    left = recording.cameras[1]
    poses = np.stack([recording.truth_of(LEFT, entry.im_id) for entry in left.frames])
    times = np.array([entry.timestamp_ns for entry in left.frames]) - truth.clock_offsets_ns[LEFT]
    assert np.array_equal(times >= bump.timestamp_ns, [not np.allclose(pose, poses[0]) for pose in poses])
    places = _places(recording, motion.obj_id)
    moved = np.linalg.norm(places[-1][1] - places[0][1])
    assert CONFIG.move.distance[0] <= moved <= CONFIG.move.distance[1]
    for time, place in places:
        assert np.allclose(place, places[0][1] if time < motion.start_ns else places[-1][1], atol=1e-6)
    # What a pipeline is given does not hold any of it.
    plain = json.loads((rendered.output / "sequence.json").read_text())
    assert str(bump.timestamp_ns) not in json.dumps([plain["cameras"], plain["board"], plain["tracking"]])


def _places(recording: Recording, obj_id: int) -> list[tuple[int, FloatArray]]:
    """True time and place in the world at every picture of the right camera that shows the object."""
    assert recording.truth is not None
    found: list[tuple[int, FloatArray]] = []
    for entry in recording.cameras[2].frames:
        for instance in recording.record(RIGHT, entry.im_id).instances:
            if instance.obj_id == obj_id:
                pose = recording.truth_of(RIGHT, entry.im_id) @ instance.camera_from_object
                found.append((entry.timestamp_ns - recording.truth.clock_offsets_ns[RIGHT], pose[:3, 3]))
    assert len(found) == 6
    return found


def test_static_cameras_give_noisy_depth_and_the_headset_none(rendered: SequenceConfig) -> None:
    recording = load_recording(rendered.output)
    headset, _, right = recording.cameras
    assert recording.load_frame(headset, headset.frames[0]).depth is None
    late = [e for e in right.frames if e.timestamp_ns > 1.2e9]
    first, second = (recording.load_frame(right, entry) for entry in late[:2])
    assert first.depth is not None
    assert second.depth is not None
    # The same picture but for the noise of its sensors.
    colour = np.abs(first.image.astype(int) - second.image.astype(int))
    assert 0 < colour.mean() < 6
    known = (first.depth > 0) & (second.depth > 0)
    assert known.mean() > 0.3
    difference = (first.depth - second.depth)[known]
    assert 0 < np.median(np.abs(difference)) < 0.02
    path = recording.record(RIGHT, late[0].im_id).depth_path
    assert path is not None
    assert np.allclose(np.mod(read_depth(path, 1.0) * 1e3 + 0.5, 10), 0.5, atol=1e-2)


def test_a_killed_run_is_continued_to_the_same_files(rendered: SequenceConfig) -> None:
    scene = rendered.output / "test" / "000001"
    whole = {
        path: path.read_bytes()
        for path in sorted(rendered.output.rglob("*"))
        if path.suffix in (".json", ".png", ".jpg")
    }
    for name in ("scene_gt.json", "scene_camera.json"):
        table = json.loads((scene / name).read_text())
        (scene / name).write_text(json.dumps(dict(list(table.items())[:3])))
    (rendered.output / "sequence.json").unlink()
    record(rendered)
    for path, content in whole.items():
        assert path.read_bytes() == content, path
    # Once more: nothing to do, nothing changes.
    record(rendered)
    assert {path: path.read_bytes() for path in whole} == whole
