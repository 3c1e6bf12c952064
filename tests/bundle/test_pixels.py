"""Pixels to rays and back, for cameras turned about their axis as well."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from multicam.bundle.pixels import projected, unprojected


@given(
    focal=st.tuples(st.floats(100, 2000), st.floats(100, 2000)),
    skew=st.floats(-50, 50),
    centre=st.tuples(st.floats(0, 1000), st.floats(0, 1000)),
    quarters=st.integers(0, 3),
    point=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 5)),
)
def test_a_pixel_unprojects_to_the_ray_it_came_from(
    focal: tuple[float, float],
    skew: float,
    centre: tuple[float, float],
    quarters: int,
    point: tuple[float, float, float],
) -> None:
    matrix = np.array([[focal[0], skew, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarters)
    matrix[:2] = turn @ matrix[:2]
    x, y, z = point
    ray = unprojected(matrix) @ np.array([*projected(matrix, x, y, z), 1.0])
    np.testing.assert_allclose(ray, [x / z, y / z], atol=1e-9)
    np.testing.assert_allclose(unprojected(matrix), np.linalg.inv(matrix)[:2], atol=1e-9)
