"""The motion between two cameras that their matches show, up to its length."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from multicam.bundle.bearing import across, bearing_residual
from multicam.bundle.epipolar import EpipolarFactor
from multicam.bundle.levenberg import LevenbergConfig, minimize
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.problem import Problem, State
from multicam.bundle.robust import Student
from multicam.bundle.scenery.config import SceneryConfig
from multicam.bundle.scenery.features import Matches
from multicam.geometry import se3, so3
from multicam.matching.arrays import BoolArray
from multicam.matching.linear import congruent, inverse, squared_norm
from multicam.types import FloatArray

GATE = 20.52
"""Squared Mahalanobis distance up to which a pose agrees with a motion: 99.9 % with five degrees of freedom."""

WIDE = 3.0
"""Deviations within which a match is taken to fit."""

NEAR = 10.0
"""Deviations within which a match is looked at when a guess is refined."""

DIFFERENT = 0.03
"""Radians, of turn or direction, from which two motions are not the same."""

AMBIGUOUS = 0.1
"""Radians from which it matters which of two motions it is."""

_KERNEL = Student(1.0, 1)
_ENDS = np.array([True, False])
_QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


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

    def agrees(self, poses: FloatArray, covariances: FloatArray) -> BoolArray:
        """(n,) which poses first_from_second (n, 4, 4), covariances (n, 6, 6) of their right tangents, lie in its gate.

        A pose without translation has no direction and does not agree.
        """
        apart = np.linalg.norm(poses[:, :3, 3], axis=1) > 0
        agreeing = np.zeros(len(poses), dtype=np.bool_)
        measured = np.broadcast_to(self.first_from_second, poses[apart].shape)
        residual, slope = bearing_residual(poses[apart], measured)
        covariance = congruent(slope, covariances[apart]) + self.covariance
        agreeing[apart] = squared_norm(residual, inverse(covariance)) < GATE
        return agreeing


def see_motion(matches: Matches, config: SceneryConfig) -> SeenMotion | None:
    """The motion that most matches agree with; None if there is none, or if it is not clear which."""
    if len(matches) < config.least_matches:
        return None
    factor = _factor(matches)
    refined = np.array([_refined(factor, guess) for guess in _best(_guesses(matches, config), factor, config)])
    if not len(refined):
        return None
    energy = _energy(factor, refined)
    motion = refined[np.argmin(energy)]
    fitting = np.abs(factor.residuals(motion[None])[0]) < WIDE
    if np.count_nonzero(fitting) < config.least_matches:
        return None
    rivals = refined[(energy > energy.min()) & (energy < energy.min() + config.margin)]
    motion, *others = (_before_both(each, matches.chosen(fitting)) for each in (motion, *rivals))
    if any(_differ(motion, other, AMBIGUOUS) for other in others):
        return None
    return _seen(factor, motion, others, int(np.count_nonzero(fitting)), config)


def _factor(matches: Matches) -> EpipolarFactor:
    pair = np.zeros(len(matches), dtype=np.int64)
    ends = np.array([0]), np.array([1])
    return EpipolarFactor(*ends, pair, matches.first, matches.second, matches.std, _KERNEL)


def _guesses(matches: Matches, config: SceneryConfig) -> FloatArray:
    """(n, 4, 4) one of the four motions that each E of five matches stands for; half of them of the better matches."""
    rng = np.random.default_rng(0)
    found = [np.zeros((0, 3, 3))]
    for sample in range(config.samples):
        drawn = rng.choice(len(matches) if sample % 2 else max(len(matches) // 2, 5), 5, replace=False)
        # OpenCV calls its first picture what is our second: x2' E x1 = 0.
        essential: Any = cv2.findEssentialMat(matches.second[drawn], matches.first[drawn], np.eye(3))[0]
        if essential is not None:
            found.append(essential.reshape(-1, 3, 3))
    essentials = np.concatenate(found)
    # Matches at one place in both pictures have none.
    left, _, right = np.linalg.svd(essentials[np.isfinite(essentials).all(axis=(1, 2))])
    left *= np.linalg.det(left)[:, None, None]
    right *= np.linalg.det(right)[:, None, None]
    return se3.from_parts(left @ _QUARTER @ right, left[:, :, 2])


def _energy(factor: EpipolarFactor, motions: FloatArray) -> FloatArray:
    """(n,) of motions (n, 4, 4); a match that does not fit costs the same wherever it is."""
    return np.minimum(_KERNEL.energy(factor.residuals(motions) ** 2), _KERNEL.energy(np.array(WIDE**2))).sum(axis=1)


def _best(guesses: FloatArray, factor: EpipolarFactor, config: SceneryConfig) -> list[FloatArray]:
    """The guesses of least energy that differ from each other."""
    chosen: list[FloatArray] = []
    for guess in guesses[np.argsort(_energy(factor, guesses), kind="stable")]:
        if all(_differ(guess, other, DIFFERENT) for other in chosen):
            chosen.append(guess)
        if len(chosen) == config.guesses:
            break
    return chosen


def _refined(factor: EpipolarFactor, motion: FloatArray) -> FloatArray:
    """The minimum next to a motion, for the matches near it; its length becomes 1."""
    near = np.abs(factor.residuals(motion[None])[0]) < NEAR
    part = replace(
        factor, pair=factor.pair[near], first_ray=factor.first_ray[near], second_ray=factor.second_ray[near],
        std=factor.std[near],
    )  # fmt: skip
    # Matches know no length; a weak tie to the guess keeps it about what it is.
    hold = OdometryFactor(np.array([0]), np.array([1]), motion[None], np.eye(6)[None])
    state = State(np.stack((np.eye(4), motion)), np.zeros((0, 4, 4)))
    end = minimize(Problem((), _ENDS, (part, hold)), state, LevenbergConfig()).state.world_from_camera[1]
    end[:3, 3] /= np.linalg.norm(end[:3, 3])
    return end


def _before_both(motion: FloatArray, matches: Matches) -> FloatArray:
    """Of the four motions of one E, that which has most matches before both cameras."""
    essential = so3.hat(motion[:3, 3]) @ motion[:3, :3]
    _, rotation, shift, _ = cv2.recoverPose(essential, matches.second, matches.first, np.eye(3))
    return se3.from_parts(np.asarray(rotation, dtype=np.float64), np.asarray(shift, dtype=np.float64)[:, 0])


def _differ(a: FloatArray, b: FloatArray, angle: float) -> bool:
    """Whether turns or directions of two motions of length 1 are further apart than an angle."""
    turned = np.trace(a[:3, :3].T @ b[:3, :3])
    return bool(turned < 1 + 2 * np.cos(angle) or a[:3, 3] @ b[:3, 3] < np.cos(angle))


def _seen(
    factor: EpipolarFactor, motion: FloatArray, rivals: list[FloatArray], matches: int, config: SceneryConfig
) -> SeenMotion:
    """The motion, as uncertain as its matches leave it, or as its rivals are away from it."""
    local = factor.linearize(np.stack((np.eye(4), motion)))
    # xi = (turn, R' (basis c)): what moves the direction by c.
    moves = np.zeros((6, 5))
    moves[:3, :3] = np.eye(3)
    moves[3:, 3:] = motion[:3, :3].T @ across(motion[:3, 3])
    covariance = inverse(moves.T @ local.hessian[0, 6:, 6:] @ moves)
    covariance += np.diag([config.rotation_std**2] * 3 + [config.direction_std**2] * 2)
    if rivals:
        shift, _ = bearing_residual(np.array(rivals), np.broadcast_to(motion, (len(rivals), 4, 4)))
        covariance += shift.T @ shift / len(rivals)
    return SeenMotion(motion, covariance, matches)
