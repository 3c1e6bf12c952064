# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; the modules that wrap these kernels are strict.
"""Points into pixels and pixels around them, compiled; shared by the searches in colour and depth pictures."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def transformed(transform, x, y, z):
    """A point moved by a transform (4, 4)."""
    return (
        transform[0, 0] * x + transform[0, 1] * y + transform[0, 2] * z + transform[0, 3],
        transform[1, 0] * x + transform[1, 1] * y + transform[1, 2] * z + transform[1, 3],
        transform[2, 0] * x + transform[2, 1] * y + transform[2, 2] * z + transform[2, 3],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def projected(matrix, x, y, z):
    """Pixel of a point in front of a camera with matrix (3, 3)."""
    return (
        (matrix[0, 0] * x + matrix[0, 1] * y) / z + matrix[0, 2],
        (matrix[1, 0] * x + matrix[1, 1] * y) / z + matrix[1, 2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def unprojected(matrix):
    """Rays (2, 3) with z = 1 of homogeneous pixels: the upper rows of the inverse of a camera matrix (3, 3)."""
    a, b, c, d = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    inverse = np.array([[d, -b, 0.0], [-c, a, 0.0]]) / (a * d - b * c)
    for row in range(2):
        inverse[row, 2] = -(inverse[row, 0] * matrix[0, 2] + inverse[row, 1] * matrix[1, 2])
    return inverse


@njit(cache=True, nogil=True, error_model="numpy")
def focal_length(matrix):
    """Pixels per radian along the camera's x axis, however the picture is turned."""
    return math.sqrt(matrix[0, 0] ** 2 + matrix[1, 0] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def inside(u, v, shape):
    """Whether a pixel lies on a picture of a shape (height, width); false for NaN."""
    return -0.5 <= u < shape[1] - 0.5 and -0.5 <= v < shape[0] - 0.5


@njit(cache=True, nogil=True, error_model="numpy")
def window(u, v, across, most, shape):
    """Square of pixels around a pixel on the picture, thinned to about `most` strides and cut at the borders.

    Args:
        across: width in pixels, as a real number.

    Returns:
        The stride, then first and last column, first and last row; the last ones may be passed over.
    """
    stride = int(across / most + 1)
    whole = int(across / stride + 0.5) * stride
    left = math.floor(u - whole / 2 + 0.5)
    top = math.floor(v - whole / 2 + 0.5)
    return (
        stride,
        max(left, 0), min(left + whole, shape[1] - 1),
        max(top, 0), min(top + whole, shape[0] - 1),
    )  # fmt: skip
