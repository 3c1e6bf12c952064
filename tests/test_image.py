"""The letterbox against itself, against OpenCV's pixels and against the camera model."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicam.geometry.camera import Camera
from multicam.image import PADDING, Letterbox
from tests.close import assert_close
from tests.pictures import blob_centre, blob_image, noise_image
from tests.strategies import Array, arrays

SIZES = [(640, 480), (480, 640), (761, 429), (1504, 846), (333, 77), (97, 211), (160, 120)]
INPUTS = [(320, 320), (320, 256), (416, 416)]


@st.composite
def letterboxes(draw: st.DrawFn) -> Letterbox:
    side = st.integers(8, 2000)
    target = st.sampled_from([256, 320, 416, 640])
    return Letterbox.fit(draw(side), draw(side), draw(target), draw(target))


@given(letterboxes(), arrays(2, 3000))
def test_pixels_lead_there_and_back(box: Letterbox, pixel: Array) -> None:
    assert_close(box.to_source(box.to_input(pixel)), pixel, atol=1e-9)
    affine = box.input_from_source
    assert_close(box.to_input(pixel), affine[:2, :2] @ pixel + affine[:2, 2], atol=1e-9)
    assert_close(box.to_input(np.stack([pixel, pixel]))[1], box.to_input(pixel))


@given(st.integers(8, 2000), st.integers(8, 2000))
def test_the_image_fits_touches_two_sides_and_is_centred(width: int, height: int) -> None:
    box = Letterbox.fit(width, height, 320, 256)
    corners = box.to_input(np.array([[-0.5, -0.5], [width - 0.5, height - 0.5]])) + 0.5
    size = corners[1] - corners[0]
    assert (corners > -0.51).all()
    assert (corners < np.array([320, 256]) + 0.51).all()
    assert np.isclose(size, [320, 256]).any()
    # Whole pixels on each side; an odd one goes to the right or below.
    assert np.abs(corners.mean(0) - [160, 128]).max() <= 1.0


@pytest.mark.parametrize("source", SIZES)
@pytest.mark.parametrize("target", INPUTS)
@pytest.mark.parametrize("corner", [(0.15, 0.2), (0.88, 0.8)])
def test_pixels_go_where_the_formula_says(
    source: tuple[int, int], target: tuple[int, int], corner: tuple[float, float]
) -> None:
    """A blob near either end: an error of scale grows from one end to the other."""
    box = Letterbox.fit(*source, *target)
    sigma = min(6.0, 0.03 * min(source) / min(1.0, box.scale))
    centre = np.array(corner) * source
    drawn = box.apply(blob_image(*source, centre, sigma))
    assert drawn.shape == (target[1], target[0], 3)
    width, height = round(source[0] * box.scale), round(source[1] * box.scale)
    black = np.zeros_like(drawn)
    inside = np.s_[box.offset_y : box.offset_y + height, box.offset_x : box.offset_x + width]
    black[inside] = drawn[inside]
    assert blob_centre(black) == pytest.approx(box.to_input(centre), abs=0.05)


@pytest.mark.parametrize("source", SIZES)
def test_the_border_is_grey_and_the_picture_untouched_inside(source: tuple[int, int]) -> None:
    box = Letterbox.fit(*source, 320, 320)
    drawn = box.apply(np.full((source[1], source[0], 3), 200, dtype=np.uint8))
    inside = (drawn == 200).all(axis=-1)
    assert set(np.unique(drawn)) <= {PADDING, 200}
    width, height = round(source[0] * box.scale), round(source[1] * box.scale)
    assert inside.sum() == width * height
    assert inside[box.offset_y : box.offset_y + height, box.offset_x : box.offset_x + width].all()


def test_an_image_of_the_right_size_is_copied(rng: np.random.Generator) -> None:
    image = noise_image(320, 256, rng)
    box = Letterbox.fit(320, 256, 320, 256)
    assert np.array_equal(box.apply(image), image)
    assert box.apply(image) is not image
    assert np.array_equal(box.input_from_source, np.eye(3))


@given(letterboxes(), arrays(2, 0.5))
def test_the_camera_of_the_input_sees_what_the_letterbox_shows(box: Letterbox, slope: Array) -> None:
    camera = Camera.from_focal(500.0, 640, 480)
    point = np.array([*slope, 1.0])
    warped = camera.warped(box.input_from_source, box.width, box.height)
    assert_close(warped.project(point), box.to_input(camera.project(point)), atol=1e-9)


def test_shrinking_averages_and_does_not_skip_pixels(rng: np.random.Generator) -> None:
    """Fine noise shrunk to a quarter must lose three quarters of its deviation."""
    image = rng.integers(0, 256, (1024, 1280, 3), dtype=np.uint8)
    drawn = Letterbox.fit(1280, 1024, 320, 256).apply(image)
    assert drawn.std() < 0.27 * image.std()
    assert np.abs(drawn.astype(int) - cv2.resize(image, (320, 256), interpolation=cv2.INTER_AREA)).max() <= 1
