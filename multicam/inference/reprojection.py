# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; the functions around these kernels are strict.
"""Reprojection residuals of one object and their minimiser, compiled.

Products of three numbers are written out: a call of BLAS for each costs more than all of the arithmetic.

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
def _in_camera(transform, point):
    """Coordinates of a point (3,) moved by a transform (4, 4)."""
    a, b, c = point
    x = transform[0, 0] * a + transform[0, 1] * b + transform[0, 2] * c + transform[0, 3]
    y = transform[1, 0] * a + transform[1, 1] * b + transform[1, 2] * c + transform[1, 3]
    z = transform[2, 0] * a + transform[2, 1] * b + transform[2, 2] * c + transform[2, 3]
    return x, y, z


@njit(cache=True)
def residuals(transform, points, pixels, std, matrix):
    """Whitened residuals.

    Args:
        transform: (4, 4) camera_from_object; points: (n, 3) metres; pixels, std: (n, 2); matrix: (3, 3).

    Returns:
        (n, 2); infinite where a point is not in front of the camera.
    """
    out = np.empty((len(points), 2))
    for k in range(len(points)):
        x, y, z = _in_camera(transform, points[k])
        if z <= 1e-9:
            out[k] = np.inf
            continue
        for i in range(2):
            pixel = (matrix[i, 0] * x + matrix[i, 1] * y) / z + matrix[i, 2]
            out[k, i] = (pixel - pixels[k, i]) / std[k, i]
    return out


@njit(cache=True)
def jacobian(transform, points, std, matrix):
    """(n, 2, 6): derivative of `residuals` by the right perturbation [rotation; translation]."""
    out = np.empty((len(points), 2, 6))
    for k in range(len(points)):
        x, y, z = _in_camera(transform, points[k])
        a, b, c = points[k]
        for i in range(2):
            m0, m1 = matrix[i, 0] / (z * std[k, i]), matrix[i, 1] / (z * std[k, i])
            m2 = -(m0 * x + m1 * y) / z
            for axis in range(3):
                out[k, i, 3 + axis] = m0 * transform[0, axis] + m1 * transform[1, axis] + m2 * transform[2, axis]
            g0, g1, g2 = out[k, i, 3:]
            # The row -g hat(X) is the cross product X x g.
            out[k, i, 0] = b * g2 - c * g1
            out[k, i, 1] = c * g0 - a * g2
            out[k, i, 2] = a * g1 - b * g0
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
            rest = matrix[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
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
