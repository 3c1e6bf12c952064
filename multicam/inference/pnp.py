"""Keypoints with uncertainties to camera_from_object with a covariance. Equations: docs/inference.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray
from scipy.special import gammaincinv

from multicam.geometry import se3
from multicam.geometry.camera import Camera
from multicam.inference import layout, reprojection
from multicam.inference.initial_pose import closed_form, minimal_samples, reversed_twin, sample_turns
from multicam.types import FloatArray

_LARGEST_ROTATION_VARIANCE = np.pi**2 / 3
"""Variance of an angle of which nothing is known; bounds the covariance where the keypoints show no roll."""

_SINGULAR = 1e-10
"""Ratio of the eigenvalues of the scaled information below which its inverse is noise."""

_SAME_POSE = 0.1
"""Radians between two minima that count as one."""

_MISSED = 1e-3
"""Probability that all samples so far have had a wrong keypoint at which sampling ends (Fischler and Bolles 1981)."""

_LUCK = 0.05
"""Probability down to which small residuals are put down to luck."""

_REFINED_HYPOTHESES = 5
_REFINEMENT_ROUNDS = 3


@dataclass(frozen=True)
class PnpConfig:
    """How a pose is found from keypoints, and when it is refused."""

    std_floor: float = 0.5
    """Least standard deviation believed of a keypoint coordinate, pixels."""
    huber: float = 2.45
    """Whitened residual norm beyond which a keypoint pulls with constant force (chi-square, 95 %, 2 dof)."""
    inlier_sigma: float = 3.03
    """Whitened residual norm up to which a keypoint agrees with a pose (chi-square, 99 %, 2 dof)."""
    max_error_px: float = 4.0
    """Reprojection error, pixels, always tolerated: of one keypoint as an inlier, of all for the pose."""
    max_error_fraction: float = 0.02
    """The same as a share of the object's extent in the image; the larger of the two counts."""
    max_stated_fraction: float = 0.1
    """Share of the extent up to which the error of all may also be as large as the network says (median deviation)."""
    min_inliers: int = 5
    """Keypoints that must agree; at least 4."""
    min_visible: float = 1.0
    """Expected number of unhidden keypoints (sum of visibilities) below which an object is not believed."""
    ambiguity_gap: float = 5.99
    """Rise of the inflated chi-square up to which the second pose is reported as a twin."""

    def __post_init__(self) -> None:
        if self.min_inliers < 4:
            raise ValueError(f"min_inliers must be at least 4 to fix a pose; it is {self.min_inliers}")
        if min(self.std_floor, self.huber, self.inlier_sigma, self.max_error_px) <= 0:
            raise ValueError("std_floor, huber, inlier_sigma and max_error_px must be positive")
        if self.max_stated_fraction < 0:
            raise ValueError(f"max_stated_fraction is a share of the extent; it is {self.max_stated_fraction}")


@dataclass(frozen=True, eq=False)
class PnpSolution:
    """A pose that agrees with the keypoints.

    Attributes:
        camera_from_object: (4, 4).
        covariance: (6, 6) of the right perturbation [rotation rad; translation m], positive definite.
        inliers: (K,) bool, the keypoints behind the pose.
        error_px: root mean square reprojection error of the inliers, weighted by their certainty, pixels.
        chi2_per_dof: whitened residuals over degrees of freedom; near 1 where the predicted std is honest.
        twin: (4, 4) another pose that explains the inliers almost as well (flat, straight objects), or None.
    """

    camera_from_object: FloatArray
    covariance: FloatArray
    inliers: NDArray[np.bool_]
    error_px: float
    chi2_per_dof: float
    twin: FloatArray | None = None


@dataclass(frozen=True)
class PnpRefusal:
    """Why no pose is given, in words."""

    reason: str


