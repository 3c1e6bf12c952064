"""The joint problem: signs and frames by differences, elimination against a dense solve, and the toy world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.normal import NormalEquations
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.pose import PoseFactor
from multicam.bundle.problem import Problem, State
from multicam.bundle.robust import Student
from multicam.geometry import se3
from tests.close import assert_close
from tests.strategies import seeds
from tests.toy_world import looking_at, place_objects

CAMERAS, OBJECTS = 3, 4
SPREAD = np.array([0.02] * 3 + [0.005] * 3)
FIXED = np.array([True, False, False])


def truth(rng: np.random.Generator) -> State:
    eyes = [(0.6 * np.sin(a), -0.6 * np.cos(a), 0.6) for a in (-1.0, 0.0, 1.0)]
    cameras = [looking_at(np.array(eye), rng.normal(scale=0.02, size=3)) for eye in eyes]
    objects = [toy.world_from_object for toy in place_objects(rng, (1, 2, 5, 6))]
    return State(np.array(cameras), np.array(objects))


def problem(
    rng: np.random.Generator, state: State, noise: float = 0.0, gross: int = 0, tracked: bool = False
) -> Problem:
    """Every camera sees every object; the first `gross` edges are nonsense. On request the last two are one camera."""
    camera, obj = (index.reshape(-1) for index in np.indices((CAMERAS, OBJECTS)))
    observed = se3.inverse(state.world_from_camera)[camera] @ state.world_from_object[obj]
    observed = se3.plus(observed, noise * SPREAD * rng.normal(size=(len(camera), 6)))
    observed[:gross] = se3.random(rng, gross)
    information = np.broadcast_to(np.diag(SPREAD**-2.0), (len(camera), 6, 6))
    factors = (PoseFactor(camera, obj, observed, information, Student(2.0, 6)),)
    return Problem(factors, FIXED, (motion(state),) if tracked else ())


def motion(state: State) -> OdometryFactor:
    """The true motion from the second camera to the third, with two millimetres and a tenth of a degree."""
    relative = se3.inverse(state.world_from_camera[1]) @ state.world_from_camera[2]
    spread = np.array([0.002] * 6)
    return OdometryFactor(np.array([1]), np.array([2]), relative[None], np.diag(spread**-2)[None])


def disturbed(rng: np.random.Generator, state: State, size: float = 0.05) -> State:
    cameras = se3.plus(state.world_from_camera, size * rng.normal(size=(CAMERAS, 6)) * ~FIXED[:, None])
    return State(cameras, se3.plus(state.world_from_object, size * rng.normal(size=(OBJECTS, 6))))


def dense(system: NormalEquations) -> tuple[np.ndarray, np.ndarray]:
    """Hessian and gradient over (free cameras, objects)."""
    cameras, objects = len(system.camera_hessian), len(system.object_hessian)
    hessian = np.zeros((cameras + objects, 6, cameras + objects, 6))
    for c in range(cameras):
        hessian[c, :, c] = system.camera_hessian[c]
    for o in range(objects):
        hessian[cameras + o, :, cameras + o] = system.object_hessian[o]
        for c in range(cameras):
            hessian[cameras + o, :, c] = system.coupling[o, c]
            hessian[c, :, cameras + o] = system.coupling[o, c].T
    hessian[:cameras, :, :cameras] += np.swapaxes(system.motion, 1, 2)
    size = 6 * (cameras + objects)
    gradient = np.concatenate((system.camera_gradient.reshape(-1), system.object_gradient.reshape(-1)))
    return hessian.reshape(size, size), gradient


@settings(max_examples=15)
@given(seeds())
def test_the_joint_gradient_is_exact_for_cameras_and_objects(rng: np.random.Generator) -> None:
    true_state = truth(rng)
    task, state = problem(rng, true_state, tracked=True), disturbed(rng, true_state)
    _, gradient = dense(task.linearize(state)[1])
    steps = 1e-6 * np.eye(len(gradient))
    numeric = [
        (task.linearize(task.retract(state, s))[0] - task.linearize(task.retract(state, -s))[0]) / 2e-6 for s in steps
    ]
    assert np.allclose(gradient, numeric, atol=1e-4 * np.abs(gradient).max())


def test_the_joint_hessian_is_exact_at_the_truth(rng: np.random.Generator) -> None:
    state = truth(rng)
    task = problem(rng, state, tracked=True)
    hessian, _ = dense(task.linearize(state)[1])
    steps = 1e-6 * np.eye(len(hessian))
    numeric = [
        (dense(task.linearize(task.retract(state, s))[1])[1] - dense(task.linearize(task.retract(state, -s))[1])[1])
        / 2e-6
        for s in steps
    ]
    assert np.allclose(hessian, numeric, atol=1e-5 * np.abs(hessian).max())


@given(seeds())
def test_a_camera_moved_on_the_left_needs_the_other_adjoint(rng: np.random.Generator) -> None:
    """Right variation -Ad(object_from_camera), left variation -Ad(object_from_world)."""
    camera, obj, xi = se3.random(rng), se3.random(rng), 1e-6 * rng.normal(size=6)
    before = se3.inverse(camera) @ obj
    right = se3.inverse(se3.plus(camera, xi)) @ obj
    left = se3.inverse(se3.exp(xi) @ camera) @ obj
    assert np.allclose(se3.minus(right, before), -se3.adjoint(se3.inverse(before)) @ xi, atol=1e-10)
    assert np.allclose(se3.minus(left, before), -se3.adjoint(se3.inverse(obj)) @ xi, atol=1e-10)


@settings(max_examples=30)
@given(seeds(), st.sampled_from((0.0, 1e-4, 1.0)))
def test_elimination_of_the_objects_agrees_with_a_dense_solve(rng: np.random.Generator, damping: float) -> None:
    true_state = truth(rng)
    system = problem(rng, true_state, tracked=True).linearize(disturbed(rng, true_state))[1]
    hessian, gradient = dense(system)
    hessian = hessian + damping * np.diag(np.diag(hessian))
    expected = -np.linalg.solve(hessian, gradient)
    assert np.allclose(system.solve(damping), expected, atol=1e-8 * np.abs(expected).max())


def test_marginal_covariances_agree_with_the_dense_inverse(rng: np.random.Generator) -> None:
    state = truth(rng)
    system = problem(rng, state).linearize(state)[1]
    inverse = np.linalg.inv(dense(system)[0])
    cameras, objects = system.covariances()
    blocks = np.array([inverse[6 * n : 6 * n + 6, 6 * n : 6 * n + 6] for n in range(CAMERAS - 1 + OBJECTS)])
    assert np.allclose(np.concatenate((cameras, objects)), blocks, atol=1e-10 * np.abs(blocks).max())


def test_the_toy_problem_is_solved_within_two_millimetres_in_five_iterations(rng: np.random.Generator) -> None:
    # Three cameras, four objects, one camera fixed, start 36 mm away.
    for _ in range(30):
        state = truth(rng)
        task = problem(rng, state, noise=0.02)
        found = minimize(task, disturbed(rng, state, 0.036 / np.sqrt(3)), LevenbergConfig(iterations=5))
        error = found.state.world_from_camera[1:, :3, 3] - state.world_from_camera[1:, :3, 3]
        assert np.linalg.norm(error, axis=1).max() < 2e-3


@settings(max_examples=25)
@given(seeds())
def test_without_noise_the_truth_comes_back(rng: np.random.Generator) -> None:
    state = truth(rng)
    found = minimize(problem(rng, state), disturbed(rng, state), LevenbergConfig()).state
    assert np.allclose(found.world_from_camera, state.world_from_camera, atol=1e-6)
    assert np.allclose(found.world_from_object, state.world_from_object, atol=1e-6)


@settings(max_examples=20)
@given(seeds())
def test_the_energy_never_rises(rng: np.random.Generator) -> None:
    state = truth(rng)
    energies = minimize(problem(rng, state, noise=3.0, gross=3), disturbed(rng, state, 0.2), LevenbergConfig()).energies
    assert len(energies) > 1
    assert np.all(np.diff(energies) <= 0)


def test_a_step_that_overshoots_is_taken_back_and_damped() -> None:
    class Overshooting:
        """Energy log cosh x, whose Newton step leaps ever further over the minimum from beyond 1.1."""

        def linearize(self, state: float) -> tuple[float, Slope]:
            return float(np.log(np.cosh(state))), Slope(np.tanh(state), np.cosh(state) ** -2)

        def retract(self, state: float, step: np.ndarray) -> float:
            return state + float(step[0])

    found = minimize(Overshooting(), 2.0, LevenbergConfig(iterations=100, tolerance=1e-9))
    assert abs(found.state) < 1e-8
    assert np.all(np.diff(found.energies) <= 0)


@dataclass(frozen=True)
class Slope:
    """Derivatives of a function of one number."""

    gradient: float
    curvature: float

    def solve(self, damping: float) -> np.ndarray:
        return np.array([-self.gradient / (self.curvature * (1 + damping))])


def test_gross_errors_hardly_move_the_answer(rng: np.random.Generator) -> None:
    state = truth(rng)
    found = minimize(
        problem(rng, state, noise=0.1, gross=3), disturbed(rng, state), LevenbergConfig(iterations=50)
    ).state
    error = found.world_from_camera[:, :3, 3] - state.world_from_camera[:, :3, 3]
    assert np.linalg.norm(error, axis=1).max() < 5e-3


def test_stated_covariances_hold_for_sampled_noise(rng: np.random.Generator) -> None:
    inside: list[bool] = []
    for _ in range(60):
        state = truth(rng)
        task = problem(rng, state, noise=1.0)
        found = minimize(task, state, LevenbergConfig()).state
        covariance = task.covariances(found, task.noise_scale(found))[0]
        error = se3.minus(state.world_from_camera[1:], found.world_from_camera[1:])
        squared = [e @ np.linalg.solve(c, e) for e, c in zip(error, covariance[1:], strict=True)]
        inside += [s < 12.59 for s in squared]
    assert 0.88 < np.mean(inside) <= 1.0


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_the_noise_scale_follows_the_residuals(rng: np.random.Generator, factor: float) -> None:
    scales: list[float] = []
    for _ in range(20):
        state = truth(rng)
        task = problem(rng, state, noise=factor)
        scales.append(task.noise_scale(minimize(task, state, LevenbergConfig()).state))
    assert min(scales) >= 1
    # Gaussian noise looks smaller to a heavy-tailed kernel, and some numbers always speak for the stated noise.
    assert 0.6 * factor <= np.median(scales) < 2 * factor


def test_a_tracked_camera_that_sees_nothing_is_where_its_motion_says(rng: np.random.Generator) -> None:
    state = truth(rng)
    factor = problem(rng, state, noise=0.3).factors[0]
    assert isinstance(factor, PoseFactor)
    sighted = np.flatnonzero(factor.camera < 2)
    edges = PoseFactor(
        factor.camera[sighted], factor.object[sighted], factor.observed[sighted], factor.information[sighted],
        factor.kernel,
    )  # fmt: skip
    task = Problem((edges,), FIXED, (motion(state),))
    found = minimize(task, disturbed(rng, state), LevenbergConfig(iterations=60, tolerance=1e-9)).state
    moved = se3.inverse(found.world_from_camera[1]) @ found.world_from_camera[2]
    assert np.allclose(moved, motion(state).measured[0], atol=1e-7)
    covariance = task.covariances(found)[0]
    carried = se3.adjoint(se3.inverse(moved)) @ covariance[1] @ se3.adjoint(se3.inverse(moved)).T
    assert_close(covariance[2], carried + 0.002**2 * np.eye(6), rtol=1e-6, atol=1e-12)


def test_nothing_to_move_is_no_error() -> None:
    state = State(np.eye(4)[None], np.zeros((0, 4, 4)))
    found = minimize(Problem((), np.array([True])), state, LevenbergConfig())
    assert np.allclose(found.state.world_from_camera, np.eye(4))
    assert not np.any(Problem((), np.array([True])).covariances(state)[0])


def test_edge_covariances_are_those_of_the_dense_inverse(rng: np.random.Generator) -> None:
    state = truth(rng)
    task = problem(rng, state, noise=0.5)
    factor = task.factors[0]
    state = minimize(task, state, LevenbergConfig()).state
    found = task.edge_covariances(state, factor)
    joint = np.linalg.inv(dense(task._capped(state))[0])
    cameras = CAMERAS - 1
    for edge, (camera, obj) in enumerate(zip(factor.camera, factor.object, strict=True)):
        jacobian = np.zeros((6, len(joint)))
        jacobian[:, 6 * (cameras + obj) :][:, :6] = np.eye(6)
        if camera > 0:
            relative = se3.inverse(state.world_from_object[obj]) @ state.world_from_camera[camera]
            jacobian[:, 6 * (camera - 1) :][:, :6] = -se3.adjoint(relative)
        assert_close(found[edge], jacobian @ joint @ jacobian.T, atol=1e-9, rtol=1e-6)


def test_inflated_edges_count_for_less(rng: np.random.Generator) -> None:
    state = truth(rng)
    task = problem(rng, state, noise=0.0)
    shape = len(state.world_from_camera), len(state.world_from_object)
    plain, wide = task.covariances(state), task.covariances(state, inflation=np.full(shape, 3.0))
    for before, after in zip(plain, wide, strict=True):
        assert_close(after, 3 * before, rtol=1e-9, atol=1e-15)
    one = np.ones(shape)
    one[1] = 3.0
    ratio = (
        np.trace(task.covariances(state, inflation=one)[0], axis1=1, axis2=2)[1:]
        / np.trace(plain[0], axis1=1, axis2=2)[1:]
    )
    assert ratio[0] > 1.5
    assert np.all(ratio[1:] < ratio[0])
