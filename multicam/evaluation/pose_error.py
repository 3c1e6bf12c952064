"""Errors of an estimated object pose against the true one. Definitions as in BOP (Hodan et al. 2018, 2020).

Poses are camera_from_object, points and errors in metres. An error that symmetric objects cannot be blamed for takes
the minimum over the object's symmetries (MSSD, MSPD) or over nearest points (ADD-S).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from multicam.geometry import se3
from multicam.geometry.camera import Camera

Pose = Float64[np.ndarray, "4 4"]
Points = Float64[np.ndarray, "n 3"]


def add(estimated: Pose, true: Pose, points: Points) -> float:
    """ADD: mean distance between the same points under both poses (Hinterstoisser et al. 2012)."""
    return float(np.linalg.norm(se3.act(estimated, points) - se3.act(true, points), axis=1).mean())


def add_s(estimated: Pose, true: Pose, points: Points) -> float:
    """ADD-S: mean distance from each point under the true pose to the nearest one under the estimated pose."""
    distances, _ = KDTree(se3.act(estimated, points)).query(se3.act(true, points))
    return float(np.mean(distances))


def mssd(estimated: Pose, true: Pose, symmetries: Float64[np.ndarray, "count 4 4"], points: Points) -> float:
    """MSSD: greatest distance of any point, at the symmetry of the object for which that is least."""
    shifts = se3.act(estimated, points) - se3.act(true @ symmetries, points)
    return float(np.linalg.norm(shifts, axis=-1).max(axis=-1).min())


def mspd(
    estimated: Pose, true: Pose, symmetries: Float64[np.ndarray, "count 4 4"], points: Points, camera: Camera
) -> float:
    """MSPD: as MSSD, between projections, in pixels; infinite if the estimate has a point behind the camera."""
    placed = se3.act(estimated, points)
    if np.any(placed[:, 2] <= 0):
        return float("inf")
    shifts = camera.project(placed) - camera.project(se3.act(true @ symmetries, points))
    return float(np.linalg.norm(shifts, axis=-1).max(axis=-1).min())
