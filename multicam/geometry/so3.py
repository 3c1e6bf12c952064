"""Rotations as 3x3 matrices and their tangent vectors (axis times angle, radians).

Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), appendix B.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

_SMALL = 1e-4
"""Below this angle the closed forms lose digits and their Taylor series are exact to double precision."""


def hat(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Returns the skew matrix with hat(a) @ b = a x b."""
    x, y, z = np.moveaxis(omega, -1, 0)
    zero = np.zeros_like(x)
    rows = (zero, -z, y, z, zero, -x, -y, x, zero)
    return np.stack(rows, axis=-1).reshape(*omega.shape[:-1], 3, 3)


def vee(skew: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """Inverse of `hat` on skew matrices; the antisymmetric part of anything else."""
    skew = (skew - np.swapaxes(skew, -1, -2)) / 2
    return np.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), axis=-1)


def exp(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Rotation by |omega| radians about omega (Rodrigues)."""
    a, b, _ = _coefficients(omega)
    skew = hat(omega)
    return np.eye(3) + a * skew + b * (skew @ skew)


def log(rotation: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """Tangent vector with norm in [0, pi]; accurate near 0 and near pi, through the unit quaternion."""
    quaternion = to_quaternion(rotation)
    w, v = quaternion[..., :1], quaternion[..., 1:]
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, w)
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return scale * v


def to_quaternion(rotation: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 4"]:
    """Unit quaternion (w, x, y, z) with w >= 0 (Shepperd: divide by the largest component)."""
    r = rotation
    trace = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    squares = np.stack((trace, r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]), axis=-1)
    outer = np.empty((*r.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1 + trace
    outer[..., 0, 1:] = outer[..., 1:, 0] = 2 * vee(r)
    outer[..., 1:, 1:] = r + np.swapaxes(r, -1, -2)
    for axis in range(3):
        outer[..., axis + 1, axis + 1] = 1 - trace + 2 * r[..., axis, axis]
    # Each row of `outer` is 4 q_k q; the row of the largest component is the best conditioned.
    best = np.argmax(squares, axis=-1)[..., None, None]
    q = np.take_along_axis(outer, best, axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def left_jacobian(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """J with exp(omega + d) ~ exp(J d) exp(omega); the right Jacobian is left_jacobian(-omega)."""
    _, b, c = _coefficients(omega)
    skew = hat(omega)
    return np.eye(3) + b * skew + c * (skew @ skew)


def left_jacobian_inverse(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Inverse of `left_jacobian`, in closed form; finite for angles below 2 pi."""
    angle = np.linalg.norm(omega, axis=-1)[..., None, None]
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    # The usual (1 + cos)/sin equals 1/tan(angle/2), which stays finite at pi.
    general = 1 / safe**2 - 1 / (2 * safe * np.tan(safe / 2))
    factor = np.where(small, 1 / 12 + angle**2 / 720, general)
    skew = hat(omega)
    return np.eye(3) - skew / 2 + factor * (skew @ skew)


def project(matrix: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Nearest rotation in the Frobenius norm (orthogonal Procrustes)."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ vt))
    u = u.copy()
    u[..., :, -1] *= sign[..., None]
    return u @ vt


def random(rng: np.random.Generator, *batch: int) -> np.ndarray:
    """Rotations drawn uniformly; shape (*batch, 3, 3)."""
    q = rng.normal(size=(*batch, 4))
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return np.stack(rows, axis=-1).reshape(*batch, 3, 3)


def _coefficients(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3, shaped to multiply 3x3 matrices."""
    angle = np.linalg.norm(omega, axis=-1)[..., None, None]
    small = angle < _SMALL
    t = np.where(small, 1.0, angle)
    square = angle**2
    a = np.where(small, 1 - square / 6, np.sin(t) / t)
    b = np.where(small, 0.5 - square / 24, 2 * np.sin(t / 2) ** 2 / t**2)
    c = np.where(small, 1 / 6 - square / 120, (t - np.sin(t)) / t**3)
    return a, b, c
