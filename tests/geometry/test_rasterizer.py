"""Depth maps against rays cut by the planes of a convex body, which is exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import NEAR, render_depth, render_depths
from tests.close import assert_close
from tests.strategies import Array, arrays, rotations
from tests.toy_objects import BRACKET, PEG, PYRAMID, toy_meshes
from tests.toy_world import looking_at

CAMERA = Camera.from_focal(90.0, 64, 48)
MESHES = toy_meshes()


def ray_depth(mesh: Mesh, camera: Camera, camera_from_object: Array) -> tuple[Array, Array]:
    """Depth at which the ray of each pixel enters a convex mesh (0: misses), and how far inside it passes (m)."""
    corners = se3.act(camera_from_object, mesh.vertices)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("fi,fi->f", normals, corners[:, 0])
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(np.float64)
    slope = camera.unproject(pixels) @ normals.T
    with np.errstate(divide="ignore"):
        crossing = offsets / slope
    enter = np.where(slope < 0, crossing, -np.inf).max(-1)
    leave = np.where(slope > 0, crossing, np.inf).min(-1)
    return np.where(leave > enter, enter, 0.0), leave - enter


@pytest.mark.parametrize("obj_id", [BRACKET, PEG, PYRAMID])
@given(rotation=rotations(), translation=arrays(3, 0.08))
@settings(max_examples=20)
def test_depth_is_that_of_the_first_surface_the_ray_meets(obj_id: int, rotation: Array, translation: Array) -> None:
    # Large shifts push the body over the border of the image.
    pose = se3.from_parts(rotation, translation * [3, 3, 1] + [0, 0, 0.4])
    expected, inside = ray_depth(MESHES[obj_id], CAMERA, pose)
    found = render_depth(MESHES[obj_id], CAMERA, pose)
    assert found.dtype == np.float32
    # A ray that grazes an edge may fall on either side of it.
    clear = np.abs(inside) > 1e-6
    assert_close(found[clear], expected[clear], atol=1e-6)


def test_a_warped_camera_draws_the_warped_picture() -> None:
    camera = CAMERA.warped(np.array([[1.5, 0.3, -4], [-0.2, 1.2, 9], [0, 0, 1.0]]), 90, 70)
    pose = se3.inverse(looking_at(np.array([0.2, -0.3, 0.25]), np.zeros(3)))
    expected, inside = ray_depth(MESHES[BRACKET], camera, pose)
    clear = np.abs(inside) > 1e-6
    assert (expected > 0).sum() > 200
    assert_close(render_depth(MESHES[BRACKET], camera, pose)[clear], expected[clear], atol=1e-6)


def test_of_several_meshes_the_nearest_is_seen() -> None:
    poses = [se3.from_parts(np.eye(3), np.array([x, 0, z])) for x, z in ((0.0, 0.5), (0.02, 0.4), (-0.04, 0.3))]
    meshes = [(MESHES[obj_id], pose) for obj_id, pose in zip((BRACKET, PEG, PYRAMID), poses, strict=True)]
    alone = np.array([render_depth(mesh, CAMERA, pose) for mesh, pose in meshes])
    nearest = np.where(alone > 0, alone, np.inf).min(axis=0)
    assert all(np.any(one == nearest) for one in alone)
    assert np.array_equal(render_depths(meshes, CAMERA), np.where(np.isfinite(nearest), nearest, 0))


def test_the_winding_of_a_face_does_not_matter() -> None:
    mesh = MESHES[PYRAMID]
    pose = se3.inverse(looking_at(np.array([0.2, -0.3, 0.25]), np.zeros(3)))
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy())
    assert_close(render_depth(turned, CAMERA, pose), render_depth(mesh, CAMERA, pose), atol=1e-6)


def test_what_reaches_behind_the_camera_is_clipped() -> None:
    """A floor 0.1 m below the eye, from 2 m behind it to 2.1 m before it."""
    floor = Mesh(
        np.array([[-5, 0.1, -2], [5, 0.1, -2], [5, 0.1, 2.1], [-5, 0.1, 2.1]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    found = render_depth(floor, CAMERA, np.eye(4))
    down = CAMERA.unproject(np.stack(np.meshgrid(np.zeros(1), np.arange(48.0)), axis=-1))[:, 0, 1]
    expected = np.where(down > 0.1 / 2.1, 0.1 / np.maximum(down, 1e-9), 0)
    assert_close(found, expected[:, None] * np.ones(64), atol=1e-5)


def test_what_stands_nearer_than_the_near_plane_is_not_drawn() -> None:
    wall = np.array([[-1, -1, 0], [1, -1, 0], [0, 2, 0.0]])
    mesh = Mesh(wall, np.array([[0, 1, 2]]))
    pose = np.eye(4)
    pose[2, 3] = 0.9 * NEAR
    assert not render_depth(mesh, CAMERA, pose).any()
    pose[2, 3] = 1.1 * NEAR
    assert render_depth(mesh, CAMERA, pose)[24, 32] == pytest.approx(1.1 * NEAR)


def test_a_lens_with_distortion_is_refused() -> None:
    with pytest.raises(ValueError, match="straight edges"):
        render_depth(MESHES[PEG], Camera(CAMERA.matrix, 64, 48, (0.1, 0.0, 0.0, 0.0)), np.eye(4))
