"""Errors of one network are alike in like views: how many views of an object look at it from like directions."""

from __future__ import annotations

import numpy as np

from multicam.matching.arrays import IntArray
from multicam.matching.learned import centre_in_camera
from multicam.types import FloatArray

ALIKE = np.cos(np.radians(30))
"""Cosine between directions of view, seen from the object, above which errors of one network count as related."""


def count_alike(camera_from_object: FloatArray, centre: FloatArray, obj: IntArray) -> IntArray:
    """(e,) how many edges of the same object, itself included, look at it from a like direction.

    Args:
        camera_from_object: (e, 4, 4).
        centre: (e, 3) of the objects, object frame.
        obj: (e,) which object.
    """
    ray = centre_in_camera(camera_from_object, centre)
    seen_from = np.einsum(
        "eji,ej->ei", camera_from_object[:, :3, :3], ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    )
    alike = (obj[:, None] == obj) & (seen_from @ seen_from.T > ALIKE)
    return np.sum(alike, axis=1)


def inflation(kinship: float, alike: IntArray) -> FloatArray:
    """(e,) how much larger variances are to be taken, so that like views do not count as independent ones.

    If unlike views err `kinship` times as much (variance) as all do, like views have a share 1 - 1/kinship of their
    variance in common, and n of them count for n / (1 + (n - 1) share) (Kish, Survey Sampling, 1965: design effect).
    """
    return kinship * (1 + (1 - 1 / kinship) * (alike - 1))
