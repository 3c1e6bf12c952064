"""A box before a wall: pictures in colour and depth, and the points of one view of it."""

from __future__ import annotations

from functools import cache

import numpy as np

from multicam.bundle.depth_image import DepthImage
from multicam.bundle.tracking import Sight
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from tests.bundle.m3t_views import M3tView, contour_points, surface_points

COLOR_CAMERA = Camera.from_focal(600.0, 640, 480)
DEPTH_CAMERA = Camera.from_focal(300.0, 320, 240)
DEPTH_FROM_CAMERA = se3.exp(np.array([0.01, -0.03, 0.02, -0.03, 0.004, 0.002]))
BOX, WALL = np.array([200, 60, 40]), np.array([60, 90, 180])
WALL_DEPTH = 1.2
OFFSET_STEP = 0.002


def box() -> Mesh:
    """Sides of 9, 7 and 5 cm."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.045, 0.035, 0.025]
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    return Mesh(corners, np.array(faces))


def pose() -> np.ndarray:
    """camera_from_object of a box 60 cm away that shows three faces."""
    turned = se3.exp(np.array([0.5, 0.6, 0.3, 0, 0, 0]))
    turned[:3, 3] = [0.03, -0.02, 0.6]
    return turned


@cache
def box_model() -> ViewpointModel:
    """The one view of the box that fits `pose`, drawn as M3T draws it."""
    direction = pose()[:3, :3].T @ pose()[:3, 3] / np.linalg.norm(pose()[:3, 3])
    view = M3tView(box(), direction)
    contour, length = contour_points(view, 200)
    surface, area = surface_points(view, box(), 200)
    return viewpoint_model(direction, contour, length, surface, area)


def viewpoint_model(
    direction: np.ndarray, contour: np.ndarray, length: float, surface: np.ndarray, area: float
) -> ViewpointModel:
    """A model of one view from records of points."""
    return ViewpointModel(
        direction=direction.astype(np.float32)[None],
        contour_length=np.array([length], np.float32),
        contour_point=contour["point"][None],
        contour_normal=contour["normal"][None],
        foreground=contour["foreground"][None],
        background=contour["background"][None],
        contour_offset=contour["offset"][None],
        surface_area=np.array([area], np.float32),
        surface_point=surface["point"][None],
        surface_normal=surface["normal"][None],
        surface_offset=surface["offset"][None],
        offset_step=OFFSET_STEP,
    )


def color_picture(rng: np.random.Generator, *camera_from_object: np.ndarray, noise: float = 12.0) -> np.ndarray:
    """Boxes before a wall in noisy colours, (480, 640, 3)."""
    covered = np.zeros((480, 640), dtype=bool)
    for each in camera_from_object:
        covered |= render_depth(box(), COLOR_CAMERA, each) > 0
    picture = np.where(covered[..., None], BOX, WALL) + rng.normal(scale=noise, size=(480, 640, 3))
    return picture.clip(0, 255).astype(np.uint8)


def depth_picture(camera_from_object: np.ndarray) -> DepthImage:
    """What a depth camera beside the colour camera measures of one box and the wall."""
    depth = render_depth(box(), DEPTH_CAMERA, DEPTH_FROM_CAMERA @ camera_from_object)
    return DepthImage(np.where(depth > 0, depth, np.float32(WALL_DEPTH)), DEPTH_CAMERA, DEPTH_FROM_CAMERA)


def sight(rng: np.random.Generator, camera_from_object: np.ndarray) -> Sight:
    """Both pictures of a camera at the world's origin."""
    picture = color_picture(rng, camera_from_object)
    return Sight(picture, COLOR_CAMERA, np.eye(4), depth_picture(camera_from_object))


def constant_depth(metres: float) -> DepthImage:
    """A depth picture, from the colour camera's own place, of one value."""
    depth = np.full((COLOR_CAMERA.height, COLOR_CAMERA.width), metres, dtype=np.float32)
    return DepthImage(depth, COLOR_CAMERA, np.eye(4))
