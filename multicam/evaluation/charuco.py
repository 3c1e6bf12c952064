"""Poses of cameras by a ChArUco board: the marker-based way that this software is compared with."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.dataset.sequence_facts import Board
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.types import FloatArray, ImageArray

LEAST_CORNERS = 6
"""Corners from which a board's pose is taken; fewer lie in a line or in one corner of it all too often."""
_WINDOW, _WIDEST_WINDOW = 0.1, 5
"""Half the window in which a corner is refined: a share of the distance to the next corner, for farther away there are
markers; and at most so many pixels."""


def charuco(board: Board) -> cv2.aruco.CharucoBoard:
    """The board as OpenCV knows it."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    return cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)


def detect_corners(image: ImageArray, board: Board) -> tuple[NDArray[np.int64], FloatArray]:
    """Inner corners that OpenCV finds in an RGB picture: ids (n,) and pixels (n, 2), a pixel's centre being whole.

    CharucoDetector's own pixels are half a pixel too far right and down in most releases (opencv issue 25539, fixed by
    pull request 28380), so the corners are refined once more, which is right with any release.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    # OpenCV's types do not say that it returns None for nothing.
    detector: Any = cv2.aruco.CharucoDetector(charuco(board))
    found, ids, _, _ = detector.detectBoard(grey)
    if ids is None or len(ids) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    corners = np.asarray(found, dtype=np.float32).reshape(-1, 1, 2)
    gaps = np.linalg.norm(corners - corners.reshape(1, -1, 2), axis=2)
    nearest = float(np.min(gaps[gaps > 0], initial=_WIDEST_WINDOW / _WINDOW))
    window = int(np.clip(_WINDOW * nearest, 2, _WIDEST_WINDOW))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
    refined = cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), stop)
    return ids.reshape(-1).astype(np.int64), refined.reshape(-1, 2).astype(np.float64)


def board_pose(image: ImageArray, camera: Camera, board: Board) -> FloatArray | None:
    """camera_from_board (4, 4) of a board in one RGB picture, or None where too few corners are found.

    Infinitesimal plane-based pose estimation (Collins and Bartoli, IJCV 2014), then least squares, both of OpenCV. Of
    the two poses that a plane allows, the one that fits better.
    """
    ids, pixels = detect_corners(image, board)
    if len(ids) < LEAST_CORNERS:
        return None
    points = np.asarray(charuco(board).getChessboardCorners(), dtype=np.float64)[ids]
    ideal = camera.undistort_pixels(pixels) if camera.distortion else pixels
    none = np.zeros(0)
    count, rotations, translations, _ = cv2.solvePnPGeneric(points, ideal, camera.matrix, none, flags=cv2.SOLVEPNP_IPPE)
    if not count:
        return None
    rotation, translation = cv2.solvePnPRefineLM(
        points, ideal, camera.matrix, none, rotations[0].copy(), translations[0].copy()
    )
    matrix, _ = cv2.Rodrigues(rotation)
    return se3.from_parts(np.asarray(matrix, dtype=np.float64), np.asarray(translation, dtype=np.float64).reshape(3))
