"""The motion between two cameras that their matches show, up to its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from multicam.bundle.bearing import across
from multicam.bundle.epipolar import EpipolarFactor
from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.problem import Problem, State
from multicam.bundle.robust import Student
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Matches
from multicam.geometry import se3
from multicam.matching.linear import inverse, squared_norm
from multicam.types import FloatArray

GATE = 22.46
"""Greatest squared Mahalanobis distance of a guess from the motion that is known before: 99.9 % with six degrees."""

WIDE = 3.0
"""Deviations within which a match is taken to fit."""

DIFFERENT = 0.03
"""Radians, of turn or direction, from which two motions are not the same."""

AMBIGUOUS = 0.1
"""Radians from which it matters which of two motions it is."""

_KERNEL = Student(1.0, 1)
_ENDS = np.array([True, False])


@dataclass(frozen=True, eq=False)
class SeenMotion:
    """A motion up to its length.

    Attributes:
        first_from_second: (4, 4); the translation has length 1.
        covariance: (5, 5) of its turn (right tangent) and of its direction in `across`.
        matches: how many fit.
    """

    first_from_second: FloatArray
    covariance: FloatArray
    matches: int


def see_motion(matches: Matches, known: FloatArray, covariance: FloatArray, config: SceneryConfig) -> SeenMotion | None:
    """The motion that most matches agree with, near the one that is known; None if it is not clear which.

    Args:
        known: (4, 4) first_from_second, metres, with a covariance (6, 6) of its right tangent. Cameras at the very same
            place have no direction to be seen.
    """
    if not known[:3, 3].any():
        return None
    information = inverse(covariance)
    factor = _factor(matches)
    # With the motion known that well, most wrong matches are too far from their lines.
    residual, slope = factor.whitened(known[None])
    likely = residual**2 < WIDE**2 * (1 + squared_norm(slope, np.broadcast_to(covariance, (len(slope), 6, 6))))
    factor, matches = _factor(matches.chosen(likely)), matches.chosen(likely)
    if len(matches) < config.least_matches:
        return None
    guesses = _guesses(matches, known, information, config)
    prior = OdometryFactor(np.array([0]), np.array([1]), known[None], information[None])
    refined = [_refined(factor, prior, guess) for guess in _best(guesses, factor, prior, config.guesses)]
    refined.sort(key=lambda each: each[0])
    energy, motion = refined[0]
    rivals = [each for other, each in refined[1:] if other - energy < config.margin]
    fitting = int(np.count_nonzero(np.abs(factor.whitened(motion[None])[0]) < WIDE))
    if fitting < max(config.least_matches, config.least_share * len(matches)):
        return None
    if any(_differ(motion, each, AMBIGUOUS) for each in rivals):
        return None
    if not squared_norm(se3.minus(motion, known), information) < GATE:
        return None
    return _seen(factor, motion, rivals, fitting, config)


def _factor(matches: Matches) -> EpipolarFactor:
    pair = np.zeros(len(matches), dtype=np.int64)
    ends = np.array([0]), np.array([1])
    return EpipolarFactor(*ends, pair, matches.first, matches.second, matches.std, _KERNEL)


def _guesses(matches: Matches, known: FloatArray, information: FloatArray, config: SceneryConfig) -> FloatArray:
    """(n, 4, 4) the known motion and those of five matches each that lie within its gate."""
    rng = np.random.default_rng(0)
    found: list[FloatArray] = []
    for _ in range(config.samples):
        drawn = rng.choice(len(matches), 5, replace=False)
        # OpenCV calls its first picture what is our second: x2' E x1 = 0.
        essential: Any = cv2.findEssentialMat(matches.second[drawn], matches.first[drawn], np.eye(3))[0]
        if essential is not None:
            found.append(essential.reshape(-1, 3, 3))
    essentials = np.concatenate(found) if found else np.zeros((0, 3, 3))
    # Matches at one place in both pictures have none.
    essentials = essentials[np.isfinite(essentials).all(axis=(1, 2))]
    left, _, right = np.linalg.svd(essentials)
    left *= np.linalg.det(left)[:, None, None]
    right *= np.linalg.det(right)[:, None, None]
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotations = np.concatenate((left @ quarter @ right, left @ quarter.T @ right))
    directions = np.tile(left[:, :, 2], (2, 1))
    # The length and the sign that bring it closest to the known motion.
    lengths = directions @ known[:3, 3]
    motions = se3.from_parts(rotations, directions * lengths[:, None])
    near = squared_norm(se3.minus(motions, known), np.broadcast_to(information, (len(motions), 6, 6))) < GATE
    return np.concatenate((known[None], motions[near]))


def _best(guesses: FloatArray, factor: EpipolarFactor, prior: OdometryFactor, count: int) -> list[FloatArray]:
    """The guesses of least energy that differ from each other."""
    poses = np.stack((np.broadcast_to(np.eye(4), guesses.shape), guesses), axis=1)
    energy = np.array([_energy(factor, prior, pair) for pair in poses])
    chosen: list[FloatArray] = []
    for guess in guesses[np.argsort(energy, kind="stable")]:
        if all(_differ(guess, other, DIFFERENT) for other in chosen):
            chosen.append(guess)
        if len(chosen) == count:
            break
    return chosen


def _energy(factor: EpipolarFactor, prior: OdometryFactor, poses: FloatArray) -> float:
    matched = factor.linearize(poses).energy[0]
    return float(matched + prior.linearize(poses).energy[0])


def _refined(factor: EpipolarFactor, prior: OdometryFactor, motion: FloatArray) -> tuple[float, FloatArray]:
    """The minimum next to a motion, and its energy."""
    state = State(np.stack((np.eye(4), motion)), np.zeros((0, 4, 4)))
    for width in (2.0, 1.0):
        problem = Problem((), _ENDS, (replace(factor, std=width * factor.std), prior))
        minimum = minimize(problem, state, LevenbergConfig())
        state = minimum.state
    return minimum.energies[-1], state.world_from_camera[1]


def _differ(a: FloatArray, b: FloatArray, angle: float) -> bool:
    """Whether turns or directions of two motions are further apart than an angle."""
    turned = np.trace(a[:3, :3].T @ b[:3, :3])
    along = a[:3, 3] @ b[:3, 3] / (np.linalg.norm(a[:3, 3]) * np.linalg.norm(b[:3, 3]))
    return bool(turned < 1 + 2 * np.cos(angle) or along < np.cos(angle))


def _seen(
    factor: EpipolarFactor, motion: FloatArray, rivals: Sequence[FloatArray], matches: int, config: SceneryConfig
) -> SeenMotion:
    """The motion, as uncertain as its matches leave it, or as its rivals are away from it."""
    unit = _of_length_one(motion)
    local = factor.linearize(np.stack((np.eye(4), unit)))
    basis = across(unit[:3, 3])
    # xi = (turn, R' (basis c)): what moves the direction by c.
    moves = np.zeros((6, 5))
    moves[:3, :3] = np.eye(3)
    moves[3:, 3:] = unit[:3, :3].T @ basis
    covariance = inverse(moves.T @ local.hessian[0, 6:, 6:] @ moves)
    covariance += np.diag([config.rotation_std**2] * 3 + [config.direction_std**2] * 2)
    for rival in rivals:
        shift = np.concatenate((se3.minus(rival, motion)[:3], basis.T @ _of_length_one(rival)[:3, 3]))
        covariance += np.outer(shift, shift) / len(rivals)
    return SeenMotion(unit, covariance, matches)


def _of_length_one(motion: FloatArray) -> FloatArray:
    unit = motion.copy()
    unit[:3, 3] /= np.linalg.norm(motion[:3, 3])
    return unit
