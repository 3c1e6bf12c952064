"""Error of an estimated camera pose against the true one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.geometry import se3, so3
from multicam.types import FloatArray

INSIDE_95 = 12.591587243743977
"""95 % quantile of chi-square with 6 degrees of freedom."""


@dataclass(frozen=True)
class CameraError:
    """Distance between two poses of one camera.

    Attributes:
        rotation_deg: angle of the rotation between them.
        centre_mm: distance of the two camera centres.
        inside: whether the truth lies in the stated 95 % ellipsoid, or None where no covariance was stated.
    """

    rotation_deg: float
    centre_mm: float
    inside: bool | None = None


def camera_error(estimated: FloatArray, true: FloatArray, covariance: FloatArray | None = None) -> CameraError:
    """Error of an estimated reference_from_camera, both (4, 4) in metres; `covariance` (6, 6) is the estimate's."""
    angle = float(np.degrees(np.linalg.norm(so3.log(estimated[:3, :3].T @ true[:3, :3]))))
    distance = 1000 * float(np.linalg.norm(estimated[:3, 3] - true[:3, 3]))
    if covariance is None:
        return CameraError(angle, distance)
    twist = se3.minus(true, estimated)
    return CameraError(angle, distance, bool(twist @ np.linalg.solve(covariance, twist) <= INSIDE_95))
