"""Where millimetres become metres and published numbers become transforms."""

from __future__ import annotations

from typing import Any

import numpy as np

from multicam.geometry import se3, so3
from multicam.types import FloatArray

MILLIMETRE = 1e-3


def transform_from_bop(rotation: Any, translation_mm: Any) -> FloatArray:
    """(4, 4) metres from BOP's nine row-major numbers and millimetres; the rotation is cleaned of rounding.

    Raises:
        ValueError: wrong count, NaN, or numbers that are no rotation.
    """
    r, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation_mm, dtype=np.float64)
    if r.size != 9 or t.size != 3:
        raise ValueError(f"a pose needs 9 rotation and 3 translation numbers, got {r.size} and {t.size}")
    if not (np.all(np.isfinite(r)) and np.all(np.isfinite(t))):
        raise ValueError("pose holds NaN or infinity")
    r = r.reshape(3, 3)
    if np.abs(r @ r.T - np.eye(3)).max() > 1e-2 or np.linalg.det(r) < 0:
        raise ValueError("rotation is not orthonormal, or mirrors")
    return se3.from_parts(so3.project(r), t.reshape(3) * MILLIMETRE)
