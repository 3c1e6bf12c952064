"""Starting poses for PnP: closed form on all keypoints, minimal samples if some are wrong, the reversed twin."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from multicam.geometry import se3
from multicam.inference.layout import normal
from multicam.types import FloatArray

_NO_CAMERA = np.eye(3)
_NO_DISTORTION = np.zeros(4)
_LEAST_SPREAD = 1.1e-5
"""Variance of the normalized image points below which OpenCV's SQPnP refuses: objects of about a degree."""

_MAX_SAMPLES = 60
"""Triples there are to be tried; all 56 of 8 keypoints, an even selection of more."""

_PARTS = 4
"""Turns in which they are tried."""


def closed_form(points: FloatArray, normalized: FloatArray) -> FloatArray:
    """Poses by SQPnP (Terzakis and Lourakis 2020), the global least squares optimum of all keypoints.

    Args:
        points: (n, 3) metres, object frame, n >= 3.
        normalized: (n, 2) image points of a camera with identity matrix.

    Returns:
        (m, 4, 4) camera_from_object; none for objects so small that the solver declines them.
    """
    if normalized.var(axis=0).sum() < _LEAST_SPREAD:
        return np.zeros((0, 4, 4))
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        points, normalized, _NO_CAMERA, _NO_DISTORTION, flags=cv2.SOLVEPNP_SQPNP
    )
    return _transforms(rotations, translations)


@cache
def sample_turns(count: int) -> tuple[NDArray[np.int64], ...]:
    """Triples of `count` keypoints (m, 3), in the turns in which to try them, each an even selection.

    All triples of few keypoints are taken, an even selection of many, so the answer needs no randomness.
    """
    triples = np.array(list(combinations(range(count), 3)))
    if len(triples) > _MAX_SAMPLES:
        triples = triples[np.linspace(0, len(triples) - 1, _MAX_SAMPLES).astype(int)]
    return tuple(triples[first::_PARTS] for first in range(_PARTS))


def minimal_samples(points: FloatArray, normalized: FloatArray, triples: NDArray[np.int64]) -> FloatArray:
    """Poses of triples (m, 3) of keypoints by P3P (Ke and Roumeliotis 2017).

    Returns:
        (s, 4, 4) camera_from_object, up to four of each triple.
    """
    rotations: list[object] = []
    translations: list[object] = []
    for triple in triples:
        _, r, t = cv2.solveP3P(points[triple], normalized[triple], _NO_CAMERA, _NO_DISTORTION, flags=cv2.SOLVEPNP_AP3P)
        rotations.extend(r)
        translations.extend(t)
    return _transforms(rotations, translations)


def reversed_twin(camera_from_object: FloatArray, points: FloatArray) -> FloatArray:
    """The pose whose picture is the same but for perspective, if the points lie in a plane or on a line.

    The points are mirrored in the plane through their centre at right angles to the line of sight v, and in
    their own plane of normal n, which leaves flat points where they are: R' = (I - 2 v v') R (I - 2 n n').

    Returns:
        (4, 4).
    """
    centre = points.mean(0)
    centre_in_camera = se3.act(camera_from_object, centre)
    sight = centre_in_camera / np.linalg.norm(centre_in_camera)
    rotation = _mirror(sight) @ camera_from_object[:3, :3] @ _mirror(normal(points))
    return se3.from_parts(rotation, centre_in_camera - rotation @ centre)


def _mirror(normal: FloatArray) -> FloatArray:
    return np.eye(3) - 2 * np.outer(normal, normal)


def _transforms(rotations: object, translations: object) -> FloatArray:
    vectors = np.asarray(rotations, dtype=np.float64).reshape(-1, 3)
    shifts = np.asarray(translations, dtype=np.float64).reshape(-1, 3)
    found = se3.exp(np.concatenate((vectors, np.zeros_like(shifts)), axis=1))
    found[:, :3, 3] = shifts
    return found[np.isfinite(found).all(axis=(1, 2))]
