"""Rigid transforms as 4x4 matrices; compose with `@`. Tangents are [rotation; translation], right-multiplied.

`plus(T, xi) = T @ exp(xi)`. A transform named target_from_source maps source coordinates to target coordinates.
Formulas: Sola, Deray, Atchuthan (2018), appendix D, with the rotation first.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from multicam.geometry import compiled, so3


def from_parts(
    rotation: Float64[np.ndarray, "*batch 3 3"], translation: Float64[np.ndarray, "*batch 3"]
) -> Float64[np.ndarray, "*batch 4 4"]:
    """Builds transforms from rotation matrices and translations (metres)."""
    transform = np.zeros((*rotation.shape[:-2], 4, 4))
    transform[..., :3, :3] = rotation
    transform[..., :3, 3] = translation
    transform[..., 3, 3] = 1
    return transform


def inverse(transform: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 4 4"]:
    """source_from_target of a target_from_source."""
    return so3.over_stack(compiled.inverse_all, transform, 2, (4, 4))


def act(transform: Float64[np.ndarray, "*batch 4 4"], points: Float64[np.ndarray, "*batch_p 3"]) -> np.ndarray:
    """Maps points (..., n, 3) or a single (3,): target coordinates of source points.

    Batch axes of the transform lead those of the points: (b, 4, 4) acting on (n, 3) gives (b, n, 3).
    """
    if points.ndim == 1:
        return (transform[..., :3, :3] @ points[:, None])[..., 0] + transform[..., :3, 3]
    return points @ np.swapaxes(transform[..., :3, :3], -1, -2) + transform[..., None, :3, 3]


def exp(xi: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 4 4"]:
    """Exponential of a twist [rotation; translation]."""
    return so3.over_stack(compiled.transform_exp_all, xi, 1, (4, 4))


def log(transform: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 6"]:
    """Twist whose exponential is the transform; rotation angle in [0, pi]."""
    return so3.over_stack(compiled.transform_log_all, transform, 2, (6,))


def plus(transform: Float64[np.ndarray, "*#batch 4 4"], xi: Float64[np.ndarray, "*#batch 6"]) -> np.ndarray:
    """T @ exp(xi)."""
    return transform @ exp(xi)


def minus(a: Float64[np.ndarray, "*#batch 4 4"], b: Float64[np.ndarray, "*#batch 4 4"]) -> np.ndarray:
    """The twist with plus(b, twist) = a."""
    return log(inverse(b) @ a)


def adjoint(transform: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 6 6"]:
    """Ad(T) with T exp(xi) T^-1 = exp(Ad(T) xi): [[R, 0], [hat(t) R, R]]."""
    return so3.over_stack(compiled.adjoint_all, transform, 2, (6, 6))


def left_jacobian_inverse(xi: Float64[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 6 6"]:
    """J^-1 with log(exp(d) exp(xi)) ~ xi + J^-1 d; for a right perturbation use left_jacobian_inverse(-xi).

    Closed form of Barfoot and Furgale, "Associating uncertainty with three-dimensional poses" (2014), eq. 102.
    """
    return so3.over_stack(compiled.left_jacobian_inverse_all, xi, 1, (6, 6))


def random(rng: np.random.Generator, *batch: int, spread: float = 1.0) -> np.ndarray:
    """Uniform rotations and normal translations (standard deviation `spread` metres)."""
    return from_parts(so3.random(rng, *batch), spread * rng.normal(size=(*batch, 3)))
