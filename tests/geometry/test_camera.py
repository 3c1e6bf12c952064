"""The camera model against OpenCV, finite differences and the pixels of really resized images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from multicam.geometry.camera import Camera, distort, undistort
from tests.close import assert_close
from tests.pictures import blob_centre, blob_image
from tests.strategies import Array, arrays, cameras, distortions, seeds, visible_points

EXAMPLE = Camera(np.array([[500.0, 0, 320], [0, 510, 236], [0, 0, 1]]), 640, 480)


def in_lens(rng: np.random.Generator, count: int = 20, radius: float = 0.8) -> Array:
    """Normalized points within the field of view that the distortion strategies are fit for."""
    angle, r = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return np.column_stack((r * np.cos(angle), r * np.sin(angle)))


@given(cameras(distorted=True), seeds())
def test_projection_agrees_with_opencv(camera: Camera, rng: np.random.Generator) -> None:
    points = np.c_[in_lens(rng), np.ones(20)] * rng.uniform(0.2, 5, (20, 1))
    coefficients = np.array(camera.distortion) if camera.distortion else None
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, coefficients)
    assert_close(camera.project(points), expected[:, 0], atol=1e-8)


@given(distortions(), seeds())
def test_undistortion_agrees_with_opencv_and_is_sharper(
    coefficients: tuple[float, ...], rng: np.random.Generator
) -> None:
    assume(coefficients)
    normalized = in_lens(rng)
    distorted = distort(normalized, coefficients)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    theirs = cv2.undistortPointsIter(distorted[:, None], np.eye(3), np.array(coefficients), None, None, criteria)
    assert_close(undistort(distorted, coefficients), theirs[:, 0], atol=1e-7)
    assert_close(undistort(distorted, coefficients), normalized, atol=1e-12)


@given(cameras(distorted=True), seeds())
def test_unproject_undoes_project(camera: Camera, rng: np.random.Generator) -> None:
    depth = rng.uniform(0.2, 5, 20)
    points = np.c_[in_lens(rng), np.ones(20)] * depth[:, None]
    pixels = camera.project(points)
    assert_close(camera.unproject(pixels, depth), points, atol=1e-10)
    assert_close(camera.unproject(pixels), points / depth[:, None], atol=1e-10)


@given(cameras(distorted=True), seeds())
def test_undistorted_pixels_are_those_of_the_ideal_lens(camera: Camera, rng: np.random.Generator) -> None:
    points = np.c_[in_lens(rng), np.ones(20)]
    ideal = camera.without_distortion()
    assert_close(camera.undistort_pixels(camera.project(points)), ideal.project(points), atol=1e-7)
    assert ideal.distortion == ()


@given(st.data(), cameras())
def test_projection_jacobian_matches_differences(data: st.DataObject, camera: Camera) -> None:
    points = data.draw(visible_points(camera))
    step = 1e-6
    columns = [
        (camera.project(points + step * axis) - camera.project(points - step * axis)) / (2 * step) for axis in np.eye(3)
    ]
    found = camera.projection_jacobian(points)
    assert_close(found, np.stack(columns, axis=-1), rtol=1e-6, atol=1e-4)


@given(st.data(), cameras(), arrays(6, 1.0))
def test_a_warped_camera_projects_to_the_warped_pixel(data: st.DataObject, camera: Camera, numbers: Array) -> None:
    points = data.draw(visible_points(camera))
    warp = np.eye(3)
    warp[:2] += numbers.reshape(2, 3) * [0.4, 0.4, 50]
    warped = camera.warped(warp, 320, 200)
    moved = camera.project(points) @ warp[:2, :2].T + warp[:2, 2]
    assert_close(warped.project(points), moved, atol=1e-8)
    assert np.array_equal(warped.matrix, warp @ camera.matrix)
    assert (warped.width, warped.height) == (320, 200)
    # A skewed matrix must still lead back.
    assert_close(warped.unproject(moved, points[:, 2]), points, atol=1e-8)
    assert_close(warped.projection_jacobian(points), warp[:2, :2] @ camera.projection_jacobian(points))


def test_a_warped_camera_sees_what_warp_affine_draws() -> None:
    point = np.array([0.1, -0.05, 1.0])
    warp = np.array([[0.7, 0.2, 30.0], [-0.15, 0.8, 60.0], [0, 0, 1]])
    image = blob_image(640, 480, EXAMPLE.project(point))
    drawn = cv2.warpAffine(image, warp[:2], (600, 500))
    assert blob_centre(drawn) == pytest.approx(EXAMPLE.warped(warp, 600, 500).project(point), abs=0.02)


@pytest.mark.parametrize(("factor", "mode"), [(0.5, cv2.INTER_AREA), (0.3, cv2.INTER_AREA), (2.0, cv2.INTER_LINEAR)])
@pytest.mark.parametrize("size", [(640, 480), (761, 429)])
def test_a_scaled_camera_sees_what_resize_draws(factor: float, mode: int, size: tuple[int, int]) -> None:
    camera = Camera.from_focal(500.0, *size)
    point = np.array([0.35, -0.2, 1.0])
    image = blob_image(*size, camera.project(point))
    drawn = cv2.resize(image, None, fx=factor, fy=factor, interpolation=mode)
    scaled = camera.scaled(factor)
    assert drawn.shape[:2] == (scaled.height, scaled.width)
    assert blob_centre(drawn) == pytest.approx(scaled.project(point), abs=0.02)


@given(cameras(distorted=True), seeds())
def test_pixels_far_outside_the_image_break_nothing(camera: Camera, rng: np.random.Generator) -> None:
    pixels = rng.uniform(-2, 3, (200, 2)) * [camera.width, camera.height]
    assert np.isfinite(camera.undistort_pixels(pixels)).all()


def test_lenses_that_fold_over_break_nothing(rng: np.random.Generator) -> None:
    """Round numbers meet the fold itself, where the derivative is zero."""
    for _ in range(400):
        lens = tuple(np.round(rng.uniform(-1, 1, 5) * [0.4, 0.3, 0.02, 0.02, 0.15] * 32) / 32)
        points = np.round(rng.uniform(-4, 4, (100, 2)) * 4) / 4
        assert np.isfinite(undistort(points, lens)).all()


def test_a_model_is_undone_up_to_its_fold() -> None:
    """At radius 1 / sqrt(3 * 0.3) this lens turns back: the derivative is zero there."""
    lens = (-0.3, 0.0, 0.0, 0.0)
    radius = np.linspace(0, 3, 301)
    points = np.column_stack((radius, np.zeros(301)))
    inside = radius < 0.95
    assert_close(undistort(distort(points, lens), lens)[inside], points[inside], atol=1e-9)


@given(cameras(), distortions(), st.floats(0.2, 3))
def test_scaling_there_and_back_changes_nothing(camera: Camera, distortion: tuple[float, ...], factor: float) -> None:
    assert Camera(camera.matrix, camera.width, camera.height, distortion).scaled(factor).distortion == distortion
    there = camera.scaled(factor)
    assert_close(there.scaled(1 / factor).matrix, camera.matrix, atol=1e-9)
    # The corner of the image, half a pixel outside the first centre, stays the corner.
    corner = np.array([-0.5, -0.5])
    assert_close(there.unproject(corner), camera.unproject(corner), atol=1e-9)


def test_from_focal_looks_through_the_centre_of_the_picture() -> None:
    camera = Camera.from_focal(400.0, 640, 480)
    assert camera.project(np.array([0.0, 0, 2])) == pytest.approx([319.5, 239.5])


def test_the_sensor_reaches_half_a_pixel_beyond_the_outer_centres() -> None:
    inside = [[-0.5, -0.5], [0, 0], [639.49, 479.49]]
    outside = [[-0.51, 0], [0, -0.51], [639.5, 0], [0, 479.5], [np.nan, 0]]
    assert EXAMPLE.contains(np.array(inside)).all()
    assert not EXAMPLE.contains(np.array(outside)).any()


@given(seeds())
def test_batch_axes_lead(rng: np.random.Generator) -> None:
    points = np.concatenate((rng.normal(size=(2, 5, 2)), rng.uniform(1, 2, (2, 5, 1))), axis=-1)
    pixels = EXAMPLE.project(points)
    assert pixels.shape == (2, 5, 2)
    assert EXAMPLE.projection_jacobian(points).shape == (2, 5, 2, 3)
    assert_close(EXAMPLE.projection_jacobian(points)[1, 2], EXAMPLE.projection_jacobian(points[1, 2]))
    assert_close(EXAMPLE.unproject(pixels, points[..., 2]), points)


def test_an_affine_map_of_a_distorted_lens_is_refused() -> None:
    lens = Camera(EXAMPLE.matrix, 640, 480, (0.1, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="ideal lens"):
        lens.warped(np.eye(3), 640, 480)
    with pytest.raises(ValueError, match="ideal lens"):
        lens.projection_jacobian(np.array([0.0, 0, 1]))


@pytest.mark.parametrize("matrix", [np.eye(2), np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag([1.0, 1.0, np.inf])])
def test_a_matrix_that_is_no_camera_is_refused(matrix: Array) -> None:
    with pytest.raises(ValueError, match="camera matrix"):
        Camera(matrix, 640, 480)


def test_a_wrong_count_of_distortion_coefficients_is_refused() -> None:
    with pytest.raises(ValueError, match="got 3"):
        Camera(EXAMPLE.matrix, 640, 480, (0.1, 0.2, 0.3))
