# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; hypotheses and consensus, which wrap these kernels, are strict.
"""Which objects may be one, compiled: pairs of one class, the poses they measure, and the best pairs one-to-one."""

from __future__ import annotations

import numpy as np
from numba import njit

from multicam.geometry import compiled
from multicam.matching.linear_compiled import add_congruent


@njit(cache=True, error_model="numpy")
def pair_up(reference_frame, reference_class, query_frame, query_class, allowed):
    """Allowed pairs (n,) of one class, sorted by both frames; frames ascend.

    Returns:
        reference, query (n,), link (n,) numbered pairs of frames, and rivals (n,): how many pairs of its link share the
        reference, or the query, whichever are more.
    """
    count = 0
    for i in range(len(reference_frame)):
        for j in range(len(query_frame)):
            count += allowed[i, j] and reference_class[i] == query_class[j]
    reference, query, key = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    frames, n = largest(query_frame) + 1, 0
    for i in range(len(reference_frame)):
        for j in range(len(query_frame)):
            if allowed[i, j] and reference_class[i] == query_class[j]:
                reference[n], query[n], key[n] = i, j, reference_frame[i] * frames + query_frame[j]
                n += 1
    order = np.argsort(key, kind="mergesort")
    reference, query, key = reference[order], query[order], key[order]
    link, rivals = np.empty(count, np.int64), np.empty(count, np.int64)
    of_reference, of_query = np.zeros(len(reference_frame), np.int64), np.zeros(len(query_frame), np.int64)
    start, number = 0, 0
    while start < count:
        stop = start
        while stop < count and key[stop] == key[start]:
            of_reference[reference[stop]] += 1
            of_query[query[stop]] += 1
            stop += 1
        for n in range(start, stop):
            link[n], rivals[n] = number, max(of_reference[reference[n]], of_query[query[n]])
        for n in range(start, stop):
            of_reference[reference[n]] = of_query[query[n]] = 0
        start, number = stop, number + 1
    return reference, query, link, rivals


@njit(cache=True, error_model="numpy")
def relative_poses(
    reference, query, symmetry, reference_pose, reference_covariance, query_pose, query_covariance, transforms,
    pose, covariance, move,
):  # fmt: skip
    """Writes reference_from_query (m, 4, 4) by objects and their symmetry, and its covariance (m, 6, 6).

    Also the adjoint (m, 6, 6) of the twin query_from_object @ inverse(symmetry), which carries tangents of the object
    to the query.
    """
    inverse, twin, of_query = np.empty((4, 4)), np.empty((4, 4)), np.empty((6, 6))
    for n in range(len(reference)):
        a, b = reference[n], query[n]
        compiled.inverse(transforms[symmetry[n]], inverse)
        compiled.compose(query_pose[b], inverse, twin)
        compiled.adjoint(twin, move[n])
        compiled.adjoint(query_pose[b], of_query)
        compiled.inverse(twin, inverse)
        compiled.compose(reference_pose[a], inverse, pose[n])
        covariance[n] = 0
        add_congruent(move[n], reference_covariance[a], covariance[n])
        add_congruent(of_query, query_covariance[b], covariance[n])


@njit(cache=True, error_model="numpy")
def one_to_one(owner, reference, query, gain, best):
    """Writes (n,) whether a pairing is the best of its owner both for its reference and for its query; owners ascend.

    Of equals the last one counts.
    """
    by_reference, by_query = np.full(largest(reference) + 1, -1), np.full(largest(query) + 1, -1)
    start = 0
    while start < len(owner):
        stop = start
        while stop < len(owner) and owner[stop] == owner[start]:
            a, b = reference[stop], query[stop]
            # What an earlier owner left does not count.
            if by_reference[a] < start or gain[stop] >= gain[by_reference[a]]:
                by_reference[a] = stop
            if by_query[b] < start or gain[stop] >= gain[by_query[b]]:
                by_query[b] = stop
            stop += 1
        for n in range(start, stop):
            best[n] = by_reference[reference[n]] == n and by_query[query[n]] == n
        start = stop


@njit(cache=True, error_model="numpy")
def largest(index):
    """The largest of indices (n,), -1 if there are none."""
    result = -1
    for value in index:
        result = max(result, value)
    return result
