"""Outlines of posed objects drawn onto a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.types import FloatArray, ImageArray

Color = tuple[int, int, int]

PALETTE: tuple[Color, ...] = (
    (255, 140, 0), (0, 190, 255), (80, 220, 100), (240, 80, 120), (190, 120, 255),
    (250, 215, 60), (0, 220, 200), (255, 150, 200), (160, 200, 60), (120, 160, 255),
)  # fmt: skip
"""RGB, bright enough for dark and light pictures."""

GREY: Color = (170, 170, 170)
WHITE: Color = (255, 255, 255)

DRAWN_WIDTH = 640
"""Pictures narrower than this are enlarged by whole factors first, so that lines stay thin."""


@dataclass(frozen=True, eq=False)
class Outline:
    """One object to draw: mesh in metres, pose (4, 4), RGB colour, and whether its line is bold."""

    mesh: Mesh
    camera_from_object: FloatArray
    color: Color
    bold: bool = True


def color_of(obj_id: int) -> Color:
    """The colour of a class; alike in all pictures and legends."""
    return PALETTE[obj_id % len(PALETTE)]


def hex_of(obj_id: int) -> str:
    """The same colour as pages write it, #rrggbb."""
    return to_hex(color_of(obj_id))


def to_hex(color: Color) -> str:
    """A colour as pages write it, #rrggbb."""
    return "#" + "".join(f"{channel:02x}" for channel in color)


def draw_outlines(image: ImageArray, camera: Camera, outlines: Sequence[Outline]) -> ImageArray:
    """The picture with the silhouette of each object; a lens's distortion is ignored in drawing.

    Args:
        image: (h, w, 3) uint8 RGB; it is not changed.

    Returns:
        (h', w', 3) uint8 RGB, enlarged by a whole factor where the picture is small.
    """
    factor = float(max(1, DRAWN_WIDTH // camera.width))
    canvas = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    enlarged = camera.without_distortion().scaled(factor)
    for outline in sorted(outlines, key=lambda o: -o.camera_from_object[2, 3]):
        contours = silhouette(outline.mesh, enlarged, outline.camera_from_object)
        # A dark rim keeps bright lines visible on bright ground.
        cv2.polylines(canvas, contours, True, (0, 0, 0), 4 if outline.bold else 2, cv2.LINE_AA)
        cv2.polylines(canvas, contours, True, outline.color, 2 if outline.bold else 1, cv2.LINE_AA)
    return canvas.astype(np.uint8, copy=False)


def silhouette(mesh: Mesh, camera: Camera, camera_from_object: FloatArray) -> list[NDArray[np.int32]]:
    """Contours of the object's image, each (n, 1, 2) pixels; none where it is out of sight."""
    mask = (render_depth(mesh, camera, camera_from_object) > 0).astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return [np.asarray(contour, dtype=np.int32) for contour in contours]
