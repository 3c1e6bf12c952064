"""Whether stated covariances are right: two halves of the objects place the same cameras independently."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from multicam.bundle.levenberg import minimize
from multicam.bundle.problem import Problem, State
from multicam.geometry import se3
from multicam.matching.linear import inverse, squared_norm
from multicam.registration.edges import Edges, pose_factor, reachable
from multicam.registration.group import Group
from multicam.registration.refinement import Refinement
from multicam.types import FloatArray

PRIOR = 20
"""How many pairs of cameras the stated covariances count for against what the halves say of them."""

QUANTILE = 0.8
"""Where distances are compared with their distribution: near the end by which error bars are judged, short of
failures."""


def disagreement(group: Group, found: Refinement) -> FloatArray:
    """(c - 1,) squared Mahalanobis distances between the cameras that every second object and the others give.

    Empty where one half does not hold all cameras together.
    """
    cameras = len(found.placement.views)
    poses: list[FloatArray] = []
    covariances: list[FloatArray] = []
    for half in (0, 1):
        chosen = np.flatnonzero(found.edges.object % 2 == half)
        shared, position = np.unique(found.edges.object[chosen], return_inverse=True)
        part = Edges(found.edges.track[chosen], found.edges.camera[chosen], position, found.edges.shared[shared])
        if not np.all(reachable(part, cameras)):
            return np.zeros(0)
        problem = Problem((pose_factor(group, found.tracks, part),), np.arange(cameras) == 0)
        start = State(found.placement.world_from_camera, found.world_from_object[shared])
        state = minimize(problem, start, group.config.solver).state
        poses.append(state.world_from_camera[1:])
        covariances.append(problem.covariances(state, problem.noise_scale(state))[0][1:])
    return squared_norm(se3.minus(*poses), inverse(covariances[0] + covariances[1]))


def variance_ratio(distances: FloatArray) -> float:
    """How much larger variances are than stated, by squared distances (n,) of six dimensions."""
    expected = _chi_square((np.arange(PRIOR) + 0.5) / PRIOR)
    return float(np.quantile(np.concatenate((distances, expected)), QUANTILE) / _chi_square(np.array(QUANTILE)))


def _chi_square(probability: FloatArray) -> FloatArray:
    """Quantiles of the chi-square distribution with 6 degrees of freedom."""
    return 2 * gammaincinv(3, probability)
