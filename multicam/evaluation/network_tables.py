"""What only a network's own answers tell, as tables: boxes, keypoints, stated uncertainties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import erf

from multicam.dataset.objects import Catalogue
from multicam.evaluation.calibration import KeypointErrors, keypoint_shares, pose_shares, with_covariance
from multicam.evaluation.detection import IOUS, ClassDetections, average_precision
from multicam.evaluation.report import Cell, Column, Table, mean_cell
from multicam.evaluation.single_view import ObjectErrors
from multicam.evaluation.single_view_tables import MEAN
from multicam.types import FloatArray

SIGMAS: FloatArray = np.array([erf(sigmas / np.sqrt(2)) for sigmas in (1, 2, 3)])
"""Shares of a normal variable within one, two and three standard deviations."""

NEAR = 0.5
"""Share of the diameter, BOP's widest threshold, within which a pose is surely meant for its object."""

_ELLIPSOIDS: FloatArray = np.array([0.5, 0.95])


def detection_table(classes: Mapping[int, ClassDetections], catalogue: Catalogue, least_score: float) -> Table:
    """Average precision per class, and recall and precision at the score from which the network is believed."""
    rows = [(catalogue[obj_id].name, *_detection_cells(own, least_score)) for obj_id, own in classes.items()]
    note = (
        "COCO's AP over all scores: mean over overlaps (IoU) of 0.50 to 0.95, and at 0.50 and 0.75. Recall and "
        f"precision at IoU 0.50, of detections scored {least_score:g} or more. Boxes are amodal."
    )
    names = ("object", "wanted", "AP %", "AP50 %", "AP75 %", "recall %", "precision %")
    return _with_mean("Detection", names, rows, note)


def keypoint_table(errors: Mapping[int, Sequence[KeypointErrors]], catalogue: Catalogue) -> Table:
    """Keypoint errors in pixels and how they compare with the standard deviations stated, per class."""
    rows = [(catalogue[obj_id].name, *_keypoint_cells(own)) for obj_id, own in errors.items() if own]
    note = (
        "Of detected objects (IoU 0.50), hidden keypoints included, at the best symmetry; pixels of the picture. "
        "Inside: share of coordinates within 1, 2, 3 of the standard deviations stated; honest ones give 68.3, 95.4, "
        "99.7 %."
    )
    names = ("object", "detected", "median px", "mean px", "p90 px", "stated px", "inside 1 %", "inside 2 %")
    return _with_mean("Keypoints", (*names, "inside 3 %"), rows, note)


def pose_calibration_table(errors: Mapping[int, Sequence[ObjectErrors]], catalogue: Catalogue) -> Table:
    """How many poses have their truth in the ellipsoid they state, per class."""
    rows: list[tuple[Cell, ...]] = []
    for obj_id, found in errors.items():
        stated = with_covariance(found)
        if stated:
            near = [e for e in stated if e.mssd < NEAR * catalogue[obj_id].diameter]
            every, those = (_percents(pose_shares(some, catalogue, _ELLIPSOIDS)) for some in (stated, near))
            rows.append((catalogue[obj_id].name, len(stated), *every, 100 * len(near) / len(stated), *those))
    names = ("object", "poses", "inside 50 %", "inside 95 %", "near %", "near inside 50 %", "near inside 95 %")
    note = (
        "Share of poses whose truth lies in the ellipsoid that should hold 50 or 95 % of them (6 degrees of freedom): "
        f"of all, and of those near the truth (MSSD below {NEAR:g} of the diameter), surely meant for it."
    )
    return _with_mean("Pose uncertainty", names, rows, note)


def _with_mean(title: str, names: Sequence[str], rows: Sequence[tuple[Cell, ...]], note: str) -> Table:
    """The second column counts, and the last row is the mean of the others."""
    columns = tuple(Column(name, 0 if i < 2 else 1) for i, name in enumerate(names))
    if rows:
        count = sum(int(row[1] or 0) for row in rows)
        rows = [*rows, (MEAN, count, *(mean_cell(row[i] for row in rows) for i in range(2, len(names))))]
    return Table(title, columns, tuple(rows), note)


def _detection_cells(own: ClassDetections, least_score: float) -> tuple[Cell, ...]:
    correct = np.array(own.correct, dtype=np.bool_).reshape(-1, len(IOUS))
    ignored = np.array(own.ignored, dtype=np.bool_).reshape(-1, len(IOUS))
    precisions = [
        100 * average_precision(own.scores, correct[:, i], ignored[:, i], own.wanted) for i in range(len(IOUS))
    ]
    believed = (np.array(own.scores) >= least_score) & ~ignored[:, 0]
    hits = int(np.count_nonzero(correct[:, 0] & believed))
    precision = 100 * hits / np.count_nonzero(believed) if believed.any() else None
    recall = 100 * hits / own.wanted
    return own.wanted, float(np.mean(precisions)), precisions[0], precisions[5], recall, precision


def _keypoint_cells(errors: Sequence[KeypointErrors]) -> tuple[Cell, ...]:
    pixels = np.concatenate([e.pixels for e in errors])
    stated = float(np.median(np.concatenate([e.std.ravel() for e in errors])))
    figures = float(np.median(pixels)), float(pixels.mean()), float(np.percentile(pixels, 90)), stated
    return len(errors), *figures, *(100 * keypoint_shares(errors, SIGMAS)).tolist()


def _percents(shares: FloatArray) -> list[float | None]:
    return [100 * float(share) if np.isfinite(share) else None for share in shares]