@dataclass(frozen=True, eq=False)
class _Problem:
    """The usable keypoints, as an ideal lens sees them.

    Attributes:
        points: (n, 3) metres, object frame; pixels, std: (n, 2).
        normalized: (n, 2) pixels as a camera with identity matrix would have them.
        limits: (n,) whitened residual norm up to which a keypoint is an inlier.
        matrix: (3, 3) of the camera; huber: threshold of the kernel.
    """

    points: FloatArray
    normalized: FloatArray
    pixels: FloatArray
    std: FloatArray
    limits: FloatArray
    matrix: FloatArray
    huber: float

    def subset(self, chosen: NDArray[np.bool_]) -> _Problem:
        return _Problem(
            self.points[chosen],
            self.normalized[chosen],
            self.pixels[chosen],
            self.std[chosen],
            self.limits[chosen],
            self.matrix,
            self.huber,
        )

    def norms(self, pose: FloatArray) -> FloatArray:
        """(n,) whitened residual norms; infinite behind the camera."""
        whitened = reprojection.residuals(pose, self.points, self.pixels, self.std, self.matrix)
        return np.hypot(whitened[:, 0], whitened[:, 1])

    def inliers(self, pose: FloatArray) -> NDArray[np.bool_]:
        return self.norms(pose) <= self.limits

    def refine(self, pose: FloatArray) -> tuple[FloatArray, float]:
        return reprojection.refine(pose, self.points, self.pixels, self.std, self.matrix, self.huber)

    def truncated_costs(self, poses: FloatArray) -> FloatArray:
        return reprojection.truncated_costs(poses, self.points, self.pixels, self.std, self.matrix, self.limits)

    def information(self, pose: FloatArray) -> FloatArray:
        return reprojection.information(pose, self.points, self.pixels, self.std, self.matrix, self.huber)[1]


def solve_pnp(
    keypoints: Float64[np.ndarray, "k 2"],
    std: Float64[np.ndarray, "k 2"],
    visibility: Float64[np.ndarray, " k"],
    keypoints_in_object: Float64[np.ndarray, "k 3"],
    camera: Camera,
    config: PnpConfig,
) -> PnpSolution | PnpRefusal:
    """Finds the pose that best explains the keypoints, or says why there is none.

    Closed form on all keypoints, consensus over minimal samples if some disagree, least squares on the inliers.

    Args:
        keypoints: (K, 2) pixels of the image, lens distortion included; rows not finite are left out.
        std: (K, 2) standard deviations, pixels.
        visibility: (K,) probabilities that a keypoint is not hidden.
        keypoints_in_object: (K, 3) metres.
        camera: intrinsics of the image.
    """
    total, needed = len(keypoints), config.min_inliers
    usable = np.flatnonzero(np.isfinite(keypoints).all(axis=1) & np.isfinite(std).all(axis=1))
    if len(usable) < needed:
        return PnpRefusal(f"only {len(usable)} of {total} keypoints are finite; {needed} are needed")
    visible = float(visibility.sum())
    if visible < config.min_visible:
        return PnpRefusal(f"{visible:.1f} keypoints are expected to be visible; {config.min_visible:g} are needed")
    points = np.ascontiguousarray(keypoints_in_object[usable], dtype=np.float64)
    if layout.collinear(points):
        return PnpRefusal("the usable keypoints lie on one line of the object, which leaves its pose open")
    rays = camera.unproject(keypoints[usable])
    normalized, pixels = np.ascontiguousarray(rays[:, :2]), camera.without_distortion().project(rays)
    sigma = np.maximum(std[usable], config.std_floor)
    extent, uncertainty = layout.extent(pixels), float(np.median(sigma))
    if extent <= uncertainty:
        return PnpRefusal(f"the keypoints span {extent:.1f} px, no more than their uncertainty of {uncertainty:.1f} px")
    tolerance = max(config.max_error_px, config.max_error_fraction * extent)
    limits = np.maximum(config.inlier_sigma, tolerance / np.sqrt(sigma.prod(axis=1)))
    problem = _Problem(points, normalized, pixels, sigma, limits, camera.matrix, config.huber)

    pose = _robust_pose(problem)
    if pose is None:
        return PnpRefusal("no pose puts the keypoints in front of the camera")
    inliers = problem.inliers(pose)
    if inliers.sum() < config.min_inliers:
        return PnpRefusal(f"only {inliers.sum()} of {total} keypoints agree with one pose; {needed} are needed")
    chosen = problem.subset(inliers)
    if layout.collinear(chosen.points):
        return PnpRefusal("the keypoints that agree lie on one line of the object, which leaves its pose open")
    agreeing = np.zeros(total, dtype=np.bool_)
    agreeing[usable[inliers]] = True
    allowed = max(tolerance, min(uncertainty, config.max_stated_fraction * extent))
    return _describe(chosen, pose, agreeing, allowed, config)


def _robust_pose(problem: _Problem) -> FloatArray | None:
    """The pose with the best truncated cost; its inliers have been refined by least squares."""
    starts = closed_form(problem.points, problem.normalized)
    refined = [problem.refine(start)[0] for start in starts]
    if any(problem.inliers(pose).all() for pose in refined):
        return _best(problem, np.array(refined))
    # A single gross error drags a least squares pose along, however robust its kernel.
    candidates = np.concatenate((np.reshape(refined, (-1, 4, 4)), _consensus(problem)))
    order = np.argsort(problem.truncated_costs(candidates))[:_REFINED_HYPOTHESES]
    # Samples of the same right keypoints choose the same inliers: one of them is enough.
    best = {problem.inliers(candidates[index]).tobytes(): candidates[index] for index in reversed(order)}
    hypotheses = [_refit(problem, candidate) for candidate in best.values()]
    in_front = [pose for pose in hypotheses if np.isfinite(problem.norms(pose)).all()]
    return _best(problem, np.array(in_front)) if in_front else None


