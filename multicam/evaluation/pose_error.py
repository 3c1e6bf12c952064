"""Errors of an estimated object pose against the true one. Definitions as in BOP (Hodan et al. 2018, 2020).

Poses are camera_from_object, points and errors in metres. An error that symmetric objects cannot be blamed for takes
the minimum over the object's symmetries (MSSD, MSPD) or over nearest points (ADD-S).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from multicam.evaluation import compiled
from multicam.geometry import se3
from multicam.geometry.camera import Camera

Pose = Float64[np.ndarray, "4 4"]
Points = Float64[np.ndarray, "n 3"]

_SLACK = 0.001
"""Share by which a nearest distance may be too large: far fewer points are then looked at where a pose is far off."""


def add(estimated: Pose, true: Pose, points: Points) -> float:
    """ADD: mean distance between the same points under both poses (Hinterstoisser et al. 2012)."""
    return float(np.linalg.norm(se3.act(estimated, points) - se3.act(true, points), axis=1).mean())


def add_s(estimated: Pose, true: Pose, points: Points, tree: KDTree | None = None) -> float:
    """ADD-S: mean distance from each point under the true pose to the nearest one under the estimated pose.

    Args:
        tree: of the same points, where many poses are judged.
    """
    # Seen from the object, the estimated points stay where they are.
    moved = se3.act(se3.inverse(estimated) @ true, points)
    distances, _ = (tree or KDTree(points)).query(moved, eps=_SLACK, workers=-1)
    return float(np.mean(distances))


def mssd(estimated: Pose, true: Pose, symmetries: Float64[np.ndarray, "count 4 4"], points: Points) -> float:
    """MSSD: greatest distance of any point, at the symmetry of the object for which that is least."""
    return float(compiled.least_greatest_distance(se3.act(estimated, points), true @ symmetries, points))


def mspd(
    estimated: Pose, true: Pose, symmetries: Float64[np.ndarray, "count 4 4"], points: Points, camera: Camera
) -> float:
    """MSPD: as MSSD, between projections, in pixels; infinite if the estimate has a point behind the camera.

    Raises:
        ValueError: the lens has distortion, which BOP pictures have not.
    """
    if camera.distortion:
        raise ValueError("projections are compared as an ideal lens makes them: use camera.without_distortion()")
    placed = se3.act(estimated, points)
    if np.any(placed[:, 2] <= 0):
        return float("inf")
    projections = camera.matrix @ (true @ symmetries)[:, :3]
    return float(compiled.least_greatest_shift(camera.project(placed), projections, points))
