"""Outputs of the network to detections in pixels of the original image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multicam.errors import ModelError
from multicam.geometry.boxes import overlap
from multicam.image import Letterbox
from multicam.types import Detection, FloatArray


@dataclass(frozen=True)
class DecodeConfig:
    """Which outputs of the network count as detections."""

    score_threshold: float = 0.3
    """Least score."""
    nms_iou: float = 0.65
    """Boxes of one class that overlap more than this are one object; the best score stays."""
    max_per_class: int | None = None
    """Most instances of one class in an image, where that is known; the best scores stay."""


@dataclass(frozen=True, eq=False)
class RawDetections:
    """Outputs for one image, best score first; pixels of the network's input.

    Attributes:
        boxes: (N, 4); scores: (N,); labels: (N,) indices of classes.
        keypoints: (N, K, 2); visibility: (N, K); std: (N, K, 2).
    """

    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    labels: NDArray[np.int64]
    keypoints: NDArray[np.float32]
    visibility: NDArray[np.float32]
    std: NDArray[np.float32]


def decode(raw: RawDetections, letterbox: Letterbox, obj_ids: Sequence[int], config: DecodeConfig) -> list[Detection]:
    """Chooses the detections of one image and leads them back to its own pixels; best score first.

    Raises:
        ModelError: a label beyond the classes of the metadata.
    """
    rows = np.flatnonzero(raw.scores >= config.score_threshold)
    labels, boxes = raw.labels[rows], raw.boxes[rows].astype(np.float64)
    if np.any((labels < 0) | (labels >= len(obj_ids))):
        raise ModelError(
            f"the network answers with class index {labels.max()} but its metadata names {len(obj_ids)} classes; "
            "export it again."
        )
    kept = suppress(boxes, labels, config.nms_iou, config.max_per_class)
    rows = rows[kept]
    corners = letterbox.to_source(boxes[kept].reshape(-1, 2, 2)).reshape(-1, 4)
    keypoints = letterbox.to_source(raw.keypoints[rows].astype(np.float64))
    std = raw.std[rows].astype(np.float64) / letterbox.scale
    visibility = raw.visibility[rows].astype(np.float64)
    return [
        Detection(
            obj_ids[int(raw.labels[row])], float(raw.scores[row]), corners[i], keypoints[i], visibility[i], std[i]
        )
        for i, row in enumerate(rows)
    ]


def suppress(
    boxes: FloatArray, labels: NDArray[np.int64], iou: float, max_per_class: int | None = None
) -> NDArray[np.intp]:
    """Greedy non-maximum suppression within each class.

    Args:
        boxes: (n, 4) x0 y0 x1 y1, best score first; labels: (n,).

    Returns:
        Indices that stay, in order.
    """
    rivals = (labels[:, None] == labels) & (overlap(boxes, boxes) > iou)
    alive = np.ones(len(boxes), dtype=np.bool_)
    counts: dict[int, int] = {}
    for i in range(len(boxes)):
        if not alive[i]:
            continue
        label = int(labels[i])
        counts[label] = counts.get(label, 0) + 1
        if max_per_class is not None and counts[label] > max_per_class:
            alive[i] = False
            continue
        alive[i + 1 :] &= ~rivals[i, i + 1 :]
    return np.flatnonzero(alive)
