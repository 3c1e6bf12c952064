"""Keypoints behind an estimate: what a detector saw of an object, as observations of its pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multicam.dataset.objects import Catalogue
from multicam.types import FloatArray, ObjectEstimate


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of one estimate.

    Attributes:
        points: (k, 3) metres, object frame.
        pixels, std: (k, 2) where they were seen, and the standard deviations.
        camera_matrix: (3, 3).
    """

    points: FloatArray
    pixels: FloatArray
    std: FloatArray
    camera_matrix: FloatArray


def keypoints_of(estimate: ObjectEstimate, camera_matrix: FloatArray | None, catalogue: Catalogue) -> Keypoints | None:
    """Those that are numbers; None if there is none, or if the object or the camera is not known well enough.

    Objects with a continuous symmetry keep their poses, whose covariances leave the turn open: their keypoints follow
    whatever turn the detector chose in that picture.
    """
    model, seen = catalogue[estimate.obj_id], estimate.detection
    if seen is None or camera_matrix is None or model.keypoints is None or model.symmetries.axes:
        return None
    usable = np.isfinite(np.hstack((seen.keypoints, seen.std))).all(axis=1)
    if not usable.any():
        return None
    return Keypoints(model.keypoints[usable], seen.keypoints[usable], seen.std[usable], camera_matrix)
