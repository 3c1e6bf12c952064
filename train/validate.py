"""Held-out figures: detections, keypoints in pixels, and ADD(-S) through the runtime's own PnP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from models.detector import Decoded, Detector
from multicam.evaluation.pose_error import add, add_s
from multicam.geometry import se3
from multicam.geometry.boxes import overlap
from multicam.geometry.camera import Camera
from multicam.inference.decode import DecodeConfig, RawDetections, suppress
from multicam.inference.pnp import PnpConfig, PnpSolution, solve_pnp
from multicam.inference.shrinkage import undo_shrinkage
from multicam.progress import Progress
from multicam.types import FloatArray, ImageArray
from train.loader import ValidationSet
from train.samples import Labels, TrainedObject, project

_KEPT = 64
"""Best cells of each picture that are decoded."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Detections in one picture; arrays as in RawDetections, after suppression."""

    image: ImageArray
    labels: Labels
    found: RawDetections


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one labelled instance.

    Attributes:
        index: class; pixel_error: mean over keypoints, at the symmetry of the object for which that is least.
        pose_error: ADD or ADD-S over the diameter. Both are infinite where nothing was found.
    """

    index: int
    pixel_error: float
    pose_error: float


@torch.no_grad()
def predict(
    detector: Detector, dataset: ValidationSet, batch_size: int, progress: Progress, indices: Sequence[int]
) -> list[Prediction]:
    """Runs the network on pictures of the set and suppresses duplicates."""
    config, device = DecodeConfig(), next(detector.parameters()).device
    predictions: list[Prediction] = []
    starts = range(0, len(indices), batch_size)
    for start in progress.track(starts, "validating", total=len(starts)):
        samples = [dataset[i] for i in indices[start : start + batch_size]]
        images = torch.from_numpy(np.stack([image for image, _ in samples])).to(device)
        tensor = images.permute(0, 3, 1, 2).float().contiguous(memory_format=torch.channels_last)
        decoded = [t.cpu().numpy() for t in _best_cells(detector, tensor)]
        for row, (image, labels) in enumerate(samples):
            boxes, scores, classes, keypoints, visibility, std = (t[row] for t in decoded)
            rows = np.flatnonzero(scores >= config.score_threshold)
            rows = rows[suppress(boxes[rows].astype(np.float64), classes[rows], config.nms_iou)]
            found = RawDetections(
                boxes[rows], scores[rows], classes[rows], keypoints[rows], visibility[rows], std[rows]
            )
            predictions.append(Prediction(image, labels, found))
    return predictions


def _best_cells(detector: Detector, images: torch.Tensor) -> Decoded:
    raw = detector(images)
    return detector.decode(raw, min(_KEPT, len(raw.centres)))


def figures(predictions: Sequence[Prediction], objects: Sequence[TrainedObject]) -> dict[str, float]:
    """Validation figures by name, as TensorBoard shows them; `add/<object>` are per class."""
    outcomes = [outcome for prediction in predictions for outcome in _outcomes(prediction, objects)]
    matched = [o for o in outcomes if np.isfinite(o.pixel_error)]
    detections = sum(len(p.found.scores) for p in predictions)
    within = {known.index: [o.pose_error < 0.1 for o in outcomes if o.index == known.index] for known in objects}
    result = {
        "add_recall": _mean([o.pose_error < 0.1 for o in outcomes]),
        "recall": len(matched) / max(len(outcomes), 1),
        "precision": min(len(matched) / max(detections, 1), 1.0),
        "keypoint_px": float(np.median([o.pixel_error for o in matched])) if matched else 1e3,
    }
    names = {known.index: known.model.name for known in objects}
    return result | {f"add/{names[index]}": _mean(flags) for index, flags in within.items() if flags}


def is_better(new: dict[str, float], best: dict[str, float]) -> bool:
    """Whether figures beat the best so far: by pose recall, then by detections."""
    order = ("add_recall", "recall")
    return tuple(new[k] for k in order) >= tuple(best.get(k, -1.0) for k in order)


def _outcomes(prediction: Prediction, objects: Sequence[TrainedObject]) -> list[Outcome]:
    labels, found = prediction.labels, prediction.found
    height, width = prediction.image.shape[:2]
    outcomes: list[Outcome] = []
    for row in np.flatnonzero(~labels.ignored):
        known = objects[int(labels.classes[row])]
        best = _best_match(labels.boxes[row], known.index, found)
        if best is None:
            outcomes.append(Outcome(known.index, np.inf, np.inf))
            continue
        keypoints = found.keypoints[best].astype(np.float64)
        camera, pose = Camera(labels.cameras[row], width, height), labels.poses[row]
        outcomes.append(
            Outcome(
                known.index,
                _pixel_error(keypoints, camera, pose, known),
                _pose_error(found, best, keypoints, camera, pose, known),
            )
        )
    return outcomes


def _best_match(box: FloatArray, index: int, found: RawDetections) -> int | None:
    """The detection of the class that overlaps the box most, at least by half."""
    iou = np.where(found.labels == index, overlap(box[None], found.boxes.astype(np.float64))[0], 0)
    return int(iou.argmax()) if iou.size and iou.max() >= 0.5 else None


def _pixel_error(keypoints: FloatArray, camera: Camera, pose: FloatArray, known: TrainedObject) -> float:
    poses = pose @ known.model.symmetries.transforms()
    true = project(camera.matrix, se3.act(poses, known.keypoints))
    return float(np.linalg.norm(true - keypoints, axis=-1).mean(axis=-1).min())


def _pose_error(
    found: RawDetections, best: int, keypoints: FloatArray, camera: Camera, pose: FloatArray, known: TrainedObject
) -> float:
    std, visibility = found.std[best].astype(np.float64), found.visibility[best].astype(np.float64)
    solution = solve_pnp(undo_shrinkage(keypoints, std), std, visibility, known.keypoints, camera, PnpConfig())
    if not isinstance(solution, PnpSolution):
        return float("inf")
    distance = add_s if known.model.symmetries else add
    return distance(solution.camera_from_object, pose, known.surface) / known.model.diameter


def _mean(flags: Sequence[bool]) -> float:
    return float(np.mean(flags)) if flags else 0.0
