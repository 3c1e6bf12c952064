"""Our cameras in Blender's conventions, without Blender."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.blender.axes import SENSOR_MM, lens_of, world_from_blender_camera
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.geometry.camera import Camera


@pytest.mark.parametrize(("width", "height"), [(64, 48), (48, 64)])
def test_blender_projects_to_the_same_pixel(width: int, height: int, rng: np.random.Generator) -> None:
    camera = Camera(np.array([[70.0, 0, 30.0], [0, 70, 25], [0, 0, 1]]), width, height)
    world_from_camera = se3.random(rng)
    points = se3.act(world_from_camera, rng.normal(size=(20, 3)) * 0.2 + [0, 0, 1.0])
    expected = camera.project(se3.act(se3.inverse(world_from_camera), points))
    # Blender: x right, y up, looking along -z; film coordinates in shares of the larger side, y up, 0 in the middle.
    x, y, z = se3.act(se3.inverse(world_from_blender_camera(world_from_camera)), points).T
    lens, side = lens_of(camera), max(width, height)
    film_x = lens.focal_mm / SENSOR_MM * x / -z - lens.shift_x
    film_y = lens.focal_mm / SENSOR_MM * y / -z - lens.shift_y
    found = np.stack((film_x * side + width / 2 - 0.5, height / 2 - film_y * side - 0.5), axis=1)
    assert np.allclose(found, expected)


@pytest.mark.parametrize(
    "camera",
    [
        Camera(np.array([[70.0, 0, 30], [0, 71, 20], [0, 0, 1]]), 64, 48),
        Camera(np.array([[70.0, 1, 30], [0, 70, 20], [0, 0, 1]]), 64, 48),
        Camera(np.array([[70.0, 0, 30], [0, 70, 20], [0, 0, 1]]), 64, 48, (0.1, 0.0, 0.0, 0.0)),
    ],
)
def test_lenses_that_blender_cannot_make_are_refused(camera: Camera) -> None:
    with pytest.raises(DataError, match="square pixels"):
        lens_of(camera)
