"""Recordings of several cameras: there and back, grouping by time, and faults."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.dataset.bop_writer import SceneWriter, write_models
from multicam.dataset.objects import Catalogue
from multicam.dataset.sequence import (
    CameraEntry,
    FrameEntry,
    group_by_time,
    load_recording,
    write_sequence,
)
from multicam.dataset.sequence_facts import Board, Bump, ObjectMotion, SequenceTruth, TrackingErrors
from multicam.geometry import se3
from tests.close import assert_close
from tests.dataset.labelled import CAMERA, labelled_image
from tests.faults import edit_json, sentence
from tests.toy_objects import toy_meshes

MS = 1_000_000
BOARD = Board(5, 4, 0.05, 0.04, "DICT_4X4_50")
TRACKING = TrackingErrors(1e-4, 2e-3, 3e-4, 4e-3)
SHIPPED = Path(__file__).parents[2] / "multicam" / "assets" / "recording"


@pytest.fixture
def recording(tmp_path: Path, catalogue: Catalogue, rng: np.random.Generator) -> Path:
    """A headset and one static camera, three pictures each, 5 ms apart."""
    write_models(tmp_path / "models", catalogue, toy_meshes())
    cameras: list[CameraEntry] = []
    for scene_id, name in enumerate(("headset", "static")):
        writer = SceneWriter(tmp_path / "test" / f"{scene_id:06d}")
        frames: list[FrameEntry] = []
        for im_id in range(3):
            writer.add(im_id, labelled_image(rng))
            tracked = se3.random(rng) if name == "headset" else None
            frames.append(FrameEntry(im_id, (100 * im_id + 5 * scene_id) * MS, tracked))
        cameras.append(CameraEntry(name, scene_id, name == "headset", tuple(frames), 10.0))
    truth = SequenceTruth(
        {"headset": 0, "static": -3}, (Bump("static", 150 * MS),), (ObjectMotion(2, 0, 9),), se3.random(rng)
    )
    write_sequence(tmp_path, tuple(cameras), BOARD, TRACKING, truth)
    return tmp_path


def test_a_recording_comes_back_as_it_was_written(recording: Path, catalogue: Catalogue) -> None:
    found = load_recording(recording)
    assert [(c.camera_id, c.scene_id, c.moving) for c in found.cameras] == [("headset", 0, True), ("static", 1, False)]
    assert found.catalogue.obj_ids == catalogue.obj_ids
    headset, static = found.cameras
    assert [e.timestamp_ns for e in headset.frames] == [0, 100 * MS, 200 * MS]
    assert all(e.tracked_world_from_camera is not None for e in headset.frames)
    assert all(e.tracked_world_from_camera is None for e in static.frames)
    truth = found.truth_of("static", 1)
    assert_close(se3.inverse(truth), found.record("static", 1).camera_from_world)


def test_poses_survive_to_the_last_digit(tmp_path: Path, recording: Path, rng: np.random.Generator) -> None:
    pose = se3.random(rng)
    write_sequence(recording, (CameraEntry("headset", 0, True, (FrameEntry(2, 7, pose),)),))
    (camera,) = load_recording(recording).cameras
    assert np.array_equal(camera.frames[0].tracked_world_from_camera, pose)  # pyright: ignore[reportArgumentType]


def test_board_tracking_and_truth_come_back(recording: Path) -> None:
    found = load_recording(recording)
    assert found.board == BOARD
    assert found.tracking == TRACKING
    assert [camera.rate_hz for camera in found.cameras] == [10.0, 10.0]
    assert found.truth is not None
    assert found.truth.clock_offsets_ns == {"headset": 0, "static": -3}
    assert found.truth.bumps == (Bump("static", 150 * MS),)
    assert found.truth.motions == (ObjectMotion(2, 0, 9),)
    written = json.loads((recording / "sequence.json").read_text())
    assert np.array_equal(found.truth.world_from_board, written["board"]["world_from_board"])  # pyright: ignore[reportArgumentType]


def test_a_recording_need_not_state_them(recording: Path) -> None:
    write_sequence(recording, (CameraEntry("static", 1, False, (FrameEntry(0, 1),)),))
    found = load_recording(recording)
    assert (found.board, found.tracking, found.truth, found.cameras[0].rate_hz) == (None, None, None, None)


def test_what_a_pipeline_is_given_holds_no_truth(recording: Path) -> None:
    first, *_ = load_recording(recording).frame_sets()
    fields = {name for frame in first.frames for name in vars(frame)}
    assert fields == {"camera_id", "timestamp_ns", "image", "camera", "tracked_world_from_camera", "depth"}
    assert "world_from_board" not in vars(BOARD)


def test_version_1_is_still_read(recording: Path) -> None:
    def age(content: Any) -> None:
        content["version"] = 1
        for entry in ("board", "tracking", "truth"):
            del content[entry]
        for row in content["cameras"]:
            row["moving"] = row.pop("kind") == "headset"
            del row["rate_hz"]

    before = load_recording(recording).cameras
    edit_json(recording / "sequence.json", age)
    found = load_recording(recording)
    assert [(c.camera_id, c.moving, c.rate_hz) for c in found.cameras] == [
        ("headset", True, None),
        ("static", False, None),
    ]
    assert found.cameras[0].frames[1].timestamp_ns == before[0].frames[1].timestamp_ns
    assert (found.board, found.tracking, found.truth) == (None, None, None)
    edit_json(recording / "sequence.json", lambda c: c["cameras"][0].update(moving="false"))
    assert "\"moving\" of camera headset is 'false', not true or false" in sentence(lambda: load_recording(recording))


def test_the_shipped_recording_is_read() -> None:
    found = load_recording(SHIPPED)
    assert [camera.moving for camera in found.cameras] == [True, False, False]
    assert all(camera.frames for camera in found.cameras)


def test_frame_sets_hold_pictures_of_one_time(recording: Path) -> None:
    sets = list(load_recording(recording).frame_sets(tolerance_ns=10 * MS))
    assert [s.timestamp_ns for s in sets] == [0, 100 * MS, 200 * MS]
    for frame_set in sets:
        headset, static = frame_set.frames
        assert (headset.camera_id, static.camera_id) == ("headset", "static")
        assert headset.image.shape == (48, 64, 3)
        assert_close(headset.camera.matrix, CAMERA.matrix)
        assert headset.tracked_world_from_camera is not None
        assert static.tracked_world_from_camera is None
        assert headset.depth is not None
        assert headset.depth.shape == (48, 64)
    assert [len(s.frames) for s in load_recording(recording).frame_sets(tolerance_ns=4 * MS)] == [1] * 6


@st.composite
def timed_cameras(draw: st.DrawFn) -> tuple[CameraEntry, ...]:
    cameras: list[CameraEntry] = []
    for index in range(draw(st.integers(1, 4))):
        times = sorted(draw(st.lists(st.integers(0, 300), max_size=8)))
        frames = tuple(FrameEntry(im_id, time) for im_id, time in enumerate(times))
        cameras.append(CameraEntry(f"camera{index}", index, False, frames))
    return tuple(cameras)


@given(timed_cameras(), st.integers(0, 100))
def test_groups_hold_every_frame_once_within_the_tolerance(cameras: tuple[CameraEntry, ...], tolerance: int) -> None:
    groups = group_by_time(cameras, tolerance)
    members = [(camera.camera_id, entry.im_id) for group in groups for camera, entry in group]
    expected = [(camera.camera_id, entry.im_id) for camera in cameras for entry in camera.frames]
    assert sorted(members) == sorted(expected)
    for group in groups:
        names = [camera.camera_id for camera, _ in group]
        times = [entry.timestamp_ns for _, entry in group]
        assert len(set(names)) == len(names)
        assert times == sorted(times)
        assert times[-1] - times[0] <= tolerance
    starts = [group[0][1].timestamp_ns for group in groups]
    assert starts == sorted(starts)
    # No group was cut without need: the next frame is too late, or its camera is in the group already.
    for group, following in pairwise(groups):
        camera, entry = following[0]
        late = entry.timestamp_ns - group[0][1].timestamp_ns > tolerance
        assert late or camera.camera_id in [other.camera_id for other, _ in group]


def frame(content: Any, camera: int, index: int) -> Any:
    return content["cameras"][camera]["frames"][index]


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda c: c.update(format="other"), 'must hold "format": "multicam-sequence"'),
        (lambda c: c.update(version=3), '"version": 1 or 2'),
        (lambda c: c.pop("cameras"), '"cameras" is missing'),
        (lambda c: c.update(cameras=[]), "names no camera"),
        (lambda c: c.update(cameras=3), "does not follow the recording format"),
        (lambda c: c["cameras"][1].update(camera_id="headset"), "names a camera twice: headset, headset"),
        (lambda c: c["cameras"][0].pop("scene_id"), '"scene_id" is missing'),
        (
            lambda c: c["cameras"][0].update(kind="handheld"),
            "\"kind\" of camera headset is 'handheld', not headset or static",
        ),
        (lambda c: c["cameras"][0].pop("kind"), '"kind" is missing'),
        (lambda c: c["cameras"][0].update(rate_hz=0), '"rate_hz" of camera headset is 0; it must be more than 0'),
        (lambda c: c.pop("truth"), '"truth" is missing'),
        (lambda c: c["board"].pop("square"), '"square" is missing'),
        (lambda c: c["board"].update(marker=0.06), "markers smaller than its squares"),
        (lambda c: c["board"].update(world_from_board=[[1, 0]]), "the board's pose is no 4x4 rigid transform"),
        (lambda c: c["tracking"].update(rotation_walk=None), "does not follow the recording format"),
        (lambda c: c["truth"].update(clock_offset_ns=[1]), "does not follow the recording format"),
        (lambda c: c["truth"]["bumps"][0].update(camera_id="door"), "speaks of camera door, which the recording lacks"),
        (lambda c: c["truth"]["moved"][0].update(end_ns=-1), "motion of object 2 ends before it starts"),
        (lambda c: c["cameras"][0].update(frames=["x"]), "does not follow the recording format"),
        (lambda c: frame(c, 0, 1).pop("timestamp_ns"), '"timestamp_ns" is missing'),
        (lambda c: frame(c, 0, 1).update(timestamp_ns="soon"), "'soon'"),
        (lambda c: frame(c, 0, 1).update(im_id=9), "camera headset names images [9] that its scene lacks"),
        (lambda c: frame(c, 0, 1).update(tracked_world_from_camera=[[1]]), "pose of image 1 is no 4x4 rigid transform"),
        (
            lambda c: frame(c, 0, 1)["tracked_world_from_camera"][0].__setitem__(3, float("nan")),
            "pose of image 1 is no 4x4 rigid transform",
        ),
        (
            lambda c: frame(c, 0, 1)["tracked_world_from_camera"][0].__setitem__(0, 5.0),
            "pose of image 1 is no 4x4 rigid transform",
        ),
    ],
)
def test_a_faulty_sequence_is_refused(recording: Path, edit: Callable[[Any], object], expected: str) -> None:
    edit_json(recording / "sequence.json", edit)
    text = sentence(lambda: load_recording(recording))
    assert str(recording / "sequence.json") in text
    assert expected in text


def test_missing_and_malformed_files_are_refused(recording: Path) -> None:
    assert "absent/sequence.json does not exist" in sentence(lambda: load_recording(recording / "absent"))
    (recording / "sequence.json").write_text("{")
    assert "sequence.json is not valid JSON" in sentence(lambda: load_recording(recording))
    (recording / "sequence.json").write_text("[]")
    assert "sequence.json is not a recording" in sentence(lambda: load_recording(recording))


def test_faults_of_pictures_are_told_when_they_are_read(recording: Path) -> None:
    scene = recording / "test" / "000001"
    picture = scene / "rgb" / "000001.jpg"
    picture.write_bytes(picture.read_bytes()[:-30])
    opened = load_recording(recording)
    assert "000001.jpg is not a readable image" in sentence(lambda: list(opened.frame_sets()))
    picture.unlink()
    assert "camera static, image 1 lacks its picture" in sentence(lambda: list(load_recording(recording).frame_sets()))
    edit_json(scene / "scene_camera.json", lambda table: table["0"].pop("cam_K"))
    assert "camera static, image 0 lacks" in sentence(lambda: list(load_recording(recording).frame_sets()))


def test_a_recording_without_truth_can_be_read_but_not_judged(recording: Path) -> None:
    def forget(table: Any) -> None:
        for row in table.values():
            del row["cam_R_w2c"], row["cam_t_w2c"]

    edit_json(recording / "test" / "000001" / "scene_camera.json", forget)
    opened = load_recording(recording)
    assert len(list(opened.frame_sets())) == 3
    assert "no true poses (cam_R_w2c) for camera static" in sentence(lambda: opened.truth_of("static", 0))
