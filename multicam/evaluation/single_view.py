"""Errors of single-view estimates, as a results file holds them, against a BOP split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multicam.dataset.bop_reader import ImageRecord, list_scenes, read_image, read_scene
from multicam.dataset.objects import Catalogue
from multicam.dataset.results import Estimates
from multicam.errors import DataError
from multicam.evaluation import pose_error
from multicam.evaluation.assignment import assign_greedily
from multicam.evaluation.points import PointSets
from multicam.evaluation.recall import BOP_PIXELS, BOP_SHARES, auc_posecnn, average_recall, median, recall
from multicam.evaluation.report import Cell, Column, Table, mean_cell
from multicam.geometry.camera import Camera
from multicam.progress import Progress
from multicam.types import ObjectEstimate

LEAST_VISIBLE = 0.1
"""Objects of which less than this fraction is seen are not asked for (BOP)."""

BOP_WIDTH = 640
"""Image width to which pixel errors are scaled."""


@dataclass(frozen=True)
class ObjectErrors:
    """Errors of one true object and its estimate; infinite where there is none.

    Attributes:
        add: ADD(-S), metres.
        mssd: metres.
        mspd: pixels of an image 640 wide.
    """

    add: float = float("inf")
    mssd: float = float("inf")
    mspd: float = float("inf")


def read_split(split: Path, estimates: Estimates) -> list[ImageRecord]:
    """The images of a split, in order of scene and image.

    Raises:
        DataError: the split is missing or malformed, or lacks an image that the estimates name.
    """
    records = {(r.scene_id, r.im_id): r for scene in list_scenes(split) for r in read_scene(scene)}
    unknown = sorted(set(estimates) - set(records))
    if unknown:
        raise DataError(f"the estimates name scene {unknown[0][0]}, image {unknown[0][1]}, which {split} lacks.")
    return [record for _, record in sorted(records.items())]


def evaluate_estimates(
    estimates: Estimates, records: Sequence[ImageRecord], catalogue: Catalogue, progress: Progress
) -> dict[int, list[ObjectErrors]]:
    """Errors by class over some images; estimates for other images are ignored.

    Raises:
        DataError: classes that the catalogue lacks; images without truth or intrinsics.
    """
    points = PointSets(catalogue)
    symmetries = {obj_id: catalogue[obj_id].symmetries.transforms() for obj_id in catalogue.obj_ids}
    errors: dict[int, list[ObjectErrors]] = {}
    for record in progress.track(records, "evaluating", len(records)):
        found = estimates.get((record.scene_id, record.im_id), [])
        for obj_id, rows in _image_errors(record, found, points, symmetries).items():
            errors.setdefault(obj_id, []).extend(rows)
    return dict(sorted(errors.items()))


def single_view_table(errors: Mapping[int, Sequence[ObjectErrors]], catalogue: Catalogue) -> Table:
    """One row per class and a mean over classes."""
    rows: list[tuple[Cell, ...]] = []
    for obj_id, found in errors.items():
        model = catalogue[obj_id]
        adds, shares, pixels = ([getattr(e, name) for e in found] for name in ("add", "mssd", "mspd"))
        rows.append(
            (
                model.name,
                len(found),
                100 * float(np.mean(np.isfinite(adds))),
                100 * recall(adds, 0.1 * model.diameter),
                100 * auc_posecnn(adds),
                100 * average_recall(np.array(shares) / model.diameter, BOP_SHARES),
                100 * average_recall(pixels, BOP_PIXELS),
                1000 * median(adds),
            )
        )
    if rows:
        means = [mean_cell(row[i] for row in rows) for i in range(2, 7)]
        rows.append(("mean of classes", sum(len(found) for found in errors.values()), *means, None))
    names = ("object", "asked", "found %", "within 0.1 d %", "AUC %", "AR MSSD %", "AR MSPD %", "median mm")
    columns = tuple(Column(name, 0 if i < 3 else 1) for i, name in enumerate(names))
    note = (
        "ADD, or ADD-S for symmetric objects; a missing estimate is an infinite error. Objects less than 10 % visible "
        "are not asked for. AUC: up to 100 mm, as in PoseCNN. AR: BOP's thresholds."
    )
    return Table("Single-view object errors", columns, tuple(rows), note)


def _image_errors(
    record: ImageRecord,
    estimates: Sequence[ObjectEstimate],
    points: PointSets,
    symmetries: Mapping[int, np.ndarray],
) -> dict[int, list[ObjectErrors]]:
    asked = [i for i in record.instances if i.visible_fraction is None or i.visible_fraction >= LEAST_VISIBLE]
    if not asked:
        return {}
    camera = _camera(record)
    errors: dict[int, list[ObjectErrors]] = {}
    for obj_id in sorted({instance.obj_id for instance in asked}):
        truths = [i.camera_from_object for i in asked if i.obj_id == obj_id]
        ranked = sorted((e for e in estimates if e.obj_id == obj_id), key=lambda e: -e.score)
        found = [e.camera_from_object for e in ranked]

        def distance(estimated: np.ndarray, true: np.ndarray, obj_id: int = obj_id) -> float:
            return pose_error.mssd(estimated, true, symmetries[obj_id], points[obj_id])

        answers = assign_greedily(found, truths, distance)
        for answer, true in zip(answers, truths, strict=True):
            row = ObjectErrors()
            if answer is not None:
                pose = found[answer[0]]
                pixels = pose_error.mspd(pose, true, symmetries[obj_id], points[obj_id], camera)
                add = points.add_or_add_s(obj_id, pose, true)
                row = ObjectErrors(add, answer[1], pixels * BOP_WIDTH / camera.width)
            errors.setdefault(obj_id, []).append(row)
    return errors


def _camera(record: ImageRecord) -> Camera:
    if record.camera_matrix is None or record.rgb_path is None:
        raise DataError(f"scene {record.scene_id}, image {record.im_id} lacks its picture or its cam_K.")
    height, width = read_image(record.rgb_path).shape[:2]
    return Camera(record.camera_matrix, width, height)
