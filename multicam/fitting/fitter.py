"""Detections in cameras that measure depth, brought to where depth and contours show the objects, each by itself.

a detection, with a pose or without -> starts -> lines and points searched from each -> the pose they bear out, or none

A network that is unsure of an attitude takes one end of a part for the other, and its distances are off by percents.
Depth and contours tell, mostly, where colours and keypoints do not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from multicam.bundle.adjustment.descent import UNKNOWN
from multicam.bundle.adjustment.frames import ideal_picture
from multicam.bundle.adjustment.scene import Body
from multicam.bundle.cores import over_cores
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.tracking import Sight, Tracked, first_colors, track
from multicam.dataset.objects import Catalogue
from multicam.fitting.agreement import agreement, confirmed
from multicam.fitting.attitudes import poses_at_box
from multicam.fitting.config import FitConfig
from multicam.fitting.sampled import surface_errors
from multicam.geometry import se3
from multicam.inference.estimator import FrameEstimates
from multicam.matching.linear import inverse
from multicam.types import Detection, FloatArray, Frame, ObjectEstimate

HALF_TURNS = np.array([np.diag([1.0, 1, 1]), *(2 * np.diag(axis) - np.eye(3) for axis in np.eye(3))])
"""(4, 3, 3) none, and about each axis: what turns a part end for end."""

NEARER, TYPICAL = 0.1, 0.5
"""Quantiles of how far measured depth lies behind an estimate, by which starts are moved along the line of sight."""

TAKEN_FURTHER = 2
"""How many ends of searches from other starts are searched from once more."""

SAME = 0.25
"""Share of the diameter within which the middles of two fitted poses of a class are one object, seen twice."""


class Fitter:
    """Fits the detections of frames with depth."""

    def __init__(self, bodies: Mapping[int, Body], catalogue: Catalogue, config: FitConfig) -> None:
        self.bodies, self.catalogue, self.config = bodies, catalogue, config

    def fit(self, frames: Sequence[Frame], found: Sequence[FrameEstimates]) -> list[tuple[ObjectEstimate, ...]]:
        """The estimates of each frame; those that the pictures bear out at another pose with it, without detection.

        Refused detections become estimates where a pose is borne out. The rest stays as it is, and so does all of a
        frame without depth. Of fitted poses that are one object, the best stays.
        """
        return [
            each.estimates if frame.depth is None else self._fit_frame(frame, each)
            for frame, each in zip(frames, found, strict=True)
        ]

    def _fit_frame(self, frame: Frame, found: FrameEstimates) -> tuple[ObjectEstimate, ...]:
        picture = ideal_picture(frame)
        assert picture.depth is not None, "the frame measures depth"
        sight, depth = Sight(picture.image, picture.camera, np.eye(4), picture.depth), picture.depth
        detections = [*found.estimates, *(refused.detection for refused in found.refusals)]
        fits = over_cores(lambda each: self._fit_one(sight, depth, each), detections)
        borne_out: list[ObjectEstimate] = []
        for fit in sorted((each for each in fits if each is not None), key=lambda each: -each[0]):
            if not any(self._same(fit[1], other) for other in borne_out):
                borne_out.append(fit[1])
        rest = [each for each, fit in zip(found.estimates, fits, strict=False) if fit is None]
        return tuple(sorted((*borne_out, *rest), key=lambda each: -each.score))

    def _same(self, one: ObjectEstimate, other: ObjectEstimate) -> bool:
        if one.obj_id != other.obj_id:
            return False
        model = self.catalogue[one.obj_id]
        middles = [se3.act(each.camera_from_object, model.box_centre()) for each in (one, other)]
        return bool(np.linalg.norm(middles[0] - middles[1]) < SAME * model.diameter)

    def _fit_one(
        self, sight: Sight, depth: DepthImage, found: ObjectEstimate | Detection
    ) -> tuple[float, ObjectEstimate] | None:
        """How well a pose is borne out, and the estimate with it; None where it is not well enough."""
        body, config = self.bodies.get(found.obj_id), self.config
        if body is None:
            return None
        best, score = None, -np.inf
        for pose in self._refined(sight, depth, body, found):
            # Colours learnt at a start that was off draw the contour towards it.
            tracked = self._track(sight, body, pose)
            agrees = agreement(body, depth, tracked, config)
            if agrees > score:
                best, score = tracked, agrees
            if score >= config.enough:
                break
        if best is None or score < config.least:
            return None
        covariance = config.inflation * inverse(best.hessian + UNKNOWN * np.eye(6))
        covariance += np.diag(np.repeat(config.least_std, 3) ** 2)
        return score, ObjectEstimate(found.obj_id, found.score, best.world_from_object, covariance)

    def _refined(
        self, sight: Sight, depth: DepthImage, body: Body, found: ObjectEstimate | Detection
    ) -> Iterator[FloatArray]:
        """Poses (4, 4) where searches ended: from the estimate; then from other starts, the best two."""
        centre, config = self.catalogue[found.obj_id].box_centre(), self.config
        starts, box = list[tuple[float, FloatArray]](), None
        if isinstance(found, Detection):
            box = found.box
        else:
            yield self._track(sight, body, found.camera_from_object).world_from_object
            turned = self._turned(depth, body, found.camera_from_object, centre)
            starts += [(confirmed(surface_errors(body.model, depth, pose), config), pose) for pose in turned]
            box = None if found.detection is None else found.detection.box
        if box is not None:
            starts += poses_at_box(sight, depth, body.model, centre, box, config)
        starts.sort(key=lambda start: -start[0])
        ends = [self._track(sight, body, pose) for _, pose in starts[: config.followed]]
        ends.sort(key=lambda end: -agreement(body, depth, end, config))
        yield from (end.world_from_object for end in ends[:TAKEN_FURTHER])

    def _turned(self, depth: DepthImage, body: Body, pose: FloatArray, centre: FloatArray) -> list[FloatArray]:
        """A pose (4, 4) and its half turns at three distances along the line of sight, without itself."""
        behind = surface_errors(body.model, depth, pose)
        away = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
        shifts = [0.0, *np.quantile(behind, (TYPICAL, NEARER))] if len(behind) else [0.0]
        poses: list[FloatArray] = []
        for turn in HALF_TURNS:
            turned = pose @ se3.from_parts(turn, centre - turn @ centre)
            for shift in shifts:
                start = turned.copy()
                start[:3, 3] += shift * away
                poses.append(start)
        return poses[1:]

    def _track(self, sight: Sight, body: Body, pose: FloatArray) -> Tracked:
        region = self.config.tracking.region
        colors = ColorModel.uniform() if region is None else first_colors(body.model, sight, pose, region)
        return track(body.model, [sight], [colors], pose, self.config.tracking)
