# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; the functions around these kernels are strict.
"""Reprojection residuals of one object and their minimiser, compiled: about 30 microseconds for 8 keypoints.

For a keypoint X (object frame, metres) seen at pixel u with standard deviations s (per coordinate),

    p = R X + t,    r = S^-1 (A (p_x, p_y) / p_z + c - u),    S = diag(s),

where A, c are the upper blocks of the camera matrix [A c; 0 1]. With the right perturbation
T exp(xi), xi = [rotation; translation], dp/dxi = R [-hat(X)  I], hence

    dr/dxi = S^-1 A [1/p_z 0 -p_x/p_z^2; 0 1/p_z -p_y/p_z^2] R [-hat(X)  I].
"""

from __future__ import annotations

import numpy as np
from numba import njit

_MAX_STEPS = 50
_MAX_DAMPING = 1e10


@njit(cache=True)
def residuals(transform, points, pixels, std, matrix):
    """Whitened residuals.

    Args:
        transform: (4, 4) camera_from_object; points: (n, 3) metres; pixels, std: (n, 2); matrix: (3, 3).

    Returns:
        (n, 2); infinite where a point is not in front of the camera.
    """
    out = np.empty((len(points), 2))
    rotation = np.ascontiguousarray(transform[:3, :3])
    for k in range(len(points)):
        p = rotation @ points[k] + transform[:3, 3]
        if p[2] <= 1e-9:
            out[k] = np.inf
            continue
        x, y = p[0] / p[2], p[1] / p[2]
        for i in range(2):
            out[k, i] = (matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] - pixels[k, i]) / std[k, i]
    return out


@njit(cache=True)
def jacobian(transform, points, std, matrix):
    """(n, 2, 6): derivative of `residuals` by the right perturbation [rotation; translation]."""
    out = np.empty((len(points), 2, 6))
    rotation = np.ascontiguousarray(transform[:3, :3])
    for k in range(len(points)):
        p = rotation @ points[k] + transform[:3, 3]
        a, b, c = points[k]
        for i in range(2):
            m0, m1 = matrix[i, 0] / (p[2] * std[k, i]), matrix[i, 1] / (p[2] * std[k, i])
            by_p = np.array([m0, m1, -(m0 * p[0] + m1 * p[1]) / p[2]])
            g = by_p @ rotation
            # The row -g hat(X) is the cross product X x g.
            out[k, i, 0] = b * g[2] - c * g[1]
            out[k, i, 1] = c * g[0] - a * g[2]
            out[k, i, 2] = a * g[1] - b * g[0]
            out[k, i, 3:] = g
    return out


@njit(cache=True)
def huber_cost(residual, threshold):
    """Sum over (n, 2) residuals of norm e of Huber's function: e^2, beyond the threshold k it is 2 k e - k^2."""
    total = 0.0
    for k in range(len(residual)):
        norm = np.hypot(residual[k, 0], residual[k, 1])
        total += norm * norm if norm <= threshold else 2 * threshold * norm - threshold * threshold
    return total


@njit(cache=True)
def information(transform, points, pixels, std, matrix, threshold):
    """Gradient (6,) and information matrix (6, 6) of half the Huber cost, by iterated reweighting."""
    r = residuals(transform, points, pixels, std, matrix)
    j = jacobian(transform, points, std, matrix)
    gradient, hessian = np.zeros(6), np.zeros((6, 6))
    for k in range(len(points)):
        weight = threshold / max(np.hypot(r[k, 0], r[k, 1]), threshold)
        for i in range(2):
            for a in range(6):
                gradient[a] += weight * r[k, i] * j[k, i, a]
                for b in range(6):
                    hessian[a, b] += weight * j[k, i, a] * j[k, i, b]
    return gradient, hessian


@njit(cache=True)
def _solve_positive(matrix, right):
    """x with matrix x = right, for a positive definite (n, n) matrix and right (n,), by Cholesky.

    LAPACK would do, but OpenBLAS wakes its threads for it: on a busy machine 6x6 then costs milliseconds.
    """
    n = len(matrix)
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j] - lower[i, :j] @ lower[j, :j]
            lower[i, j] = np.sqrt(rest) if i == j else rest / lower[j, j]
    x = right.copy()
    for i in range(n):
        for j in range(i):
            x[i] -= lower[i, j] * x[j]
        x[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= lower[j, i] * x[j]
        x[i] /= lower[i, i]
    return x


@njit(cache=True)
def _moved(transform, step):
    """T (Exp(rotation), translation): a retraction that agrees with T exp(step) to first order."""
    omega = step[:3]
    angle = np.sqrt(omega @ omega)
    a = 1.0 if angle < 1e-8 else np.sin(angle) / angle
    b = 0.5 if angle < 1e-8 else 2 * (np.sin(angle / 2) / angle) ** 2
    x, y, z = omega
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    delta = np.eye(3) + a * hat + b * (hat @ hat)
    rotation = np.ascontiguousarray(transform[:3, :3])
    out = np.eye(4)
    out[:3, :3] = rotation @ delta
    out[:3, 3] = transform[:3, 3] + rotation @ step[3:]
    return out


@njit(cache=True)
def refine(transform, points, pixels, std, matrix, threshold):
    """Minimises the Huber cost from a start by Levenberg-Marquardt.

    Returns:
        camera_from_object (4, 4) and its cost; infinite if a point of the start is behind the camera.
    """
    cost = huber_cost(residuals(transform, points, pixels, std, matrix), threshold)
    damping = 1e-4
    for _ in range(_MAX_STEPS):
        if not np.isfinite(cost) or cost < 1e-24:
            break
        gradient, hessian = information(transform, points, pixels, std, matrix, threshold)
        accepted = False
        while not accepted and damping < _MAX_DAMPING:
            damped = hessian.copy()
            for i in range(6):
                # The addition keeps the system solvable where nothing is observed (roll of a straight rod).
                damped[i, i] += damping * hessian[i, i] + 1e-9 * (1 + hessian[i, i])
            candidate = _moved(transform, _solve_positive(damped, -gradient))
            new_cost = huber_cost(residuals(candidate, points, pixels, std, matrix), threshold)
            accepted = new_cost < cost
            damping *= 0.1 if accepted else 10.0
        if not accepted:
            break
        settled = cost - new_cost < 1e-9 * (1 + cost)
        transform, cost = candidate, new_cost
        damping = max(damping, 1e-12)
        if settled:
            break
    return transform, cost


@njit(cache=True)
def truncated_costs(transforms, points, pixels, std, matrix, limits):
    """Score of many poses at once, the less the better.

    Args:
        transforms: (m, 4, 4); limits: (n,) whitened norm beyond which a keypoint counts as an outlier.

    Returns:
        (m,) mean over the keypoints of min(norm^2 / limit^2, 1).
    """
    out = np.empty(len(transforms))
    for m in range(len(transforms)):
        r = residuals(transforms[m], points, pixels, std, matrix)
        total = 0.0
        for k in range(len(points)):
            total += min((r[k, 0] ** 2 + r[k, 1] ** 2) / limits[k] ** 2, 1.0)
        out[m] = total / len(points)
    return out
