"""Objects that are put elsewhere or carried about."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datagen.recordings.config import CarryConfig, MoveConfig
from datagen.recordings.motions import Move, is_on_table, sample_carry, sample_move
from datagen.recordings.statics import Unsuitable
from datagen.scenes.layout import Table, place
from datagen.scenes.stock import Stock
from multicam.geometry import se3
from tests.close import assert_close
from tests.toy_objects import PLATE, ROD

CONFIG = MoveConfig(at_s=2.0, seconds=1.0, distance=(0.06, 0.2))


def moved(stock: Stock, seed: int, config: MoveConfig = CONFIG) -> tuple[Table, Move]:
    rng, table = np.random.default_rng(seed), Table()
    body = stock.bodies[ROD]
    before = place(table, body, np.zeros(2), 0.05, rng)
    place(table, stock.bodies[PLATE], np.zeros(2), 0.05, rng)
    return table, sample_move(config, 3, body, before, 0.18, table, rng)


@pytest.mark.parametrize("seed", range(5))
def test_an_object_is_put_on_bare_table_at_the_stated_distance(stock: Stock, seed: int) -> None:
    _, move = moved(stock, seed)
    assert 0.06 <= np.linalg.norm((move.after - move.before)[:2, 3]) <= 0.2
    assert is_on_table(stock.bodies[ROD], move.after)
    # It lies as it lay, only turned about the vertical.
    assert_close(move.after[2, :3], move.before[2, :3], 1e-12)
    assert move.after[2, 3] == pytest.approx(move.before[2, 3], abs=1e-12)


@given(st.floats(0, 5), st.integers(0, 20))
def test_it_is_lifted_before_it_goes_sideways(stock: Stock, time: float, seed: int) -> None:
    _, move = moved(stock, seed)
    pose = move.at(time)
    if time < 2.0:
        assert np.array_equal(pose, move.before)
    elif time >= 3.0:
        assert np.array_equal(pose, move.after)
    else:
        gone = np.linalg.norm((pose - move.before)[:2, 3])
        left = np.linalg.norm((pose - move.after)[:2, 3])
        height = pose[2, 3] - move.before[2, 3]
        # Wherever it is not above one of its places it is above everything else, which is 18 cm high.
        assert height >= 0.2 - 1e-9 or min(gone, left) < 1e-9
        assert -1e-12 <= height <= 0.2 + 1e-9
        assert gone + left == pytest.approx(np.linalg.norm((move.after - move.before)[:2, 3]), abs=1e-9)


def test_a_motion_has_no_jumps_unless_it_is_not_seen(stock: Stock) -> None:
    _, move = moved(stock, 0)
    times = np.arange(1.9, 3.1, 1e-3)
    steps = se3.minus(np.stack([move.at(t + 1e-3) for t in times]), np.stack([move.at(t) for t in times]))
    assert np.linalg.norm(steps[:, 3:], axis=1).max() < 2.0 * 1e-3
    _, jump = moved(stock, 0, MoveConfig(at_s=2.0, seconds=0.0, distance=(0.06, 0.2)))
    assert np.array_equal(jump.at(1.999), jump.before)
    assert np.array_equal(jump.at(2.0), jump.after)


def test_where_there_is_no_room_nothing_is_moved(stock: Stock) -> None:
    with pytest.raises(Unsuitable, match=r"raise move.distance"):
        moved(stock, 0, MoveConfig(at_s=2.0, distance=(0.001, 0.002)))


@pytest.mark.parametrize("seed", range(5))
def test_what_is_carried_never_touches_what_it_is_carried_over(stock: Stock, seed: int) -> None:
    rng, body = np.random.default_rng(seed), stock.bodies[ROD]
    carry = sample_carry(CarryConfig(reach_mm=40.0), 0, body, np.array([0.4, 0.0]), 0.11, 8.0, rng)
    times = np.arange(0, 8, 0.05)
    poses = np.stack([carry.at(float(t)) for t in times])
    lowest = min(float(se3.act(pose, body.points)[:, 2].min()) for pose in poses)
    assert lowest >= 0.13 - 1e-9
    assert 0.01 < np.std(poses[:, :2, 3] - [0.4, 0.0]) < 0.08
    speeds = np.linalg.norm(se3.minus(poses[1:], poses[:-1]), axis=1) / 0.05
    assert 0.05 < speeds.max() < 3
