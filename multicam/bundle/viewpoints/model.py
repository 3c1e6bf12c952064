"""Sparse viewpoint model: points of an object's contour and surface as seen from all around, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from multicam.bundle.viewpoints.compiled import closest_view
from multicam.errors import DataError
from multicam.files import require_file, write_atomic
from multicam.types import FloatArray

Float32Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ViewpointModel:
    """Sparse viewpoint model as ICG and M3T have it (Stoiber et al., CVPR 2022 and IROS 2023).

    All arrays are float32, read-only, in metres and in the object frame; V views, N contour points, M surface points,
    K depth offsets. The large ones are mapped from a file, where all of one view lies together. Points of a view stand
    in random order, so that the first n are as good as any n. A view whose `contour_length` or `surface_area` is zero
    has no contour or surface points: theirs are all zero.

    Attributes:
        direction: (V, 3) unit; the camera's optical axis, which runs through the origin of the object.
        contour_length: (V,) number of pixels on the contour times the size of a pixel at the distance of the origin.
        contour_point: (V, N, 3) on the border of the silhouette.
        contour_normal: (V, N, 3) unit, outward, parallel to the image plane of the view.
        foreground, background: (V, N) from the contour point along minus and plus its normal: how far the silhouette
            reaches, and how far there is none of it; infinite where the line meets no border again.
        contour_offset: (V, N, K) how much nearer to the camera, along the optical axis, the object comes than the point
            within the radius (k + 1) `offset_step` around it; never negative, never falling with k.
        surface_area: (V,) number of pixels of the silhouette times the area of a pixel at the distance of the origin.
        surface_point, surface_normal: (V, M, 3) seen by the camera; normals are unit and face it.
        surface_offset: (V, M, K).
        offset_step: step of the radius between two depth offsets.
    """

    direction: Float32Array
    contour_length: Float32Array
    contour_point: Float32Array
    contour_normal: Float32Array
    foreground: Float32Array
    background: Float32Array
    contour_offset: Float32Array
    surface_area: Float32Array
    surface_point: Float32Array
    surface_normal: Float32Array
    surface_offset: Float32Array
    offset_step: float

    def closest_view(self, camera_from_object: FloatArray) -> int:
        """Index of the view that sees the object most as a pose (4, 4) does; an object at the camera gets view 0."""
        return closest_view(self.direction, camera_from_object)


_STEP = "offset_step"
_SMALL = ("direction", "contour_length", "surface_area")
_LARGE = (
    "contour_point",
    "contour_normal",
    "foreground",
    "background",
    "contour_offset",
    "surface_point",
    "surface_normal",
    "surface_offset",
)


def save(model: ViewpointModel, path: Path) -> None:
    """Writes a model atomically as one .npy file of records, one for each view."""
    layout = [(_STEP, "<f8")]
    layout += [(name, "<f4", getattr(model, name).shape[1:]) for name in _SMALL + _LARGE]
    records = np.empty(len(model.direction), dtype=np.dtype(layout))
    records[_STEP] = model.offset_step
    for name in _SMALL + _LARGE:
        records[name] = getattr(model, name)
    with write_atomic(path) as temporary:
        np.save(temporary, records, allow_pickle=False)


def load(path: Path) -> ViewpointModel:
    """Maps a model from its file: only the views that are looked at are read.

    Raises:
        DataError: the file is missing, cut short, has gaps or holds something else. The numbers between are not looked
            at, for that would read the whole file.
    """
    require_file(path, "viewpoint model")
    try:
        records = np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    except (ValueError, EOFError, OSError) as error:
        raise DataError(f"{path} is no viewpoint model: {error}.") from error
    names = (_STEP, *_SMALL, *_LARGE)
    if records.ndim != 1 or records.dtype.names != names:
        raise DataError(f"{path} is no viewpoint model: its array of {records.ndim} axes holds {records.dtype}.")
    # Those that a search goes through are laid out for it; of the others, one view lies in one piece.
    arrays = {name: np.ascontiguousarray(records[name]) for name in _SMALL}
    if not np.allclose(np.linalg.norm(arrays["direction"], axis=1), 1, atol=1e-3):
        raise DataError(f"{path} is damaged: some of its views have no direction.")
    for values in arrays.values():
        values.flags.writeable = False
    return ViewpointModel(offset_step=float(records[_STEP][0]), **arrays, **{name: records[name] for name in _LARGE})
