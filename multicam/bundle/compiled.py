# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; pose and normal, which wrap these kernels, are strict.
"""Edges between cameras and objects, compiled: one loop each, for a scene has a handful of them."""

from __future__ import annotations

import numpy as np
from numba import njit

from multicam.geometry import compiled
from multicam.matching.linear_compiled import invert_all, product


@njit(cache=True, error_model="numpy")
def edge_poses(world_from_camera, world_from_object, camera, obj, out):
    """See State.camera_from_object: writes (e, 4, 4)."""
    inverse = np.empty((4, 4))
    for e in range(len(camera)):
        compiled.inverse(world_from_camera[camera[e]], inverse)
        compiled.compose(inverse, world_from_object[obj[e]], out[e])


@njit(cache=True, error_model="numpy")
def move_cameras(world_from_camera, fixed, step, out):
    """Writes the cameras (c, 4, 4), all but the fixed ones moved by the twists (f, 6) of a step."""
    moved, twist = 0, np.empty((4, 4))
    for c in range(len(fixed)):
        if fixed[c]:
            out[c] = world_from_camera[c]
            continue
        compiled.transform_exp(step[moved], twist)
        compiled.compose(world_from_camera[c], twist, out[c])
        moved += 1


@njit(cache=True, error_model="numpy")
def linearize_poses(pose, observed, information, energy, gradient, hessian):
    """See PoseFactor: writes energies (e,), gradients (e, 6) and Hessians (e, 6, 6) at poses (e, 4, 4)."""
    inverse, difference, jacobian = np.empty((4, 4)), np.empty((4, 4)), np.empty((6, 6))
    residual, pulled = np.empty(6), np.empty((6, 6))
    for e in range(len(pose)):
        compiled.inverse(observed[e], inverse)
        compiled.compose(inverse, pose[e], difference)
        compiled.transform_log(difference, residual)
        compiled.left_jacobian_inverse(-residual, jacobian)
        product(jacobian.T, information[e], pulled)
        product(pulled, jacobian, hessian[e])
        squared = 0.0
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += pulled[i, j] * residual[j]
                squared += residual[i] * information[e, i, j] * residual[j]
            gradient[e, i] = total
        energy[e] = squared / 2


@njit(cache=True, error_model="numpy")
def add_edges(
    camera, obj, pose, gradient, hessian, weight,
    camera_hessian, object_hessian, coupling, camera_gradient, object_gradient,
):  # fmt: skip
    """See NormalEquations.add_edges: adds edges (e,) at poses camera_from_object (e, 4, 4)."""
    inverse, jacobian, mixed, square = np.empty((4, 4)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    for e in range(len(pose)):
        c, o, w = camera[e], obj[e], weight[e]
        compiled.inverse(pose[e], inverse)
        compiled.adjoint(inverse, jacobian)
        product(hessian[e], jacobian, mixed)
        product(jacobian.T, mixed, square)
        # The camera moves the pose by minus the adjoint.
        for i in range(6):
            object_gradient[o, i] += w * gradient[e, i]
            for j in range(6):
                object_hessian[o, i, j] += w * hessian[e, i, j]
                coupling[o, c, i, j] -= w * mixed[i, j]
                camera_hessian[c, i, j] += w * square[i, j]
                camera_gradient[c, i] -= w * jacobian[j, i] * gradient[e, j]


@njit(cache=True, error_model="numpy")
def eliminate(camera_hessian, object_hessian, coupling, motion, damping, eliminated, pulled, schur):
    """See NormalEquations._reduce; False if an object's block is not positive definite."""
    objects, cameras = coupling.shape[0], coupling.shape[1]
    damped, rows = object_hessian.copy(), np.empty((6 * objects, 6 * cameras))
    for o in range(objects):
        for i in range(6):
            damped[o, i, i] *= 1 + damping
            for c in range(cameras):
                for j in range(6):
                    rows[6 * o + i, 6 * c + j] = coupling[o, c, i, j]
    if not invert_all(damped, eliminated, np.empty(objects)):
        return False
    for o in range(objects):
        for i in range(6):
            for j in range(6 * cameras):
                total = 0.0
                for k in range(6):
                    total += eliminated[o, i, k] * rows[6 * o + k, j]
                pulled[6 * o + i, j] = total
    schur[:] = -np.dot(rows.T, pulled)
    for c in range(cameras):
        for i in range(6):
            for j in range(6):
                schur[6 * c + i, 6 * c + j] += camera_hessian[c, i, j]
                for d in range(cameras):
                    schur[6 * c + i, 6 * d + j] += motion[c, d, i, j]
            schur[6 * c + i, 6 * c + i] += damping * camera_hessian[c, i, i]
    return True
