# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; so3 and se3, which wrap these kernels, are strict.
"""Formulas of `so3` and `se3`, compiled: one element each, and loops over stacks of them.

The calls of many small NumPy functions would cost a hundred times more than the arithmetic. Sources of the formulas are
named where they are documented, in `so3` and `se3`. Every kernel writes to its last argument.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

SMALL = 1e-4
"""Below this angle the closed forms lose digits and their Taylor series are exact to double precision."""

SMALL_COUPLING = 1e-2
"""The same for the coefficients of `_coupling`, which lose digits earlier."""


@njit(cache=True, error_model="numpy")
@no_type_check
def coefficients(angle):
    """sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3."""
    square = angle * angle
    if angle < SMALL:
        return 1 - square / 6, 0.5 - square / 24, 1 / 6 - square / 120
    half = math.sin(angle / 2)
    return math.sin(angle) / angle, 2 * half * half / square, (angle - math.sin(angle)) / (square * angle)


@njit(cache=True, error_model="numpy")
@no_type_check
def inverse_coefficient(angle):
    """1/t^2 - (1 + cos t)/(2 t sin t); as 1/tan(t/2) it stays finite at pi."""
    if angle < SMALL:
        return 1 / 12 + angle * angle / 720
    return 1 / (angle * angle) - 1 / (2 * angle * math.tan(angle / 2))


@njit(cache=True, error_model="numpy")
@no_type_check
def length(v):
    """Norm of a vector (3,)."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@njit(cache=True, error_model="numpy")
@no_type_check
def series(first, second, w, out):
    """I + first hat(w) + second hat(w)^2, with hat(w)^2 = w w' - |w|^2 I."""
    x, y, z = w[0], w[1], w[2]
    out[0, 0] = 1 - second * (y * y + z * z)
    out[1, 1] = 1 - second * (x * x + z * z)
    out[2, 2] = 1 - second * (x * x + y * y)
    out[0, 1] = second * x * y - first * z
    out[1, 0] = second * x * y + first * z
    out[0, 2] = second * x * z + first * y
    out[2, 0] = second * x * z - first * y
    out[1, 2] = second * y * z - first * x
    out[2, 1] = second * y * z + first * x


