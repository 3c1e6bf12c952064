"""Which relative pose the objects agree on: truncated likelihood with covariances, then a refit on all that agree.

The gain of a pairing is the log ratio of "one object" to "clutter", plus the log prior of the pairing, and never below
zero: a pairing that does not fit costs nothing. The evidence of a pose is the sum of its gains less the freedom the
pose had to fit them (Laplace's approximation): a pose that rests on one pairing has none (docs/registration.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray, rank_in_group
from multicam.matching.compare import refit, squared_norms
from multicam.matching.hypotheses import Hypotheses, Measurements
from multicam.matching.likelihood import LikelihoodConfig
from multicam.matching.linear import inverse, invert, squared_norm
from multicam.matching.pairing import one_to_one
from multicam.types import FloatArray

SAME_POSE = 22.46
"""Squared Mahalanobis distance (99.9 % of chi-square with 6 dof) up to which two refitted poses are one."""

LARGEST_TURN = 1.0
"""Attitudes, radians apart, that are never compared in full; spares most of the work, for most pairs are wrong."""


@dataclass(frozen=True)
class ConsensusConfig:
    """How the poses that objects agree on are found."""

    likelihood: LikelihoodConfig = field(default_factory=LikelihoodConfig)
    """When two estimates count as one object."""
    refined: int = 16
    """Hypotheses of each pair of frames that are refitted, best first."""
    rounds: int = 3
    """Refits of each."""


@dataclass(frozen=True, eq=False)
class Consensus:
    """The best pose of each link.

    Attributes:
        frames: (l, 2) reference and query frame.
        pose: (l, 4, 4) reference_from_query.
        covariance: (l, 6, 6) of its right perturbation.
        evidence: (l,) log odds of this pose against chance.
        rival: (l,) evidence of the best pose that differs from it; minus infinity if there is none.
        support: (l,) number of pairings that agree.
    """

    frames: IntArray
    pose: FloatArray
    covariance: FloatArray
    evidence: FloatArray
    rival: FloatArray
    support: IntArray

    @property
    def log_odds(self) -> FloatArray:
        """(l,) log odds of the pose against both chance and its rival."""
        return self.evidence - np.logaddexp(0.0, self.rival)


def find_consensus(measurements: Measurements, hypotheses: Hypotheses, config: ConsensusConfig) -> Consensus:
    """Scores all hypotheses, refits the best of each link on what agrees with them, and takes the best of these.

    Links without a hypothesis are left out.
    """
    first = _Round.of(measurements, hypotheses.link, hypotheses.pose, hypotheses.covariance, config.likelihood)
    order = np.lexsort((-first.score, hypotheses.link))
    kept = hypotheses[order[rank_in_group(hypotheses.link[order]) < config.refined]]
    link, pose = kept.link, kept.pose
    for _ in range(config.rounds):
        pose, covariance, evidence = _Round.of(measurements, link, pose, None, config.likelihood).refitted(measurements)
        # Most hypotheses soon tell the pose of the best one, which then stands for them.
        best = _best(link, evidence)
        kept_on = _differs(link, pose, covariance, best)
        kept_on[best] = True
        link, pose = link[kept_on], pose[kept_on]
    last = _Round.of(measurements, link, pose, None, config.likelihood)
    _, covariance, evidence = last.refitted(measurements)
    best = _best(link, evidence)
    other = _differs(link, pose, covariance, best)
    rival = np.full(len(best), -np.inf)
    np.maximum.at(rival, np.searchsorted(link[best], link[other]), evidence[other])
    frames = measurements.frames[link[best]]
    return Consensus(frames, pose[best], covariance[best], evidence[best], rival, last.support[best])


@dataclass(frozen=True, eq=False)
class _Round:
    """Hypotheses compared with every measurement of their link.

    Attributes:
        pose: (h, 4, 4).
        owner, member: (n,) hypothesis and measurement that agree, one-to-one within each hypothesis.
        residual: (n, 6).
        squared, gain: (n,).
        log_clutter: see LikelihoodConfig.
    """

    pose: FloatArray
    owner: IntArray
    member: IntArray
    residual: FloatArray
    gain: FloatArray
    weight: FloatArray
    log_clutter: float

    @classmethod
    def of(
        cls,
        measurements: Measurements,
        link: IntArray,
        pose: FloatArray,
        covariance: FloatArray | None,
        likelihood: LikelihoodConfig,
    ) -> _Round:
        """Compares; `covariance` is that of the poses where they do not stem from all that agrees with them."""
        owner, member, residual = measurements.near(link, pose, LARGEST_TURN)
        if covariance is None:
            squared, determinant = np.empty(len(member)), measurements.log_determinant[member]
            squared_norms(residual, measurements.information, member, squared)
        else:
            information, determinant = invert(covariance[owner] + measurements.covariance[member])
            squared = squared_norm(residual, information)
        gain = likelihood.log_ratio(squared, determinant) + measurements.log_prior[member]
        useful = np.flatnonzero(gain > 0)
        useful = useful[_one_to_one(owner[useful], measurements, member[useful], gain[useful])]
        return cls(
            pose, owner[useful], member[useful], residual[useful], gain[useful],
            likelihood.weight(squared[useful]), likelihood.log_clutter,
        )  # fmt: skip

    @property
    def score(self) -> FloatArray:
        """(h,) sum of gains."""
        return np.bincount(self.owner, self.gain, minlength=len(self.pose)).astype(np.float64)

    @property
    def support(self) -> IntArray:
        """(h,) number of pairings that agree."""
        return np.bincount(self.owner, minlength=len(self.pose)).astype(np.int64)

    def refitted(self, measurements: Measurements) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Poses after a weighted step on all that agrees (h, 4, 4), covariances (h, 6, 6), and evidence (h,)."""
        count = len(self.pose)
        moved, covariance, determinant = np.empty((count, 4, 4)), np.empty((count, 6, 6)), np.empty(count)
        if not refit(
            self.pose, self.owner, self.residual, self.weight, measurements.information, self.member,
            moved, covariance, determinant,
        ):  # fmt: skip
            raise np.linalg.LinAlgError("the information about a pose is not positive definite")
        freedom = self.log_clutter + 3 * np.log(2 * np.pi) - determinant / 2
        # A hypothesis that nothing supports stays where it is and gets no evidence.
        return moved, covariance, np.where(self.support > 0, self.score + freedom, 0.0)


def _one_to_one(owner: IntArray, measurements: Measurements, member: IntArray, gain: FloatArray) -> BoolArray:
    """Pairings that are the best both of their reference object and of their query object, per hypothesis."""
    best = np.empty(len(owner), dtype=np.bool_)
    one_to_one(owner, measurements.reference[member], measurements.query[member], gain, best)
    return best


def _best(link: IntArray, evidence: FloatArray) -> IntArray:
    """(l,) the pose with the greatest evidence of each link; links ascend."""
    order = np.lexsort((-evidence, link))
    return order[rank_in_group(link[order]) == 0]


def _differs(link: IntArray, pose: FloatArray, covariance: FloatArray, best: IntArray) -> BoolArray:
    """(h,) whether a pose is another one than the best of its link."""
    winner = best[np.searchsorted(link[best], link)]
    difference = se3.minus(pose, pose[winner])
    return squared_norm(difference, inverse(covariance + covariance[winner])) > SAME_POSE
