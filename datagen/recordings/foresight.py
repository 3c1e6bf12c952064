"""What each camera will see at each step, from geometry alone: seconds of work before hours of rendering."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.recordings.sight import Sight, View
from datagen.recordings.stage import Stage
from datagen.scenes.primitives import mesh_of
from datagen.scenes.stock import Stock
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from multicam.types import FloatArray

_REHEARSED_WIDTH = 160
"""Pixels of the pictures from which it is foreseen what will be visible."""
_LEAST_SQUARE = 16
"""Pixels across a square of the board where it is narrowest, below which OpenCV rarely reads its markers."""
_HIDDEN = 0.005
"""Metres that something must be nearer than a corner of the board to hide it."""


def foresee(stage: Stage, stock: Stock) -> Sight:
    """What the cameras will see, by a z-buffer of small pictures."""
    sight: Sight = {}
    for camera in stage.cameras:
        known: dict[int, View] = {}
        sight[camera.camera_id] = {}
        for entry in camera.frames:
            shot = stage.rendered_as[stage.shot_of(camera, entry.im_id)]
            if shot not in known:
                known[shot] = _foresee_view(stage, stock, shot)
            sight[camera.camera_id][entry.im_id] = known[shot]
    return sight


def _foresee_view(stage: Stage, stock: Stock, shot: int) -> View:
    taken = stage.scene.shots[shot]
    small = taken.camera.scaled(_REHEARSED_WIDTH / taken.camera.width)
    # One picture more on every side, for what is outside is not visible either.
    shift = np.array([[1, 0, small.width], [0, 1, small.height], [0, 0, 1.0]])
    canvas = small.warped(shift, 3 * small.width, 3 * small.height)
    picture = np.s_[small.height : 2 * small.height, small.width : 2 * small.width]
    camera_from_world = se3.inverse(taken.world_from_camera)
    alone = [
        _distances(stock.meshes[item.obj_id], canvas, camera_from_world @ item.world_from_object)
        for item in stage.scene.objects_in(shot)
    ]
    board = stage.board.solids if stage.board else ()
    about = np.full((small.height, small.width), np.inf)
    others = about.copy()
    for solid in stage.scene.solids:
        drawn = _distances(mesh_of(solid), small, camera_from_world @ solid.world_from_solid)
        about = np.minimum(about, drawn)
        if not any(solid is part for part in board):
            others = np.minimum(others, drawn)
    nearest = np.minimum.reduce([about, *(own[picture] for own in alone)])
    visible = {
        index: float((own[picture] <= nearest)[np.isfinite(own[picture])].sum() / max(np.isfinite(own).sum(), 1))
        for index, own in enumerate(alone)
    }
    others = np.minimum.reduce([others, *(own[picture] for own in alone)])
    corners = _visible_corners(stage, taken.camera, camera_from_world, others)
    return View({index: fraction for index, fraction in visible.items() if fraction > 0}, corners)


def _distances(mesh: Mesh, camera: Camera, camera_from_mesh: FloatArray) -> NDArray[np.float64]:
    """Depth at each pixel, infinite where the mesh is not."""
    depth = render_depth(mesh, camera, camera_from_mesh).astype(np.float64)
    return np.where(depth > 0, depth, np.inf)


def _visible_corners(stage: Stage, camera: Camera, camera_from_world: FloatArray, others: NDArray[np.float64]) -> int:
    """Corners of the board that can be found: the squares about them are in the picture, large enough and not hidden.

    Args:
        others: depth of everything but the board, in a smaller picture.
    """
    if stage.board is None:
        return 0
    patches = se3.act(camera_from_world, stage.board.patches.reshape(-1, 3))
    if patches[:, 2].min() < 0.05:
        return 0
    pixels = camera.project(patches)
    cells = np.floor((pixels + 0.5) * others.shape[1] / camera.width).astype(int)
    cells = np.clip(cells, 0, (others.shape[1] - 1, others.shape[0] - 1))
    clear = camera.contains(pixels) & (others[cells[:, 1], cells[:, 0]] > patches[:, 2] - _HIDDEN)
    a, b, c, _ = np.moveaxis(pixels.reshape(-1, 4, 2), 1, 0)
    areas = np.abs(np.cross(b - a, c - b)) / 4
    edges = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - b, axis=1)) / 2
    large = areas / edges > _LEAST_SQUARE
    return int((clear.reshape(-1, 4).all(axis=1) & large).sum())
