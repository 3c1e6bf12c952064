"""Records to BOP folders; millimetres begin here. Every file is written by rename, and an image counts as written
only when scene_gt.json names it, which happens last: a killed writer leaves no torn and no half-labelled image."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.dataset.objects import Catalogue
from multicam.dataset.units import MILLIMETRE
from multicam.files import find_leftovers, read_json, write_bytes, write_json
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh, save_ply
from multicam.types import FloatArray, ImageArray

DEPTH_SCALE = 0.1
"""Millimetres per raw unit, as BOP's synthetic sets use."""


@dataclass(frozen=True, eq=False)
class InstanceLabels:
    """Labels of one object in one image.

    Attributes:
        box: (4,) amodal x0 y0 x1 y1, pixels, may leave the image.
        mask: (h, w) bool, whole silhouette inside the image.
        mask_visible: (h, w) bool.
        visible_fraction: visible pixels over all pixels of the silhouette (those outside the image included).
        pixel_count: pixels of the whole silhouette, those outside the image included.
        keypoints: (K, 2) pixels; keypoints_visible: (K,) bool.
    """

    obj_id: int
    camera_from_object: FloatArray
    box: FloatArray
    mask: NDArray[np.bool_]
    mask_visible: NDArray[np.bool_]
    visible_fraction: float
    pixel_count: int
    keypoints: FloatArray
    keypoints_visible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """One rendered picture with everything known of it.

    Attributes:
        depth: (h, w) metres, 0 where unknown; None for a camera that gives none.
        alpha: (h, w) share of each pixel of `image` that labelled objects cover, 0..1, or None.
        jpeg_quality: of the stored picture, 0..100.
    """

    camera: Camera
    camera_from_world: FloatArray
    image: ImageArray
    depth: NDArray[np.float32] | None
    instances: tuple[InstanceLabels, ...]
    alpha: NDArray[np.float32] | None = None
    jpeg_quality: int = 95


@dataclass
class SceneWriter:
    """Adds images to one BOP scene folder; opening an existing folder continues it."""

    folder: Path
    _tables: dict[str, dict[str, Any]] = field(init=False)

    _FILES = ("scene_camera", "scene_gt_info", "scene_keypoints", "scene_gt")
    """In the order of writing: scene_gt comes last and makes the image exist."""

    def __post_init__(self) -> None:
        self._tables = {}
        for name in self._FILES:
            path = self.folder / f"{name}.json"
            self._tables[name] = read_json(path) if path.is_file() else {}
        done = self._tables["scene_gt"].keys()
        for name in self._FILES:
            self._tables[name] = {k: v for k, v in self._tables[name].items() if k in done}

    @property
    def completed(self) -> set[int]:
        """Ids of the images that are wholly written."""
        return {int(key) for key in self._tables["scene_gt"]}

    def tidy(self) -> None:
        """Removes what a killed writer left behind: temporary files, and pixels of images that do not exist."""
        for path in find_leftovers(self.folder):
            path.unlink()
        for path in self.folder.glob("*/*"):
            number = path.stem.split("_")[0]
            if number.isdigit() and int(number) not in self.completed:
                path.unlink()

    def add(self, im_id: int, picture: LabelledImage) -> None:
        """Writes pixels, masks, depth and labels of one image, atomically as a whole."""
        stem, key = f"{im_id:06d}", str(im_id)
        if not self._tables["scene_gt"]:
            # To a reader a scene without this file is one without ground truth, not one that has just begun.
            write_json(self.folder / "scene_gt.json", {})
        self._encode("rgb", f"{stem}.jpg", picture.image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, picture.jpeg_quality])
        if picture.depth is not None:
            raw = np.rint(picture.depth / (DEPTH_SCALE * MILLIMETRE))
            # What lies beyond 16 bits (6.5 m) is unknown; clipped, it would be a wall.
            raw = np.where(raw > 65535, 0, raw).astype(np.uint16)
            self._encode("depth", f"{stem}.png", raw, [])
        if picture.alpha is not None:
            self._encode("alpha", f"{stem}.png", np.rint(picture.alpha * 255).astype(np.uint8), [])
        for index, row in enumerate(picture.instances):
            for kind, mask in (("mask", row.mask), ("mask_visib", row.mask_visible)):
                self._encode(kind, f"{stem}_{index:06d}.png", mask.astype(np.uint8) * 255, [])
        self._tables["scene_camera"][key] = _camera_row(picture.camera.matrix, picture.camera_from_world)
        self._tables["scene_gt_info"][key] = [_info_row(row) for row in picture.instances]
        self._tables["scene_keypoints"][key] = [_keypoint_row(row) for row in picture.instances]
        self._tables["scene_gt"][key] = [_truth_row(row) for row in picture.instances]
        for name in self._FILES:
            # In the order of the images, whatever the order in which they came to be.
            table = sorted(self._tables[name].items(), key=lambda row: int(row[0]))
            write_json(self.folder / f"{name}.json", dict(table))

    def _encode(self, kind: str, name: str, pixels: NDArray[Any], options: list[int]) -> None:
        suffix = Path(name).suffix
        done, data = cv2.imencode(suffix, pixels, options)
        if not done:
            raise OSError(f"OpenCV could not encode {kind}/{name}")
        write_bytes(self.folder / kind / name, data.tobytes())


