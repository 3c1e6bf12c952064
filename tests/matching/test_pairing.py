"""Compiled pairing of objects against plain Python."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from multicam.geometry import se3
from multicam.matching.pairing import one_to_one, pair_up, relative_poses
from tests.close import assert_close
from tests.strategies import seeds


@given(seeds(), st.integers(0, 30))
def test_one_to_one_keeps_what_is_best_both_ways(rng: np.random.Generator, count: int) -> None:
    owner = np.sort(rng.integers(4, size=count))
    reference, query = rng.integers(3, size=(2, count))
    # Few values, so that some are equal: the last of them counts.
    gain = rng.integers(4, size=count).astype(float)
    found = np.empty(count, dtype=np.bool_)
    one_to_one(owner, reference, query, gain, found)

    def is_last_best(n: int, side: np.ndarray) -> bool:
        rivals = np.flatnonzero((owner == owner[n]) & (side == side[n]))
        return bool(max(rivals, key=lambda m: (gain[m], m)) == n)

    assert found.tolist() == [is_last_best(n, reference) and is_last_best(n, query) for n in range(count)]


@given(seeds(), st.integers(0, 8), st.integers(0, 8))
def test_pairs_are_those_of_one_class_sorted_by_frames(rng: np.random.Generator, references: int, queries: int) -> None:
    frame = np.sort(rng.integers(3, size=references)), np.sort(rng.integers(3, size=queries))
    obj_id = rng.integers(2, size=references), rng.integers(2, size=queries)
    allowed = rng.uniform(size=(references, queries)) < 0.7
    pairs = [
        (i, j) for i in range(references) for j in range(queries) if allowed[i, j] and obj_id[0][i] == obj_id[1][j]
    ]
    pairs.sort(key=lambda pair: (frame[0][pair[0]], frame[1][pair[1]]))
    frames = [(frame[0][i], frame[1][j]) for i, j in pairs]
    numbers = {pair: n for n, pair in enumerate(dict.fromkeys(frames))}
    reference, query, link, rivals = pair_up(frame[0], obj_id[0], frame[1], obj_id[1], allowed)
    assert list(zip(reference.tolist(), query.tolist(), strict=True)) == pairs
    assert link.tolist() == [numbers[pair] for pair in frames]
    assert rivals.tolist() == [
        max(
            sum(other[side] == pair[side] and frames[m] == frames[n] for m, other in enumerate(pairs))
            for side in (0, 1)
        )
        for n, pair in enumerate(pairs)
    ]


def test_relative_poses_carry_the_covariances_of_both_objects(rng: np.random.Generator) -> None:
    poses, twins = (se3.random(rng, 2), se3.random(rng, 3)), se3.random(rng, 2)
    root = rng.normal(size=(5, 6, 6))
    covariance = root @ np.swapaxes(root, -1, -2)
    a, b, symmetry = np.array([0, 1, 1]), np.array([2, 0, 1]), np.array([0, 1, 0])
    pose, found, move = np.empty((3, 4, 4)), np.empty((3, 6, 6)), np.empty((3, 6, 6))
    relative_poses(a, b, symmetry, poses[0], covariance[:2], poses[1], covariance[2:], twins, pose, found, move)
    twin = poses[1][b] @ se3.inverse(twins[symmetry])
    of_twin, of_query = se3.adjoint(twin), se3.adjoint(poses[1][b])
    assert_close(pose, poses[0][a] @ se3.inverse(twin), atol=1e-12)
    assert_close(move, of_twin, atol=1e-12)
    expected = of_twin @ covariance[:2][a] @ np.swapaxes(of_twin, -1, -2)
    assert_close(found, expected + of_query @ covariance[2:][b] @ np.swapaxes(of_query, -1, -2), atol=1e-9)
