"""BOP records in memory, and the labels of a warped picture: boxes, keypoints, visibility, rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multicam.dataset.bop_reader import ImageRecord, list_scenes, read_depth, read_image, read_mask, read_scene
from multicam.dataset.objects import Catalogue, ObjectModel
from multicam.errors import DataError
from multicam.geometry import se3
from multicam.progress import Progress
from multicam.types import FloatArray, ImageArray
from train.symmetry import CanonicalView, canonical_view, invariant_centre

_OUTLINE_DIRECTIONS = 256
_SURFACE_SAMPLES = 500
_DEPTH_TOLERANCE = 0.004
"""Metres by which the depth image may lie in front of a keypoint that still counts as seen."""


@dataclass(frozen=True)
class Region:
    """A rectangle of whole pixels: columns left to right - 1, rows top to bottom - 1."""

    left: int
    top: int
    right: int
    bottom: int

    def contains(self, pixels: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether pixels (..., 2) lie inside."""
        x, y = pixels[..., 0] + 0.5, pixels[..., 1] + 0.5
        return (x >= self.left) & (y >= self.top) & (x < self.right) & (y < self.bottom)

    def share(self, boxes: FloatArray) -> FloatArray:
        """Share (G,) of the area of boxes (G, 4) that lies inside."""
        low = np.maximum(boxes[:, :2], np.array([self.left, self.top]) - 0.5)
        high = np.minimum(boxes[:, 2:], np.array([self.right, self.bottom]) - 0.5)
        whole = np.maximum(boxes[:, 2:] - boxes[:, :2], 1e-6)
        return (np.maximum(high - low, 0) / whole).prod(axis=1)


