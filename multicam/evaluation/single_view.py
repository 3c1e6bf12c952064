"""Errors of single-view estimates, as a results file holds them, against a BOP split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from multicam.dataset.bop_reader import ImageRecord, Instance, list_scenes, read_depth, read_image, read_scene
from multicam.dataset.results import Estimates
from multicam.errors import DataError
from multicam.evaluation import pose_error
from multicam.evaluation.assignment import assign_greedily, found_share
from multicam.evaluation.points import PointSets
from multicam.evaluation.recall import BOP_PIXELS, BOP_SHARES
from multicam.evaluation.selection import ASKED
from multicam.evaluation.surface import TAUS, distances, drawn_distances, vsd
from multicam.geometry.camera import Camera
from multicam.progress import Progress
from multicam.types import FloatArray, ObjectEstimate

BOP_WIDTH = 640
"""Image width to which pixel errors are scaled."""


@dataclass(frozen=True, eq=False)
class ObjectErrors:
    """Errors of one true object and its estimate; infinite where there is none.

    Attributes:
        record: the image; truth: the object in it; estimate: what answers for it, or None.
        add, add_s, add_or_add_s, mssd: metres.
        mspd: pixels of an image 640 wide.
        mssd_share, mspd_share: share of BOP's thresholds at which the object counts as found.
        vsd_share: the same over all tolerances and thresholds; None where there was no depth image.
    """

    record: ImageRecord
    truth: Instance
    estimate: ObjectEstimate | None = None
    add: float = float("inf")
    add_s: float = float("inf")
    add_or_add_s: float = float("inf")
    mssd: float = float("inf")
    mspd: float = float("inf")
    mssd_share: float = 0.0
    mspd_share: float = 0.0
    vsd_share: float | None = None


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
    estimates: Estimates, records: Sequence[ImageRecord], points: PointSets, progress: Progress, surfaces: bool = False
) -> dict[int, list[ObjectErrors]]:
    """Errors by class over some images; estimates for other images are ignored.

    Args:
        surfaces: compare visible surfaces too (VSD); every image must then have its depth.

    Raises:
        DataError: classes that the catalogue lacks; images without truth, intrinsics or, if asked for, depth.
    """
    errors: dict[int, list[ObjectErrors]] = {}
    for record in progress.track(records, "evaluating", len(records)):
        found = estimates.get((record.scene_id, record.im_id), [])
        for row in _image_errors(record, found, points, surfaces):
            errors.setdefault(row.truth.obj_id, []).append(row)
    return dict(sorted(errors.items()))


def camera_of(record: ImageRecord) -> Camera:
    """Intrinsics of an image; its size is read from the picture.

    Raises:
        DataError: the image lacks its picture or its cam_K.
    """
    if record.camera_matrix is None or record.rgb_path is None:
        raise DataError(f"scene {record.scene_id}, image {record.im_id} lacks its picture or its cam_K.")
    height, width = read_image(record.rgb_path).shape[:2]
    return Camera(record.camera_matrix, width, height)


def by_score(estimates: Sequence[ObjectEstimate]) -> list[ObjectEstimate]:
    """Best score first; equal scores in an order that does not depend on the file's."""
    return sorted(estimates, key=lambda e: (-e.score, e.camera_from_object.tolist()))


def _image_errors(
    record: ImageRecord, estimates: Sequence[ObjectEstimate], points: PointSets, surfaces: bool
) -> list[ObjectErrors]:
    truths = [i for i in record.instances if ASKED.takes(i)]
    if not truths:
        return []
    camera = camera_of(record)
    scene = _scene_distances(record, camera) if surfaces else None
    rows: list[ObjectErrors] = []
    for obj_id in sorted({instance.obj_id for instance in truths}):
        wanted = [i for i in truths if i.obj_id == obj_id]
        found = by_score([e for e in estimates if e.obj_id == obj_id])[: len(wanted)]
        rows += _class_errors(record, wanted, found, points, camera, scene)
    return rows


def _scene_distances(record: ImageRecord, camera: Camera) -> FloatArray:
    if record.depth_path is None:
        raise DataError(f"scene {record.scene_id}, image {record.im_id} has no depth image.")
    depth = read_depth(record.depth_path, record.depth_scale)
    if depth.shape != (camera.height, camera.width):
        raise DataError(
            f"{record.depth_path} is {depth.shape[1]} x {depth.shape[0]} pixels but its picture "
            f"{camera.width} x {camera.height}; they must show the same."
        )
    return distances(depth, camera)


def _class_errors(
    record: ImageRecord,
    truths: Sequence[Instance],
    found: Sequence[ObjectEstimate],
    points: PointSets,
    camera: Camera,
    scene: FloatArray | None,
) -> list[ObjectErrors]:
    """Errors of the objects of one class in one image; `found` holds the best-scored estimates, best first."""
    obj_id = truths[0].obj_id
    model, symmetries, vertices = points.catalogue[obj_id], points.symmetries(obj_id), points[obj_id]
    shape = len(found), len(truths)
    mssd, mspd = np.zeros(shape), np.zeros(shape)
    for (i, j), _ in np.ndenumerate(mssd):
        pair = found[i].camera_from_object, truths[j].camera_from_object, symmetries, vertices
        mssd[i, j], mspd[i, j] = pose_error.mssd(*pair), pose_error.mspd(*pair, camera)
    mspd *= BOP_WIDTH / camera.width
    mssd_share, mspd_share = found_share(mssd / model.diameter, BOP_SHARES), found_share(mspd, BOP_PIXELS)
    vsd_share = None if scene is None else _vsd_shares(truths, found, points, camera, scene)
    rows: list[ObjectErrors] = []
    answers = assign_greedily(range(shape[0]), range(shape[1]), lambda i, j: float(mssd[i, j]))
    for j, (answer, truth) in enumerate(zip(answers, truths, strict=True)):
        row = ObjectErrors(
            record,
            truth,
            mssd_share=float(mssd_share[j]),
            mspd_share=float(mspd_share[j]),
            vsd_share=None if vsd_share is None else float(vsd_share[j]),
        )
        if answer is not None:
            estimate = found[answer[0]]
            poses = estimate.camera_from_object, truth.camera_from_object
            add, add_s = points.add(obj_id, *poses), points.add_s(obj_id, *poses)
            either = add_s if model.symmetries else add
            pixels = float(mspd[answer[0], j])
            row = replace(
                row, estimate=estimate, add=add, add_s=add_s, add_or_add_s=either, mssd=answer[1], mspd=pixels
            )
        rows.append(row)
    return rows


def _vsd_shares(
    truths: Sequence[Instance],
    found: Sequence[ObjectEstimate],
    points: PointSets,
    camera: Camera,
    scene: FloatArray,
) -> FloatArray:
    obj_id = truths[0].obj_id
    mesh, diameter = points.mesh(obj_id), points.catalogue[obj_id].diameter
    drawn = [drawn_distances(mesh, camera, truth.camera_from_object) for truth in truths]
    errors = np.zeros((len(found), len(truths), len(TAUS)))
    for i, estimate in enumerate(found):
        own = drawn_distances(mesh, camera, estimate.camera_from_object)
        for j, true in enumerate(drawn):
            errors[i, j] = vsd(own, true, scene, diameter)
    return np.mean([found_share(errors[:, :, tau], BOP_SHARES) for tau in range(len(TAUS))], axis=0)
