# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; hypotheses and consensus, which wrap these kernels, are strict.
"""Hypotheses against measurements, compiled: the loops whose length is their product."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from multicam.geometry import compiled


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
def difference_all(pose, measured, axis, out):
    """Of poses (n, 4, 4), measurements (n, 4, 4) and axes (n, 6)."""
    for n in range(len(pose)):
        difference(pose[n], measured[n], axis[n], out[n])


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
def accumulate(owner, values, out):
    """Adds values (n, ...) to the rows (h, ...) of their owners."""
    for n in range(len(owner)):
        out[owner[n]] += values[n]


@njit(cache=True, error_model="numpy")
def greatest(slot, value, winner):
    """Writes the element (of n) with the greatest value of each slot; of equals the last. `winner` starts as -1."""
    for n in range(len(slot)):
        best = winner[slot[n]]
        if best < 0 or value[n] >= value[best]:
            winner[slot[n]] = n
