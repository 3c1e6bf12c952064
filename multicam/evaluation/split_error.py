"""All errors of a split together: of poses, and of a network's own answers where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from multicam.dataset.bop_reader import ImageRecord
from multicam.dataset.objects import Catalogue
from multicam.dataset.results import Estimates
from multicam.errors import DataError
from multicam.evaluation.calibration import KeypointErrors, all_keypoint_errors
from multicam.evaluation.detection import ClassDetections, Detections, evaluate_detections
from multicam.evaluation.points import PointSets
from multicam.evaluation.selection import Selection
from multicam.evaluation.single_view import ObjectErrors, evaluate_estimates
from multicam.progress import Progress


@dataclass(frozen=True, eq=False)
class NetworkAnswers:
    """What a network said before poses were made of it.

    Attributes:
        detections: of all scores, by scene and image.
        objects: its classes, with its keypoints.
        least_score: from which a detection is believed.
    """

    detections: Detections
    objects: Catalogue
    least_score: float


@dataclass(frozen=True, eq=False)
class NetworkErrors:
    """Errors of boxes and keypoints by class."""

    detections: dict[int, ClassDetections]
    keypoints: dict[int, list[KeypointErrors]]
    least_score: float


@dataclass(frozen=True, eq=False)
class SplitErrors:
    """Errors by class of the objects selected.

    Attributes:
        pictures: how many were judged.
        poses: of estimates; network: of detections, or None where there are only estimates.
    """

    catalogue: Catalogue
    pictures: int
    selection: Selection
    poses: dict[int, list[ObjectErrors]]
    network: NetworkErrors | None


def evaluate_split(
    records: Sequence[ImageRecord],
    estimates: Estimates,
    answers: NetworkAnswers | None,
    points: PointSets,
    selection: Selection,
    progress: Progress,
) -> SplitErrors:
    """Judges estimates, and detections where given, against all objects of some images; figures are of those selected.

    Visible surfaces are compared if every image has its depth.

    Raises:
        DataError: images without truth, intrinsics or visible fractions that are asked for; nothing selected.
    """
    truths = [truth for record in records for truth in record.instances]
    if not truths:
        raise DataError("the images have no true poses: scene_gt.json is missing or empty in every scene.")
    selection.require_visibility(truths)
    if not any(selection.takes(truth) for truth in truths):
        raise DataError(f"none of the {len(truths)} objects in {len(records)} images is {selection.words()}.")
    surfaces = all(record.depth_path is not None for record in records)
    poses = evaluate_estimates(estimates, records, points, progress, surfaces)
    selected = {obj_id: [e for e in found if selection.takes(e.truth)] for obj_id, found in poses.items()}
    network = None if answers is None else _network_errors(records, answers, points, selection, progress)
    return SplitErrors(
        points.catalogue, len(records), selection, {i: found for i, found in selected.items() if found}, network
    )


def _network_errors(
    records: Sequence[ImageRecord],
    answers: NetworkAnswers,
    points: PointSets,
    selection: Selection,
    progress: Progress,
) -> NetworkErrors:
    detections = evaluate_detections(answers.detections, records, points, selection, progress)
    keypoints = {
        obj_id: all_keypoint_errors(
            (found for found in own.found if found.detection.score >= answers.least_score), answers.objects, points
        )
        for obj_id, own in detections.items()
    }
    return NetworkErrors(detections, keypoints, answers.least_score)
