"""Reads the files of M3T (https://github.com/DLR-RM/3DObjectTracking): binary models, matrices, OpenCV's YAML."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from multicam.geometry.camera import Camera

OFFSETS = 30
"""Room for depth offsets in every point of a file, however many are used."""

CONTOUR_POINT = np.dtype(
    [
        ("point", "<f4", 3),
        ("normal", "<f4", 3),
        ("foreground", "<f4"),
        ("background", "<f4"),
        ("offset", "<f4", OFFSETS),
    ]
)
SURFACE_POINT = np.dtype([("point", "<f4", 3), ("normal", "<f4", 3), ("offset", "<f4", OFFSETS)])

PARAMETERS = np.dtype(
    [
        ("kind", "S1"),
        ("version", "<i4"),
        ("sphere_radius", "<f4"),
        ("n_divides", "<i4"),
        ("n_points", "<i4"),
        ("max_radius_depth_offset", "<f4"),
        ("stride_depth_offset", "<f4"),
        ("use_random_seed", "?"),
        ("image_size", "<i4"),
    ]
)
BODY = np.dtype(
    [
        ("unit", "<f4"),
        ("counterclockwise", "?"),
        ("culling", "?"),
        ("diameter", "<f4"),
        ("columns", "<f4", (4, 4)),
    ]
)


@dataclass(frozen=True, eq=False)
class M3tModel:
    """One binary model.

    Attributes:
        parameters, body: records of PARAMETERS and BODY.
        points: (V, N) records of CONTOUR_POINT or SURFACE_POINT.
        direction: (V, 3) from the camera to the body, body frame.
        measure: (V,) contour length in metres or surface area in square metres.
    """

    parameters: Any
    body: Any
    points: np.ndarray
    direction: np.ndarray
    measure: np.ndarray


def read_model(path: Path) -> M3tModel:
    """Reads a region or a depth model, whichever it is."""
    stream = io.BytesIO(path.read_bytes())
    parameters = _record(stream, PARAMETERS)
    stream.read(_count(stream))
    body = _record(stream, BODY)
    region = parameters["kind"] == b"r"
    associated = [_count(stream) for _ in range(5 if region else 1)]
    assert not any(associated), "models with associated bodies are not read"
    point = CONTOUR_POINT if region else SURFACE_POINT
    view = np.dtype([("points", point, int(parameters["n_points"])), ("direction", "<f4", 3), ("measure", "<f4")])
    views = np.frombuffer(stream.read(_count(stream) * view.itemsize), dtype=view)
    return M3tModel(parameters, body, views["points"], views["direction"], views["measure"])


def read_matrix(path: Path) -> np.ndarray:
    """Reads a matrix written as text: name, shape and rows of numbers ending in commas."""
    rows = [[float(x) for x in line.split(",") if x.strip()] for line in path.read_text().splitlines()[1:] if line]
    return np.array(rows[1:]).reshape(int(rows[0][0]), int(rows[0][1]))


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads OpenCV's dialect of YAML; its matrices become arrays."""
    text = path.read_text().replace("%YAML:1.2", "").replace("!!opencv-matrix", "")
    values = yaml.safe_load(text)
    return {
        key: np.array(value["data"]).reshape(value["rows"], value["cols"])
        if isinstance(value, dict) and "data" in value
        else value
        for key, value in values.items()
    }


def read_camera(path: Path) -> tuple[Camera, np.ndarray]:
    """Reads intrinsics and world_from_camera."""
    values = read_yaml(path)
    k = values["intrinsics"]
    matrix = np.array([[k["f_u"], 0, k["pp_x"]], [0, k["f_v"], k["pp_y"]], [0, 0, 1]])
    return Camera(matrix, k["width"], k["height"]), values["camera2world_pose"]


def _record(stream: io.BytesIO, dtype: np.dtype) -> Any:
    return np.frombuffer(stream.read(dtype.itemsize), dtype=dtype)[0]


def _count(stream: io.BytesIO) -> int:
    return int(np.frombuffer(stream.read(8), dtype="<u8")[0])
