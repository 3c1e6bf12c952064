"""Catalogue of known objects: a BOP `models/` folder as frozen records in metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from multicam.dataset.units import MILLIMETRE, transform_from_bop
from multicam.errors import DataError, describe
from multicam.files import read_json, require_folder
from multicam.geometry.mesh import Mesh, load_mesh
from multicam.geometry.symmetry import Axis, Symmetries
from multicam.types import FloatArray

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb")


_UPPER = np.stack(np.meshgrid([False, True], [False, True], [False, True], indexing="ij"), axis=-1).reshape(8, 3)
"""Which bound of the box each of its corners takes."""


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """What is known of one object class.

    Attributes:
        diameter: greatest extent, metres.
        box: (2, 3) corners of the axis-aligned box in the object frame, metres; None if the source has none.
        keypoints: (K, 3) metres, or None for catalogues without keypoints.
        mesh_path: file of the mesh, or None.
    """

    obj_id: int
    name: str
    diameter: float
    symmetries: Symmetries
    box: FloatArray | None = None
    keypoints: FloatArray | None = None
    mesh_path: Path | None = None

    def __post_init__(self) -> None:
        if not 1e-3 < self.diameter < 10:
            raise DataError(
                f"object {self.obj_id} ({self.name}) has a diameter of {self.diameter * 1000:g} mm, which is outside "
                "1 mm to 10 m: models_info.json must be in millimetres (BOP format), is it in metres?"
            )
        for name, points in (("box", self.box), ("keypoints", self.keypoints)):
            span = self.diameter if points is None else float(np.linalg.norm(np.ptp(points, axis=0)))
            if not 0.05 < span / self.diameter < 2:
                raise DataError(
                    f"object {self.obj_id} ({self.name}) is {self.diameter * 1000:g} mm across but its {name} "
                    f"{span * 1000:g} mm: they must be in the same unit (BOP format: millimetres)."
                )

    def box_corners(self) -> FloatArray:
        """(8, 3) corners of the box, or of a cube of the same diameter where no box is known; metres; read-only."""
        return self._corners

    def box_centre(self) -> FloatArray:
        """(3,) middle of that box; metres; read-only."""
        return self._centre

    @cached_property
    def _corners(self) -> FloatArray:
        if self.box is None:
            half = self.diameter / 2 / np.sqrt(3)
            box = np.array([[-half] * 3, [half] * 3])
        else:
            box = self.box
        return _read_only(np.where(_UPPER, box[1], box[0]))

    @cached_property
    def _centre(self) -> FloatArray:
        return _read_only(self._corners.mean(axis=0))

    def load_mesh(self) -> Mesh:
        """Loads the mesh in metres.

        Raises:
            DataError: there is none, or its size contradicts models_info.json (a file in the wrong unit).
        """
        if self.mesh_path is None:
            raise DataError(f"object {self.obj_id} ({self.name}) has no mesh file in its models folder.")
        # glTF fixes the metre; every other mesh of a BOP folder is in millimetres.
        mesh = load_mesh(self.mesh_path, 1.0 if self.mesh_path.suffix == ".glb" else MILLIMETRE)
        found = mesh.diameter()
        if not 0.8 < found / self.diameter < 1.25:
            raise DataError(
                f"{self.mesh_path} is {found * 1000:.4g} mm across but models_info.json says "
                f"{self.diameter * 1000:.4g} mm: is the mesh in another unit than "
                f"{'metres' if self.mesh_path.suffix == '.glb' else 'millimetres'}?"
            )
        return mesh


@dataclass(frozen=True, eq=False)
class Catalogue:
    """The objects of a data set, by class id in ascending order."""

    objects: dict[int, ObjectModel]

    def __getitem__(self, obj_id: int) -> ObjectModel:
        """The object of a class.

        Raises:
            DataError: the class is unknown; the sentence lists the known ones.
        """
        if obj_id not in self.objects:
            known = ", ".join(f"{o.obj_id} ({o.name})" for o in self.objects.values())
            raise DataError(f"unknown object class {obj_id}; the catalogue holds {known}.")
        return self.objects[obj_id]

    def __contains__(self, obj_id: object) -> bool:
        return obj_id in self.objects

    @property
    def obj_ids(self) -> tuple[int, ...]:
        """Class ids, ascending; a network's label i means obj_ids[i]."""
        return tuple(self.objects)


