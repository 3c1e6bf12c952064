"""Rotations as 3x3 matrices and their tangent vectors (axis times angle, radians).

Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), appendix B.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from multicam.geometry import compiled


def hat(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Returns the skew matrix with hat(a) @ b = a x b."""
    return over_stack(compiled.hat_all, omega, 1, (3, 3))


def vee(skew: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """Inverse of `hat` on skew matrices; the antisymmetric part of anything else."""
    skew = (skew - np.swapaxes(skew, -1, -2)) / 2
    return np.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), axis=-1)


def cross(a: Float64[np.ndarray, "*#batch 3"], b: Float64[np.ndarray, "*#batch 3"]) -> np.ndarray:
    """a x b; `numpy.cross` takes several times as long over the few vectors of a scene."""
    return (hat(a) @ b[..., None])[..., 0]


def exp(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Rotation by |omega| radians about omega (Rodrigues)."""
    return over_stack(compiled.rotation_exp_all, omega, 1, (3, 3))


def log(rotation: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """Tangent vector with norm in [0, pi]; accurate near 0 and near pi, through the unit quaternion."""
    return over_stack(compiled.rotation_log_all, rotation, 2, (3,))


def to_quaternion(rotation: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 4"]:
    """Unit quaternion (w, x, y, z) with w >= 0 (Shepperd: divide by the largest component)."""
    return over_stack(compiled.quaternion_all, rotation, 2, (4,))


def left_jacobian(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """J with exp(omega + d) ~ exp(J d) exp(omega); the right Jacobian is left_jacobian(-omega)."""
    return over_stack(compiled.rotation_left_jacobian_all, omega, 1, (3, 3))


def left_jacobian_inverse(omega: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Inverse of `left_jacobian`, in closed form; finite for angles below 2 pi."""
    return over_stack(compiled.rotation_left_jacobian_inverse_all, omega, 1, (3, 3))


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


def over_stack(
    kernel: Callable[[np.ndarray, np.ndarray], None], values: np.ndarray, axes: int, shape: tuple[int, ...]
) -> np.ndarray:
    """Runs a compiled kernel over all leading axes.

    Args:
        kernel: takes stacks of inputs and of outputs, one leading axis each.
        values: (*batch, ...) with `axes` axes after the batch.
        shape: of one output.
    """
    batch = values.shape[: values.ndim - axes]
    result = np.empty(batch + shape)
    flat = np.ascontiguousarray(values, dtype=np.float64).reshape(-1, *values.shape[len(batch) :])
    kernel(flat, result.reshape(-1, *shape))
    return result