@dataclass(frozen=True, eq=False)
class Picture:
    """Pixels of one record.

    Attributes:
        image: (h, w, 3).
        depth: (h, w) metres, or None.
        instances: (h, w) which instance of the record a pixel shows, counted from 1, 0 for none; None if not asked for.
    """

    record: ImageRecord
    image: ImageArray
    depth: NDArray[np.float32] | None
    instances: NDArray[np.uint8] | None = None

    @cached_property
    def shown(self) -> NDArray[np.bool_]:
        """(256,) which numbers `instances` holds."""
        assert self.instances is not None
        return np.bincount(self.instances.ravel(), minlength=256) > 0


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of G instances in a picture of the network's input size; pixels of that picture.

    Attributes:
        classes: (G,) class index.
        boxes: (G, 4) amodal x0 y0 x1 y1.
        keypoints: (G, K, 2) projections, of the canonical pose.
        visible: (G, K) bool, seen in the picture.
        points: (G, K, 3) keypoints in the camera frame, metres.
        cameras: (G, 3, 3) K' = M K, which maps those points to those pixels.
        diameters: (G,) metres.
        poses: (G, 4, 4) canonical camera_from_object.
        seen: (G,) share of the instance that is visible in the picture.
        ignored: (G,) bool, seen too little to be learnt or to be background.
        places: (G,) index of the instance in its record; in a mosaic, among those of all of its records.
    """

    classes: NDArray[np.int64]
    boxes: FloatArray
    keypoints: FloatArray
    visible: NDArray[np.bool_]
    points: FloatArray
    cameras: FloatArray
    diameters: FloatArray
    poses: FloatArray
    seen: FloatArray
    ignored: NDArray[np.bool_]
    places: NDArray[np.int64]

    @classmethod
    def joined(cls, parts: Sequence[Labels]) -> Labels:
        """The labels of several pictures that share one canvas."""
        names = cls.__dataclass_fields__
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


@dataclass(frozen=True, eq=False)
class TrainedObject:
    """One class, ready for labels and figures.

    Attributes:
        index: label of the network.
        keypoints: (K, 3); outline: (P, 3) points that bound every view; surface: (N, 3) samples; metres. K, P and N are
            the same for all objects.
    """

    index: int
    model: ObjectModel
    keypoints: FloatArray
    outline: FloatArray
    surface: FloatArray
    canonical: CanonicalView


def read_records(splits: Sequence[Path]) -> list[ImageRecord]:
    """All images with a picture file and a camera, in order of folders and numbers.

    Raises:
        DataError: a split is missing, or no image remains.
    """
    found = [record for split in splits for scene in list_scenes(split) for record in read_scene(scene)]
    usable = [r for r in found if r.rgb_path is not None and r.camera_matrix is not None and r.instances]
    if splits and not usable:
        raise DataError(f"{', '.join(map(str, splits))} hold no image with a picture, a camera and an object.")
    return usable


def prepare_objects(
    catalogue: Catalogue, records: Sequence[ImageRecord], learnt: Mapping[int, FloatArray]
) -> dict[int, TrainedObject]:
    """Loads outlines of the meshes and chooses canonical views from the poses in the records.

    Args:
        catalogue: the classes.
        records: with the poses to learn from.
        learnt: (3, 3) views by obj_id that the network has learnt already (`load_views`); these are kept, for others
            would turn its labels about.

    Raises:
        DataError: an object of the records is not in the catalogue, or lacks mesh or keypoints.
    """
    poses: dict[int, list[FloatArray]] = {obj_id: [] for obj_id in catalogue.obj_ids}
    for record in records:
        for instance in record.instances:
            catalogue[instance.obj_id]
            poses[instance.obj_id].append(instance.camera_from_object)
    objects: dict[int, TrainedObject] = {}
    for index, (obj_id, model) in enumerate(catalogue.objects.items()):
        if model.keypoints is None:
            raise DataError(f"object {obj_id} ({model.name}) has no keypoints; write keypoints.json.")
        mesh = model.load_mesh()
        if obj_id in learnt:
            view = CanonicalView(model.symmetries, invariant_centre(model), learnt[obj_id])
        else:
            view = canonical_view(model, np.array(poses[obj_id]).reshape(-1, 4, 4))
        surface = mesh.sample_surface(_SURFACE_SAMPLES, np.random.default_rng(0))
        outline = outline_points(mesh.vertices)
        objects[obj_id] = TrainedObject(index, model, model.keypoints, outline, surface, view)
    return objects


def outline_points(vertices: FloatArray) -> FloatArray:
    """The vertex that is extreme in each of many directions: enough for the box around any view."""
    index = np.arange(_OUTLINE_DIRECTIONS) + 0.5
    polar, turn = np.arccos(1 - 2 * index / _OUTLINE_DIRECTIONS), np.pi * (1 + 5**0.5) * index
    directions = np.stack((np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)))
    return vertices[np.argmax(vertices @ directions, axis=0)]


class PictureStore:
    """Pictures by index, decoded once and kept where asked."""

    def __init__(
        self, records: Sequence[ImageRecord], cache: bool, progress: Progress, with_instances: bool = False
    ) -> None:
        self.records, self.with_instances = tuple(records), with_instances
        self._kept: list[Picture] = []
        if cache:
            self._kept = [load_picture(r, with_instances) for r in progress.track(self.records, "reading pictures")]

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, index: int) -> Picture:
        return self._kept[index] if self._kept else load_picture(self.records[index], self.with_instances)


def load_picture(record: ImageRecord, with_instances: bool = False) -> Picture:
    """Decodes the files of a record.

    Raises:
        DataError: a file is missing or truncated, or the record has no visible masks and they are asked for.
    """
    assert record.rgb_path is not None
    depth = None if record.depth_path is None else read_depth(record.depth_path, record.depth_scale)
    image = read_image(record.rgb_path)
    return Picture(record, image, depth, _read_instances(record, image) if with_instances else None)


def require_masks(record: ImageRecord, who: str) -> tuple[Path, ...]:
    """The visible masks of a record.

    Args:
        who: options that need them, and what to do without.

    Raises:
        DataError: the data set has none.
    """
    if not record.mask_visib_paths:
        raise DataError(f"image {record.im_id} of scene {record.scene_id} has no mask_visib files, which {who}.")
    return record.mask_visib_paths


def _read_instances(record: ImageRecord, image: ImageArray) -> NDArray[np.uint8]:
    instances = np.zeros(image.shape[:2], dtype=np.uint8)
    masks = require_masks(record, "augment.pasted and, of windows, augment.bare need; set both to 0")
    for place, path in enumerate(masks):
        instances[read_mask(path) > 0] = place + 1
    return instances


def make_labels(
    picture: Picture,
    objects: dict[int, TrainedObject],
    input_from_source: FloatArray,
    region: Region,
    minimum_visible: float,
) -> Labels:
    """Labels of a picture that the affine map `input_from_source` draws into a region of the network's input."""
    record = picture.record
    assert record.camera_matrix is not None
    known = [objects[instance.obj_id] for instance in record.instances]
    upright, turn = split_roll(input_from_source @ record.camera_matrix)
    source = Region(0, 0, picture.image.shape[1], picture.image.shape[0])
    # The warped picture is what an upright camera sees of the turned object; labels follow what is seen.
    poses = _canonical(turn @ np.stack([instance.camera_from_object for instance in record.instances]), known)
    in_source = se3.inverse(turn) @ poses
    model, outline = np.stack([one.keypoints for one in known]), np.stack([one.outline for one in known])
    points = se3.act(poses, model)
    keypoints = project(upright, points)
    boxes = _boxes(upright, se3.act(poses, outline))
    source_boxes = _boxes(record.camera_matrix, se3.act(in_source, outline))
    hidden = _hidden(picture.depth, record.camera_matrix, se3.act(in_source, model))
    seen = np.array([1.0 if i.visible_fraction is None else i.visible_fraction for i in record.instances])
    # The visible fraction of the record already counts what its own border cuts off.
    seen *= np.minimum(region.share(boxes) / np.maximum(source.share(source_boxes), 1e-6), 1)
    return Labels(
        classes=np.array([one.index for one in known]),
        boxes=boxes,
        keypoints=keypoints,
        visible=~hidden & region.contains(keypoints),
        points=points,
        cameras=np.repeat(upright[None], len(known), axis=0),
        diameters=np.array([one.model.diameter for one in known]),
        poses=poses,
        seen=seen,
        ignored=seen < minimum_visible,
        places=np.arange(len(known)),
    )


