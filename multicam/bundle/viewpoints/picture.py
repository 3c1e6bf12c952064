"""One view of an object as a picture that its silhouette fills."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.bundle.viewpoints import drawing
from multicam.bundle.viewpoints.drawing import View
from multicam.bundle.viewpoints.model import Float32Array
from multicam.bundle.viewpoints.shell import Shell
from multicam.types import FloatArray

MARGIN = 6
"""Pixels around the silhouette, more than any step out of it."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawn view.

    Attributes:
        inverse_depth: (h, w) 1/z at pixel centres, metres; 0 outside the silhouette.
        face: (h, w) index of the face that is seen; undefined outside the silhouette.
        seen: (n,) flat indices of the pixels of the silhouette.
        chain: (p, 2) pixels x, y of the contours one after the other, each closed.
        start: (c + 1,) where each contour starts in the chain.
    """

    view: View
    inverse_depth: Float32Array
    face: NDArray[np.int32]
    seen: NDArray[np.int64]
    chain: NDArray[np.int32]
    start: NDArray[np.int64]


def draw_picture(shell: Shell, rotation: FloatArray, distance: float, side: int) -> Picture:
    """Draws a shell as seen along the third row of a rotation (3, 3) of camera_from_object.

    Args:
        distance: metres from the camera to the origin of the object; the object lies in front of the camera.
        side: pixels of the longer side of the picture.
    """
    projected = np.empty_like(shell.vertices)
    left, top, right, bottom = drawing.project(shell.vertices, rotation, distance, projected)
    focal = (side - 1 - 2 * MARGIN) / max(right - left, bottom - top)
    width, height = (int(focal * extent) + 2 + 2 * MARGIN for extent in (right - left, bottom - top))
    view = View(rotation, distance, focal, MARGIN - focal * left, MARGIN - focal * top)
    inverse_depth, face = np.zeros((height, width), np.float32), np.empty((height, width), np.int32)
    drawing.draw(projected, shell.faces, shell.closed, view, inverse_depth, face)
    seen = inverse_depth > 0
    contours = cv2.findContours(seen.view(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
    chain = np.concatenate([np.zeros((0, 2)), *(contour[:, 0] for contour in contours)]).astype(np.int32)
    start = np.cumsum([0, *map(len, contours)])
    return Picture(view, inverse_depth, face, np.flatnonzero(seen), chain, start)
