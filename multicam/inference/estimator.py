"""Frames of several cameras to object poses with covariance: one batch through the network, then PnP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from multicam.geometry.camera import Camera
from multicam.inference.decode import DecodeConfig
from multicam.inference.pnp import PnpConfig, PnpRefusal, solve_pnp
from multicam.inference.session import Network
from multicam.inference.shrinkage import undo_shrinkage
from multicam.types import Detection, Frame, ObjectEstimate


@dataclass(frozen=True)
class EstimatorConfig:
    """From pixels to poses."""

    decode: DecodeConfig = field(default_factory=DecodeConfig)
    """Which outputs count as detections."""
    pnp: PnpConfig = field(default_factory=PnpConfig)
    """How poses are found and when they are refused."""


@dataclass(frozen=True, eq=False)
class RefusedDetection:
    """A detection without a pose, and the reason in words."""

    detection: Detection
    reason: str


@dataclass(frozen=True, eq=False)
class FrameEstimates:
    """What was found in one frame, best score first."""

    estimates: tuple[ObjectEstimate, ...]
    refusals: tuple[RefusedDetection, ...]


class Estimator:
    """A network with the geometry that turns its keypoints into poses."""

    def __init__(self, network: Network, config: EstimatorConfig | None = None) -> None:
        self.network = network
        self.config = config or EstimatorConfig()
        self._catalogue = network.metadata.catalogue()

    def estimate(self, frames: Sequence[Frame]) -> list[tuple[ObjectEstimate, ...]]:
        """The objects of each frame, best score first; `analyse` tells also what was refused."""
        return [found.estimates for found in self.analyse(frames)]

    def analyse(self, frames: Sequence[Frame]) -> list[FrameEstimates]:
        """The objects of each frame, and the detections that gave no pose with the reasons."""
        detections = self.network.detect([frame.image for frame in frames], self.config.decode)
        return [self.solve(found, frame.camera) for found, frame in zip(detections, frames, strict=True)]

    def solve(self, detections: Sequence[Detection], camera: Camera) -> FrameEstimates:
        """The geometric half of `analyse` for one frame: detections to poses."""
        estimates: list[ObjectEstimate] = []
        refusals: list[RefusedDetection] = []
        for expected in detections:
            found = replace(expected, keypoints=undo_shrinkage(expected.keypoints, expected.std))
            points = self._catalogue[found.obj_id].keypoints
            assert points is not None, "the metadata of a network has keypoints"
            answer = solve_pnp(found.keypoints, found.std, found.visibility, points, camera, self.config.pnp)
            if isinstance(answer, PnpRefusal):
                refusals.append(RefusedDetection(found, answer.reason))
                continue
            pose, covariance = answer.camera_from_object, answer.covariance
            estimates.append(ObjectEstimate(found.obj_id, found.score, pose, covariance, found))
        return FrameEstimates(tuple(estimates), tuple(refusals))