@njit(cache=True, error_model="numpy")
@no_type_check
def quaternion(r, out):
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation (3, 3): the row of `outer` with the largest component."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    best = trace
    axis = -1
    for k in range(3):
        if r[k, k] > best:
            best, axis = r[k, k], k
    if axis < 0:
        out[0] = 1 + trace
        out[1], out[2], out[3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    else:
        j, k = (axis + 1) % 3, (axis + 2) % 3
        out[0] = r[k, j] - r[j, k]
        out[1 + axis] = 1 - trace + 2 * r[axis, axis]
        out[1 + j] = r[j, axis] + r[axis, j]
        out[1 + k] = r[k, axis] + r[axis, k]
    scale = 1 / math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
    if out[0] < 0:
        scale = -scale
    for k in range(4):
        out[k] *= scale


@njit(cache=True, error_model="numpy")
@no_type_check
def rotation_log(r, out):
    """Tangent vector (3,) of a rotation (3, 3)."""
    q = np.empty(4)
    quaternion(r, q)
    sine = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 2 * math.atan2(sine, q[0]) / sine if sine > 1e-12 else 2.0
    for k in range(3):
        out[k] = scale * q[k + 1]


@njit(cache=True, error_model="numpy")
@no_type_check
def transform_exp(xi, out):
    """Transform (4, 4) of a twist (6,)."""
    a, b, c = coefficients(length(xi[:3]))
    jacobian = np.empty((3, 3))
    series(a, b, xi[:3], out[:3, :3])
    series(b, c, xi[:3], jacobian)
    for i in range(3):
        out[i, 3] = jacobian[i, 0] * xi[3] + jacobian[i, 1] * xi[4] + jacobian[i, 2] * xi[5]
        out[3, i] = 0.0
    out[3, 3] = 1.0


@njit(cache=True, error_model="numpy")
@no_type_check
def transform_log(transform, out):
    """Twist (6,) of a transform (4, 4)."""
    rotation_log(transform[:3, :3], out)
    jacobian = np.empty((3, 3))
    series(-0.5, inverse_coefficient(length(out)), out[:3], jacobian)
    for i in range(3):
        out[3 + i] = (
            jacobian[i, 0] * transform[0, 3] + jacobian[i, 1] * transform[1, 3] + jacobian[i, 2] * transform[2, 3]
        )


@njit(cache=True, error_model="numpy")
@no_type_check
def inverse(transform, out):
    """Inverse (4, 4) of a transform (4, 4)."""
    for i in range(3):
        out[i, 3] = -(
            transform[0, i] * transform[0, 3] + transform[1, i] * transform[1, 3] + transform[2, i] * transform[2, 3]
        )
        out[3, i] = 0.0
        for j in range(3):
            out[i, j] = transform[j, i]
    out[3, 3] = 1.0


@njit(cache=True, error_model="numpy")
@no_type_check
def compose(a, b, out):
    """Product of two transforms (4, 4)."""
    for i in range(3):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
        out[i, 3] += a[i, 3]
        out[3, i] = 0.0
    out[3, 3] = 1.0


@njit(cache=True, error_model="numpy")
@no_type_check
def adjoint(transform, out):
    """(6, 6) [[R, 0], [hat(t) R, R]] of a transform (4, 4)."""
    x, y, z = transform[0, 3], transform[1, 3], transform[2, 3]
    for j in range(3):
        a, b, c = transform[0, j], transform[1, j], transform[2, j]
        out[0, j], out[1, j], out[2, j] = a, b, c
        out[3, 3 + j], out[4, 3 + j], out[5, 3 + j] = a, b, c
        out[3, j], out[4, j], out[5, j] = y * c - z * b, z * a - x * c, x * b - y * a
        out[0, 3 + j] = out[1, 3 + j] = out[2, 3 + j] = 0.0


@njit(cache=True, error_model="numpy")
@no_type_check
def product(a, b, out):
    """Product of two matrices (3, 3); BLAS would take longer to call than to work."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True, error_model="numpy")
@no_type_check
def left_jacobian_inverse(xi, out):
    """(6, 6) [[J, 0], [-J Q J, J]] of a twist (6,), J the inverse left Jacobian of its rotation."""
    omega, rho = xi[:3], xi[3:]
    inv, coupling, half, lower = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    series(-0.5, inverse_coefficient(length(omega)), omega, inv)
    _coupling(omega, rho, coupling)
    product(inv, coupling, half)
    product(half, inv, lower)
    for i in range(3):
        for j in range(3):
            out[i, j] = out[3 + i, 3 + j] = inv[i, j]
            out[3 + i, j] = -lower[i, j]
            out[i, 3 + j] = 0.0


@njit(cache=True, error_model="numpy")
@no_type_check
def _coupling(w, p, out):
    """Q of Barfoot and Furgale: the block by which rotation moves translation.

    With W = hat(w), P = hat(p), d = w . p its products reduce to W P W = -d W, W P + P W = p w' + w p' - 2 d I and
    W W P + P W W = -|w|^2 P - d W.
    """
    t = length(w)
    square = t * t
    if t < SMALL_COUPLING:
        a = 1 / 6 - square / 120 + square * square / 5040
        b = 1 / 24 - square / 720 + square * square / 40320
        c = 1 / 120 - square / 2520 + square * square / 120960
    else:
        sin, cos = math.sin(t), math.cos(t)
        a = (t - sin) / t**3
        b = (square + 2 * cos - 2) / (2 * t**4)
        c = (2 * t - 3 * sin + t * cos) / (2 * t**5)
    d = w[0] * p[0] + w[1] * p[1] + w[2] * p[2]
    # The skew part is hat(v); the rest is symmetric.
    skew, v = np.empty((3, 3)), np.empty(3)
    for k in range(3):
        v[k] = (0.5 - b * square) * p[k] + d * (2 * b - a) * w[k]
    hat(v, skew)
    for i in range(3):
        for j in range(3):
            out[i, j] = skew[i, j] + a * (p[i] * w[j] + w[i] * p[j]) - 2 * c * d * w[i] * w[j]
        out[i, i] += 2 * d * (c * square - a)


@njit(cache=True, error_model="numpy")
@no_type_check
def hat(w, out):
    """Skew matrix (3, 3) of a vector (3,)."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 2] = -w[2], w[1], -w[0]
    out[1, 0], out[2, 0], out[2, 1] = w[2], -w[1], w[0]


@njit(cache=True, error_model="numpy")
@no_type_check
def hat_all(omega, out):
    """Of vectors (n, 3)."""
    for n in range(len(omega)):
        hat(omega[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def rotation_exp_all(omega, out):
    """Rotations (n, 3, 3) of tangent vectors (n, 3)."""
    for n in range(len(omega)):
        a, b, _ = coefficients(length(omega[n]))
        series(a, b, omega[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def rotation_log_all(rotation, out):
    """Of rotations (n, 3, 3)."""
    for n in range(len(rotation)):
        rotation_log(rotation[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def quaternion_all(rotation, out):
    """Of rotations (n, 3, 3)."""
    for n in range(len(rotation)):
        quaternion(rotation[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def rotation_left_jacobian_all(omega, out):
    """J (n, 3, 3) at tangent vectors (n, 3)."""
    for n in range(len(omega)):
        _, b, c = coefficients(length(omega[n]))
        series(b, c, omega[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def rotation_left_jacobian_inverse_all(omega, out):
    """J^-1 (n, 3, 3) at tangent vectors (n, 3)."""
    for n in range(len(omega)):
        series(-0.5, inverse_coefficient(length(omega[n])), omega[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def transform_exp_all(xi, out):
    """Of twists (n, 6)."""
    for n in range(len(xi)):
        transform_exp(xi[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def transform_log_all(transform, out):
    """Of transforms (n, 4, 4)."""
    for n in range(len(transform)):
        transform_log(transform[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def inverse_all(transform, out):
    """Of transforms (n, 4, 4)."""
    for n in range(len(transform)):
        inverse(transform[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def adjoint_all(transform, out):
    """Of transforms (n, 4, 4)."""
    for n in range(len(transform)):
        adjoint(transform[n], out[n])


@njit(cache=True, error_model="numpy")
@no_type_check
def left_jacobian_inverse_all(xi, out):
    """Of twists (n, 6)."""
    for n in range(len(xi)):
        left_jacobian_inverse(xi[n], out[n])
