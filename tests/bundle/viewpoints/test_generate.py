from __future__ import annotations

import os
from dataclasses import fields, replace
from functools import cache

import cv2
import numpy as np
import pytest
import trimesh

from multicam.bundle.viewpoints.generate import ViewpointConfig, generate, look_along
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.bundle.viewpoints.picture import draw_picture
from multicam.bundle.viewpoints.shell import find_shells
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.geometry.rasterizer import render_depth
from tests.bundle.viewpoints.shapes import BOX, RADIUS, TUBE, ball, box, moved, open_box, torus

CONFIG = ViewpointConfig(subdivisions=1, contour_points=80, surface_points=80, offsets=26)
MESHES = {
    "ball": ball(),
    "torus": torus(),
    "box": box(),
    "open box": open_box(),
    "metre": moved(torus(), (0, 0, 0), 8),
    "centimetre": moved(torus(), (0, 0, 0), 0.08),
    "off its origin": moved(box(), (0.1, -0.2, 0.15)),
}


@cache
def _model(name: str) -> ViewpointModel:
    return generate(MESHES[name], CONFIG)


def _distance(mesh: Mesh) -> float:
    return max(CONFIG.distance, 2 * float(np.linalg.norm(mesh.vertices, axis=1).max()))


def _in_camera(model: ViewpointModel, mesh: Mesh, points: np.ndarray, view: int) -> np.ndarray:
    return points @ look_along(model.direction[view : view + 1].astype(np.float64))[0].T + [0, 0, _distance(mesh)]


def _pixel(mesh: Mesh) -> float:
    """Most metres that a pixel spans in any view."""
    return 2.2 * float(np.linalg.norm(mesh.vertices - mesh.box.mean(0), axis=1).max()) / CONFIG.picture


def _along(model: ViewpointModel, direction: tuple[int, int, int]) -> int:
    view = int(np.argmax(model.direction @ np.array(direction, np.float32)))
    np.testing.assert_allclose(model.direction[view], direction, atol=1e-6)
    return view


