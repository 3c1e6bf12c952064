"""What one camera, standing at one place, says of one object at rest: all its looks in one, in information form."""

from __future__ import annotations

from dataclasses import dataclass, replace

from multicam.scenegraph.config import GraphConfig
from multicam.scenegraph.uncertain import UncertainPose, fuse, mahalanobis
from multicam.types import FloatArray


@dataclass(frozen=True, eq=False)
class Edge:
    """The looks of one camera at one object.

    Attributes:
        mean: camera_from_object over all looks, with the covariance of the errors that averaging removes.
        recent: camera_from_object over the last few looks, each at its full covariance.
        common: (6, 6) covariance of the error that all looks share.
        looks: how many there were.
        first_ns, last_ns: when.
    """

    mean: UncertainPose
    recent: UncertainPose
    common: FloatArray
    looks: int
    first_ns: int
    last_ns: int

    @classmethod
    def of(cls, measured: UncertainPose, timestamp_ns: int, config: GraphConfig) -> Edge:
        """The first look."""
        own = UncertainPose(measured.pose, (1 - config.common) * measured.covariance)
        return cls(own, measured, config.common * measured.covariance, 1, timestamp_ns, timestamp_ns)

    def seen_from(self, motion: UncertainPose) -> Edge:
        """The same looks as if from another place, given there_from_here."""
        return replace(self, mean=motion @ self.mean, recent=motion @ self.recent)

    def joined(self, later: Edge, config: GraphConfig) -> Edge:
        """With later looks from the same place at the same symmetric twin."""
        looks = self.looks + later.looks
        memory = UncertainPose(self.recent.pose, self.recent.covariance / config.change.memory)
        return Edge(
            fuse(self.mean, later.mean),
            fuse(memory, later.recent),
            (self.looks * self.common + later.looks * later.common) / looks,
            looks,
            self.first_ns,
            later.last_ns,
        )

    def shift(self) -> float:
        """Squared Mahalanobis distance of the recent looks from the mean of all."""
        return mahalanobis(self.mean, self.recent)

    @property
    def estimate(self) -> UncertainPose:
        """The mean with all its uncertainty."""
        return self.mean.inflated(self.common)
