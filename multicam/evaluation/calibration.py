"""Whether stated uncertainties are true: of the network's keypoints, and of the poses made from them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv, ndtri

from multicam.dataset.objects import Catalogue
from multicam.evaluation.detection import FoundObject
from multicam.evaluation.points import PointSets
from multicam.evaluation.single_view import ObjectErrors
from multicam.geometry import se3
from multicam.types import FloatArray

LEVELS = np.linspace(0.05, 0.95, 19)
"""Shares at which stated and true uncertainty are compared."""


@dataclass(frozen=True, eq=False)
class KeypointErrors:
    """Keypoints of one detected object, at the symmetry of the object that fits them best.

    Attributes:
        errors: (K, 2) predicted minus true, pixels of the picture.
        std: (K, 2) standard deviations that the network states.
    """

    errors: FloatArray
    std: FloatArray

    @property
    def pixels(self) -> FloatArray:
        """(K,) lengths of the errors."""
        return np.linalg.norm(self.errors, axis=-1)


def keypoint_errors(found: FoundObject, keypoints: FloatArray, symmetries: FloatArray) -> KeypointErrors:
    """Errors of a detection's keypoints, hidden ones included.

    Args:
        keypoints: (K, 3) metres, object frame; symmetries: (count, 4, 4) object_from_object.
    """
    placed = se3.act(found.truth.camera_from_object @ symmetries, keypoints)
    errors = found.detection.keypoints - found.camera.project(placed)
    best = int(np.argmin(np.linalg.norm(errors, axis=-1).mean(axis=-1)))
    return KeypointErrors(errors[best], found.detection.std)


def all_keypoint_errors(
    found: Iterable[FoundObject], network_objects: Catalogue, points: PointSets
) -> list[KeypointErrors]:
    """Of many detections; the network's own catalogue says where its keypoints are."""
    errors: list[KeypointErrors] = []
    for one in found:
        obj_id = one.truth.obj_id
        keypoints = network_objects[obj_id].keypoints
        assert keypoints is not None, "the metadata of a network has keypoints"
        errors.append(keypoint_errors(one, keypoints, points.symmetries(obj_id)))
    return errors


def keypoint_shares(errors: Sequence[KeypointErrors], levels: FloatArray) -> FloatArray:
    """Share of keypoint coordinates inside the central interval that should hold each level of a normal variable."""
    ratios = np.concatenate([np.abs(e.errors / e.std).ravel() for e in errors])
    return np.array([np.mean(ratios <= limit) for limit in ndtri((1 + levels) / 2)])


def pose_shares(errors: Sequence[ObjectErrors], catalogue: Catalogue, levels: FloatArray) -> FloatArray:
    """Share of poses whose truth lies in the ellipsoid that should hold each level (chi-square, 6 degrees of freedom).

    The truth is taken at the symmetry that comes closest to the estimate. NaN of no poses.

    Args:
        errors: of estimates with a covariance.
    """
    if not errors:
        return np.full(len(levels), np.nan)
    squares = np.array([_mahalanobis_squared(e, catalogue) for e in errors])
    # Chi-square with 6 degrees of freedom is twice a gamma variable of shape 3.
    return np.array([np.mean(squares <= limit) for limit in 2 * gammaincinv(3, levels)])


def with_covariance(errors: Iterable[ObjectErrors]) -> list[ObjectErrors]:
    """Those whose estimate states one."""
    return [e for e in errors if e.estimate is not None and e.estimate.covariance is not None]


def best_symmetry(error: ObjectErrors, catalogue: Catalogue) -> FloatArray:
    """The true pose at the symmetry that comes closest to the estimate, (4, 4)."""
    assert error.estimate is not None
    model, true = catalogue[error.truth.obj_id], error.truth.camera_from_object
    return true @ model.symmetries.closest(error.estimate.camera_from_object, true, model.diameter / 2)


def _mahalanobis_squared(error: ObjectErrors, catalogue: Catalogue) -> float:
    assert error.estimate is not None
    assert error.estimate.covariance is not None
    twist = se3.minus(best_symmetry(error, catalogue), error.estimate.camera_from_object)
    return float(twist @ np.linalg.solve(error.estimate.covariance, twist))