def write_models(folder: Path, catalogue: Catalogue, meshes: dict[int, Mesh]) -> None:
    """Writes PLY files (mm), keypoints.json (mm) and, last, models_info.json of a BOP models folder."""
    info: dict[str, Any] = {}
    for obj_id, mesh in meshes.items():
        model = catalogue[obj_id]
        save_ply(mesh, folder / f"obj_{obj_id:06d}.ply", 1 / MILLIMETRE)
        low, high = mesh.box / MILLIMETRE
        row: dict[str, Any] = {"name": model.name, "diameter": model.diameter / MILLIMETRE}
        for axis, least, size in zip("xyz", low, high - low, strict=True):
            row |= {f"min_{axis}": least, f"size_{axis}": size}
        if len(model.symmetries.discrete):
            scaled = model.symmetries.discrete.copy()
            scaled[:, :3, 3] /= MILLIMETRE
            row["symmetries_discrete"] = scaled.reshape(-1, 16).tolist()
        if model.symmetries.axes:
            row["symmetries_continuous"] = [
                {"axis": a.direction.tolist(), "offset": (a.offset / MILLIMETRE).tolist()}
                for a in model.symmetries.axes
            ]
        info[str(obj_id)] = row
    keypoints = {o: model.keypoints for o in meshes if (model := catalogue[o]).keypoints is not None}
    write_json(folder / "keypoints.json", keypoint_table(keypoints), indent=1)
    write_json(folder / "models_info.json", info, indent=1)


def keypoint_table(keypoints: dict[int, FloatArray]) -> dict[str, Any]:
    """Content of keypoints.json: class id to (K, 3) points, metres in, millimetres out."""
    return {str(obj_id): (points / MILLIMETRE).tolist() for obj_id, points in keypoints.items()}


def pose_row(transform: FloatArray, source: str) -> dict[str, Any]:
    """BOP's two entries of a camera_from_source pose, `source` being m2c or w2c; millimetres."""
    return {
        f"cam_R_{source}": transform[:3, :3].reshape(-1).tolist(),
        f"cam_t_{source}": (transform[:3, 3] / MILLIMETRE).tolist(),
    }


def _camera_row(matrix: FloatArray, camera_from_world: FloatArray) -> dict[str, Any]:
    return {"cam_K": matrix.reshape(-1).tolist(), "depth_scale": DEPTH_SCALE} | pose_row(camera_from_world, "w2c")


def _truth_row(row: InstanceLabels) -> dict[str, Any]:
    return {"obj_id": row.obj_id} | pose_row(row.camera_from_object, "m2c")


def _info_row(row: InstanceLabels) -> dict[str, Any]:
    x0, y0, x1, y1 = (float(v) for v in row.box)
    visible = int(row.mask_visible.sum())
    return {
        "bbox_obj": [x0, y0, x1 - x0, y1 - y0],
        "bbox_visib": _mask_box(row.mask_visible),
        "px_count_all": row.pixel_count,
        "px_count_valid": int(row.mask.sum()),
        "px_count_visib": visible,
        "visib_fract": float(row.visible_fraction),
    }


def _keypoint_row(row: InstanceLabels) -> list[list[float]]:
    return [[float(x), float(y), int(v)] for (x, y), v in zip(row.keypoints, row.keypoints_visible, strict=True)]


def _mask_box(mask: NDArray[np.bool_]) -> list[int]:
    """x, y, width, height of the pixels set, or BOP's [-1, -1, -1, -1] for none."""
    ys, xs = np.nonzero(mask)
    if len(xs) == 0:
        return [-1, -1, -1, -1]
    return [int(xs.min()), int(ys.min()), int(xs.max() - xs.min() + 1), int(ys.max() - ys.min() + 1)]
