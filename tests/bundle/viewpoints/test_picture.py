from __future__ import annotations

import numpy as np
import pytest

from multicam.bundle.viewpoints.generate import look_along
from multicam.bundle.viewpoints.picture import MARGIN, Picture, draw_picture
from multicam.bundle.viewpoints.shell import find_shells
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from tests.bundle.viewpoints.shapes import ball, box, moved, open_box, torus

DISTANCE = 0.8
MESHES = {
    "torus": torus(),
    "box": box(),
    "open box": open_box(),
    "tiny box": box((0.01, 0.006, 0.001)),
    "far from its origin": moved(ball(), (0.1, -0.2, 0.15)),
}


def _draw(mesh: Mesh, seed: int, side: int = 200) -> Picture:
    direction = np.random.default_rng(seed).normal(size=(1, 3))
    return draw_picture(find_shells(mesh), look_along(direction)[0], DISTANCE, side)


def _camera(picture: Picture) -> Camera:
    view, (height, width) = picture.view, picture.inverse_depth.shape
    matrix = [[view.focal, 0, view.center_x], [0, view.focal, view.center_y], [0, 0, 1]]
    return Camera(np.array(matrix), width, height)


@pytest.mark.parametrize("name", MESHES)
def test_depth_is_that_of_the_exact_rasterizer(name: str) -> None:
    for seed in range(4):
        picture = _draw(MESHES[name], seed)
        camera_from_object = se3.from_parts(picture.view.rotation, np.array([0, 0, DISTANCE]))
        exact = render_depth(MESHES[name], _camera(picture), camera_from_object)
        both = (exact > 0) & (picture.inverse_depth > 0)
        # Rounded corners may move the silhouette across a pixel's centre.
        assert np.count_nonzero((exact > 0) != (picture.inverse_depth > 0)) < 0.005 * np.count_nonzero(both)
        error = np.abs(1 / picture.inverse_depth[both] - exact[both])
        assert np.quantile(error, 0.99) < 0.02 * picture.view.pixel_size


@pytest.mark.parametrize("name", MESHES)
def test_the_silhouette_fills_the_picture_up_to_its_margin(name: str) -> None:
    picture = _draw(MESHES[name], seed=1)
    seen = picture.inverse_depth > 0
    assert max(seen.shape) == pytest.approx(200, abs=2)
    for axis in (0, 1):
        places = np.flatnonzero(seen.any(axis=axis))
        assert places[0] in (MARGIN, MARGIN + 1)
        assert seen.shape[1 - axis] - MARGIN - 3 <= places[-1] <= seen.shape[1 - axis] - MARGIN


def test_a_closed_mesh_shows_no_cracks() -> None:
    for seed in range(5):
        picture = _draw(ball(), seed, side=400)
        assert len(picture.start) == 2


def test_an_open_box_is_seen_from_behind() -> None:
    downwards = look_along(np.array([[0.0, 0.0, -1.0]]))[0]
    picture = draw_picture(find_shells(open_box()), downwards, DISTANCE, 100)
    height, width = picture.inverse_depth.shape
    # Through the missing lid the floor is seen, 1 cm beyond the origin.
    assert 1 / picture.inverse_depth[height // 2, width // 2] == pytest.approx(DISTANCE + 0.01, abs=1e-6)


def test_cameras_look_along_their_directions_and_keep_level() -> None:
    direction = np.vstack((np.random.default_rng(0).normal(size=(20, 3)), np.eye(3), -np.eye(3)))
    rotation = look_along(direction)
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, 1, 2), np.broadcast_to(np.eye(3), (26, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1)
    np.testing.assert_allclose(rotation[:, 2], direction / np.linalg.norm(direction, axis=1, keepdims=True))
    np.testing.assert_allclose(rotation[:, 0, 1], 0, atol=1e-12)
