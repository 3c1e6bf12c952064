"""Boxes on a table before a rig of cameras: pictures in colour and depth, viewpoint models, and scenes to adjust."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from multicam.bundle.adjustment.keypoints import EdgeKeypoints
from multicam.bundle.adjustment.scene import Body, Picture, Scene
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.problem import State
from multicam.bundle.viewpoints.generate import ViewpointConfig, generate
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.rasterizer import render_depth
from tests.bundle.box_world import box

CAMERA = Camera.from_focal(300.0, 320, 240)
COLORS = np.array([[200, 60, 40], [40, 170, 60], [220, 200, 50]])
WALL = np.array([60, 90, 180])
ESTIMATE_STD = np.repeat([0.05, 0.008], 3)
"""Of the estimated poses, radians and metres."""


@cache
def body() -> Body:
    return Body(generate(box(), ViewpointConfig(subdivisions=3, picture=160)), box())


@cache
def cameras() -> np.ndarray:
    """world_from_camera of three cameras half a metre away that look at the origin."""
    return np.array([looking(angle) for angle in (-0.5, 0.1, 0.7)])


def looking(angle: float) -> np.ndarray:
    eye = 0.5 * np.array([np.sin(angle), -0.6, -np.cos(angle)])
    z = -eye / np.linalg.norm(eye)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return se3.from_parts(np.stack((x, np.cross(z, x), z), axis=1), eye)


@cache
def objects() -> np.ndarray:
    """world_from_object of three boxes side by side."""
    turns = np.array([[0.2, 0.5, 0.1], [-0.3, 0.2, 0.6], [0.4, -0.6, 0.2]])
    return np.array([se3.exp(np.r_[turn, [0.13 * k, 0, 0]]) for turn, k in zip(turns, (-1, 0, 1), strict=True)])


def picture(rng: np.random.Generator, camera_from_world: np.ndarray, placed: np.ndarray, depth: bool = True) -> Picture:
    """Boxes of three colours before a wall, with noise."""
    nearest = np.full((CAMERA.height, CAMERA.width), 1.0, np.float32)
    image = np.broadcast_to(WALL, (CAMERA.height, CAMERA.width, 3)).astype(float)
    for color, pose in zip(COLORS, placed, strict=False):
        drawn = render_depth(box(), CAMERA, camera_from_world @ pose)
        front = (drawn > 0) & (drawn < nearest)
        nearest[front], image[front] = drawn[front], color
    noisy = (image + rng.normal(scale=8, size=image.shape)).clip(0, 255).astype(np.uint8)
    return Picture(noisy, CAMERA, DepthImage(nearest, CAMERA, np.eye(4)) if depth else None)


def with_keypoints(scene: Scene, rng: np.random.Generator, edges: int, std: float = 1.0) -> Scene:
    """The scene with the corners of the first edges' boxes as keypoints, off by a pixel."""
    exact = se3.inverse(cameras())[scene.camera] @ objects()[scene.object]
    corners = box().vertices[:8]
    edge = np.repeat(np.arange(edges), len(corners))
    pixel = CAMERA.project(np.reshape([se3.act(exact[e], corners) for e in range(edges)], (-1, 3)))
    return replace(
        scene,
        keypoints=EdgeKeypoints(
            edge, np.tile(corners, (edges, 1)), pixel + std * rng.normal(size=pixel.shape), np.full(pixel.shape, std),
            np.tile(CAMERA.matrix, (len(edge), 1, 1)),
        ),
    )  # fmt: skip


def rig(rng: np.random.Generator, depth: bool = True) -> Scene:
    """Every camera sees every box; estimates are noisy, and the first camera is fixed."""
    camera, obj = (index.ravel() for index in np.mgrid[:3, :3])
    pictures = [picture(rng, se3.inverse(each), objects(), depth) for each in cameras()]
    exact = se3.inverse(cameras())[camera] @ objects()[obj]
    return Scene(
        pictures=pictures,
        bodies=[body()] * 3,
        camera=camera,
        object=obj,
        estimated=se3.plus(exact, rng.normal(size=(9, 6)) * ESTIMATE_STD),
        information=np.tile(np.diag(ESTIMATE_STD**-2), (9, 1, 1)),
        fixed=np.arange(3) == 0,
        camera_covariance=np.array([0.0, 1, 1])[:, None, None] * np.diag(np.repeat([0.05, 0.03], 3) ** 2),
        object_covariance=np.tile(np.diag(np.repeat([0.06, 0.01], 3) ** 2), (3, 1, 1)),
    )


def only(scene: Scene, edges: np.ndarray) -> Scene:
    """The scene with some of its edges."""
    parts = {name: getattr(scene, name)[edges] for name in ("camera", "object", "estimated", "information")}
    return replace(scene, **parts)


def shaken(rng: np.random.Generator) -> State:
    """Cameras off by about 20 mm and 1.5 degrees, boxes by about 8 mm and 3 degrees."""
    camera = rng.normal(size=(3, 6)) * np.repeat([0.015, 0.012], 3)
    camera[0] = 0
    obj = rng.normal(size=(3, 6)) * np.repeat([0.03, 0.005], 3)
    return State(se3.plus(cameras(), camera), se3.plus(objects(), obj))


def camera_errors(state: State) -> np.ndarray:
    """(3,) millimetres."""
    return 1e3 * np.linalg.norm(state.world_from_camera[:, :3, 3] - cameras()[:, :3, 3], axis=1)
