"""Keypoints of an object: farthest points of its surface."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from multicam.geometry.mesh import Mesh


def farthest_points(points: Float64[np.ndarray, "n 3"], count: int) -> Float64[np.ndarray, "count 3"]:
    """Farthest point sampling: start farthest from the centroid, then repeat the max-min distance.

    Raises:
        ValueError: fewer points than asked for.
    """
    if len(points) < count:
        raise ValueError(f"{count} keypoints asked of {len(points)} points")
    first = int(np.argmax(np.linalg.norm(points - points.mean(0), axis=1)))
    chosen, distance = [first], np.linalg.norm(points - points[first], axis=1)
    for _ in range(count - 1):
        index = int(np.argmax(distance))
        chosen.append(index)
        distance = np.minimum(distance, np.linalg.norm(points - points[index], axis=1))
    return points[chosen]


def sample_keypoints(mesh: Mesh, count: int, rng: np.random.Generator) -> Float64[np.ndarray, "count 3"]:
    """Farthest points of 20 000 surface samples, metres, object frame."""
    return farthest_points(mesh.sample_surface(20_000, rng), count)