def test_the_default_has_2562_views_all_around() -> None:
    model = generate(box(), ViewpointConfig(contour_points=1, surface_points=1, picture=40))
    assert model.direction.shape == (2562, 3)
    np.testing.assert_allclose(np.linalg.norm(model.direction, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(model.direction.mean(0), 0, atol=1e-6)
    others = model.direction @ model.direction.T - 2 * np.eye(2562)
    assert np.degrees(np.arccos(others.max(axis=1))).max() < 5


@pytest.mark.parametrize("name", MESHES)
def test_contour_points_project_onto_the_border_of_the_silhouette(name: str) -> None:
    mesh, model, finer = MESHES[name], _model(name), 4
    for view in range(0, len(model.direction), 15):
        rotation = look_along(model.direction[view : view + 1].astype(np.float64))[0]
        frame = draw_picture(find_shells(mesh), rotation, _distance(mesh), CONFIG.picture).view
        size = finer * (CONFIG.picture + 4)
        matrix = np.array([[frame.focal, 0, frame.center_x], [0, frame.focal, frame.center_y], [0, 0, 1]])
        camera = Camera(matrix, size // finer, size // finer).scaled(float(finer))
        drawn = render_depth(mesh, camera, se3.from_parts(rotation, np.array([0, 0, _distance(mesh)]))) > 0
        apart = cv2.distanceTransform(np.uint8(drawn), cv2.DIST_L2, 5)
        apart = np.maximum(apart, cv2.distanceTransform(np.uint8(~drawn), cv2.DIST_L2, 5)) - 0.5
        place = np.rint(camera.project(_in_camera(model, mesh, model.contour_point[view], view))).astype(int)
        assert apart[place[:, 1], place[:, 0]].max() < finer


@pytest.mark.parametrize("name", MESHES)
def test_normals_lead_out_of_the_silhouette_and_lie_in_the_image_plane(name: str) -> None:
    mesh, model = MESHES[name], _model(name)
    np.testing.assert_allclose(np.linalg.norm(model.contour_normal, axis=2), 1, atol=1e-5)
    np.testing.assert_allclose(np.einsum("vni,vi->vn", model.contour_normal, model.direction), 0, atol=1e-6)
    for view in range(0, len(model.direction), 15):
        rotation = look_along(model.direction[view : view + 1].astype(np.float64))[0]
        picture = draw_picture(find_shells(mesh), rotation, _distance(mesh), CONFIG.picture)
        for side in (-1, 1):
            # Two pixels either way along the normal.
            step = 2 * side * picture.view.pixel_size * model.contour_normal[view]
            points = _in_camera(model, mesh, model.contour_point[view] + step, view)
            image = picture.view.focal * points[:, :2] / points[:, 2:]
            x, y = np.rint(np.add(image, [picture.view.center_x, picture.view.center_y])).astype(int).T
            assert np.mean((picture.inverse_depth[y, x] > 0) == (side < 0)) > 0.97


@pytest.mark.parametrize("name", MESHES)
def test_surface_points_lie_on_faces_that_look_at_the_camera(name: str) -> None:
    mesh, model = MESHES[name], _model(name)
    # In pixels, for trimesh takes small numbers for zeros.
    triangles = mesh.vertices[mesh.faces] / _pixel(mesh)
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for view in range(0, len(model.direction), 15):
        for point, normal in zip(model.surface_point[view, :8], model.surface_normal[view, :8], strict=True):
            here = np.tile(point.astype(np.float64) / _pixel(mesh), (len(triangles), 1))
            apart = np.linalg.norm(trimesh.triangles.closest_point(triangles, here) - here, axis=1)
            assert apart.min() < 0.02
            assert np.abs(surface.face_normals[apart < 0.1] @ normal).max() > 1 - 1e-5
            assert normal @ (point + _distance(mesh) * model.direction[view]) < 0


def test_a_ball_is_as_worked_out_by_hand() -> None:
    model = _model("ball")
    slope = RADIUS / np.sqrt(0.8**2 - RADIUS**2)
    pixel = 2 * slope * 0.8 / (CONFIG.picture - 13)
    # A circle of radius r has 4 sqrt(2) r pixels that touch at edges or corners.
    np.testing.assert_allclose(model.contour_length, 4 * np.sqrt(2) * slope * 0.8, rtol=0.01)
    np.testing.assert_allclose(model.surface_area, np.pi * (slope * 0.8) ** 2, rtol=0.01)
    assert np.isinf(model.background).all()
    np.testing.assert_allclose(np.linalg.norm(model.surface_point, axis=2), RADIUS, rtol=1e-3)
    outward = model.surface_point / np.linalg.norm(model.surface_point, axis=2, keepdims=True)
    assert np.einsum("vni,vni->vn", outward, model.surface_normal).min() > np.cos(np.radians(2))
    for view in range(len(model.direction)):
        points = _in_camera(model, MESHES["ball"], model.contour_point[view], view)
        error = np.linalg.norm(points[:, :2], axis=1) / points[:, 2] - slope
        assert np.abs(error).max() < pixel / 0.8
        assert abs(error.mean()) < 0.15 * pixel / 0.8
        flat = model.contour_point[view] - np.outer(
            model.contour_point[view] @ model.direction[view], model.direction[view]
        )
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        assert np.quantile(np.sum(flat * model.contour_normal[view], axis=1), 0.1) > np.cos(np.radians(5))
        np.testing.assert_allclose(model.foreground[view], 2 * slope * points[:, 2], atol=3 * pixel)
        # The largest circles reach the nearest point of the ball from everywhere.
        np.testing.assert_allclose(model.contour_offset[view, :, -1], points[:, 2] - (0.8 - RADIUS), atol=2e-4)


def test_a_box_seen_face_on_is_as_worked_out_by_hand() -> None:
    model = _model("box")
    view = _along(model, (0, 0, 1))
    width, height, depth = BOX
    pixel = width / (CONFIG.picture - 13)
    point, normal = model.contour_point[view], model.contour_normal[view]
    np.testing.assert_allclose(point[:, 2], -depth / 2, atol=1e-6)
    from_edge = np.abs(np.abs(point[:, :2]) - [width / 2, height / 2])
    np.testing.assert_allclose(from_edge.min(axis=1), 0, atol=pixel)
    straight = from_edge.max(axis=1) > 8 * pixel
    assert np.mean(straight) > 0.8
    side = from_edge.argmin(axis=1)[straight]
    outward = np.sign(point[straight]) * np.eye(3)[side]
    np.testing.assert_allclose(normal[straight], outward, atol=1e-5)
    np.testing.assert_allclose(model.foreground[view][straight], np.array(BOX)[side], atol=2 * pixel)
    assert np.isinf(model.background[view]).all()
    magnified = (0.8 / (0.8 - depth / 2)) ** 2
    np.testing.assert_allclose(model.surface_area[view], width * height * magnified, rtol=0.01)
    np.testing.assert_allclose(model.surface_point[view, :, 2], -depth / 2, atol=1e-6)
    np.testing.assert_allclose(model.surface_normal[view], np.tile([0, 0, -1], (80, 1)), atol=1e-6)
    np.testing.assert_allclose(model.surface_offset[view], 0, atol=1e-6)


def test_a_torus_has_a_contour_around_its_hole() -> None:
    model = _model("torus")
    view = _along(model, (0, 0, 1))
    # Slopes of the rays that touch the tube, left and right of its circle.
    towards, half = np.arctan2(RADIUS, 0.8), np.arcsin(TUBE / np.hypot(RADIUS, 0.8))
    inner, outer = np.tan(towards - half), np.tan(towards + half)
    pixel = 2 * outer * 0.8 / (CONFIG.picture - 13)
    np.testing.assert_allclose(model.contour_length[view], 4 * np.sqrt(2) * (inner + outer) * 0.8, rtol=0.02)
    points = _in_camera(model, MESHES["torus"], model.contour_point[view], view)
    slope = np.linalg.norm(points[:, :2], axis=1) / points[:, 2]
    at_hole = slope < (inner + outer) / 2
    assert np.mean(at_hole) == pytest.approx(inner / (inner + outer), abs=0.03)
    np.testing.assert_allclose(slope, np.where(at_hole, inner, outer), atol=pixel / 0.8)
    outward = np.sum(model.contour_point[view] * model.contour_normal[view], axis=1)
    np.testing.assert_array_equal(outward < 0, at_hole)
    across = np.where(at_hole, 2 * inner * points[:, 2], np.inf)
    np.testing.assert_allclose(model.background[view], across, atol=2.5 * pixel)
    np.testing.assert_allclose(model.foreground[view], (outer - inner) * points[:, 2], atol=2.5 * pixel)


@pytest.mark.parametrize("name", ["torus", "metre", "centimetre", "off its origin"])
def test_depth_offsets_agree_with_brute_force(name: str) -> None:
    mesh, model = MESHES[name], _model(name)
    for view in range(0, len(model.direction), 15):
        rotation = look_along(model.direction[view : view + 1].astype(np.float64))[0]
        picture = draw_picture(find_shells(mesh), rotation, _distance(mesh), CONFIG.picture)
        y, x = np.nonzero(picture.inverse_depth)
        depth = 1 / picture.inverse_depth[y, x]
        # The circles are made of cells that are no wider than a step, or, of small objects, a fortieth of the picture.
        cell = max(1, min(CONFIG.offset_step / picture.view.pixel_size, CONFIG.picture / 40)) + 1
        for point, offset in zip(model.surface_point[view, :10], model.surface_offset[view, :10], strict=True):
            here = _in_camera(model, mesh, point[None], view)[0]
            scale = picture.view.focal / here[2]
            apart = np.hypot(x - picture.view.center_x - scale * here[0], y - picture.view.center_y - scale * here[1])
            for k in (0, 2, 5, 12, 25):
                radius = (k + 1) * CONFIG.offset_step * scale
                least, most = (
                    here[2] - depth[apart <= r].min(initial=here[2]) for r in (radius - 1.5 * cell, radius + 1.5 * cell)
                )
                assert least - 1e-5 <= offset[k] <= most + 1e-5


def test_depth_offsets_never_fall_and_are_never_negative() -> None:
    for name in MESHES:
        for offset in (_model(name).contour_offset, _model(name).surface_offset):
            assert offset.min() >= 0
            assert np.diff(offset, axis=2).min() >= 0


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(CONFIG, picture=100, subdivisions=2)
    model = generate(torus(), config)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    again, other = generate(torus(), config), generate(torus(), replace(config, seed=1))
    for field in fields(model):
        assert np.asarray(getattr(model, field.name)).tobytes() == np.asarray(getattr(again, field.name)).tobytes()
    assert np.mean(model.contour_point == other.contour_point) < 0.1
    np.testing.assert_array_equal(model.contour_length, other.contour_length)


def test_the_first_points_of_a_view_are_spread_all_over_it() -> None:
    model = _model("ball")
    for view in range(len(model.direction)):
        assert np.linalg.norm(model.contour_point[view, :20].mean(0) - model.contour_point[view].mean(0)) < RADIUS / 2


def test_a_plate_without_thickness_has_no_contour_where_it_is_seen_edge_on() -> None:
    plate = Mesh(box().vertices * [1, 1, 0], box().faces)
    model = generate(plate, CONFIG)
    edge_on, face_on = _along(model, (1, 0, 0)), _along(model, (0, 0, 1))
    assert model.contour_length[edge_on] == 0
    assert not model.contour_point[edge_on].any()
    np.testing.assert_allclose(model.surface_area[face_on], BOX[0] * BOX[1], rtol=0.01)
    assert np.isfinite(model.contour_point).all()


def test_a_mesh_without_area_is_refused() -> None:
    with pytest.raises(DataError, match="no triangle with an area"):
        generate(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])), CONFIG)
