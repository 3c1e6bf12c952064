"""Drift of the tracking, clocks and lost frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datagen.recordings.config import ClockConfig, DriftConfig
from datagen.recordings.tracking import sample_clock, tracked_poses, tracking_errors
from multicam.dataset.sequence_facts import TrackingErrors
from multicam.geometry import se3, so3
from tests.close import assert_close
from tests.strategies import Array

NONE = TrackingErrors(0.0, 0.0, 0.0, 0.0)


def step_errors(truth: Array, tracked: Array) -> Array:
    """(n - 1, 6) the twists by which tracked steps are off: the drift's formula turned round."""
    true_steps = se3.inverse(truth[:-1]) @ truth[1:]
    return se3.minus(se3.inverse(tracked[:-1]) @ tracked[1:], true_steps)


def test_without_errors_tracking_is_the_truth(rng: np.random.Generator) -> None:
    truth = se3.random(rng, 9)
    assert_close(tracked_poses(truth, np.arange(9.0), NONE, rng), truth)


def test_the_configured_drift_is_stated_in_radians_and_metres() -> None:
    stated = tracking_errors(DriftConfig(0.02, 0.6, 0.08, 1.5))
    assert_close(list(vars(stated).values()), [np.deg2rad(0.02), 6e-4, np.deg2rad(0.08), 1.5e-3], 1e-15)


@given(st.integers(0, 2**16), st.floats(0, 0.02), st.floats(0, 0.01))
def test_bias_alone_is_the_same_twist_per_second_at_every_step(seed: int, turn: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    truth, times = se3.random(rng, 8), np.cumsum(rng.uniform(0.05, 0.5, 8))
    errors = step_errors(truth, tracked_poses(truth, times, TrackingErrors(turn, shift, 0.0, 0.0), rng))
    rates = errors / np.diff(times)[:, None]
    assert_close(rates, np.broadcast_to(rates[0], rates.shape), 1e-6)
    assert np.linalg.norm(rates[0, :3]) == pytest.approx(turn, abs=1e-6)
    assert np.linalg.norm(rates[0, 3:]) == pytest.approx(shift, abs=1e-6)


def test_the_walk_grows_with_the_root_of_time(rng: np.random.Generator) -> None:
    truth, walk = se3.random(rng, 1501), TrackingErrors(0.0, 0.0, 2e-3, 1e-3)
    for dt in (0.04, 0.25):
        errors = step_errors(truth, tracked_poses(truth, dt * np.arange(1501), walk, rng))
        assert np.std(errors[:, :3]) == pytest.approx(2e-3 * np.sqrt(dt), rel=0.05)
        assert np.std(errors[:, 3:]) == pytest.approx(1e-3 * np.sqrt(dt), rel=0.05)
        assert np.abs(errors.mean(axis=0) / errors.std(axis=0)).max() < 0.12


def test_drift_at_the_end_has_the_stated_size(rng: np.random.Generator) -> None:
    still, times = np.broadcast_to(np.eye(4), (12, 4, 4)), 0.2 * np.arange(12)
    ends = np.stack([tracked_poses(still, times, TrackingErrors(0, 0, 0, 2e-3), rng)[-1] for _ in range(150)])
    assert np.std(ends[:, :3, 3]) == pytest.approx(2e-3 * np.sqrt(times[-1]), rel=0.1)
    end = tracked_poses(still, times, TrackingErrors(8e-3, 0, 0, 0), rng)[-1]
    assert np.linalg.norm(so3.log(end[:3, :3])) == pytest.approx(8e-3 * times[-1])


@given(
    st.integers(1, 60), st.floats(0.5, 60), st.floats(0, 20), st.floats(0, 500), st.floats(0, 20), st.floats(0, 0.9),
    st.integers(0, 2**16), st.booleans(),
)  # fmt: skip
def test_times_ascend_and_are_never_negative(
    steps: int, rate: float, phase: float, jitter: float, offset: float, lost: float, seed: int, true: bool
) -> None:
    config = ClockConfig(phase, jitter, offset, lost)
    clock = sample_clock(config, steps, rate, np.random.default_rng(seed), true=true)
    stamps = [clock.stamp_ns(step) for step in range(steps)]
    assert np.all(np.diff(clock.times) > 0)
    assert stamps == sorted(stamps)
    assert min(stamps) >= 0
    assert abs(clock.offset) <= (0 if true else 1e-3 * offset)
    assert clock.kept[0]
    assert (~clock.kept).sum() == min(round(lost * steps), steps - 1)
    assert_close(np.array(stamps) * 1e-9 - clock.times, np.full(steps, clock.offset), 1e-9)
