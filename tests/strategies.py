"""Hypothesis strategies for geometry: rotations that dwell near 0 and near pi, transforms, cameras."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera

Array = NDArray[np.float64]


def arrays(size: int, bound: float) -> st.SearchStrategy[Array]:
    """Vectors with entries in [-bound, bound]."""
    return st.lists(st.floats(-bound, bound), min_size=size, max_size=size).map(lambda v: np.array(v, dtype=np.float64))


def seeds() -> st.SearchStrategy[np.random.Generator]:
    """Generators, for data whose exact form does not matter."""
    return st.integers(0, 2**32 - 1).map(np.random.default_rng)


@st.composite
def directions(draw: st.DrawFn) -> Array:
    """Unit vectors; the coordinate axes and their opposites come up often."""
    if draw(st.booleans()):
        return draw(st.sampled_from((1.0, -1.0))) * np.eye(3)[draw(st.integers(0, 2))]
    z, azimuth = draw(st.floats(-1, 1)), draw(st.floats(0, 2 * np.pi))
    radius = np.sqrt(1 - z * z)
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), z])


def angles(most: float = np.pi) -> st.SearchStrategy[float]:
    """Angles in [0, most]; tiny ones and ones just below `most` come up often."""
    tiny = st.floats(-14, -2).map(lambda exponent: 10.0**exponent)
    return st.one_of(
        st.floats(0, most), st.just(0.0), st.just(most), tiny, tiny.map(lambda small: max(most - small, 0.0))
    )


@st.composite
def rotation_vectors(draw: st.DrawFn, most: float = np.pi) -> Array:
    """(3,) axis times angle, norm at most `most`."""
    return draw(directions()) * draw(angles(most))


def rotations(most: float = np.pi) -> st.SearchStrategy[Array]:
    """(3, 3) rotation matrices by at most `most` radians."""
    return rotation_vectors(most).map(so3.exp)


@st.composite
def twists(draw: st.DrawFn, most: float = np.pi, reach: float = 3.0) -> Array:
    """(6,) [rotation; translation], translation within +-reach per axis."""
    return np.concatenate((draw(rotation_vectors(most)), draw(arrays(3, reach))))


@st.composite
def transforms(draw: st.DrawFn, most: float = np.pi, reach: float = 3.0) -> Array:
    """(4, 4) rigid transforms, translation within +-reach metres per axis."""
    return se3.from_parts(draw(rotations(most)), draw(arrays(3, reach)))


@st.composite
def distortions(draw: st.DrawFn) -> tuple[float, ...]:
    """OpenCV coefficients of real lenses: none, Brown-Conrady with 4 or 5 numbers, or the rational model."""
    count = draw(st.sampled_from((0, 4, 5, 8)))
    bounds = (0.15, 0.05, 0.003, 0.003, 0.02, 0.1, 0.05, 0.01)[:count]
    return tuple(draw(st.floats(-bound, bound)) for bound in bounds)


@st.composite
def cameras(draw: st.DrawFn, distorted: bool = False) -> Camera:
    """Cameras with field of view between about 40 and 90 degrees and a principal point off the centre."""
    width, height = draw(st.integers(32, 1920)), draw(st.integers(32, 1080))
    focal = max(width, height) * draw(st.floats(0.5, 1.4))
    matrix = np.array(
        [
            [focal, 0, (width - 1) / 2 + draw(st.floats(-0.05, 0.05)) * width],
            [0, focal * draw(st.floats(0.9, 1.1)), (height - 1) / 2 + draw(st.floats(-0.05, 0.05)) * height],
            [0, 0, 1],
        ]
    )
    return Camera(matrix, width, height, draw(distortions()) if distorted else ())


@st.composite
def visible_points(draw: st.DrawFn, camera: Camera, count: int = 8) -> Array:
    """(count, 3) points in metres, 0.2 to 3 m before the camera, whose ideal images lie on the sensor."""
    rng = draw(seeds())
    pixels = rng.uniform(0, 1, (count, 2)) * [camera.width - 1, camera.height - 1]
    return camera.without_distortion().unproject(pixels, rng.uniform(0.2, 3, count))
