"""Cameras with poses in one world, grown link by link, best first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.linear import congruent
from multicam.registration.links import MAP, Link
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class Placement:
    """Placed views in the order in which they were placed; the first is the world.

    Attributes:
        views: (c,) indices.
        world_from_camera: (c, 4, 4).
        covariance: (c, 6, 6) of its right perturbation; zero for the first.
    """

    views: IntArray
    world_from_camera: FloatArray
    covariance: FloatArray

    def extended(self, link: Link) -> Placement:
        """With the query of a link from a placed view or from the map."""
        pose, covariance = link.pose, link.covariance
        if link.reference != MAP:
            base = int(np.flatnonzero(self.views == link.reference)[0])
            pose = self.world_from_camera[base] @ link.pose
            covariance = covariance + congruent(se3.adjoint(se3.inverse(link.pose)), self.covariance[base])
        return Placement(
            np.append(self.views, link.query),
            np.concatenate((self.world_from_camera, pose[None])),
            np.concatenate((self.covariance, covariance[None])),
        )

    def only(self, chosen: BoolArray) -> Placement:
        """Some of the cameras."""
        return Placement(self.views[chosen], self.world_from_camera[chosen], self.covariance[chosen])


def seed(link: Link) -> Placement:
    """The two views of a link, the reference being the world."""
    return Placement(np.array([link.reference]), np.eye(4)[None], np.zeros((1, 6, 6))).extended(link)


def spread(placement: Placement, links: Iterable[Link], open_views: set[int]) -> Placement:
    """Adds views over believed links from placed ones, the link with the greatest log odds first (Prim)."""
    believed = [link for link in links if link.doubt is None]
    both_ways = believed + [link.reversed() for link in believed if link.reference != MAP]
    placed = {MAP, *placement.views.tolist()}
    while next_links := [
        link for link in both_ways if link.reference in placed and link.query in open_views and link.query not in placed
    ]:
        best = max(next_links, key=lambda link: link.log_odds)
        placement = placement.extended(best)
        placed.add(best.query)
    return placement