def _consensus(problem: _Problem) -> FloatArray:
    """Poses (m, 4, 4) of minimal samples, until all of one's keypoints being right would have been likely by now."""
    found, tried = np.zeros((0, 4, 4)), 0
    for triples in sample_turns(len(problem.points)):
        found = np.concatenate((found, minimal_samples(problem.points, problem.normalized, triples)))
        tried += len(triples)
        if len(found):
            right = problem.inliers(_best(problem, found)).mean()
            if (1 - right**3) ** tried < _MISSED:
                break
    return found


def _refit(problem: _Problem, pose: FloatArray) -> FloatArray:
    """Chooses the inliers and fits them until the choice no longer changes."""
    previous = np.zeros(len(problem.points), dtype=np.bool_)
    for _ in range(_REFINEMENT_ROUNDS):
        inliers = problem.inliers(pose)
        if inliers.sum() < 4 or np.array_equal(inliers, previous):
            break
        pose, previous = problem.subset(inliers).refine(pose)[0], inliers
    return pose


def _best(problem: _Problem, poses: FloatArray) -> FloatArray:
    return poses[int(np.argmin(problem.truncated_costs(poses)))]


def _describe(
    problem: _Problem, pose: FloatArray, inliers: NDArray[np.bool_], allowed: float, config: PnpConfig
) -> PnpSolution | PnpRefusal:
    """Final fit of the inliers, its twin, its covariance and the gate on its error."""
    first, second = sorted(
        (problem.refine(pose), problem.refine(reversed_twin(pose, problem.points))), key=lambda fit: fit[1]
    )
    norms = problem.norms(first[0])
    chi2 = float(np.sum(norms**2))
    error_px = float(np.sqrt(2 * chi2 / np.sum(problem.std**-2.0)))
    if error_px > allowed:
        return PnpRefusal(f"the reprojection error is {error_px:.1f} px; {allowed:.1f} px are allowed")
    chi2_per_dof = chi2 / (2 * len(norms) - 6)
    # A model that fits better than it claims is luck: the covariance is never deflated.
    inflation = max(1.0, chi2_per_dof) * _shared_errors(chi2_per_dof, len(norms))
    precision = problem.information(first[0]) / inflation
    precision[:3, :3] += np.eye(3) / _LARGEST_ROTATION_VARIANCE
    covariance = _inverse(precision)
    if covariance is None:
        return PnpRefusal("the keypoints that agree leave the pose undetermined")
    close_call = second[1] - first[1] <= config.ambiguity_gap * inflation
    ambiguous = close_call and np.linalg.norm(se3.minus(second[0], first[0])[:3]) > _SAME_POSE
    return PnpSolution(
        camera_from_object=first[0],
        covariance=covariance,
        inliers=inliers,
        error_px=error_px,
        chi2_per_dof=chi2_per_dof,
        twin=second[0] if ambiguous else None,
    )


def _shared_errors(chi2_per_dof: float, keypoints: int) -> float:
    """How much larger the covariance of a pose is because its keypoints are wrong together.

    A network that takes an object to be turned otherwise than it is places all its keypoints as they would be then:
    they agree with each other far better than their deviations say, though these are right for each. If all error is of
    that kind, the pose has to explain the deviations of 2 n coordinates by 6 numbers, and its covariance is 2 n / 6
    times that of independent errors. Residuals that luck makes as small once in twenty times or more often prove
    nothing.
    """
    freedoms = 2 * keypoints - 6
    by_luck = 2 * float(gammaincinv(freedoms / 2, _LUCK)) / freedoms
    share = max(0.0, 1 - chi2_per_dof / by_luck)
    return 1 + share * (2 * keypoints / 6 - 1)


def _inverse(precision: FloatArray) -> FloatArray | None:
    """Inverse of a (6, 6) symmetric matrix, positive definite by construction; None if it is singular in double."""
    # Radians and metres differ by orders of magnitude; equal diagonals make the condition number mean something.
    scale = 1 / np.sqrt(np.diag(precision))
    values, vectors = np.linalg.eigh(precision * np.outer(scale, scale))
    if not values[0] > _SINGULAR * values[-1]:
        return None
    half = scale[:, None] * vectors / np.sqrt(values)
    covariance = half @ half.T
    return (covariance + covariance.T) / 2
