"""The ChArUco board: its picture, its place, and whether OpenCV finds it in a render where it truly is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datagen.pictures.photo import develop
from datagen.pictures.renderer import BlenderRenderer
from datagen.recordings.board import (
    BOARD,
    PlacedBoard,
    board_picture,
    place_board,
    write_board,
)
from datagen.scenes.layout import Table
from datagen.scenes.looks import plain_lamps
from datagen.scenes.spec import SceneSpec, Shot, Solid, Surface, Surroundings
from datagen.scenes.viewpoints import look_at
from multicam.evaluation.charuco import board_pose, charuco, detect_corners
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from tests.close import assert_close
from tests.strategies import Array

BORDER, PIXELS_PER_METRE = 0.02, 3000


def lying(picture: Path = Path("board.png"), table: Table | None = None) -> PlacedBoard:
    return place_board(picture, np.array([0.1, 0.2]), None, 0.0, table or Table(), np.random.default_rng(0))


def in_picture(board_points: Array) -> Array:
    """Where points of the board's own frame are in its picture, a pixel's centre being whole."""
    return (board_points[:, :2] + BORDER) * PIXELS_PER_METRE - 0.5


def corner_points() -> Array:
    """(12, 3) inner corners in the board's frame: whole squares from its origin, row by row."""
    columns, rows = np.meshgrid(np.arange(1, 5), np.arange(1, 4))
    return 0.05 * np.stack((columns, rows, np.zeros_like(rows)), axis=-1).reshape(-1, 3)


def test_the_board_is_the_papers() -> None:
    assert (BOARD.columns, BOARD.rows, BOARD.square, BOARD.marker) == (5, 4, 0.05, 0.04)


def test_the_picture_has_whole_squares_and_a_white_border() -> None:
    picture = board_picture()
    assert picture.shape == (round(0.24 * PIXELS_PER_METRE), round(0.29 * PIXELS_PER_METRE))
    assert set(np.unique(picture)) == {0, 255}
    border = round(BORDER * PIXELS_PER_METRE)
    inner = picture[border:-border, border:-border]
    assert picture.astype(int).sum() - inner.astype(int).sum() == 255 * (picture.size - inner.size)
    squares = inner.reshape(4, 150, 5, 150).transpose(0, 2, 1, 3)
    dark = [[bool(squares[row, column].max() == 0) for column in range(5)] for row in range(4)]
    assert dark == [[(row + column) % 2 == 0 for column in range(5)] for row in range(4)]


def test_corners_are_found_where_they_are_to_a_tenth_of_a_pixel() -> None:
    soft = cv2.GaussianBlur(board_picture(), (0, 0), 1.5)
    ids, found = detect_corners(np.repeat(soft[:, :, None], 3, axis=2).astype(np.uint8), BOARD)
    assert sorted(ids) == list(range(12))
    # Half a pixel off, as OpenCV's own detector is in most releases, would fail.
    assert_close(found, in_picture(corner_points())[ids], 0.1)


def test_nothing_is_found_where_no_board_is(rng: np.random.Generator) -> None:
    ids, found = detect_corners(rng.integers(0, 255, (120, 160, 3), dtype=np.uint8), BOARD)
    assert ids.shape == (0,)
    assert found.shape == (0, 2)


def test_the_frame_is_opencvs_and_lies_on_the_top_of_the_box() -> None:
    board = lying()
    # Read from -y, columns go right and rows towards the reader; z goes down into the table.
    assert_close(board.world_from_board[:3, :3], np.diag([1.0, -1.0, -1.0]))
    assert_close(board.world_from_board[:3, 3], [0.1 - 0.125, 0.2 + 0.1, 0.004])
    assert_close(board.corners, se3.act(board.world_from_board, corner_points()))
    assert_close(charuco(BOARD).getChessboardCorners(), corner_points(), 1e-7)
    assert_close(board.normal, [0, 0, 1])
    (slab,) = board.solids
    assert_close(slab.size, [0.29, 0.24, 0.004])
    assert slab.surface.picture == str(Path("board.png").resolve())


@given(st.floats(5, 60), st.floats(-3, 3))
def test_a_standing_board_touches_the_table_and_leans_on_its_block(lean: float, turn: float) -> None:
    table = Table()
    board = place_board(Path("b.png"), np.array([0.0, 0.1]), lean, turn, table, np.random.default_rng(0))
    panel, block = (
        se3.act(s.world_from_solid, s.size * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)) for s in board.solids
    )
    assert panel[:, 2].min() == pytest.approx(0, abs=1e-12)
    assert block[:, 2].min() == pytest.approx(0, abs=1e-12)
    assert board.normal[2] == pytest.approx(np.sin(np.deg2rad(lean)))
    # The block's upper edge touches the panel's back, which is one thickness behind its front; all of it is behind.
    behind = -(block - board.world_from_board[:3, 3]) @ board.normal
    assert behind.min() == pytest.approx(0.004, abs=1e-9)


def test_the_table_is_taken_where_the_board_is() -> None:
    table = Table()
    lying(table=table)
    spot = place_board(Path("b.png"), np.zeros(2), None, 0.0, Table(), np.random.default_rng(0))
    assert spot.points[:, 2].min() == pytest.approx(0)
    heights = table._height
    assert heights.max() == pytest.approx(0.004)
    assert (heights > 0).sum() * 0.003**2 == pytest.approx(0.29 * 0.24, rel=0.1)


@pytest.mark.blender
@pytest.mark.parametrize("lean", [None, 25.0])
def test_a_rendered_board_is_found_within_a_third_of_a_pixel(models: Path, tmp_path: Path, lean: float | None) -> None:
    write_board(tmp_path / "board.png")
    board = place_board(tmp_path / "board.png", np.zeros(2), lean, 0.2, Table(), np.random.default_rng(0))
    camera = Camera(np.array([[700.0, 0, 322.3], [0, 700.0, 236.8], [0, 0, 1]]), 640, 480)
    middle = board.corners.mean(axis=0)
    shots = [
        Shot(camera, look_at(middle + 0.55 * np.array(view), middle, 0.1))
        for view in ((0.1, -0.6, 0.79), (-0.5, -0.6, 0.62))
    ]
    wood = Solid(
        "box", np.array([2, 2, 0.1]), se3.from_parts(np.eye(3), np.array([0, 0, -0.05])), Surface((0.3, 0.2, 0.1))
    )
    scene = SceneSpec("board", 1, (), (wood, *board.solids), plain_lamps(), Surroundings(1.0), tuple(shots))
    with BlenderRenderer(models, 8) as renderer:
        for shot, passes in zip(shots, renderer.render(scene, range(len(shots))), strict=True):
            photograph = develop(passes.color, shot, np.random.default_rng(0))
            ids, found = detect_corners(photograph, BOARD)
            true = camera.project(se3.act(se3.inverse(shot.world_from_camera), board.corners[ids]))
            errors = np.linalg.norm(found - true, axis=1)
            assert len(ids) == 12
            assert errors.max() < 0.3
            # No convention is off by a part of a pixel: the errors are those of noise.
            assert np.linalg.norm((found - true).mean(axis=0)) < 0.1
            pose = board_pose(photograph, camera, BOARD)
            assert pose is not None
            shift = se3.minus(pose, se3.inverse(shot.world_from_camera) @ board.world_from_board)
            assert np.linalg.norm(shift[3:]) < 2e-3 and np.degrees(np.linalg.norm(shift[:3])) < 0.5
