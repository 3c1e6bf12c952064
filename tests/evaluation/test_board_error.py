"""Cameras by a ChArUco board: pictures of a flat board, warped as a camera sees it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from multicam.dataset.bop_writer import LabelledImage, SceneWriter, write_models
from multicam.dataset.results import Estimates
from multicam.dataset.sequence import CameraEntry, FrameEntry, Recording, load_recording, write_sequence
from multicam.dataset.sequence_facts import Board
from multicam.evaluation.charuco import board_pose, charuco
from multicam.evaluation.run_error import evaluate_run
from multicam.evaluation.tables import board_table
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.progress import SilentProgress
from tests.toy_objects import toy_meshes
from tests.toy_recording import truthful_run
from tests.toy_walk import make_walk

BOARD = Board(columns=5, rows=4, square=0.05, marker=0.04, dictionary="DICT_4X4_50")
CAMERA = Camera.from_focal(500.0, 640, 480)
PIXELS_PER_METRE, BORDER = 2000, 0.02
NONE: Estimates = {}


def looking(x: float, y: float, height: float, roll: float = 0.0) -> np.ndarray:
    """world_from_camera that looks at the middle of a board which lies at the origin, facing -z."""
    eye = np.array([0.125 + x, 0.1 + y, -height])
    z = np.array([0.125, 0.1, 0.0]) - eye
    z /= np.linalg.norm(z)
    x_axis = np.cross([0.0, 1.0, 0.0], z)
    x_axis /= np.linalg.norm(x_axis)
    pose = se3.from_parts(np.stack((x_axis, np.cross(z, x_axis), z), axis=1), eye)
    return pose @ se3.exp(np.array([0, 0, roll, 0, 0, 0]))


def photograph(world_from_camera: np.ndarray, seen: bool = True) -> np.ndarray:
    """(480, 640, 3) of the board."""
    flat = np.full((480, 640), 120, np.uint8)
    if seen:
        size = tuple(round((n * BOARD.square + 2 * BORDER) * PIXELS_PER_METRE) for n in (BOARD.columns, BOARD.rows))
        picture = charuco(BOARD).generateImage(size, marginSize=round(BORDER * PIXELS_PER_METRE))
        board_from_pixel = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, PIXELS_PER_METRE]]) / PIXELS_PER_METRE
        board_from_pixel[:2, 2] -= BORDER
        pose = se3.inverse(world_from_camera)
        pixel_from_board = CAMERA.matrix @ np.stack((pose[:3, 0], pose[:3, 1], pose[:3, 3]), axis=1)
        cv2.warpPerspective(
            picture, pixel_from_board @ board_from_pixel, (640, 480), flat, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT
        )
    return np.repeat(cv2.GaussianBlur(flat, (0, 0), 0.8)[..., None], 3, axis=2)


@pytest.mark.parametrize("place", [(0.1, -0.3, 0.5, 0.2), (-0.3, 0.1, 0.6, -0.4), (0.02, 0.3, 0.9, 0.0)])
def test_a_board_is_where_it_is(place: tuple[float, float, float, float]) -> None:
    world_from_camera = looking(*place)
    found = board_pose(photograph(world_from_camera), CAMERA, BOARD)
    assert found is not None
    shift = se3.minus(found, se3.inverse(world_from_camera))
    assert np.linalg.norm(shift[3:]) < 4e-3 * place[2] / 0.5
    assert np.degrees(np.linalg.norm(shift[:3])) < 0.6


def test_a_real_lens_is_undone() -> None:
    # The board lies at the side of the picture, where a lens bends most.
    world_from_camera = looking(0.1, -0.3, 0.5) @ se3.exp(np.array([0.05, 0.3, 0, 0, 0, 0]))
    lens = Camera(CAMERA.matrix, 640, 480, (-0.3, 0.1, 0.0, 0.0))
    ideal = photograph(world_from_camera)
    y, x = np.mgrid[:480, :640].astype(np.float64)
    maps = lens.undistort_pixels(np.stack((x, y), axis=-1).reshape(-1, 2)).reshape(480, 640, 2).astype(np.float32)
    bent = cv2.remap(ideal, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    found, wrong = (board_pose(bent, camera, BOARD) for camera in (lens, CAMERA))
    assert found is not None and wrong is not None
    right, off = (np.linalg.norm(se3.minus(each, se3.inverse(world_from_camera))[3:]) for each in (found, wrong))
    assert right < 5e-3 < 10e-3 < off


def test_without_a_board_there_is_no_pose() -> None:
    assert board_pose(photograph(looking(0, 0.2, 0.5), seen=False), CAMERA, BOARD) is None


HEADSET_AT = [(0.1, -0.3, 0.5), (0.2, -0.2, 0.5), (0.0, 0.3, 0.6), (-0.1, -0.3, 0.5)]
STATIC_AT = (0.3, 0.2, 0.6)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A headset that reads the board at steps 0, 1 and 3, and a static camera that reads it at steps 1 and 2; before
    step 3 it is bumped."""
    folder = tmp_path_factory.mktemp("board")
    write_models(
        folder / "models", make_walk(np.random.default_rng(0), num_steps=2).steps[0].world.catalogue, toy_meshes()
    )
    places = {
        "headset": [looking(*at) for at in HEADSET_AT],
        "left": [looking(*STATIC_AT)] * 3 + [looking(0.3, 0.1, 0.6)],
    }
    reads = {"headset": (0, 1, 3), "left": (1, 2)}
    entries = []
    for scene_id, (name, stands) in enumerate(places.items()):
        writer = SceneWriter(folder / "test" / f"{scene_id:06d}")
        for im_id, pose in enumerate(stands):
            picture = photograph(pose, im_id in reads[name])
            writer.add(im_id, LabelledImage(CAMERA, se3.inverse(pose), picture, np.zeros((480, 640), np.float32), ()))
        frames = tuple(FrameEntry(i, i * 10**9, pose if name == "headset" else None) for i, pose in enumerate(stands))
        entries.append(CameraEntry(name, scene_id, name == "headset", frames))
    write_sequence(folder, tuple(entries), BOARD)
    return load_recording(folder)


def test_static_cameras_are_judged_where_both_have_read_the_board(recording: Recording) -> None:
    run = truthful_run(recording, placed_from=1)
    errors = evaluate_run(run, NONE, recording, SilentProgress()).board
    # At step 0 the static camera has not read the board yet; at 2 the headset does not; before 3 it was bumped.
    assert list(errors) == ["left"] and len(errors["left"].board) == 1
    assert errors["left"].board[0].centre_mm < 12 and errors["left"].board[0].rotation_deg < 1.5
    assert errors["left"].run[0] is not None and errors["left"].run[0].centre_mm < 1e-6
    (row,) = board_table(errors, run.headset).to_plain()["rows"]
    assert row["camera"] == "left in headset" and row["times"] == 1 and row["run has pose %"] == 100
    unplaced = evaluate_run(truthful_run(recording, placed_from=4), NONE, recording, SilentProgress()).board
    (row,) = board_table(unplaced, run.headset).to_plain()["rows"]
    assert row["run has pose %"] == 0 and row["run mm"] is None and row["board mm"] < 12


def test_a_recording_without_board_has_no_such_table(toy_recording: Recording) -> None:
    assert evaluate_run(truthful_run(toy_recording), NONE, toy_recording, SilentProgress()).board == {}
