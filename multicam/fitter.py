"""Estimates in cameras that measure depth, brought to where depth and contours show the objects, each by itself.

a pose of the network -> other starts -> lines and points searched from each -> the one that depth confirms, or none

A network that is unsure of an attitude takes one end of a part for the other, and its distances are off by percents.
Depth tells both, mostly, which colour alone does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from multicam.bundle.adjustment.descent import UNKNOWN
from multicam.bundle.adjustment.frames import ideal_picture
from multicam.bundle.adjustment.scene import Body
from multicam.bundle.adjustment.search import DRAWN
from multicam.bundle.cores import over_cores
from multicam.bundle.depth_image import DepthImage, draw_bodies
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.tracking import Sight, Tracked, TrackingConfig, first_colors, track
from multicam.dataset.objects import Catalogue
from multicam.errors import ConfigError
from multicam.geometry import se3
from multicam.matching.linear import inverse
from multicam.types import FloatArray, Frame, ObjectEstimate

HALF_TURNS = np.array([np.diag([1.0, 1, 1]), *(2 * np.diag(axis) - np.eye(3) for axis in np.eye(3))])
"""(4, 3, 3) none, and about each axis: what turns a part end for end."""

NEARER, TYPICAL = 0.1, 0.5
"""Quantiles of measured over drawn depth by which a start is moved along the line of sight."""

FARTHEST = 1.5
"""By which factor a distance is changed at most, either way."""


@dataclass(frozen=True)
class FitConfig:
    """Estimates brought to measured depth (docs/bundle.md)."""

    enabled: bool = False
    """Whether to do it in cameras that measure depth: a good tenth of a second for each object that the network has
    wrong."""
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(searches=7))
    """Search and steps from each start."""
    confirms: float = 0.008
    """Depth that differs from that of a pose by less confirms it, metres."""
    contradicts: float = 0.015
    """Depth that differs by more contradicts it: wholly if it lies behind, by half if something may hide the object."""
    least: float = 0.7
    """Share of an object's pixels that must confirm a pose, less those that contradict it."""
    enough: float = 0.9
    """The same at which no other start is tried."""
    pixels: int = 20
    """Least pixels of measured depth that an object must cover at half size."""
    inflation: float = 4.0
    """How much larger variances are than lines and points say, which are not independent."""
    least_std: tuple[float, float] = (0.02, 0.003)
    """Least deviations of a fitted pose, per axis, radians and metres."""

    def __post_init__(self) -> None:
        if not 0 < self.confirms <= self.contradicts:
            raise ConfigError(f"fit.confirms must lie above 0 and not above fit.contradicts; it is {self.confirms:g}.")
        if not 0 < self.least <= self.enough:
            raise ConfigError(f"fit.least must lie above 0 and not above fit.enough; it is {self.least:g}.")


class Fitter:
    """Fits the estimates of frames with depth."""

    def __init__(self, bodies: Mapping[int, Body], catalogue: Catalogue, config: FitConfig) -> None:
        self.bodies, self.catalogue, self.config = bodies, catalogue, config

    def fit(
        self, frames: Sequence[Frame], found: Sequence[tuple[ObjectEstimate, ...]]
    ) -> list[tuple[ObjectEstimate, ...]]:
        """The estimates of each frame, those that depth confirms with another pose and covariance, without detection.

        The rest stays as it is, and so does all of a frame without depth.
        """
        return [
            estimates if frame.depth is None else self._fit_frame(frame, estimates)
            for frame, estimates in zip(frames, found, strict=True)
        ]

    def _fit_frame(self, frame: Frame, estimates: Sequence[ObjectEstimate]) -> tuple[ObjectEstimate, ...]:
        picture = ideal_picture(frame)
        sight = Sight(picture.image, picture.camera, np.eye(4), picture.depth)
        return tuple(over_cores(lambda estimate: self._fit_one(sight, estimate), estimates))

    def _fit_one(self, sight: Sight, estimate: ObjectEstimate) -> ObjectEstimate:
        body, config = self.bodies.get(estimate.obj_id), self.config
        if body is None:
            return estimate
        best, score = None, -np.inf
        for start in self._starts(sight, body, estimate):
            # Colours learnt at a start that was off draw the contour towards it.
            found = self._track(sight, body, self._track(sight, body, start).world_from_object)
            confirmed = self._confirmed(sight, body, found.world_from_object)
            if confirmed > score:
                best, score = found, confirmed
            if score >= config.enough:
                break
        assert best is not None, "the estimate itself is a start"
        if score < config.least:
            return estimate
        covariance = config.inflation * inverse(best.hessian + UNKNOWN * np.eye(6))
        covariance += np.diag(np.repeat(config.least_std, 3) ** 2)
        return replace(estimate, camera_from_object=best.world_from_object, covariance=covariance, detection=None)

    def _starts(self, sight: Sight, body: Body, estimate: ObjectEstimate) -> Iterator[FloatArray]:
        """Poses (4, 4): the estimate, at distances that depth suggests, and all of these turned end for end."""
        pose = estimate.camera_from_object
        measured, drawn = self._depths(sight, body, pose)
        factors = [1.0, *np.quantile(measured / drawn, (TYPICAL, NEARER))] if len(drawn) else [1.0]
        centre = self.catalogue[estimate.obj_id].box_centre()
        for turn in HALF_TURNS:
            turned = pose @ se3.from_parts(turn, centre - turn @ centre)
            for factor in np.clip(factors, 1 / FARTHEST, FARTHEST):
                start = turned.copy()
                start[:3, 3] *= factor
                yield start

    def _track(self, sight: Sight, body: Body, pose: FloatArray) -> Tracked:
        region = self.config.tracking.region
        colors = ColorModel.uniform() if region is None else first_colors(body.model, sight, pose, region)
        return track(body.model, [sight], [colors], pose, self.config.tracking)

    def _confirmed(self, sight: Sight, body: Body, pose: FloatArray) -> float:
        """Share of the object's pixels at a pose (4, 4) that depth confirms, less those that it contradicts."""
        measured, drawn = self._depths(sight, body, pose)
        if len(drawn) < self.config.pixels:
            return -1.0
        behind = measured - drawn
        confirmed = np.abs(behind) < self.config.confirms
        contradicted = (behind > self.config.contradicts) + 0.5 * (behind < -self.config.contradicts)
        return float(np.mean(confirmed - contradicted))

    def _depths(self, sight: Sight, body: Body, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Depth (n,) as measured and as drawn at a pose (4, 4), at the pixels at half size that have both."""
        depth = sight.depth
        assert isinstance(depth, DepthImage)
        drawn = draw_bodies([(body.mesh, depth.depth_from_camera @ pose)], depth.camera.scaled(DRAWN)).depth
        row, column = np.nonzero(np.isfinite(drawn))
        height, width = depth.depth.shape
        at = depth.depth[
            np.minimum((row / DRAWN).astype(int), height - 1), np.minimum((column / DRAWN).astype(int), width - 1)
        ]
        known = np.isfinite(at) & (at > 0)
        return at[known].astype(np.float64), drawn[row, column][known].astype(np.float64)