def _canonical(poses: FloatArray, known: Sequence[TrainedObject]) -> FloatArray:
    """The canonical ones among the poses equivalent to (G, 4, 4)."""
    poses = poses.copy()
    for one in {id(one): one for one in known if one.model.symmetries}.values():
        rows = [row for row, other in enumerate(known) if other is one]
        poses[rows] = one.canonical.canonical(poses[rows])
    return poses


def project(camera_matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Pixels (..., 2) of points (..., 3) in front of the camera."""
    homogeneous = points @ camera_matrix.T
    return homogeneous[..., :2] / np.maximum(homogeneous[..., 2:], 1e-3)


def split_roll(camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """RQ decomposition: camera = upright @ turn, with upright triangular and its diagonal positive.

    Returns:
        (3, 3) upright camera, (4, 4) turn about the camera's centre.
    """
    # QR of the transpose with its rows and columns in reverse.
    turned, triangle = np.linalg.qr(camera[::-1].T)
    upright, turn = triangle.T[::-1, ::-1], turned.T[::-1]
    signs = np.diag(np.sign(np.diag(upright)))
    return upright @ signs, se3.from_parts(signs @ turn, np.zeros(3))


def _boxes(camera: FloatArray, outlines: FloatArray) -> FloatArray:
    """(G, 4) boxes around the projections of outlines (G, P, 3)."""
    pixels = project(camera, outlines)
    return np.concatenate((pixels.min(axis=1), pixels.max(axis=1)), axis=1)


def _hidden(depth: NDArray[np.float32] | None, camera: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Whether the depth image shows something in front of points (G, K, 3); false where there is no depth."""
    if depth is None:
        return np.zeros(points.shape[:2], dtype=np.bool_)
    pixels = np.rint(project(camera, points)).astype(int)
    inside = Region(0, 0, depth.shape[1], depth.shape[0]).contains(pixels)
    x, y = np.where(inside[..., None], pixels, 0).transpose(2, 0, 1)
    found = depth[y, x]
    return inside & (found > 0) & (found < points[..., 2] - _DEPTH_TOLERANCE)