def load_catalogue(folder: Path) -> Catalogue:
    """Reads `models_info.json` (and `keypoints.json` where present) of a BOP models folder.

    A data set's root is taken as well: its `models/` is used, unless models_info.json stands in the root itself.

    Raises:
        DataError: files missing or malformed, wrong units, keypoints for unknown classes.
    """
    require_folder(folder, "models folder")
    info_folder = folder if (folder / "models_info.json").is_file() else folder / "models"
    mesh_folder = folder / "models" if (folder / "models").is_dir() else folder
    info_path = info_folder / "models_info.json"
    info = read_json(info_path)
    keypoint_path = next((p for p in (info_folder, mesh_folder) if (p / "keypoints.json").is_file()), None)
    keypoints: Any = read_json(keypoint_path / "keypoints.json") if keypoint_path else {}
    if not isinstance(info, dict) or not info:
        raise DataError(f"{info_path} must map class ids to objects, as the BOP format says; it holds none.")
    if not isinstance(keypoints, dict):
        raise DataError(f"{keypoint_path}/keypoints.json must map class ids to lists of points; it does not.")
    objects: dict[int, ObjectModel] = {}
    for key in sorted(info, key=lambda k: int(k) if str(k).isdigit() else -1):  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType, reportUnknownLambdaType]
        try:
            objects[int(key)] = _read_object(int(key), info[key], keypoints.get(key), mesh_folder)  # pyright: ignore[reportUnknownArgumentType]
        except (KeyError, ValueError, TypeError) as error:
            raise DataError(f"{info_path}: entry {key} does not follow the BOP format: {describe(error)}.") from error
    unknown = set(keypoints) - {str(k) for k in objects}
    if unknown:
        raise DataError(f"{keypoint_path}/keypoints.json names unknown classes {sorted(unknown)}.")
    return Catalogue(objects)


def _read_only(values: FloatArray) -> FloatArray:
    values.flags.writeable = False
    return values


def _read_object(obj_id: int, row: Any, keypoints: Any, mesh_folder: Path) -> ObjectModel:
    if not isinstance(row, dict):
        raise TypeError(f"expected an object, got {row!r}")
    box = None
    if "min_x" in row:
        low = np.array([row["min_x"], row["min_y"], row["min_z"]], dtype=np.float64)
        size = np.array([row["size_x"], row["size_y"], row["size_z"]], dtype=np.float64)
        box = np.stack((low, low + size)) * MILLIMETRE
    matrices = np.array(row.get("symmetries_discrete", []), dtype=np.float64).reshape(-1, 4, 4)
    discrete = np.array([transform_from_bop(m[:3, :3], m[:3, 3]) for m in matrices])
    axes = tuple(
        Axis(np.array(a["axis"], dtype=np.float64), np.array(a.get("offset", [0, 0, 0])) * MILLIMETRE)
        for a in row.get("symmetries_continuous", [])
    )
    mesh_path = next((p for s in MESH_SUFFIXES if (p := mesh_folder / f"obj_{obj_id:06d}{s}").is_file()), None)
    points = None if keypoints is None else np.array(keypoints, dtype=np.float64).reshape(-1, 3) * MILLIMETRE
    name = str(row.get("name", f"obj_{obj_id:06d}"))
    diameter = float(row["diameter"]) * MILLIMETRE
    return ObjectModel(obj_id, name, diameter, Symmetries(discrete, axes), box, points, mesh_path)
