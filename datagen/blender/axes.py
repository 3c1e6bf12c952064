"""Our cameras as Blender's: the one place where axes and sensor conventions change.

Ours: x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel. Blender: x right, y up, looking
along -z; lens in sensor units, principal point as a shift in shares of the larger image side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multicam.errors import DataError
from multicam.geometry.camera import Camera

SENSOR_MM = 36.0
OURS_FROM_BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Lens:
    """Blender's camera data for sensor_fit AUTO and a sensor width of SENSOR_MM."""

    focal_mm: float
    shift_x: float
    shift_y: float


def world_from_blender_camera(world_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) matrix_world of a Blender camera."""
    return world_from_camera @ OURS_FROM_BLENDER


def lens_of(camera: Camera) -> Lens:
    """Lens and shifts that give the camera's matrix.

    Raises:
        DataError: distortion, skew or pixels that are not square, which this renderer does not make.
    """
    k = camera.matrix
    if camera.distortion or abs(k[0, 1]) > 1e-9 or abs(k[0, 0] - k[1, 1]) > 1e-9 * k[0, 0]:
        raise DataError(f"Blender renders ideal lenses with square pixels; the camera matrix is {k.tolist()}.")
    side = max(camera.width, camera.height)
    return Lens(
        focal_mm=float(k[0, 0] * SENSOR_MM / side),
        shift_x=float(-(k[0, 2] - (camera.width - 1) / 2) / side),
        shift_y=float((k[1, 2] - (camera.height - 1) / 2) / side),
    )
