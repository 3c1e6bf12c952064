# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; hypotheses, consensus and assignment, which wrap these kernels, are strict.
"""Poses against measurements, compiled: differences, and the weighted means of what agrees."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from multicam.geometry import compiled
from multicam.matching.linear_compiled import invert_all, product


@njit(cache=True, error_model="numpy")
def turn_angle(rotation, direction):
    """Angle a for which rotation (3, 3) @ exp(a direction) is closest to the identity, for a unit direction n.

    trace(R exp(a n)) = cos a (tr R - n'Rn) - 2 sin a (n . vee R) + n'Rn.
    """
    along, trace = 0.0, 0.0
    for i in range(3):
        trace += rotation[i, i]
        for j in range(3):
            along += direction[i] * rotation[i, j] * direction[j]
    skew = (
        direction[0] * (rotation[2, 1] - rotation[1, 2])
        + direction[1] * (rotation[0, 2] - rotation[2, 0])
        + direction[2] * (rotation[1, 0] - rotation[0, 1])
    )
    return math.atan2(-skew, trace - along)


@njit(cache=True, error_model="numpy")
def difference(pose, measured, axis, out):
    """pose^-1 measured (4, 4), turned about an axis (6,), if that is not zero, to come closest to the identity."""
    inverse = np.empty((4, 4))
    compiled.inverse(pose, inverse)
    compiled.compose(inverse, measured, out)
    if axis[0] != 0 or axis[1] != 0 or axis[2] != 0:
        angle = turn_angle(out[:3, :3], axis[:3])
        turn, turned = np.empty((4, 4)), np.empty((4, 4))
        compiled.transform_exp(angle * axis, turn)
        compiled.compose(out, turn, turned)
        out[:] = turned


@njit(cache=True, error_model="numpy")
def near_differences(pose, start, stop, measured, axis, least_trace, owner, member, residual):
    """Logarithms (n, 6) of the differences of each pose (h, 4, 4) to the measurements start[h] to stop[h].

    Only of those whose rotation has a trace above `least_trace`. Writes owner, member and residual; returns n.
    """
    count = 0
    relative = np.empty((4, 4))
    for h in range(len(pose)):
        for m in range(start[h], stop[h]):
            if axis[m, 0] == 0 and axis[m, 1] == 0 and axis[m, 2] == 0:
                trace = 0.0
                for i in range(3):
                    for j in range(3):
                        trace += pose[h, i, j] * measured[m, i, j]
                # Most pairs are told apart by this alone.
                if trace <= least_trace:
                    continue
            difference(pose[h], measured[m], axis[m], relative)
            if relative[0, 0] + relative[1, 1] + relative[2, 2] > least_trace:
                owner[count], member[count] = h, m
                compiled.transform_log(relative, residual[count])
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def squared_norms(residual, information, member, out):
    """Writes r' A r (n,) of residuals (n, 6) and the matrices (m, 6, 6) of their members (n,)."""
    for n in range(len(residual)):
        total, matrix = 0.0, information[member[n]]
        for i in range(6):
            for j in range(6):
                total += residual[n, i] * matrix[i, j] * residual[n, j]
        out[n] = total


@njit(cache=True, error_model="numpy")
def refit(pose, owner, residual, weight, information, member, moved, covariance, log_determinant):
    """Takes each pose (h, 4, 4) to the weighted mean of what its residuals (n, 6) say; owners ascend.

    Writes the poses (h, 4, 4), their covariances (h, 6, 6) and the log determinants (h,) of their information. A pose
    without residuals stays where it is, with unit information. False if an information is not positive definite.
    """
    normal, right, shift = np.empty((1, 6, 6)), np.empty(6), np.empty(6)
    step, n = np.empty((4, 4)), 0
    for h in range(len(pose)):
        normal[:], right[:] = 0, 0
        first = n
        while n < len(owner) and owner[n] == h:
            matrix = information[member[n]]
            for i in range(6):
                for j in range(6):
                    normal[0, i, j] += weight[n] * matrix[i, j]
                    right[i] += weight[n] * matrix[i, j] * residual[n, j]
            n += 1
        if n == first:
            for i in range(6):
                normal[0, i, i] = 1
        if not invert_all(normal, covariance[h : h + 1], log_determinant[h : h + 1]):
            return False
        for i in range(6):
            shift[i] = 0
            for j in range(6):
                shift[i] += covariance[h, i, j] * right[j]
        compiled.transform_exp(shift, step)
        compiled.compose(pose[h], step, moved[h])
    return True


@njit(cache=True, error_model="numpy")
def fuse(pose, covariance, row, measured, noise):
    """Moves some of the poses (o, 4, 4) with covariances (o, 6, 6) towards measurements (n, 4, 4) with noise (n, 6, 6).

    By the weighted mean of both (Kalman's update); `row` (n,) tells which, each at most once. False if the sum of a
    covariance and its noise is not positive definite.
    """
    inverse, relative, step, residual, shift = (
        np.empty((4, 4)),
        np.empty((4, 4)),
        np.empty((4, 4)),
        np.empty(6),
        np.empty(6),
    )
    total, weight, gain, less = np.empty((1, 6, 6)), np.empty((1, 6, 6)), np.empty((6, 6)), np.empty((6, 6))
    for n in range(len(row)):
        o = row[n]
        total[0] = covariance[o] + noise[n]
        if not invert_all(total, weight, np.empty(1)):
            return False
        product(covariance[o], weight[0], gain)
        compiled.inverse(pose[o], inverse)
        compiled.compose(inverse, measured[n], relative)
        compiled.transform_log(relative, residual)
        for i in range(6):
            shift[i] = 0
            for j in range(6):
                shift[i] += gain[i, j] * residual[j]
        compiled.transform_exp(shift, step)
        compiled.compose(pose[o], step, relative)
        pose[o] = relative
        product(gain, covariance[o], less)
        covariance[o] -= less
    return True
