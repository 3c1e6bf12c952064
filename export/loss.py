"""What a smaller file loses against the single-precision one: on pictures, and against their truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from export.config import LossLimits
from export.pictures import Picture
from multicam.dataset.objects import Catalogue
from multicam.errors import ModelError
from multicam.evaluation.calibration import all_keypoint_errors
from multicam.evaluation.detection import evaluate_detections, match_boxes
from multicam.evaluation.points import PointSets
from multicam.evaluation.selection import Selection
from multicam.geometry.boxes import overlap
from multicam.inference.session import Network
from multicam.progress import Progress, SilentProgress
from multicam.types import Detection

_SAME_OVERLAP = 0.5
"""Boxes of one class that overlap by this are the same detection."""

Pair = tuple[Detection, Detection]


@dataclass(frozen=True)
class Change:
    """Size of a change: of the middle one, and of the one that 95 % do not exceed."""

    median: float
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Change:
        """The change of many values; NaN of none."""
        return cls(*np.percentile(values, (50, 95)).tolist()) if values else cls(np.nan, np.nan)


@dataclass(frozen=True)
class Truth:
    """How well a file finds what is in the pictures.

    Attributes:
        recall: share of the objects whose box is found, by half of it and in its class.
        keypoint_px: median over those of the mean error of their keypoints, at the best symmetry; pixels.
    """

    recall: float
    keypoint_px: float


@dataclass(frozen=True)
class Loss:
    """The detections of a smaller file beside those of the single-precision one; pixels of the pictures.

    Attributes:
        pictures, detections: how many were compared; detections of the single-precision file.
        same: share of those that are found again. new: share of the smaller file's that the other lacks.
        box_px, keypoint_px, score: changes of what both find; the greatest of a box's sides, and of each keypoint.
        truth: of the single-precision file and of the smaller one, or None where no truth is known.
    """

    pictures: int
    detections: int
    same: float
    new: float
    box_px: Change
    keypoint_px: Change
    score: Change
    truth: tuple[Truth, Truth] | None

    def lines(self) -> list[str]:
        """The figures in words."""
        lines = [
            f"against fp32 on {self.pictures} pictures: of {self.detections} detections {100 * self.same:.1f} % stay, "
            f"{100 * self.new:.1f} % of its own are new",
            f"what both find moves by (median, 95 %): boxes {self.box_px.median:.2f}, {self.box_px.most:.2f} px, "
            f"keypoints {self.keypoint_px.median:.2f}, {self.keypoint_px.most:.2f} px, "
            f"scores {self.score.median:.4f}, {self.score.most:.4f}",
        ]
        if self.truth:
            before, after = self.truth
            lines.append(
                f"against the truth: recall {100 * before.recall:.1f} -> {100 * after.recall:.1f} %, "
                f"keypoints {before.keypoint_px:.2f} -> {after.keypoint_px:.2f} px off (median)"
            )
        return lines

    def require(self, limits: LossLimits) -> None:
        """Accepts the loss.

        Raises:
            ModelError: it exceeds a limit, or nothing was detected that could tell.
        """
        if self.detections == 0:
            raise ModelError(
                f"the fp32 network finds nothing in {self.pictures} pictures, so nothing tells what is lost; give "
                "pictures of its objects. No file was written."
            )
        lost = self.truth[0].recall - self.truth[1].recall if self.truth else 0.0
        checks = (
            (self.same >= limits.least_same, f"{100 * self.same:.1f} % of the detections stay", "least_same"),
            (
                self.keypoint_px.median <= limits.most_keypoint_px,
                f"keypoints move by {self.keypoint_px.median:.2f} px in the median",
                "most_keypoint_px",
            ),
            (lost <= limits.most_recall, f"recall falls by {100 * lost:.1f} %", "most_recall"),
        )
        for passed, figure, name in checks:
            if not passed:
                raise ModelError(
                    f"too much is lost against fp32: {figure}, and loss.{name} is {getattr(limits, name):g}; "
                    "no file was written."
                )


def measure_loss(single: Network, smaller: Network, pictures: Sequence[Picture], progress: Progress) -> Loss:
    """Runs both files on pictures and compares what they find."""
    before: list[list[Detection]] = []
    after: list[list[Detection]] = []
    for picture in progress.track(pictures, "comparing with fp32", len(pictures)):
        before += single.detect([picture.image])
        after += smaller.detect([picture.image])
    pairs = [pair for one, other in zip(before, after, strict=True) for pair in _pairs(one, other)]
    catalogue = single.metadata.catalogue()
    truths = [_judge(found, pictures, catalogue) for found in (before, after)]
    detections, others = sum(map(len, before)), sum(map(len, after))
    return Loss(
        pictures=len(pictures),
        detections=detections,
        same=len(pairs) / max(detections, 1),
        new=1 - len(pairs) / max(others, 1),
        box_px=Change.of([float(np.abs(a.box - b.box).max()) for a, b in pairs]),
        keypoint_px=Change.of([d for a, b in pairs for d in np.linalg.norm(a.keypoints - b.keypoints, axis=1)]),
        score=Change.of([abs(a.score - b.score) for a, b in pairs]),
        truth=(truths[0], truths[1]) if truths[0] and truths[1] else None,
    )


def _pairs(before: Sequence[Detection], after: Sequence[Detection]) -> list[Pair]:
    """Detections of one picture that are the same in both files."""
    boxes = [np.array([d.box for d in found]).reshape(-1, 4) for found in (before, after)]
    kinds = [np.array([d.obj_id for d in found]) for found in (before, after)]
    overlaps = np.where(kinds[0][:, None] == kinds[1], overlap(*boxes), 0)
    taken = match_boxes(overlaps, np.zeros(len(after), dtype=np.bool_), _SAME_OVERLAP)
    return [(one, after[index]) for one, index in zip(before, taken, strict=True) if index is not None]


def _judge(found: Sequence[Sequence[Detection]], pictures: Sequence[Picture], catalogue: Catalogue) -> Truth | None:
    """Figures against the truth as `multicam evaluate` has them, or None without true objects."""
    records = [picture.record for picture in pictures if picture.record is not None and picture.record.instances]
    known = {(p.record.scene_id, p.record.im_id): d for p, d in zip(pictures, found, strict=True) if p.record}
    points = PointSets(catalogue)
    judged = evaluate_detections(known, records, points, Selection(), SilentProgress())
    wanted = sum(own.wanted for own in judged.values())
    if not wanted:
        return None
    matched = [one for own in judged.values() for one in own.found]
    errors = [float(e.pixels.mean()) for e in all_keypoint_errors(matched, catalogue, points)]
    return Truth(len(matched) / wanted, float(np.median(errors)) if errors else np.nan)
