"""The ChArUco board of a recording: its picture, its place on the table, its corners.

The board's frame is OpenCV's: origin at the outer corner of the first square, x along the columns, y along the rows,
z into the board. The dictionary is the smallest that holds the board's ten markers with some to spare: the fewer its
words, the more they differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from datagen.scenes.layout import Table, block_of
from datagen.scenes.primitives import mesh_of
from datagen.scenes.spec import Solid, Surface
from multicam.dataset.sequence_facts import Board
from multicam.evaluation.charuco import charuco
from multicam.files import write_bytes
from multicam.geometry import se3, so3
from multicam.types import FloatArray, ImageArray

BOARD = Board(columns=5, rows=4, square=0.05, marker=0.04, dictionary="DICT_4X4_50")
_BORDER = 0.02
"""White margin around the squares, metres."""
_THICKNESS = 0.004
_PIXEL = 1 / 3000
"""Edge of a pixel of the picture: squares, markers and their bits (1/6 of a marker) are whole pixels."""
_PAPER = Surface((0.8, 0.8, 0.8), roughness=0.9)
_STAND = Surface((0.2, 0.2, 0.21), roughness=0.6)
_STAND_SIZE = (0.05, 0.03)
"""Width and depth of the block that a standing board leans on, metres."""


@dataclass(frozen=True, eq=False)
class PlacedBoard:
    """The board in a scene.

    Attributes:
        world_from_board: (4, 4).
        solids: the board, whose picture is a file, and what holds it.
    """

    world_from_board: FloatArray
    solids: tuple[Solid, ...]

    @property
    def corners(self) -> FloatArray:
        """(12, 3) inner corners in the order of OpenCV's ids, world."""
        return se3.act(self.world_from_board, _inner_corners())

    @property
    def patches(self) -> FloatArray:
        """(12, 4, 3) outer corners of the four squares about each inner corner; OpenCV finds it by their markers."""
        around = BOARD.square * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
        return se3.act(self.world_from_board, _inner_corners()[:, None] + around)

    @property
    def normal(self) -> FloatArray:
        """(3,) towards those who can read it."""
        return -self.world_from_board[:3, 2]

    @property
    def points(self) -> FloatArray:
        """(n, 3) surface points of all its parts, world."""
        return np.concatenate([solid_cloud(solid) for solid in self.solids])


def board_picture() -> ImageArray:
    """(h, w) uint8 with the white border; the first square is at the upper left."""
    width, height = (round(edge / _PIXEL) for edge in _size())
    return charuco(BOARD).generateImage((width, height), marginSize=round(_BORDER / _PIXEL)).astype(np.uint8)


def write_board(path: Path) -> None:
    """Writes the board's picture as PNG."""
    done, data = cv2.imencode(".png", board_picture())
    assert done, "OpenCV can encode PNG"
    write_bytes(path, data.tobytes())


def place_board(
    picture: Path, centre: FloatArray, lean_deg: float | None, turn: float, table: Table, rng: np.random.Generator
) -> PlacedBoard:
    """The board on the table, which is then taken there; nothing may be on it yet.

    Args:
        picture: the file that `write_board` wrote or will write.
        centre: (2,) x and y of its middle, or of its lower edge if it stands.
        lean_deg: how far a standing board leans back; None for one that lies.
        turn: radians about the vertical; at 0 its lower edge, in reading position, is at -y.
    """
    size = np.array([*_size(), _THICKNESS])
    yaw = se3.from_parts(so3.exp(np.array([0.0, 0.0, turn])), np.array([*centre, 0.0]))
    surface = Surface(_PAPER.color, roughness=_PAPER.roughness, picture=str(picture.resolve()))
    if lean_deg is None:
        pose = yaw @ _shift(0.0, 0.0, size[2] / 2)
        solids = (Solid("box", size, pose, surface),)
    else:
        # It stands on the edge between its back and its lower side, which touches the table at `centre`.
        tilt = np.pi / 2 - np.deg2rad(lean_deg)
        tilted = yaw @ se3.from_parts(so3.exp(np.array([tilt, 0.0, 0.0])), np.zeros(3))
        pose = tilted @ _shift(0.0, size[1] / 2, size[2] / 2)
        # A block behind it reaches up to its back.
        height = 0.7 * size[1] * np.sin(tilt)
        behind = height / np.tan(tilt) + _STAND_SIZE[1] / 2
        block = Solid("box", np.array([*_STAND_SIZE, height]), yaw @ _shift(0.0, behind, height / 2), _STAND)
        solids = (Solid("box", size, pose, surface), block)
    placed = PlacedBoard(pose @ _solid_from_board(), solids)
    for solid in solids:
        table.put(block_of(mesh_of(solid), rng), solid.world_from_solid)
    return placed


def solid_cloud(solid: Solid) -> FloatArray:
    """(n, 3) surface points of a solid, world; always the same ones."""
    mesh = mesh_of(solid)
    points = np.concatenate((mesh.vertices, mesh.sample_surface(200, np.random.default_rng(0))))
    return se3.act(solid.world_from_solid, points)


def _inner_corners() -> FloatArray:
    """(12, 3) in the board's frame, in the order of OpenCV's ids."""
    columns, rows = np.meshgrid(np.arange(1, BOARD.columns), np.arange(1, BOARD.rows))
    return BOARD.square * np.stack((columns, rows, np.zeros_like(rows)), axis=-1).reshape(-1, 3)


def _solid_from_board() -> FloatArray:
    """The picture's right is the box's +x, its top +y, and the picture lies on the box's top."""
    width, height = BOARD.columns * BOARD.square, BOARD.rows * BOARD.square
    return se3.from_parts(np.diag([1.0, -1.0, -1.0]), np.array([-width / 2, height / 2, _THICKNESS / 2]))


def _size() -> tuple[float, float]:
    return BOARD.columns * BOARD.square + 2 * _BORDER, BOARD.rows * BOARD.square + 2 * _BORDER


def _shift(x: float, y: float, z: float) -> FloatArray:
    return se3.from_parts(np.eye(3), np.array([x, y, z]))
