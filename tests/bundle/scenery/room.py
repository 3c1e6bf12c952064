"""A room with patterned surfaces, drawn by casting a ray for each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from multicam.geometry import se3
from multicam.geometry.camera import Camera

CAMERA = Camera.from_focal(300.0, 320, 240)
TABLE, WALL, BOX = 0, 1, 2
SURFACES = (
    # Origin and the two sides of each rectangle, metres.
    ([-1.0, 0.0, -1.0], [2.0, 0, 0], [0, 0, 2.0]),
    ([-1.0, 0.0, 0.45], [2.0, 0, 0], [0, -1.0, 0.3]),
    ([-0.25, -0.2, -0.1], [0.15, 0.0, 0.1], [0.0, 0.2, 0.0]),
)
"""A table, a wall behind it and a card that stands on the table; y points down."""


@cache
def pattern(surface: int) -> np.ndarray:
    """(800, 800, 3) blots of many sizes."""
    rng = np.random.default_rng(surface)
    total = np.zeros((800, 800, 3))
    for cells in (10, 25, 60, 140):
        total += cv2.resize(rng.normal(size=(cells, cells, 3)), (800, 800), interpolation=cv2.INTER_CUBIC)
    return (128 + 45 * total).clip(0, 255).astype(np.uint8)


def draw(world_from_camera: np.ndarray, surfaces: Sequence[int] = (TABLE, WALL, BOX)) -> np.ndarray:
    """(240, 320, 3) what a camera sees of some surfaces; grey where there is none."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(CAMERA.matrix).T @ world_from_camera[:3, :3].T
    image = np.full((CAMERA.height, CAMERA.width, 3), 110, np.uint8)
    nearest = np.full(image.shape[:2], np.inf)
    for surface in surfaces:
        origin, right, down = (np.array(each) for each in SURFACES[surface])
        normal = np.cross(right, down)
        depth = (origin - world_from_camera[:3, 3]) @ normal / (rays @ normal)
        point = world_from_camera[:3, 3] + depth[..., None] * rays - origin
        x, y = (800 * (point @ side) / (side @ side) for side in (right, down))
        seen = (depth > 0) & (depth < nearest) & (np.minimum(x, y) >= 0) & (np.maximum(x, y) < 799)
        drawn = cv2.remap(pattern(surface), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        image[seen], nearest[seen] = drawn[seen], depth[seen]
    return image


def standing(angle: float, height: float = 0.5, distance: float = 0.75) -> np.ndarray:
    """world_from_camera of a camera beside the table that looks at its middle."""
    eye = distance * np.array([np.sin(angle), 0, -np.cos(angle)]) - [0, height, 0]
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return se3.from_parts(np.stack((x, np.cross(z, x), z), axis=1), eye)
