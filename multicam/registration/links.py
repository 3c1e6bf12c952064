"""Relative poses between views, and between a view and the map of objects, with what speaks against them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from multicam.bundle.scenery.motion import SeenMotion
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray
from multicam.matching.consensus import find_consensus
from multicam.matching.hypotheses import measure, propose
from multicam.matching.linear import congruent, total_std
from multicam.matching.observations import PosedObjects
from multicam.registration.config import PlacementConfig
from multicam.registration.group import Group
from multicam.types import FloatArray

FREE_TURN = 0.35
"""Root mean square error of an attitude, radians, from which its linear covariance means nothing: a turn is free."""

PARTNERS = 5
"""Other views that each view is compared with first: enough to hold many together, and time grows with its number."""

MAP = -1
"""Stands for the map of fused objects where the index of a view is expected."""


class Doubt(Enum):
    """Why a relative pose is not believed."""

    CHANCE = auto()
    RIVAL = auto()
    LOOSE = auto()
    SCENERY = auto()


@dataclass(frozen=True, eq=False)
class Link:
    """The best relative pose of two frames.

    Attributes:
        reference, query: views, or MAP.
        pose: (4, 4) reference_from_query.
        covariance: (6, 6) of its right perturbation.
        log_odds: log odds against chance and the second best pose.
        support: number of objects that agree.
        doubt: why it is not believed, or None.
    """

    reference: int
    query: int
    pose: FloatArray
    covariance: FloatArray
    log_odds: float
    support: int
    doubt: Doubt | None

    def reversed(self) -> Link:
        """The same link seen from the other side."""
        return Link(
            self.query, self.reference, se3.inverse(self.pose), congruent(se3.adjoint(self.pose), self.covariance),
            self.log_odds, self.support, self.doubt,
        )  # fmt: skip


def links_between_views(group: Group) -> list[Link]:
    """One link for each pair of views with estimates of a common class; of many views, for the likeliest pairs."""
    estimates = group.estimates
    chosen = _likely_pairs(estimates, len(group.views))[estimates.frame[:, None], estimates.frame[None, :]]
    return _find(group, estimates, estimates, chosen & (estimates.frame[:, None] < estimates.frame[None, :]))


def witnessed(group: Group, links: list[Link]) -> tuple[Group, list[Link]]:
    """The group with the bearings that its pictures show, and the links as these leave them.

    Where pictures show the turn and direction between two views, only objects that agree with both may tell the pose:
    then it is not by chance that they do. Where none does, they have moved.
    """
    if group.scenery is None:
        return group, links
    pairs = [(link.reference, link.query) for link in links]
    names = [view.view_id for view in group.views]
    seen = {(a, b): group.scenery.motion(names[a], names[b]) for a, b in pairs}
    motions = {pair: motion for pair, motion in seen.items() if motion is not None}
    estimates = group.estimates
    allowed = np.zeros((len(group.views), len(group.views)), dtype=np.bool_)
    for pair in motions:
        allowed[pair] = True
    agreeing = _find(group, estimates, estimates, allowed[estimates.frame[:, None], estimates.frame], motions)
    again = {
        (link.reference, link.query): replace(link, doubt=None) if link.doubt is Doubt.CHANCE else link
        for link in agreeing
    }
    left: list[Link] = []
    for link in links:
        pair = link.reference, link.query
        moved = pair in motions and pair not in again
        left.append(replace(link, doubt=Doubt.SCENERY) if moved else again.get(pair, link))
    return replace(group, bearings=tuple((*pair, motion) for pair, motion in motions.items())), left


def _likely_pairs(estimates: PosedObjects, views: int) -> BoolArray:
    """(v, v) symmetric: whether one of two views is among the PARTNERS with which the other has most classes in common.

    Among equals the next ones in the circle of views go first, which keeps all of them connected.
    """
    classes, column = np.unique(estimates.obj_id, return_inverse=True)
    sees = np.zeros((views, len(classes)))
    sees[estimates.frame, column] = 1
    common = sees @ sees.T
    ahead = (np.arange(views)[None, :] - np.arange(views)[:, None]) % views
    rank = np.argsort(np.argsort(ahead - views * common, axis=1), axis=1)
    np.fill_diagonal(common, 0)
    # A view stands first in its own ranking.
    chosen = (rank <= PARTNERS) & (common > 0)
    return chosen | chosen.T


def links_to_map(group: Group, fused: PosedObjects, views: set[int]) -> list[Link]:
    """One link from the map to each of the views that holds an estimate of a class of the map."""
    estimates = group.of_views(views)
    in_map = replace(fused, frame=np.full_like(fused.frame, MAP))
    return _find(group, in_map, estimates, np.ones((len(fused), len(estimates)), dtype=np.bool_))


def _find(
    group: Group,
    reference: PosedObjects,
    query: PosedObjects,
    allowed: BoolArray,
    motions: Mapping[tuple[int, int], SeenMotion] | None = None,
) -> list[Link]:
    """The best pose of each pair of frames; of those that agree with the motions, where these are given."""
    measurements = measure(reference, query, allowed, group.symmetries)
    hypotheses = propose(measurements, reference, query, group.symmetries)
    if motions is not None:
        agrees = np.zeros(len(hypotheses), dtype=np.bool_)
        for link, pair in enumerate(measurements.frames.tolist()):
            own = hypotheses.link == link
            agrees[own] = motions[tuple(pair)].agrees(hypotheses.pose[own], hypotheses.covariance[own])
        hypotheses = hypotheses[agrees]
    found = find_consensus(measurements, hypotheses, group.config.consensus)
    log_odds, rotation_std = found.log_odds, total_std(found.covariance[:, :3, :3])
    return [
        Link(
            int(found.frames[i, 0]), int(found.frames[i, 1]), found.pose[i], found.covariance[i],
            float(log_odds[i]), int(found.support[i]),
            _doubt(float(found.evidence[i]), float(log_odds[i]), float(rotation_std[i]), group.config.placement),
        )
        for i in range(len(found.frames))
    ]  # fmt: skip


def _doubt(evidence: float, log_odds: float, rotation_std: float, config: PlacementConfig) -> Doubt | None:
    if evidence < config.min_log_odds:
        return Doubt.CHANCE
    # A free turn is a family of poses, which would look like many rivals.
    if rotation_std > FREE_TURN:
        return Doubt.LOOSE
    return Doubt.RIVAL if log_odds < config.min_log_odds else None
