"""Boxes found by the network against true ones, as COCO judges them; which detection answers for which object.

Boxes are amodal: the label's `bbox_obj`, or around the projected mesh where a data set states none. Objects outside the
selection (BOP: less than 10 % visible) are ignored: finding them is neither right nor wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from multicam.dataset.bop_reader import ImageRecord, Instance
from multicam.evaluation.points import PointSets
from multicam.evaluation.selection import Selection
from multicam.evaluation.single_view import camera_of
from multicam.geometry import se3
from multicam.geometry.boxes import overlap
from multicam.geometry.camera import Camera
from multicam.progress import Progress
from multicam.types import Detection, FloatArray

IOUS = tuple(0.5 + 0.05 * np.arange(10))
"""COCO's thresholds of overlap: 0.50 to 0.95."""

MOST_DETECTIONS = 100
"""Detections of one class in one image that count (COCO)."""

Detections = Mapping[tuple[int, int], Sequence[Detection]]
"""(scene_id, im_id) to what the network found there."""


@dataclass(frozen=True, eq=False)
class FoundObject:
    """A detection whose box overlaps that of its object by half or more."""

    camera: Camera
    truth: Instance
    detection: Detection


@dataclass(eq=False)
class ClassDetections:
    """Detections of one class over all images.

    Attributes:
        wanted: number of true objects.
        scores: of each detection; correct, ignored: whether it is, at each of IOUS.
        found: the pairs at an overlap of one half.
    """

    wanted: int = 0
    scores: list[float] = field(default_factory=list[float])
    correct: list[NDArray[np.bool_]] = field(default_factory=list[NDArray[np.bool_]])
    ignored: list[NDArray[np.bool_]] = field(default_factory=list[NDArray[np.bool_]])
    found: list[FoundObject] = field(default_factory=list[FoundObject])


def evaluate_detections(
    detections: Detections,
    records: Sequence[ImageRecord],
    points: PointSets,
    selection: Selection,
    progress: Progress,
) -> dict[int, ClassDetections]:
    """Judges boxes by class; classes of which nothing is asked have no figure and are left out.

    Raises:
        DataError: an image lacks its picture or its cam_K, or an object its mesh.
    """
    classes: dict[int, ClassDetections] = {}
    for record in progress.track(records, "matching boxes", len(records)):
        camera = camera_of(record)
        found = detections.get((record.scene_id, record.im_id), ())
        for obj_id in {i.obj_id for i in record.instances} | {d.obj_id for d in found}:
            truths = [i for i in record.instances if i.obj_id == obj_id]
            own = sorted((d for d in found if d.obj_id == obj_id), key=lambda d: -d.score)[:MOST_DETECTIONS]
            _add(classes.setdefault(obj_id, ClassDetections()), camera, truths, own, points, selection)
    return {obj_id: classes[obj_id] for obj_id in sorted(classes) if classes[obj_id].wanted}


def match_boxes(overlaps: FloatArray, ignored: NDArray[np.bool_], least: float) -> list[int | None]:
    """For each detection (rows, best score first) the true box it takes, or None; COCO's rule.

    It is the one it overlaps most among those still free, by `least` or more; an ignored one only if there is no other.
    """
    free = np.ones(len(ignored), dtype=np.bool_)
    answers: list[int | None] = []
    for row in overlaps:
        fitting = free & (row >= least)
        candidates = np.flatnonzero(fitting & ~ignored) if np.any(fitting & ~ignored) else np.flatnonzero(fitting)
        best = int(candidates[np.argmax(row[candidates])]) if len(candidates) else None
        if best is not None:
            free[best] = False
        answers.append(best)
    return answers


def average_precision(
    scores: Sequence[float], correct: NDArray[np.bool_], ignored: NDArray[np.bool_], wanted: int
) -> float:
    """Mean over 101 recalls of the best precision reached at that recall or a higher one (COCO).

    Args:
        scores, correct, ignored: of each detection; wanted: true objects.
    """
    order = np.argsort(-np.asarray(scores), kind="stable")
    order = order[~ignored[order]]
    hits = np.cumsum(correct[order])
    precision = np.maximum.accumulate((hits / np.arange(1, len(order) + 1))[::-1])[::-1]
    places = np.searchsorted(hits / wanted, np.linspace(0, 1, 101), side="left")
    return float(np.mean(np.append(precision, 0.0)[places]))


def amodal_box(truth: Instance, camera: Camera, points: PointSets) -> FloatArray:
    """(4,) box of the whole object, hidden parts and parts outside the image included."""
    if truth.box is not None:
        return truth.box
    placed = se3.act(truth.camera_from_object, points[truth.obj_id])
    pixels = camera.project(placed[placed[:, 2] > 0])
    return np.concatenate((pixels.min(axis=0), pixels.max(axis=0)))


def _add(
    result: ClassDetections,
    camera: Camera,
    truths: Sequence[Instance],
    found: Sequence[Detection],
    points: PointSets,
    selection: Selection,
) -> None:
    boxes = np.array([amodal_box(truth, camera, points) for truth in truths]).reshape(-1, 4)
    overlaps = overlap(np.array([d.box for d in found]).reshape(-1, 4), boxes)
    left_out = np.array([not selection.takes(truth) for truth in truths], dtype=np.bool_)
    result.wanted += int(np.count_nonzero(~left_out))
    answers = [match_boxes(overlaps, left_out, least) for least in IOUS]
    for index, detection in enumerate(found):
        taken = [answer[index] for answer in answers]
        skipped = np.array([i is not None and bool(left_out[i]) for i in taken])
        result.scores.append(detection.score)
        result.correct.append(np.array([i is not None for i in taken]) & ~skipped)
        result.ignored.append(skipped)
        if taken[0] is not None and not skipped[0]:
            result.found.append(FoundObject(camera, truths[taken[0]], detection))
