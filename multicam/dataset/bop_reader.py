"""BOP scenes as frozen records in metres. Format: bop_toolkit, docs/bop_datasets_format.md."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.dataset.units import MILLIMETRE, transform_from_bop
from multicam.errors import DataError, describe
from multicam.files import read_json, require_file, require_folder
from multicam.types import FloatArray, ImageArray

IMAGE_SUFFIXES = (".jpg", ".png", ".jpeg")


@dataclass(frozen=True, eq=False)
class Instance:
    """Ground truth of one object in one image.

    Attributes:
        camera_from_object: (4, 4) metres.
        box: (4,) amodal x0 y0 x1 y1 pixels (may leave the image), or None.
        visible_fraction: share of the silhouette that is seen, or None.
        keypoints: (K, 2) pixels, or None where the scene has no keypoint file.
        keypoints_visible: (K,) bool, or None.
    """

    obj_id: int
    camera_from_object: FloatArray
    box: FloatArray | None = None
    visible_fraction: float | None = None
    keypoints: FloatArray | None = None
    keypoints_visible: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """One image of a BOP scene.

    Attributes:
        camera_matrix: (3, 3), or None where the data set publishes none.
        camera_from_world: (4, 4) metres, or None.
        depth_scale: millimetres per raw unit of the depth image.
        rgb_path, depth_path: files, or None where absent.
        mask_visib_paths: per instance, empty where absent.
        alpha_path: share of each pixel that labelled objects cover, 8 bits, or None; our renders have it.
    """

    scene_id: int
    im_id: int
    camera_matrix: FloatArray | None
    camera_from_world: FloatArray | None
    depth_scale: float
    rgb_path: Path | None
    depth_path: Path | None
    mask_visib_paths: tuple[Path, ...]
    instances: tuple[Instance, ...]
    alpha_path: Path | None = None


def list_scenes(split: Path) -> list[Path]:
    """Scene folders of a split such as `train` or `test`, in order of their numbers.

    Raises:
        DataError: the folder is missing or holds no scene.
    """
    require_folder(split, "split folder")
    scenes = sorted(p for p in split.iterdir() if p.is_dir() and p.name.isdigit())
    if not scenes:
        raise DataError(f"{split} holds no scene folders such as 000001.")
    return scenes


def read_scene(folder: Path) -> list[ImageRecord]:
    """Reads the JSON files of one scene; pixels stay on disk.

    Raises:
        DataError: missing or malformed files; the sentence names file and image.
    """
    require_folder(folder, "scene folder")
    cameras = _read_table(folder / "scene_camera.json")
    truth, infos, keypoints = (
        _read_table(path) if (path := folder / f"{name}.json").is_file() else None
        for name in ("scene_gt", "scene_gt_info", "scene_keypoints")
    )
    # Where there is ground truth, an image that it lacks was left half-written by a writer that was killed.
    keys = cameras.keys() if truth is None else cameras.keys() & truth.keys()
    records: list[ImageRecord] = []
    for key in sorted(keys, key=int):
        try:
            rows = (table.get(key) if table else None for table in (truth, infos, keypoints))
            records.append(_read_image(folder, int(key), cameras[key], *rows))
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise DataError(f"{folder}: image {key} does not follow the BOP format: {describe(error)}.") from error
    return records


def read_camera_matrices(folder: Path) -> dict[int, FloatArray]:
    """Camera matrices (3, 3) of a scene's images by their numbers; images without one are left out.

    Reads scene_camera.json and nothing else: work that must not see ground truth uses this.

    Raises:
        DataError: missing or malformed file; the sentence names file and image.
    """
    path = folder / "scene_camera.json"
    matrices: dict[int, FloatArray] = {}
    for key, camera in _read_table(path).items():
        try:
            matrix = _camera_matrix(camera)
        except (ValueError, TypeError) as error:
            raise DataError(f"{path}: image {key}: {error}.") from error
        if matrix is not None:
            matrices[int(key)] = matrix
    return matrices


def read_image(path: Path) -> ImageArray:
    """Reads an image as (h, w, 3) uint8 RGB.

    Raises:
        DataError: missing, truncated or not an image.
    """
    return np.ascontiguousarray(_decode(path, cv2.IMREAD_COLOR)[:, :, ::-1])


def read_depth(path: Path, depth_scale: float) -> np.ndarray:
    """Reads a 16-bit depth image as (h, w) float32 metres, 0 where unknown.

    Raises:
        DataError: missing, truncated or not a one-channel image.
    """
    raw = _decode(path, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2:
        raise DataError(f"{path} has {raw.shape[2]} channels; a depth image has one.")
    return raw.astype(np.float32) * np.float32(depth_scale * MILLIMETRE)


def read_mask(path: Path) -> NDArray[np.uint8]:
    """Reads a mask or an alpha channel as (h, w) uint8, 255 where it is full.

    Raises:
        DataError: missing, truncated or not an image.
    """
    return _decode(path, cv2.IMREAD_GRAYSCALE)


def find_image(folder: Path, kinds: tuple[str, ...], stem: str) -> Path | None:
    """The first existing folder/kind/stem.suffix, or None."""
    candidates = (folder / kind / f"{stem}{suffix}" for kind in kinds for suffix in IMAGE_SUFFIXES)
    return next((p for p in candidates if p.is_file()), None)


def _read_table(path: Path) -> dict[str, Any]:
    """Image number to what the file says of it."""
    table = read_json(path)
    if not isinstance(table, dict) or not all(str(key).isdigit() for key in table):
        raise DataError(f"{path} must map image numbers to their data, as the BOP format says.")
    return table


def _decode(path: Path, flags: int) -> NDArray[Any]:
    require_file(path, "image")
    data = path.read_bytes()
    decoded: Any = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags) if _is_complete(data) else None
    if decoded is None:
        raise DataError(f"{path} is not a readable image ({len(data)} bytes): is the file truncated?")
    return decoded


def _is_complete(data: bytes) -> bool:
    """OpenCV before 4.11 fills the missing end of a truncated JPEG with grey; its closing marker tells."""
    if not data.startswith(b"\xff\xd8"):
        return len(data) > 0
    # The header may hold a thumbnail with an end marker of its own, so it is skipped up to the start of scan.
    position = 2
    while data[position : position + 1] == b"\xff" and data[position + 1 : position + 2] != b"\xda":
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return b"\xff\xd9" in data[position:]


def _camera_matrix(camera: dict[str, Any]) -> FloatArray | None:
    if "cam_K" not in camera:
        return None
    matrix = np.array(camera["cam_K"], dtype=np.float64)
    if matrix.size != 9 or not np.all(np.isfinite(matrix)) or matrix[0] <= 0 or matrix[4] <= 0:
        raise ValueError(f"cam_K is no camera matrix: {matrix.tolist()}")
    return matrix.reshape(3, 3)


def _read_image(folder: Path, im_id: int, camera: Any, truth: Any, infos: Any, keypoints: Any) -> ImageRecord:
    if not isinstance(camera, dict):
        raise TypeError(f"expected an object in scene_camera.json, got {camera!r}")
    stem = f"{im_id:06d}"
    instances: list[Instance] = []
    for index, row in enumerate(truth or []):
        box, fraction, points, visible = None, None, None, None
        if infos is not None:
            x, y, w, h = infos[index]["bbox_obj"]
            box = np.array([x, y, x + w, y + h], dtype=np.float64)
            fraction = float(infos[index]["visib_fract"])
        if keypoints is not None:
            table = np.array(keypoints[index], dtype=np.float64).reshape(-1, 3)
            points, visible = table[:, :2], table[:, 2] > 0
        pose = transform_from_bop(row["cam_R_m2c"], row["cam_t_m2c"])
        instances.append(Instance(int(row["obj_id"]), pose, box, fraction, points, visible))
    masks = tuple(folder / "mask_visib" / f"{stem}_{i:06d}.png" for i in range(len(instances)))
    return ImageRecord(
        scene_id=int(folder.name),
        im_id=im_id,
        camera_matrix=_camera_matrix(camera),
        camera_from_world=transform_from_bop(camera["cam_R_w2c"], camera["cam_t_w2c"])
        if "cam_R_w2c" in camera
        else None,
        depth_scale=float(camera.get("depth_scale", 1.0)),
        rgb_path=find_image(folder, ("rgb", "gray"), stem),
        depth_path=find_image(folder, ("depth",), stem),
        mask_visib_paths=masks if masks and masks[0].is_file() else (),
        instances=tuple(instances),
        alpha_path=find_image(folder, ("alpha",), stem),
    )
