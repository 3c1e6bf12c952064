import numpy as np

from multicam.geometry import se3
from multicam.scenegraph.filter import FilterConfig, FilteredPose, Outcome, absorb
from multicam.scenegraph.uncertain import UncertainPose, isotropic

CONFIG = FilterConfig(common=0.0)
NOISE = isotropic(0.01, 0.005)
STILL = np.zeros((6, 6))
SECOND = 1_000_000_000


def shifted(metres: float) -> UncertainPose:
    pose = np.eye(4)
    pose[0, 3] = metres
    return UncertainPose(pose, NOISE)


def run(shifts: list[float], drift: np.ndarray = STILL) -> tuple[FilteredPose, list[Outcome]]:
    state, outcomes = None, []
    for index, shift in enumerate(shifts):
        state, decision = absorb(state, shifted(shift), index * SECOND, drift, CONFIG)
        outcomes.append(decision.outcome)
    assert state is not None
    return state, outcomes


def test_the_first_measurement_starts_the_filter():
    state, outcomes = run([0.3])
    assert outcomes == [Outcome.STARTED]
    assert state.count == 1


def test_agreeing_measurements_are_averaged():
    state, outcomes = run([0.0, 0.003, 0.006])
    assert outcomes[1:] == [Outcome.FUSED, Outcome.FUSED]
    np.testing.assert_allclose(state.stored.pose[0, 3], 0.003, atol=1e-9)
    np.testing.assert_allclose(state.stored.covariance, NOISE / 3, rtol=1e-4, atol=1e-12)


def test_an_outlier_changes_nothing_and_the_reason_says_how_far_off_it_was():
    before, _ = run([0.0, 0.0])
    after, decision = absorb(before, shifted(0.2), 2 * SECOND, STILL, CONFIG)
    assert decision.outcome is Outcome.REJECTED
    assert after.stored is before.stored
    assert decision.reason().startswith("the measurement lies 200 mm and 0.0 deg from the stored pose")


def test_the_newest_measurement_never_just_wins_but_a_persistent_contradiction_does():
    state, outcomes = run([0.0, 0.0, 0.2, 0.2, 0.2])
    assert outcomes[2:] == [Outcome.REJECTED, Outcome.REJECTED, Outcome.REPLACED]
    np.testing.assert_allclose(state.stored.pose[0, 3], 0.2)
    assert state.count == 3


def test_contradictions_that_contradict_each_other_never_take_over():
    _, outcomes = run([0.0, 0.0, 0.2, -0.2, 0.4, -0.4, 0.6])
    assert set(outcomes[2:]) == {Outcome.REJECTED}


def test_an_agreeing_measurement_forgets_the_rival():
    state, outcomes = run([0.0, 0.2, 0.2, 0.0, 0.2, 0.2])
    assert Outcome.REPLACED not in outcomes
    assert state.rival is not None
    assert state.rival.count == 2


def test_uncertainty_grows_with_time_and_lets_the_filter_follow_a_drift():
    drift = isotropic(0.0, 0.003)
    shifts = list(0.003 * np.arange(40))
    state, outcomes = run(shifts, drift)
    assert Outcome.REJECTED not in outcomes
    assert abs(state.stored.pose[0, 3] - shifts[-1]) < 0.008
    # Without drift in the model the same walk ends in contradiction.
    assert Outcome.REJECTED in run(shifts)[1]


def test_the_common_error_is_not_averaged_away():
    config, state = FilterConfig(common=0.25, least_gain=0.0), None
    for time in range(30):
        state, _ = absorb(state, shifted(0.0), time * SECOND, STILL, config)
    expected = (0.25 + 0.75 / 30) * NOISE
    np.testing.assert_allclose(state.at(30 * SECOND, STILL).covariance, expected, rtol=1e-6, atol=1e-12)


def test_repeated_errors_stay_within_the_stated_uncertainty(rng):
    # Half of the variance is one error for all measurements, half is new each time, as the default assumes.
    distances = []
    for _ in range(100):
        shared, state = np.sqrt(0.5) * rng.normal(size=6), None
        for time in range(8):
            noise = np.sqrt(np.diag(NOISE)) * (shared + np.sqrt(0.5) * rng.normal(size=6))
            measured = UncertainPose(se3.exp(noise), NOISE)
            state, _ = absorb(state, measured, time * SECOND, STILL, FilterConfig(least_gain=0.0))
        final = state.at(8 * SECOND, STILL)
        twist = se3.minus(np.eye(4), final.pose)
        distances.append(twist @ np.linalg.solve(final.covariance, twist))
    assert 5.0 < np.mean(distances) < 7.2  # 6 degrees of freedom


def test_a_measurement_that_sharpens_nothing_is_left_out():
    state, _ = run([0.0])
    vague = UncertainPose(np.eye(4), 1e4 * NOISE)
    after, decision = absorb(state, vague, SECOND, STILL, CONFIG)
    assert decision.outcome is Outcome.NOTHING_NEW
    assert after.stored is state.stored
    assert not decision.accepted


def test_the_gate_compares_turned_poses_too():
    state, _ = run([0.0])
    turned = UncertainPose(se3.exp(np.array([0.3, 0, 0, 0, 0, 0])), NOISE)
    _, decision = absorb(state, turned, SECOND, STILL, CONFIG)
    assert decision.outcome is Outcome.REJECTED
    np.testing.assert_allclose(decision.angle, 0.3)
