"""An information filter for one pose that does not change, or drifts slowly: the newest measurement never just wins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from multicam.geometry import se3
from multicam.scenegraph.uncertain import UncertainPose, fuse, mahalanobis, shrinkage
from multicam.types import FloatArray


@dataclass(frozen=True)
class FilterConfig:
    """When a measurement counts."""

    gate: float = 22.46
    """Largest squared Mahalanobis distance from the stored pose; 99.9 % of good measurements lie within."""
    takeover: int = 3
    """Measurements in a row that must contradict the stored pose and agree with each other to replace it."""
    least_gain: float = 0.01
    """A measurement that would sharpen the stored pose by a smaller share than this is not fused."""
    common: float = 0.5
    """Share of a measurement's variance that returns with every measurement, so that averaging does not remove it: a
    static camera before a still scene makes the same error again and again."""


class Outcome(Enum):
    """What became of a measurement."""

    STARTED = "started"
    FUSED = "fused"
    NOTHING_NEW = "nothing new"
    REJECTED = "rejected"
    REPLACED = "replaced"


@dataclass(frozen=True, eq=False)
class FilteredPose:
    """The state of the filter.

    Attributes:
        stored: the pose as it was known at `updated_ns`, with the covariance of the errors that averaging removes.
        common: (6, 6) covariance of the error that all measurements share.
        count: measurements fused so far.
        rival: measurements that contradict the stored pose but not each other; cleared by one that agrees with it.
    """

    stored: UncertainPose
    common: FloatArray
    updated_ns: int
    count: int = 1
    rival: FilteredPose | None = None

    def at(self, timestamp_ns: int, drift_per_second: FloatArray) -> UncertainPose:
        """The pose with all its uncertainty, also that gathered since: a random walk of a (6, 6) covariance rate."""
        return self.aged(timestamp_ns, drift_per_second).inflated(self.common)

    def aged(self, timestamp_ns: int, drift_per_second: FloatArray) -> UncertainPose:
        """As `at`, without the common error."""
        seconds = abs(timestamp_ns - self.updated_ns) * 1e-9
        return self.stored.inflated(seconds * drift_per_second)

    def fused(
        self, measured: UncertainPose, timestamp_ns: int, drift_per_second: FloatArray, common: float
    ) -> FilteredPose:
        """With one more measurement, of whose variance the share `common` is common."""
        fresh = start(measured, timestamp_ns, common)
        pose = fuse(self.aged(timestamp_ns, drift_per_second), fresh.stored)
        mean = (self.count * self.common + fresh.common) / (self.count + 1)
        return FilteredPose(pose, mean, timestamp_ns, self.count + 1)


@dataclass(frozen=True)
class Decision:
    """The outcome for one measurement and how far it lay from the stored pose."""

    outcome: Outcome
    distance: float = 0.0
    """Square root of the Mahalanobis distance."""
    angle: float = 0.0
    """Radians between the rotations."""
    shift: float = 0.0
    """Metres between the origins."""

    @property
    def accepted(self) -> bool:
        """Whether the stored pose now contains the measurement."""
        return self.outcome in (Outcome.STARTED, Outcome.FUSED, Outcome.REPLACED)

    def reason(self) -> str:
        """Why the measurement was not used, in plain words; empty if it was."""
        if self.outcome is Outcome.NOTHING_NEW:
            return "the stored pose is already as sharp as this measurement can make it"
        if self.outcome is Outcome.REJECTED:
            return (
                f"the measurement lies {self.shift * 1000:.0f} mm and {np.degrees(self.angle):.1f} deg from the stored "
                f"pose, {self.distance:.1f} standard deviations"
            )
        return ""


def start(measured: UncertainPose, timestamp_ns: int, common: float) -> FilteredPose:
    """The filter after its first measurement."""
    own = UncertainPose(measured.pose, (1 - common) * measured.covariance)
    return FilteredPose(own, common * measured.covariance, timestamp_ns)


def absorb(
    state: FilteredPose | None,
    measured: UncertainPose,
    timestamp_ns: int,
    drift_per_second: FloatArray,
    config: FilterConfig,
) -> tuple[FilteredPose, Decision]:
    """One step of the filter: age, gate, then fuse, reject, or give way to a rival that has proved itself."""
    if state is None:
        return start(measured, timestamp_ns, config.common), Decision(Outcome.STARTED)
    prior = state.at(timestamp_ns, drift_per_second)
    squared = mahalanobis(prior, measured)
    twist = se3.minus(measured.pose, prior.pose)
    shift = np.linalg.norm(measured.pose[:3, 3] - prior.pose[:3, 3])
    measures = float(np.sqrt(squared)), float(np.linalg.norm(twist[:3])), float(shift)
    if squared > config.gate:
        return _contest(state, measured, timestamp_ns, drift_per_second, config, measures)
    fused = state.fused(measured, timestamp_ns, drift_per_second, config.common)
    if shrinkage(state.aged(timestamp_ns, drift_per_second), fused.stored) < config.least_gain:
        return replace(state, rival=None), Decision(Outcome.NOTHING_NEW, *measures)
    return fused, Decision(Outcome.FUSED, *measures)


def _contest(
    state: FilteredPose,
    measured: UncertainPose,
    timestamp_ns: int,
    drift_per_second: FloatArray,
    config: FilterConfig,
    measures: tuple[float, float, float],
) -> tuple[FilteredPose, Decision]:
    """A contradicting measurement joins the rival if they agree, else it becomes the rival."""
    rival = start(measured, timestamp_ns, config.common)
    if state.rival is not None:
        prior = state.rival.at(timestamp_ns, drift_per_second)
        if mahalanobis(prior, measured) <= config.gate:
            rival = state.rival.fused(measured, timestamp_ns, drift_per_second, config.common)
    if rival.count >= config.takeover:
        return rival, Decision(Outcome.REPLACED, *measures)
    return replace(state, rival=rival), Decision(Outcome.REJECTED, *measures)
