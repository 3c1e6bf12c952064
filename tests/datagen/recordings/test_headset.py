"""How the headset moves."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from datagen.recordings.config import SequenceConfig
from datagen.recordings.headset import HeadsetPath, Stations, minimum_jerk, sample_headset
from multicam.geometry import se3
from tests.close import assert_close
from tests.strategies import Array

CENTRES = np.array([[-0.4, 0.0], [0.4, 0.0]])
BOARD = np.array([0.0, 0.3, 0.1])


def walk(rng: np.random.Generator, board: Array | None = None) -> HeadsetPath:
    """Eight seconds above two clusters of three things."""
    things = [np.column_stack((c + rng.uniform(-0.1, 0.1, (3, 2)), np.full(3, 0.02))) for c in CENTRES]
    return sample_headset(SequenceConfig(), CENTRES, things, board, rng)


def filmed(path: HeadsetPath, times: Array) -> Array:
    return np.stack([path.world_from_camera(float(t)) for t in times])


def test_the_headset_moves_like_a_head(rng: np.random.Generator) -> None:
    for _ in range(10):
        poses = filmed(walk(rng), np.arange(0, 8, 0.01))
        steps = se3.minus(poses[1:], poses[:-1]) / 0.01
        speed, turning = np.linalg.norm(steps[:, 3:], axis=1), np.linalg.norm(steps[:, :3], axis=1)
        assert 0.01 < speed.mean() < speed.max() < 1.0
        assert turning.max() < np.deg2rad(150)
        # It rests on things: most of the time it turns slowly, now and then quickly.
        assert np.median(turning) < np.deg2rad(25) < np.deg2rad(30) < turning.max()
        # It begins at the left, is at the right in the middle, and never tilts far.
        assert poses[0][0, 3] < -0.2 < 0.2 < poses[400][0, 3]
        assert np.abs(poses[:, 2, 0]).max() < np.sin(np.deg2rad(12))


def test_breath_and_tremor_are_there_and_small(rng: np.random.Generator) -> None:
    path = walk(rng)
    times = np.arange(0, 8, 0.01)
    height = filmed(path, times)[:, 2, 3]
    spectrum = np.abs(np.fft.rfft(np.diff(height, 2)))
    assert 8 < np.fft.rfftfreq(len(times) - 2, 0.01)[spectrum.argmax()] < 9
    quick = height - np.convolve(np.pad(height, 12, "edge"), np.ones(25) / 25, "valid")
    assert 2e-5 < np.std(quick[50:-50]) < 5e-4


def test_the_board_is_looked_at_between_the_clusters(rng: np.random.Generator) -> None:
    times = np.arange(0, 8, 0.05)
    off: dict[bool, float] = {}
    for board in (False, True):
        poses = filmed(walk(rng, BOARD if board else None), times)
        sight = BOARD - poses[:, :3, 3]
        cosine = np.einsum("ni,ni->n", sight, poses[:, :3, 2]) / np.linalg.norm(sight, axis=1)
        off[board] = float(np.rad2deg(np.arccos(cosine.max())))
    assert off[True] < 4 < off[False]


@given(st.floats(-1, 2), st.floats(1e-4, 0.02))
def test_minimum_jerk_goes_from_nothing_to_all_without_a_jump(share: float, step: float) -> None:
    here, there = minimum_jerk(np.array([share, share + step]))
    assert 0 <= here <= there <= 1
    # Its greatest speed is 15/8 of the mean, in the middle.
    assert there - here <= 1.875 * step + 1e-12
    assert_close(minimum_jerk(np.array([-0.1, 0.0, 0.5, 1.0, 1.7])), [0, 0, 0.5, 1, 1])


@given(st.integers(2, 5), st.integers(0, 2**16))
def test_stations_begin_and_end_at_their_places(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middles = np.cumsum(rng.uniform(0.1, 1, count - 1))
    stations = Stations(rng.normal(size=(count, 3)), middles, rng.uniform(0.05, 2, count - 1))
    assert_close(stations.at(float(middles[0]) - 3), stations.places[0], 1e-12)
    assert_close(stations.at(float(middles[-1]) + 3), stations.places[-1], 1e-12)
